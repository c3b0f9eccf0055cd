"""Folders, patterns, stdin and stdout, where a path stands."""

import io
import json
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from tests.cli.runner import Result, occmap, spawn
from tests.samples import SAMPLE_LOGS, write_csv

DRIVE = SAMPLE_LOGS / "drive.csv"
pytestmark = pytest.mark.usefixtures("here")


def pipe(line: str, data: bytes = DRIVE.read_bytes()) -> Result:
    """Run a command with a log on its stdin, which takes bytes as that of a process does."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(sys, "stdin", io.TextIOWrapper(io.BytesIO(data)))
        return occmap(line)


def test_a_log_on_stdin_and_a_map_on_stdout() -> None:
    assert occmap("build", DRIVE, "-o", "m.pgm", "-o", "m.png", "-o", "map.npz").code == 0
    done = spawn("build", "-", "-o", "-", input=DRIVE.read_bytes(), text=False)
    assert done.returncode == 0
    assert done.stdout == Path("m.pgm").read_bytes()
    assert b"414 of 414 used" in done.stderr
    assert b"stdout.pgm" not in done.stderr
    png = spawn("render", "map.npz", "-o", "-.png", text=False).stdout
    assert png == Path("m.png").read_bytes()
    Path("edits.csv").write_text("forbidden,box,0,0,1,1\n")
    line = "render map.npz -o -.keepout.pgm --edits edits.csv"
    assert spawn(*line.split(), text=False).stdout[:3] == b"P5\n"


def test_explain_reads_stdin() -> None:
    assert occmap("build", DRIVE, "-o", "m.npz", "--stride", 20).code == 0
    line = "explain m.npz 1.5 -0.25 --log"
    named = occmap(f"{line} {DRIVE} --json").out
    assert json.loads(named.replace(json.dumps(str(DRIVE)), '"-"')) == pipe(f"{line} - --json").json
    assert pipe(f"{line} -").out.splitlines()[-1].endswith(" - scan")


def test_a_log_on_stdin_is_called_by_what_was_typed() -> None:
    done = pipe("check -")
    assert done.code == 0
    assert "414 in " in done.out
    lines = done.out.splitlines()
    assert lines[0] == "-"
    assert lines[-1].startswith("occmap build - ")
    assert [log["path"] for log in pipe("check - --json").json["logs"]] == ["-"]
    assert pipe("build - -o m.pgm --json").json["logs"] == ["-"]
    done = pipe("check -", b"no log")
    assert (done.code, done.out.count("occmap-")) == (1, 0)
    assert pipe("build - -o m.pgm", b"no log").err.startswith("error: -: ")


@pytest.mark.parametrize("command", ["check", "build", "compare"])
def test_a_page_calls_a_log_on_stdin_by_what_was_typed(command: str) -> None:
    assert pipe(f"{command} - -o page.html", DRIVE.read_bytes()[:300_000]).code == 0
    page = Path("page.html").read_text(encoding="utf-8")
    assert "line 193, the last, has no line end" in page or command == "compare"
    assert "occmap build" in page
    assert re.search(r"<title>\D+ of -</title>", page)
    assert "<td>-</td>" in page
    assert "stdin<" not in page
    assert "/stdin" not in page


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs a disk that is full")
@pytest.mark.parametrize("line", ["models", f"build -q {DRIVE} -o -"])
def test_a_full_disk_behind_stdout_is_named(line: str) -> None:
    with Path("/dev/full").open("wb") as full:
        done = spawn(*line.split(), stdout=full)
    assert done.returncode == 1
    assert done.stderr == "error: stdout: cannot be written (No space left on device)\n"


def test_an_empty_or_a_closed_stdin_is_said() -> None:
    told = "error: stdin: is empty; pipe a log into it\n"
    assert pipe("build - -o m.pgm", b"") == (1, "", told)
    if os.name != "nt":  # a shell of POSIX closes it
        line = f"exec {sys.executable} -m occmap check - <&-"
        shut = subprocess.run(["sh", "-c", line], capture_output=True, check=False)
        assert (shut.returncode, shut.stderr) == (1, told.replace("empty", "closed").encode())


@pytest.mark.parametrize("name", ["maps", "run.1"])
def test_a_folder_gets_a_map_named_after_the_log(name: str) -> None:
    Path(name).mkdir()
    assert occmap("build", DRIVE, "-o", f"{name}/", "-r", "0.1").code == 0
    assert {path.name for path in Path(name).iterdir()} == {"drive.pgm", "drive.yaml"}


def test_the_recordings_of_a_folder_are_built_as_one() -> None:
    Path("day").mkdir()
    for name in ("a", "b"):
        write_csv(Path(f"day/{name}.csv"), [(0.0, 0.0, 0.0)] * 3, [1.0, 1.0], 0.1)
    told = occmap("build day -o m.pgm --json")
    note = "day: 2 recordings, in the order of their time: a.csv, b.csv"
    assert told.json["notes"][0] == note
    assert told.json["scans"]["used"] == 6
    for said in (told, *(occmap(f"{command} day") for command in ("check", "tune", "compare"))):
        assert f"note: {note}\n" in said.err
    assert occmap("check day").out.splitlines()[-1].startswith("occmap build day -o ")
