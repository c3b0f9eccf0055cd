"""A headless browser for the pages, where the machine has one."""

import shutil
import time
from collections.abc import Callable, Iterator
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image
from selenium import webdriver
from selenium.webdriver.chrome.service import Service
from selenium.webdriver.common.action_chains import ActionChains
from selenium.webdriver.common.by import By

BROWSER = shutil.which("chromium") or shutil.which("google-chrome")
DRIVER = shutil.which("chromedriver")
FLAGS = (
    *("--headless=new", "--no-sandbox", "--disable-dev-shm-usage", "--disable-gpu"),
    *("--hide-scrollbars", "--window-size=1280,940", "--force-device-scale-factor=1"),
)
WHY_NOT = "needs a browser: apt-get install chromium chromium-driver"
PATIENCE_S = 30


def open_browser() -> Iterator[webdriver.Chrome]:
    """Open a browser that reaches nothing but files."""
    if not (BROWSER and DRIVER):
        pytest.skip(WHY_NOT)
    options = webdriver.ChromeOptions()
    options.binary_location = BROWSER
    for flag in FLAGS:
        options.add_argument(flag)
    options.set_capability("goog:loggingPrefs", {"browser": "ALL"})
    browser = webdriver.Chrome(options=options, service=Service(DRIVER))
    browser.execute_cdp_cmd("Network.enable", {})
    offline = {"offline": True, "latency": 0, "downloadThroughput": 0, "uploadThroughput": 0}
    browser.execute_cdp_cmd("Network.emulateNetworkConditions", offline)
    yield browser
    browser.quit()


def wait_until(look: Callable[[], Any], what: str) -> Any:
    """Look again and again until something is found, and return it."""
    end = time.monotonic() + PATIENCE_S
    while time.monotonic() < end:
        if found := look():
            return found
        time.sleep(0.02)
    raise AssertionError(f"not within {PATIENCE_S} s: {what}")


class Shown:
    """A page in a browser; where the pointer is comes from what the page says of it."""

    def __init__(self, browser: webdriver.Chrome, path: Path) -> None:
        self.browser = browser
        browser.get(path.resolve().as_uri())
        self.wait("document.body.dataset.drawn")

    def run(self, script: str) -> Any:
        return self.browser.execute_script(script)

    def wait(self, expression: str) -> Any:
        """Wait until a JavaScript expression is true, and return it."""
        try:
            return wait_until(lambda: self.run(f"return {expression}"), expression)
        except AssertionError as error:
            raise AssertionError(f"{error}; it said {self.complaints}") from None

    @property
    def complaints(self) -> list[str]:
        """Errors and warnings that the browser logged."""
        logged = self.browser.get_log("browser")  # type: ignore[no-untyped-call]
        return [each["message"] for each in logged if each["level"] in {"WARNING", "SEVERE"}]

    def click(self, selector: str) -> None:
        self.browser.find_element(By.CSS_SELECTOR, selector).click()

    def choose(self, name: str, value: str | int, event: str) -> None:
        """Set what a control holds, as a hand would."""
        script = (
            "const [name, value, event] = arguments, control = document.getElementById(name);"
            "control.value = value; control.dispatchEvent(new Event(event))"
        )
        self.browser.execute_script(script, name, value, event)

    def text(self, selector: str) -> str:
        return self.browser.find_element(By.CSS_SELECTOR, selector).text

    def rest(self) -> None:
        """Wait until what the page has drawn is painted, which Bokeh does by timers of its own."""
        self.browser.execute_async_script(
            "const done = arguments[0]; setTimeout(() => requestAnimationFrame("
            "() => requestAnimationFrame(() => done())), 120)"
        )

    def point_px(self, x: float, y: float) -> dict[str, str]:
        """Move the pointer to a place in the window (px); read what stands beside the map."""
        old = self.text("#pointer")
        actions = ActionChains(self.browser, duration=0)
        actions.w3c_actions.pointer_action.move_to_location(round(x), round(y))  # type: ignore[no-untyped-call]
        actions.perform()
        for _ in range(100):
            if self.text("#pointer") != old and "…" not in self.text("#pointer"):
                break
            time.sleep(0.01)
        lines = self.text("#pointer").split("\n")
        return dict(zip(lines[::2], lines[1::2], strict=True))

    def calibrate(self) -> None:
        """Find out, by pointing at two places, which pixel is where in the map."""
        box = self.run(
            "const {x, y, width, height} = document.querySelector('figure')"
            ".getBoundingClientRect(); return [x, y, width, height]"
        )
        spots = [
            (round(box[0] + share * box[2]), round(box[1] + share * box[3])) for share in (0.3, 0.7)
        ]
        said = [self.point_px(*spot)["x, y"].removesuffix(" m").split(", ") for spot in spots]
        places = [[float(number.replace(",", "")) for number in each] for each in said]
        self._from = np.array(spots[0], float), np.array(places[0])
        metres = np.subtract(places[1], places[0])
        self._scale = np.subtract(spots[1], spots[0]) / metres

    def to_px(self, x: float, y: float) -> tuple[float, float]:
        """Where a place of the map (m) is in the window (px)."""
        px, metres = self._from
        right, down = px + (np.array([x, y]) - metres) * self._scale
        return float(right), float(down)

    def point(self, x: float, y: float) -> dict[str, str]:
        """Point at a place of the map (m)."""
        return self.point_px(*self.to_px(x, y))

    def click_at(self, x: float, y: float, times: int = 1) -> None:
        """Click at a place of the map (m), too late to be a double-click with the click before."""
        right, down = self.to_px(x, y)
        actions = ActionChains(self.browser, duration=0).pause(0.6)
        mouse = actions.w3c_actions.pointer_action
        mouse.move_to_location(round(right), round(down))  # type: ignore[no-untyped-call]
        for _ in range(times):
            mouse.click()
        actions.perform()

    def photograph(self) -> NDArray[np.uint8]:
        """(H, W, 3) of the window."""
        png = self.browser.get_screenshot_as_png()
        return np.asarray(Image.open(BytesIO(png)).convert("RGB"))
