"""Folders, patterns, stdin and stdout, where a path stands."""

import json
import os
import re
import shlex
import subprocess
import sys
from pathlib import Path

import pytest

from tests.cli.runner import occmap, read_error
from tests.samples import SAMPLE_LOGS, write_csv

DRIVE = SAMPLE_LOGS / "drive.csv"


def pipe(words: list[str], data: bytes, folder: Path) -> subprocess.CompletedProcess[bytes]:
    command = [sys.executable, "-m", "occmap", *words]
    return subprocess.run(
        command, input=data, capture_output=True, cwd=folder, check=False, timeout=120
    )


def test_a_log_on_stdin_and_a_map_on_stdout(tmp_path: Path) -> None:
    assert occmap("build", DRIVE, "-o", tmp_path / "m.pgm").code == 0
    done = pipe(["build", "-", "-o", "-"], DRIVE.read_bytes(), tmp_path)
    assert done.returncode == 0
    assert done.stdout == (tmp_path / "m.pgm").read_bytes()
    assert b"414 of 414 used" in done.stderr
    assert b"stdout.pgm" not in done.stderr
    done = pipe(["render", "map.npz", "-o", "-.png"], b"", tmp_path)
    assert b"map.npz" in done.stderr
    assert occmap("build", DRIVE, "-o", tmp_path / "map.npz", "-o", tmp_path / "m.png").code == 0
    done = pipe(["render", "map.npz", "-o", "-.png"], b"", tmp_path)
    assert done.stdout == (tmp_path / "m.png").read_bytes()


def test_check_reads_stdin(tmp_path: Path) -> None:
    done = pipe(["check", "-"], DRIVE.read_bytes(), tmp_path)
    assert done.returncode == 0
    assert b"414 in " in done.stdout
    lines = done.stdout.decode().splitlines()
    assert lines[0] == "-"
    assert lines[-1].startswith("occmap build - ")


def test_explain_reads_stdin(tmp_path: Path) -> None:
    assert occmap("build", DRIVE, "-o", tmp_path / "m.npz", "--stride", 20).code == 0
    words = ["explain", "m.npz", "1.5", "-0.25", "--log"]
    named = occmap("explain", tmp_path / "m.npz", *words[2:], DRIVE, "--json").out
    piped = pipe([*words, "-", "--json"], DRIVE.read_bytes(), tmp_path).stdout
    assert json.loads(named.replace(json.dumps(str(DRIVE)), '"-"')) == json.loads(piped)
    text = pipe([*words, "-"], DRIVE.read_bytes(), tmp_path).stdout.decode()
    assert text.splitlines()[-1].endswith(" - scan")


def test_a_log_on_stdin_is_called_by_what_was_typed(tmp_path: Path) -> None:
    words = ["check", "-", "--json"]
    found = json.loads(pipe(words, DRIVE.read_bytes(), tmp_path).stdout)
    assert [log["path"] for log in found["logs"]] == ["-"]
    done = pipe(["check", "-"], b"no log", tmp_path)
    assert (done.returncode, done.stdout.count(b"occmap-")) == (1, 0)
    done = pipe(["build", "-", "-o", "m.pgm", "--json"], DRIVE.read_bytes(), tmp_path)
    assert json.loads(done.stdout)["logs"] == ["-"]
    done = pipe(["build", "-", "-o", "m.pgm"], b"no log", tmp_path)
    assert done.stderr.startswith(b"error: -: ")


@pytest.mark.parametrize("command", ["check", "build", "compare"])
def test_a_page_calls_a_log_on_stdin_by_what_was_typed(command: str, tmp_path: Path) -> None:
    cut = DRIVE.read_bytes()[:300_000]
    assert pipe([command, "-", "-o", "page.html"], cut, tmp_path).returncode == 0
    page = (tmp_path / "page.html").read_text(encoding="utf-8")
    assert "the file ends in the middle of line 193" in page or command == "compare"
    assert "occmap build" in page
    assert re.search(r"<title>\D+ of -</title>", page)
    assert "<td>-</td>" in page
    assert "stdin<" not in page
    assert "/stdin" not in page


@pytest.mark.parametrize("suffix", [".zarr", ".tiles"])
def test_a_folder_does_not_fit_through_stdout(tmp_path: Path, suffix: str) -> None:
    told = occmap("build", tmp_path / "no log", "-o", f"-{suffix}")
    assert told.code == 2
    assert told.err == (
        f"error: -{suffix}: a {suffix} is a folder, which stdout cannot take; "
        f"name the folder, such as -o map{suffix}\n"
    )


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs a disk that is full")
def test_a_full_disk_behind_stdout_is_named() -> None:
    command = [sys.executable, "-m", "occmap", "build", "-q", str(DRIVE), "-o", "-"]
    with Path("/dev/full").open("wb") as full:
        done = subprocess.run(command, stdout=full, stderr=subprocess.PIPE, check=False)
    assert done.returncode == 1
    assert done.stderr == b"error: stdout: cannot be written (No space left on device)\n"


