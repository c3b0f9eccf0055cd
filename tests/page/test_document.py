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

import pytest

from occmap import api
from occmap.cli import run
from occmap.inspection.findings import LogFindings
from occmap.page import Block, Page, Section, compose, tell_notes, to_script

DRIVE = Path("sample_logs/drive.csv")
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


def read(path: Path) -> Reader:
    return Reader(path.read_text(encoding="utf-8"))


def run_json(capsys: pytest.CaptureFixture[str], *words: object) -> Any:
    assert run([*map(str, words), "--json"]) == 0
    return json.loads(capsys.readouterr().out)


def test_a_map_says_what_the_json_says(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "m.html"
    found = run_json(capsys, "build", DRIVE, "--resolution", 0.1, "-o", path)
    grid, texts = found["map"], read(path).texts
    size = f"{grid['columns']:,} x {grid['rows']:,} cells of 0.1 m, x "
    assert any(text.startswith(size) for text in texts)
    assert f"{grid['agreement']:.1%} of the hits lie in occupied cells" in texts
    assert f"{found['scans']['used']:,} of {found['scans']['read']:,} used" in texts
    assert any(text.startswith(f"{grid['occupied']:.1%} occupied") for text in texts)
    beams = f"{sum(found['beams'].values()):,}: {found['beams']['hit']:,} hit"
    assert any(text.startswith(beams) for text in texts)
    assert hashlib.sha256(DRIVE.read_bytes()).hexdigest() in texts
    assert found["files"] == [str(path)]


def test_what_check_and_build_say_is_there(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "m.html"
    words = "--resolution", 0.2, "--no-return", "clear", "--jump", 0.3
    found = run_json(capsys, "build", "beam", DRIVE, *words, "-o", path)
    texts = read(path).texts
    assert found["notes"]
    assert set(found["notes"]) <= set(texts)
    assert {"What check finds", "No problems, no warnings."} <= set(texts)
    assert any(text.startswith("+inf ") for text in texts)


def test_evidence_has_no_way_and_the_page_says_so(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run_json(capsys, "build", DRIVE, "--resolution", 0.2, "-o", tmp_path / "m.npz")
    run_json(capsys, "render", tmp_path / "m.npz", "-o", tmp_path / "m.html")
    found = read(tmp_path / "m.html")
    assert any("does not keep where the robot went" in text for text in found.texts)
    assert "Way of the laser" not in found.texts
    assert "drive.csv" in found.texts


def test_a_check_says_what_the_json_says(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "c.html"
    found = run_json(capsys, "check", DRIVE, "-o", path)
    texts = read(path).texts
    size = f"{found['map']['columns']:,} x {found['map']['rows']:,} cells of 0.05 m, x "
    assert any(text.startswith(size) and text.endswith("at most") for text in texts)
    (log,) = found["logs"]
    special = log["scans"][0]["ranges"]["specials"][0]
    told = f"{special['name']:<12} {special['count']:>10,} {special['share']:>6.1%}  "
    assert any(text.startswith(told) for text in texts)
    assert " ".join(found["command"]) in texts


def test_options_are_spelled_as_flags_in_facts_lists_and_tables() -> None:
    text = "leave `no_return` as it is"
    blocks = [
        Block("facts", [("ranges", text)]),
        Block("list", texts=[text]),
        Block("table", [(text,)], ("ranges",)),
    ]
    texts = Reader(compose(Page("Check", "", [Section("Findings", blocks)]))).texts
    assert texts.count("leave --no-return as it is") == 3
    assert text not in texts


def test_a_comparison_says_what_the_json_says_and_what_to_type(tmp_path: Path) -> None:
    path, log = tmp_path / "c.html", tmp_path / "my room.csv"
    shutil.copy(DRIVE, log)
    made = api.compare(log, models=["simple"], resolution=0.2, picture=path)
    texts = read(path).texts
    assert shlex.join(made.command) in texts
    for each in made.to_json()["variants"]:
        row = texts[texts.index("as good within the error", texts.index("variant")) :]
        assert row[row.index(each["name"]) + 1] == f"{each['share']:.4f}"


def test_a_difference_says_what_the_json_says(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for name, end in (("a", 40), ("b", 80)):
        words = "--resolution", 0.2, "--end", end, "-o", tmp_path / f"{name}.pgm"
        run_json(capsys, "build", DRIVE, *words)
    maps = tmp_path / "a.pgm", tmp_path / "b.pgm"
    found = run_json(capsys, "diff", *maps, "-o", tmp_path / "d.html")
    texts = read(tmp_path / "d.html").texts
    head = f"{found['changed']:,} cells changed, {found['share']:.3%} of {found['known']:,} known"
    assert any(text.startswith(head) for text in texts)
    for name, cells in found["by_class"].items():
        told = name.replace("neither", "unknown")
        assert not cells or texts[texts.index(told) + 1] == f"{cells:,}"


def test_hostile_names_are_text(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    log = tmp_path / f"{HOSTILE}.csv"
    shutil.copy(DRIVE, log)
    for command in ("build", "check", "compare"):
        path = tmp_path / f"{command}.html"
        run_json(capsys, command, log, "--resolution", 0.4, "-o", path)
        found = read(path)
        assert "img" not in found.kinds
        assert any(HOSTILE in text for text in found.texts)


def test_scripts_do_not_end_where_a_name_says_so() -> None:
    value = {"name": "</script><script>alert(1)</script>&"}
    assert "<" not in to_script(value)
    assert json.loads(to_script(value)) == value
    page = compose(
        Page(
            "</title><b>",
            "",
            [tell_notes(LogFindings("", notes=("</li><script>",))), Section("<i>", [])],
        )
    )
    assert Reader(page).kinds.isdisjoint({"b", "i"})


def test_nothing_is_fetched(tmp_path: Path) -> None:
    api.build_map(DRIVE, resolution=0.4, outputs=tmp_path / "m.html")
    html = (tmp_path / "m.html").read_text(encoding="utf-8")
    assert not re.findall(r"<(?:script|link|img)[^>]*(?:src|href)=", html)
    assert "default-src 'none'" in html


def test_the_command_line_is_there_where_there_is_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    line = ["build", str(DRIVE), "--resolution", "0.4", "-o", str(tmp_path / "a b.html")]
    for program, is_occmap in (
        ("/bin/occmap", True),
        ("/x/occmap/__main__.py", True),
        ("/x", False),
    ):
        monkeypatch.setattr(sys, "argv", [program, *line])
        assert run(line) == 0
        told = shlex.join(["occmap", *line])
        assert (told in read(tmp_path / "a b.html").texts) == is_occmap


def test_without_bokeh_one_line_says_what_to_type(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setitem(sys.modules, "bokeh", None)
    for words in (["build", DRIVE], ["compare", DRIVE], ["check", DRIVE]):
        assert run([*map(str, words), "-o", str(tmp_path / "m.html")]) == 2
        told = capsys.readouterr().err
        assert told.count("\n") == 1
        found = "a page is drawn by Bokeh, which is not installed"
        assert f"{found}; install it: pip install '.[report]'" in told


def test_the_line_on_the_page_of_a_map_that_its_scans_turned_can_be_typed(tmp_path: Path) -> None:
    path = tmp_path / "m.html"
    api.build_map(DRIVE, align=None, outputs=path)
    (line,) = [text for text in read(path).texts if text.startswith("occmap build")]
    assert "None" not in line
