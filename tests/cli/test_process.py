"""What only a process of its own shows: signals, closed pipes, full disks, `python -m`."""

import os
import py_compile
import re
import signal
import subprocess
import sys
from pathlib import Path

import pytest

import occmap
from tests.cli.runner import spawn
from tests.samples import SAMPLE_LOGS

DRIVE = str(SAMPLE_LOGS / "drive.mcap")


def test_a_closed_pipe_is_no_error(tmp_path: Path) -> None:
    target = tmp_path / "m.pgm"
    for words in (["build", DRIVE, "-o", str(target)], ["--help"], ["models", "--json"]):
        read_end, write_end = os.pipe()
        os.close(read_end)
        done = spawn(*words, stdout=write_end)
        os.close(write_end)
        assert (done.returncode, done.stderr) == (0, "")
    assert target.exists()


def test_closed_streams_are_no_error() -> None:
    script = f"exec {sys.executable} -m occmap models >&- 2>&-"
    assert subprocess.run(["sh", "-c", script], check=False, timeout=60).returncode == 0


TELLING = """
from occmap.cli import console, main

console.Console.advance = lambda *_: print("reads", flush=True)
main()
"""
"""Says so whenever scans were read"""


SIGNAL_IN_EXEC = """
import signal, sys
from occmap import cli

def interrupt(*_, **__):
    exec("signal.raise_signal(signal.SIGTERM)")

cli.cli.make_context = interrupt
cli.main()
"""


def test_the_exit_code_is_that_of_the_signal_also_inside_exec(tmp_path: Path) -> None:
    """Where dataclasses are made, for one: under -m Python would end the process by SIGINT."""
    (tmp_path / "interrupted.py").write_text(SIGNAL_IN_EXEC)
    command = [sys.executable, "-m", "interrupted"]
    done = subprocess.run(command, capture_output=True, check=False, text=True, cwd=tmp_path)
    assert (done.returncode, done.stderr.count("\n")) == (143, 1)


@pytest.mark.parametrize(
    ("name", "jobs", "code"), [("SIGINT", "1", 130), ("SIGTERM", "2", 143), ("SIGHUP", "2", 129)]
)
def test_a_signal_leaves_one_line_and_no_file(
    tmp_path: Path, name: str, jobs: str, code: int
) -> None:
    words = ["build", *[DRIVE] * 500, "-o", str(tmp_path / "m.pgm"), "--jobs", jobs]
    sent = signal.Signals[name]
    with subprocess.Popen(
        [sys.executable, "-c", TELLING, *words],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        preexec_fn=lambda: signal.signal(sent, signal.SIG_DFL),  # noqa: PLW1509  no threads yet
    ) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "reads\n"  # the first of many logs
        process.send_signal(sent)
        try:
            out, err = process.communicate(timeout=30)
        finally:
            process.kill()
    assert (process.returncode, {*out.split()} - {"reads"}) == (code, set())
    assert err == "error: interrupted: nothing more is written\n"
    assert list(tmp_path.iterdir()) == []


def test_without_sources_each_option_is_there(tmp_path: Path) -> None:
    """As where only compiled files are installed."""
    package = Path(occmap.__file__).parent
    for source in package.rglob("*.py"):
        compiled = tmp_path / "occmap" / source.relative_to(package).with_suffix(".pyc")
        py_compile.compile(str(source), str(compiled))
    done = spawn("build", "--help-all", cwd=tmp_path)
    assert (done.returncode, done.stderr) == (0, "")
    assert re.search(r"--min-range M +Ignore nearer ranges. +\[default: 0.0\]", done.stdout)