def test_an_empty_stdin_is_said(tmp_path: Path) -> None:
    done = pipe(["build", "-", "-o", "m.pgm"], b"", tmp_path)
    assert (done.returncode, done.stderr) == (1, b"error: stdin: is empty; pipe a log into it\n")


@pytest.mark.skipif(os.name == "nt", reason="a shell of POSIX closes it")
def test_a_closed_stdin_is_said(tmp_path: Path) -> None:
    line = f"exec {shlex.quote(sys.executable)} -m occmap check - <&-"
    done = subprocess.run(["sh", "-c", line], capture_output=True, cwd=tmp_path, check=False)
    assert (done.returncode, done.stderr) == (1, b"error: stdin: is closed; pipe a log into it\n")


@pytest.mark.parametrize("more", [["-o", "-.png"], ["--json"]])
def test_stdout_takes_one_map_alone(tmp_path: Path, more: list[str]) -> None:
    told = occmap("build", DRIVE, "-o", "-", *more)
    assert told.code == 2
    assert told.err.startswith("error: stdout takes one map and nothing else")
    assert not list(tmp_path.iterdir())


def test_a_folder_gets_a_map_named_after_the_log(tmp_path: Path) -> None:
    assert occmap("build", DRIVE, "-o", f"{tmp_path}/", "-r", "0.1").code == 0
    assert {path.name for path in tmp_path.iterdir()} == {"drive.pgm", "drive.yaml"}


def test_the_recordings_of_a_folder_are_built_as_one(tmp_path: Path) -> None:
    day = tmp_path / "day"
    day.mkdir()
    for name in ("a", "b"):
        write_csv(day / f"{name}.csv", [(0.0, 0.0, 0.0)] * 3, [1.0, 1.0], 0.1)
    told = occmap("build", day, "-o", tmp_path / "m.pgm", "--json")
    note = f"{day}: 2 recordings, in the order of their time: a.csv, b.csv"
    assert f"note: {note}\n" in told.err
    printed = json.loads(told.out)
    assert printed["notes"][0] == note
    assert printed["scans"]["used"] == 6
    for command in ("check", "tune", "compare"):
        assert f"note: {note}\n" in occmap(command, day).err


def test_what_is_to_be_added_to_may_not_be_there_yet(tmp_path: Path) -> None:
    log = write_csv(tmp_path / "a.csv", [(0.0, 0.0, 0.0)] * 3, [1.0, 1.0], 0.1)
    other = write_csv(tmp_path / "b.csv", [(0.0, 0.0, 0.0)] * 4, [1.0, 1.0], 0.1)
    site = tmp_path / "site.npz"
    words = ["--resume-if-there", site, "-o", site, "--json"]
    first = occmap("build", log, *words)
    assert json.loads(first.out)["resumed"] is None
    assert f"note: {site}: no such file, so this build adds to nothing\n" in first.err
    second = occmap("build", other, *words)
    assert json.loads(second.out)["resumed"] == {"file": str(site), "read": 3, "used": 3}
    assert "no such file" not in second.err
    error = read_error(occmap("build", log, "--resume", site, *words[:-1]), 2)
    assert error == "--resume and --resume-if-there are both given; leave one out"


@pytest.mark.parametrize(
    ("words", "note"),
    [
        (["--end", "1700000000"], "--end 1700000000 leaves nothing out"),
        (["--start", "1", "--end", "1700000000"], "--end 1700000000 leaves nothing out"),
        (["--end", "1e3"], "--end 1000 leaves nothing out"),
        (["--end", "50"], ""),
        (["--start", "1"], ""),
    ],
)
def test_an_end_that_leaves_nothing_out_is_said(
    tmp_path: Path, words: list[str], note: str
) -> None:
    told = occmap("build", DRIVE, "-o", tmp_path / "m.pgm", *words)
    assert ("leaves nothing out" in told.err) == bool(note)
    assert note in told.err


def test_a_quiet_check_prints_its_problems(tmp_path: Path) -> None:
    (tmp_path / "notes.txt").write_text("hello\n")
    told = occmap("check", "-q", tmp_path / "notes.txt")
    assert (told.code, told.out) == (1, "")
    assert told.err.startswith(f"error: {tmp_path / 'notes.txt'}: a text file of no known log")
    assert occmap("check", "-q", DRIVE) == (0, "", "")


def test_a_short_option_takes_no_equals_sign(tmp_path: Path) -> None:
    error = read_error(occmap("build", DRIVE, f"-o={tmp_path}/m.pgm"), 2)
    found = f"-o={tmp_path}/m.pgm: a short option takes no =; write -o {tmp_path}/m.pgm"
    assert error == found
    assert not list(tmp_path.iterdir())
