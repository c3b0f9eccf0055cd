"""What a log or a path says reaches the terminal as text: it moves no cursor and starts no line."""

import json
from pathlib import Path

import pytest

from occmap.cli.console import clean
from tests.cli.runner import occmap, spawn
from tests.readers.ros import ROS2, SECOND, Written, drive, scan, write_mcap
from tests.samples import write_csv

NASTY = (
    "/s\x1b[2J\x1b]0;title\x07can\n"
    "note: the map is perfect\r"
    "::error file=a,line=1::forged\n"
    "##[error]forged\u202egnp.exe\x9b31m\u2028error: forged"
)


def check_lines(text: str) -> None:
    for line in text.split("\n"):
        assert line.isprintable(), line
        assert not line.lstrip().startswith(("::", "note: the map is perfect", "error: forged"))
        assert "##[" not in line


@pytest.mark.usefixtures("here")
def test_names_of_a_log_are_only_text_and_in_json_as_they_are() -> None:
    nasty = [Written(NASTY, SECOND * n, scan(ROS2, SECOND * n, NASTY)) for n in (2, 3)]
    write_mcap(Path("log.mcap"), [*drive(ROS2), *nasty])
    for line in ("build log.mcap -o map.pgm", "check log.mcap", "check log.mcap --json"):
        result = occmap(line)
        assert "forged" in result.out + result.err
        check_lines(result.out)
        check_lines(result.err)
    (log,) = result.json["logs"]
    assert NASTY in {stream["topic"] for stream in log["streams"]}


def test_an_error_is_only_text() -> None:
    result = occmap("build", "no\x1b[2J\n::error::forged", "-o", "m.pgm")
    assert result.code == 1
    assert result.err.count("\n") == 1
    check_lines(result.err)


@pytest.mark.parametrize(
    ("text", "cleaned"),
    [
        ("a\tb", "a\\tb"),
        ("Zürich, 地図", "Zürich, 地図"),
        ("\x1b[31m", "\\x1b[31m"),
        ("  ::warning::x", "  \\x3a:warning::x"),
        ("a ##vso[x]", "a \\x23#vso[x]"),
        ("\udcff", "\\udcff"),
        ("\u202e", "\\u202e"),
        ("", ""),
    ],
)
def test_cleaning(text: str, cleaned: str) -> None:
    assert clean(text) == cleaned


def test_a_path_that_is_no_text(here: Path) -> None:
    """Every command names it, and JSON, which has no such strings, stays JSON."""
    write_csv(here / "log.csv", [(0.0, 0.0, 0.0)], [1.5]).rename(here / "lo\udcffg.csv")
    name = "lo\udcffg.csv"
    for line in ("build {} -o m\udcfe.pgm -o m\udcfe.npz", "check {}", "check {} --json"):
        done = spawn(*line.format(name).split())
        assert (done.returncode, done.stderr) == (0, "")
        assert "lo\\udcffg" in done.stdout or "m\\udcfe" in done.stdout
    assert json.loads(done.stdout)["logs"][0]["path"] == name
