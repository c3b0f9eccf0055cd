"""What pages say, read from their HTML."""

import hashlib
import json
import re
import shlex
import shutil
import sys
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from occmap import api, page
from occmap.cells import OccupancyMap
from occmap.inspection.findings import LogFindings
from occmap.page import Block, Page, Section, compose, tell_notes, to_script
from tests.cli.runner import ask, occmap, read_error
from tests.samples import SAMPLE_LOGS

pytestmark = pytest.mark.usefixtures("here")
DRIVE = SAMPLE_LOGS / "drive.csv"
HOSTILE = "<img src=x onerror=alert(1)> & \"'"


class Reader(HTMLParser):
    """Collects the text of a page outside its scripts and styles, and the elements in it."""

    def __init__(self, html: str) -> None:
        super().__init__()
        self.texts: list[str] = []
        self.kinds: set[str] = set()
        self._open = ""
        self.feed(html)

    def handle_starttag(self, tag: str, attrs: Any) -> None:  # noqa: ARG002  as its base has it
        self.kinds.add(tag)
        self._open = tag

    def handle_data(self, data: str) -> None:
        if self._open not in {"script", "style"} and data.strip():
            self.texts.append(data.strip())


def read(name: str) -> Reader:
    return Reader(Path(name).read_text(encoding="utf-8"))


def test_a_map_says_what_the_json_says() -> None:
    found = ask("build", DRIVE, "--resolution", 0.1, "-o", "m.html")
    grid, texts = found["map"], read("m.html").texts
    size = f"{grid['columns']:,} x {grid['rows']:,} cells of 0.1 m, x "
    assert any(text.startswith(size) for text in texts)
    assert f"{grid['agreement']:.1%} of the hits lie in occupied cells" in texts
    assert f"{found['scans']['used']:,} of {found['scans']['read']:,} used" in texts
    assert any(text.startswith(f"{grid['occupied']:.1%} occupied") for text in texts)
    beams = f"{sum(found['beams'].values()):,}: {found['beams']['hit']:,} hit"
    assert any(text.startswith(beams) for text in texts)
    assert hashlib.sha256(DRIVE.read_bytes()).hexdigest() in texts
    assert found["files"] == ["m.html"]


def test_what_check_and_build_say_is_there() -> None:
    words = "--resolution", 0.2, "--max-range", 7, "--jump", 0.3
    found = ask("build", "beam", DRIVE, *words, "-o", "m.html")
    texts = read("m.html").texts
    assert found["notes"]
    assert set(found["notes"]) <= set(texts)
    assert {"What check finds", "No problems, no warnings."} <= set(texts)
    assert any(text.startswith("+inf ") for text in texts)


def test_evidence_has_no_way_and_the_page_says_so() -> None:
    assert occmap("build", DRIVE, "--resolution", 0.2, "-o", "m.npz").code == 0
    assert occmap("render m.npz -o m.html").code == 0
    texts = read("m.html").texts
    assert any("does not keep where the robot went" in text for text in texts)
    assert "Way of the laser" not in texts
    assert "drive.csv" in texts


def test_a_check_says_what_the_json_says() -> None:
    found = ask("check", DRIVE, "-o", "c.html")
    texts = read("c.html").texts
    size = f"{found['map']['columns']:,} x {found['map']['rows']:,} cells of 0.05 m, x "
    assert any(text.startswith(size) and text.endswith("at most") for text in texts)
    (log,) = found["logs"]
    special = log["scans"][0]["ranges"]["specials"][0]
    told = f"{special['name']:<12} {special['count']:>10,} {special['share']:>6.1%}  "
    assert any(text.startswith(told) for text in texts)
    assert " ".join(found["command"]) in texts


def test_options_are_spelled_as_flags_in_facts_lists_and_tables() -> None:
    text = "`no_return=ignore` is right"
    blocks = [
        Block("facts", [("ranges", text)]),
        Block("list", texts=[text]),
        Block("table", [(text,)], ("ranges",)),
    ]
    texts = Reader(compose(Page("Check", "", [Section("Findings", blocks)]))).texts
    assert texts.count("--no-return ignore is right") == 3
    assert text not in texts


def test_a_comparison_says_what_the_json_says_and_what_to_type() -> None:
    shutil.copy(DRIVE, "my room.csv")
    made = api.compare("my room.csv", models=["simple"], resolution=0.2, picture="c.html")
    texts = read("c.html").texts
    assert shlex.join(made.command) in texts
    for each in made.to_json()["variants"]:
        row = texts[texts.index("as good within the error", texts.index("variant")) :]
        assert row[row.index(each["name"]) + 1] == f"{each['share']:.4f}"


def test_a_difference_says_what_the_json_says() -> None:
    for name, end in (("a", 40), ("b", 80)):
        line = f"build {DRIVE} --resolution 0.2 --end {end} -o {name}.pgm"
        assert occmap(line).code == 0
    found = ask("diff a.pgm b.pgm -o d.html")
    texts = read("d.html").texts
    head = f"{found['changed']:,} cells changed, {found['share']:.3%} of {found['known']:,} known"
    assert any(text.startswith(head) for text in texts)
    for name, cells in found["by_class"].items():
        assert (f"{cells:,} {name}" in texts) == (cells > 0)


