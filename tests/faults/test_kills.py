"""Killed commands leave whole files; `python -m tests.faults` kills by the hundred."""

import sys
from pathlib import Path

import pytest

from tests.faults.kills import SIGNALS, judge, kill_at_random
from tests.faults.scene import Scene

RUNS = 8


@pytest.mark.skipif(sys.platform == "win32", reason="signals of POSIX")
def test_killed_commands_leave_whole_files(tmp_path: Path) -> None:
    outcomes = kill_at_random(tmp_path, RUNS, seed=1)
    assert [name for name in outcomes if name.startswith("FAULT")] == []
    assert outcomes.total() == RUNS


def test_what_is_torn_left_over_or_said_wrongly_is_a_fault(tmp_path: Path) -> None:
    scene = Scene(tmp_path, [], {"m.png": b"old"}, {"m.png": b"new"})
    (tmp_path / "m.png").write_bytes(b"old")
    line = "error: interrupted: nothing more is written\n"
    interrupt, kill = SIGNALS[0], SIGNALS[-1]
    assert judge(scene, interrupt, 130, line) == "SIGINT: exit code 130"
    assert judge(scene, kill, -9, "") == "SIGKILL"
    for code, said in ((0, ""), (1, line), (130, "Traceback\n" + line), (130, "")):
        assert judge(scene, interrupt, code, said).startswith("FAULT")
    (tmp_path / ".occmap-1.tmp").touch()
    assert judge(scene, kill, -9, "") == "SIGKILL"
    assert judge(scene, interrupt, 130, line).startswith("FAULT")
    (tmp_path / "m.png").write_bytes(b"o")
    assert judge(scene, kill, -9, "").startswith("FAULT")
    scene.reset()
    python = "Traceback\n  import typing\nKeyboardInterrupt\n"
    assert judge(scene, interrupt, -2, python) == "SIGINT: ended before it listened"
    assert judge(scene, interrupt, 130, "occmap/cli/build.py" + python).startswith("FAULT")
