"""Killed commands leave whole files. With OCCMAP_FAULTS set, 500 are killed; without, some."""

import os
import random
import signal
import sys
from pathlib import Path

import pytest

from tests.faults.kills import SIGNALS, judge, kill_once
from tests.faults.scene import COMMANDS, Scene, set_up

RUNS = 500 if "OCCMAP_FAULTS" in os.environ else len(COMMANDS)


@pytest.mark.skipif(sys.platform == "win32", reason="signals of POSIX")
def test_killed_commands_leave_whole_files(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    before = signal.signal(signal.SIGINT, signal.default_int_handler)  # a background job ignores it
    dice, scenes = random.Random(1), []
    for command in COMMANDS:
        place = tmp_path / command
        place.mkdir()
        monkeypatch.chdir(place)
        scenes.append(set_up(place, command))
    for number in range(RUNS):
        turn, at = divmod(number, len(scenes))
        outcome = kill_once(scenes[at], SIGNALS[(number + turn) % len(SIGNALS)], dice)
        assert not outcome.startswith("FAULT"), outcome
    signal.signal(signal.SIGINT, before)


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
