"""What a log or a path says reaches the terminal as text: it moves no cursor and starts no line."""

import json
import os
import shlex
import subprocess
import sys
from pathlib import Path

import pytest

from occmap.cli import console
from occmap.cli.console import clean, quote_for_windows, write_command
from tests.cli.runner import occmap
from tests.readers.ros import ROS2, SECOND, Written, drive, scan, write_mcap

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


@pytest.mark.parametrize("command", ["build", "check"])
def test_names_of_a_log_are_only_text(tmp_path: Path, command: str) -> None:
    nasty = [Written(NASTY, SECOND * n, scan(ROS2, SECOND * n, NASTY)) for n in (2, 3)]
    path = write_mcap(tmp_path / "log.mcap", [*drive(ROS2), *nasty])
    words = ["-o", str(tmp_path / "map.pgm")] if command == "build" else []
    result = occmap(command, path, *words)
    assert "forged" in result.out + result.err
    check_lines(result.out)
    check_lines(result.err)


def test_json_holds_names_as_they_are(tmp_path: Path) -> None:
    nasty = [Written(NASTY, SECOND * n, scan(ROS2, SECOND * n)) for n in (2, 3)]
    path = write_mcap(tmp_path / "log.mcap", [*drive(ROS2), *nasty])
    result = occmap("check", path, "--json")
    topics = {stream["topic"] for stream in json.loads(result.out)["logs"][0]["streams"]}
    assert NASTY in topics
    check_lines(result.out)


def test_an_error_is_only_text(tmp_path: Path) -> None:
    result = occmap("build", tmp_path / "no\x1b[2J\n::error::forged", "-o", "m.pgm")
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


def test_a_path_that_is_no_text(tmp_path: Path) -> None:
    """Every command names it, and JSON, which has no such strings, stays JSON."""
    folder = os.fsencode(tmp_path)
    name = os.path.join(folder, b"lo\xffg.csv")  # noqa: PTH118  bytes
    with open(name, "wb") as file:  # noqa: PTH123  bytes
        file.write(b"# angle_min: 0\n# angle_increment: 0.1\nstamp,x,y,yaw,r0\n0,0,0,0,1.5\n")
    program = [sys.executable.encode(), b"-m", b"occmap"]
    outputs = [b"-o", folder + b"/m\xfe.pgm", b"-o", folder + b"/m\xfe.npz"]
    for words in ([b"build", name, *outputs], [b"check", name], [b"check", name, b"--json"]):
        run = subprocess.run([*program, *words], check=False, capture_output=True)
        assert run.returncode == 0, run.stderr
        assert b"Traceback" not in run.stderr
        assert b"fault in occmap" not in run.stderr
        text = run.stdout.decode("utf-8")
        assert "lo\\udcffg" in text or "m\\udcfe" in text
    assert json.loads(text)


def test_a_command_line_is_quoted_as_the_shell_here_wants_it(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    words = ["occmap", "build", r"C:\my logs\a.bag", "--sensor-pose", "0,0,3.14159", "-o", "a.pgm"]
    windows = r'occmap build "C:\my logs\a.bag" --sensor-pose "0,0,3.14159" -o a.pgm'
    assert quote_for_windows(words) == windows
    assert shlex.split(write_command(words)) == words
    monkeypatch.setattr(console.os, "name", "nt")  # type: ignore[attr-defined]
    assert write_command(words) == windows
