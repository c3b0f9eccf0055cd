from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from selenium.webdriver import Chrome

from occmap import api
from occmap.api import Map
from occmap.cells import Box
from occmap.page.raster import CLASS_COLOURS, SCAN_COLOUR, make_raster
from occmap.writers.edits import read_edits
from tests.page.browser import Shown, open_browser, wait_until

DRIVE = Path("sample_logs/drive.mcap")
RESOLUTION = 0.2


@pytest.fixture(scope="module")
def browser() -> Iterator[Chrome]:
    yield from open_browser()


@dataclass
class Drive:
    """A map and its page."""

    map: Map
    page: Shown


@pytest.fixture(scope="module")
def drive(browser: Chrome, tmp_path_factory: pytest.TempPathFactory) -> Drive:
    path = tmp_path_factory.mktemp("drive") / "map.html"
    made = api.build_map(DRIVE, resolution=RESOLUTION, outputs=path)
    page = Shown(browser, path)
    page.calibrate()
    return Drive(made, page)


def to_rgb(colour: str) -> list[int]:
    return list(bytes.fromhex(colour.removeprefix("#")))


def find_middle(grid: Map, row: int, col: int) -> tuple[float, float]:
    """The middle of a cell (m)."""
    (x, y), size = grid.origin, grid.resolution
    return x + (col + 0.5) * size, y + (row + 0.5) * size


def test_the_pointer_says_what_the_map_holds(drive: Drive) -> None:
    made = drive.map
    rng = np.random.default_rng(1)
    names = {"occupied": made.occupied, "free": made.free, "unknown": ~made.observed}
    for name, mask in names.items():
        for row, col in rng.permutation(np.argwhere(mask))[:3].tolist():
            said = drive.page.point(*find_middle(made, row, col))
            x, y = (float(text) for text in said["x, y"].removesuffix(" m").split(", "))
            assert int((x - made.origin[0]) / made.resolution) == col
            assert int((y - made.origin[1]) / made.resolution) == row
            assert said["class"] == name
            if name == "unknown":
                assert said["hits"] == said["probability"] == "–"
                continue
            assert float(said["probability"]) == pytest.approx(made.probability[row, col], abs=0.01)
            for counted, counts in (("hits", made.hits), ("misses", made.misses)):
                number = float(said[counted].replace(",", ""))
                assert number == pytest.approx(counts[row, col], abs=0.051)
            assert said["visits"] != "0" or made.hits[row, col] + made.misses[row, col] == 0


def test_the_picture_is_the_map(drive: Drive) -> None:
    page, made = drive.page, drive.map
    page.click("#way")
    page.point_px(5, 5)
    page.rest()
    picture = page.photograph()
    classes = np.where(made.occupied, 3, np.where(made.free, 1, np.where(made.observed, 2, 0)))
    wrong = 0
    for row, col in np.ndindex(*made.shape):
        right, down = page.to_px(*find_middle(made, row, col))
        expected = to_rgb(CLASS_COLOURS[classes[row, col]])
        wrong += picture[round(down), round(right)].tolist() != expected
    page.click("#way")
    assert wrong <= made.log_odds.size // 1000


def test_each_layer_is_painted_and_named(drive: Drive) -> None:
    page, made = drive.page, drive.map
    row, col = divmod(int(made.hits.argmax()), made.shape[1])
    right, down = page.to_px(*find_middle(made, row, col))
    seen = set()
    for key in ("p", "hits", "misses", "visits", "last", "class"):
        page.click(f"[data-key={key}]")
        page.wait(f"document.body.dataset.layer === '{key}'")
        page.rest()
        seen.add(tuple(page.photograph()[round(down), round(right)].tolist()))
        assert page.text("#layer")
    assert len(seen) == 6
    assert page.text("#legend").split("\n") == ["unknown", "free", "undecided", "occupied"]