@pytest.mark.parametrize("command", ["build", "check", "compare"])
def test_hostile_names_are_text(command: str) -> None:
    shutil.copy(DRIVE, f"{HOSTILE}.csv")
    assert occmap(command, f"{HOSTILE}.csv", "--resolution", 0.4, "-o", "m.html").code == 0
    found = read("m.html")
    assert "img" not in found.kinds
    assert any(HOSTILE in text for text in found.texts)


def test_equal_pages_have_equal_bytes() -> None:
    grid = api.build_map(DRIVE, resolution=0.2, outputs="m.npz")
    for name in ("one.html", "other.html"):
        grid.save(name)
    one = Path("one.html").read_bytes()
    assert one == Path("other.html").read_bytes()
    assert b'"bokeh-0"' in one  # what Bokeh names by chance is found


def test_scripts_do_not_end_where_a_name_says_so() -> None:
    value = {"name": "</script><script>alert(1)</script>&"}
    assert "<" not in to_script(value)
    assert json.loads(to_script(value)) == value
    sections = [tell_notes(LogFindings("", notes=("</li><script>",))), Section("<i>", [])]
    made = compose(Page("</title><b>", "", sections))
    assert Reader(made).kinds.isdisjoint({"b", "i"})


def test_nothing_is_fetched_and_the_line_of_a_notebook_can_be_typed() -> None:
    api.build_map(DRIVE, resolution=0.4, align=None, outputs="m.html")
    html = Path("m.html").read_text(encoding="utf-8")
    assert not re.findall(r"<(?:script|link|img)[^>]*(?:src|href)=", html)
    assert "default-src 'none'" in html
    (line,) = [text for text in Reader(html).texts if text.startswith("occmap build")]
    assert "None" not in line


@pytest.mark.parametrize(
    ("program", "is_occmap"),
    [("/bin/occmap", True), ("/x/occmap/__main__.py", True), ("/x", False)],
)
def test_the_command_line_is_there_where_there_is_one(
    monkeypatch: pytest.MonkeyPatch, program: str, is_occmap: bool
) -> None:
    line = ["build", str(DRIVE), "--resolution", "0.4", "-o", "a b.html"]
    monkeypatch.setattr(sys, "argv", [program, *line])
    assert occmap(*line).code == 0
    assert (shlex.join(["occmap", *line]) in read("a b.html").texts) == is_occmap


@pytest.mark.parametrize("command", ["build", "compare", "check"])
def test_without_bokeh_one_line_says_what_to_type(
    monkeypatch: pytest.MonkeyPatch, command: str
) -> None:
    monkeypatch.setitem(sys.modules, "bokeh", None)
    told = read_error(occmap(command, DRIVE, "-o", "m.html"), 2)
    assert "bokeh, which is not installed; install it: pip install 'bokeh>=3.8' 'jinja2" in told


KNOWN = {"#": 3.0, ".": -3.0, "?": 0.0, " ": 0.0}


def draw(picture: str, origin: tuple[float, float] = (0.0, 0.0)) -> OccupancyMap:
    """Read a map as it is seen, the highest row first; "?" is observed and undecided."""
    cells = [list(row) for row in picture.split("/")][::-1]
    log_odds = np.array([[KNOWN[cell] for cell in row] for row in cells], np.float32)
    observed = np.array([[cell != " " for cell in row] for row in cells])
    return OccupancyMap(log_odds, observed, 0.05, origin)


def test_maps_are_aligned_by_their_lattice_and_the_highest_row_is_on_top() -> None:
    first, second = draw("#./.."), draw("#", (0.1, -0.05))
    box = first.box.join(second.box)
    assert box.shape == (3, 3)
    grey = page.paint_map(first, box)[60::120, 60::120, 0]
    assert grey.tolist() == [[12, 243, 205], [243, 243, 205], [205, 205, 205]]
    assert page.paint_map(second, box)[60::120, 60::120, 0][2].tolist() == [205, 205, 12]


def test_red_is_contradiction_and_blue_is_what_not_all_know() -> None:
    maps = [draw("#.#?# "), draw("#...  "), draw("#.#.# ")]
    legend, pixels = page.paint_disagreement(maps, maps[0].box)
    row = [tuple(pixel) for pixel in pixels[30, 30::60].tolist()]
    assert row == [(0, 0, 0), (255, 255, 255), page.RED, page.BLUE, page.BLUE, (205, 205, 205)]
    assert legend == "red: free or occupied (20.0%), blue: known or not (40.0%)"


def test_a_large_map_is_shrunk_and_loses_no_wall() -> None:
    grid = draw("/".join(["." * 1300 + "#" + "." * 1200] * 30))
    pixels = page.paint_map(grid, grid.box)
    assert pixels.shape == (10, 834, 3)
    assert (pixels[:, 1300 // 3, 0] == 12).all()
    assert (np.delete(pixels[..., 0], 1300 // 3, axis=1) == 243).all()