def test_the_slider_lays_a_scan_over_the_map(drive: Drive) -> None:
    page = drive.page
    page.choose("scan", 0, "input")
    page.wait("document.body.dataset.scan === '0'")
    page.rest()
    start = "1700000000.000 s (2023-11-14 22:13:20 UTC)"
    assert page.text("#when").startswith(start)
    assert page.text("#way-ramp").startswith(start)
    hits, x, y = page.run(
        "const d = Bokeh.documents[0].get_model_by_name('scan').data_source.data;"
        "return [d.x.length, d.x[50], d.y[50]]"
    )
    assert hits > 100
    right, down = page.to_px(x, y)
    painted = page.photograph()[round(down), round(right)].astype(int)
    np.testing.assert_allclose(painted, to_rgb(SCAN_COLOUR), atol=8)  # its edge is smoothed


def test_shapes_drawn_over_the_map_are_saved_for_edits(drive: Drive, tmp_path: Path) -> None:
    page = drive.page
    folder = {"behavior": "allow", "downloadPath": str(tmp_path)}
    page.browser.execute_cdp_cmd("Browser.setDownloadBehavior", folder)
    page.click_at(9, 7)  # nothing is drawn before one says so
    page.click("#draw")
    for x, y, clicks in ((1, 1, 1), (3, 1, 1), (3, 2.5, 2)):
        page.click_at(x, y, clicks)
    page.choose("change", "unknown", "change")
    for x, y, clicks in ((5, 1, 1), (7, 2, 1), (8, 8, 1)):
        page.click_at(x, y, clicks)
    page.click("#undo")
    page.click("#save")
    saved = tmp_path / "edits.csv"
    wait_until(saved.exists, "edits.csv is saved")
    polygon, line = read_edits(saved)
    assert [(it.change, it.width) for it in (polygon, line)] == [("free", None), ("unknown", 0.1)]
    np.testing.assert_allclose(polygon.rings[0], [(1, 1), (3, 1), (3, 2.5)], atol=0.03)
    np.testing.assert_allclose(line.rings[0], [(5, 1), (7, 2)], atol=0.03)
    page.click("#draw")


def test_nothing_is_complained_of_and_nothing_asked_of_the_network(drive: Drive) -> None:
    assert drive.page.complaints == []
    asked = drive.page.run("return performance.getEntriesByType('resource').map(e => e.name)")
    assert [name for name in asked if not name.startswith(("data:", "blob:"))] == []


def test_in_a_narrow_window_a_metre_is_as_long_in_y_and_the_plot_has_the_shape_of_the_map(
    browser: Chrome, tmp_path: Path
) -> None:
    api.build_map(DRIVE, resolution=0.2, stride=20, outputs=tmp_path / "m.html")
    page = Shown(browser, tmp_path / "m.html")
    size = browser.get_window_size()
    browser.set_window_size(600, 1000)
    page.wait("innerWidth < 700")
    page.rest()
    wide, high, metres_x, metres_y = page.run(
        "const f = Bokeh.documents[0].get_model_by_name('map-0'), x = f.x_range, y = f.y_range;"
        "return [f.inner_width, f.inner_height, x.end - x.start, y.end - y.start]"
    )
    browser.set_window_size(size["width"], size["height"])
    assert wide / metres_x == pytest.approx(high / metres_y)
    assert metres_y < 20  # of a map of 16 x 12 m; a tall strip has 24 m


@pytest.mark.parametrize("extent", [None, (-3, 0, 60, 2), (0, -20, 2, 40)])
def test_on_a_phone_nothing_sticks_out_and_a_tap_says_what_is_there(
    extent: Box | None, browser: Chrome, tmp_path: Path
) -> None:
    api.build_map(DRIVE, resolution=0.2, stride=20, extent=extent, outputs=tmp_path / "m.html")
    phone = {"width": 390, "height": 800, "deviceScaleFactor": 2, "mobile": True}
    browser.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", phone)
    browser.execute_cdp_cmd("Emulation.setTouchEmulationEnabled", {"enabled": True})
    page = Shown(browser, tmp_path / "m.html")
    page.choose("scan", 0, "input")
    page.wait("document.body.dataset.scan === '0'")
    width = page.run("return document.documentElement.scrollWidth")
    x, y, wide = page.run(
        "const box = document.querySelector('figure').getBoundingClientRect();"
        "return [box.x + box.width / 2, box.y + box.height / 2, box.width]"
    )
    for kind, points in (("touchStart", [{"x": x, "y": y}]), ("touchEnd", [])):
        browser.execute_cdp_cmd("Input.dispatchTouchEvent", {"type": kind, "touchPoints": points})
    page.wait("document.getElementById('pointer').textContent.includes('probability')")
    browser.execute_cdp_cmd("Emulation.setTouchEmulationEnabled", {"enabled": False})
    browser.execute_cdp_cmd("Emulation.clearDeviceMetricsOverride", {})
    assert (width, wide > 300) == (390, True)


def test_maps_of_a_comparison_are_linked_and_its_table_sorts(
    browser: Chrome, tmp_path: Path
) -> None:
    path = tmp_path / "c.html"
    made = api.compare(DRIVE, models=["simple", "counting"], resolution=0.5, picture=path)
    page = Shown(browser, path)
    ranges = page.run(
        "const d = Bokeh.documents[0], n = document.querySelectorAll('figure').length;"
        "return [n, new Set([...Array(n).keys()].map("
        "i => d.get_model_by_name(`map-${i}`).x_range)).size]"
    )
    assert ranges == [len(made.results), 1]
    page.click("th.number:nth-child(4) button")
    column = (
        "return [...document.querySelectorAll('tbody tr td:nth-child(4)')].map(e => +e.textContent)"
    )
    figures = [round(each.score.log_likelihood, 3) for each in made.results]
    assert page.run(column) == sorted(figures)
    page.click("th.number:nth-child(4) button")
    assert page.run(column) == sorted(figures, reverse=True)
    assert page.complaints == []


def test_a_difference_has_before_and_after_by_a_switch(browser: Chrome, tmp_path: Path) -> None:
    maps = tmp_path / "a.pgm", tmp_path / "b.pgm"
    api.build_map(DRIVE, resolution=0.2, stride=3, end_s=40, outputs=maps[0])
    api.build_map(DRIVE, resolution=0.2, stride=3, outputs=maps[1])
    found = api.diff(*maps, picture=tmp_path / "d.html")
    page = Shown(browser, tmp_path / "d.html")
    page.calibrate()
    row, col = np.argwhere((found.before == 0) & (found.after == 2))[0].tolist()
    place = found.place
    x, y = place.x + (col + 0.5) * place.resolution, place.y + (row + 0.5) * place.resolution
    said = page.point(x, y)
    told = [said[key] for key in ("change", "before", "after")]
    assert told == ["unknown to occupied", "unknown", "occupied"]
    colours = []
    right, down = page.to_px(x, y)
    for key in ("change", "before", "after"):
        page.click(f"[data-key={key}]")
        page.rest()
        colours.append(page.photograph()[round(down), round(right)].tolist())
    assert colours == [to_rgb("#e69f00"), to_rgb(CLASS_COLOURS[0]), to_rgb(CLASS_COLOURS[3])]


def test_a_page_that_had_to_be_made_smaller_says_so_and_still_points(
    browser: Chrome, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(
        "occmap.page.raster.make_raster", lambda grid, evidence: make_raster(grid, evidence, 1)
    )
    path = tmp_path / "m.html"
    made = api.build_map(DRIVE, resolution=0.05, stride=10, outputs=path)
    page = Shown(browser, path)
    assert "of each 64 x 64 cells the one most likely occupied" in page.text(".note")
    page.calibrate()
    row, col = divmod(int(made.probability.argmax()), made.shape[1])
    said = page.point(*find_middle(made, row, col))
    assert said["class"] == "occupied"
    assert float(said["probability"]) == pytest.approx(made.probability.max(), abs=0.01)
    assert float(said["misses"]) == pytest.approx(made.misses[row, col], abs=0.05)
