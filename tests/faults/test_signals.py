"""A signal at any line of the writing: one line, the exit code of the signal, and no leftovers.

With OCCMAP_FAULTS set, at every line; without, at some thirty.
"""

import gc
import os
import signal
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from types import FrameType
from typing import Any

import numpy as np
import pytest

from occmap.cli import Signals, run
from tests.faults.kills import ANSWERED, LINE
from tests.faults.scene import Scene, set_up

# A file that was being opened is left to its destructor, where Python drops a signal.
pytestmark = pytest.mark.filterwarnings("ignore:unclosed file:ResourceWarning")


class Bomb:
    """Sends a signal to this process when it first comes to the n-th line of the writing."""

    def __init__(self, signals: Signals, number: int) -> None:
        self.lines: set[tuple[str, int]] = set()
        self._signals = signals
        self._number = number

    def trace_calls(self, frame: FrameType, _event: str, _value: Any) -> Any:
        if self.lines or frame.f_code.co_name == "write_outputs":
            return self.trace_lines
        return None

    def trace_lines(self, frame: FrameType, event: str, _value: Any) -> Any:
        place = frame.f_code.co_filename, frame.f_lineno
        if event == "line" and place not in self.lines and not place[0].endswith("signals.py"):
            self.lines.add(place)
            if len(self.lines) == self._number:
                sys.settrace(None)
                self._signals.receive(signal.SIGTERM, frame)
        return self.trace_lines


@pytest.fixture
def signals() -> Iterator[Signals]:
    """Signals that listen; a background job ignores some."""
    before = {each: signal.signal(each, signal.SIG_DFL) for each in ANSWERED}
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(sys, "unraisablehook", sys.unraisablehook)
        yield (made := Signals())
    made.ignore()
    for each, handler in before.items():
        signal.signal(each, handler)


def run_with_bomb(scene: Scene, number: int) -> tuple[int, int]:
    """Run a command; return its exit code, and how many lines the writing has come to."""
    scene.reset()
    for each in ANSWERED:
        signal.signal(each, signal.SIG_DFL)
    signals = Signals()
    signals.listen()
    bomb = Bomb(signals, number)
    sys.settrace(bomb.trace_calls)
    try:
        code = run(scene.words, signals)
    except KeyboardInterrupt:  # run had returned
        code = signals.exit_code
    finally:
        sys.settrace(None)
        signals.ignore()
    return code, len(bomb.lines)


@pytest.mark.usefixtures("signals")
@pytest.mark.parametrize("command", ["build npz", "build pgm", "build png"])
def test_a_signal_anywhere_while_files_are_written(
    command: str, here: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    scene = set_up(here, command)
    code, lines = run_with_bomb(scene, 0)
    assert code == 0
    step = 1 if "OCCMAP_FAULTS" in os.environ else max(1, lines // 30)
    codes = []
    capsys.readouterr()
    for number in range(1, lines, step):
        code, _ = run_with_bomb(scene, number)
        said = capsys.readouterr().err
        about = f"at line {number}: {code} {said}"
        assert (code, said) in [(143, LINE), (0, "")], about
        assert list(scene.list_wrong()) == [], about
        if code == 0:
            assert scene.is_done(), about
        codes.append(code)
    assert codes.count(143) > 0.9 * len(codes)
    gc.collect()  # of files that are not closed no other test is to be told


@pytest.mark.usefixtures("signals")
def test_of_two_signals_at_once_the_second_does_not_break_off_the_clearing_up(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    signals = Signals()
    signals.listen()
    with pytest.raises(KeyboardInterrupt):
        signal.raise_signal(signal.SIGTERM)
    signal.raise_signal(signal.SIGHUP)
    assert signals.exit_code == 143
    signals.receive(signal.SIGINT, None)
    monkeypatch.setattr("occmap.cli.monotonic", lambda: time.monotonic() + 2)
    with pytest.raises(KeyboardInterrupt):  # whoever waits for longer is heard again
        signals.receive(signal.SIGINT, None)


class Asked(type):
    """A type that is interrupted where NumPy asks it for an attribute, and drops what is raised."""

    def __getattr__(cls, name: str) -> None:
        signal.raise_signal(signal.SIGTERM)
        raise AttributeError(name)


def test_a_signal_that_is_dropped_comes_again_and_does_not_disturb_the_clearing_up(
    signals: Signals, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("occmap.cli.GRACE_S", 0.1)
    signals.listen()
    done = []
    with pytest.raises(KeyboardInterrupt):  # noqa: PT012  one after the other
        try:
            done.append(np.zeros(1) == Asked("Odd", (), {})())
            time.sleep(20)
        finally:
            time.sleep(0.3)
            done.append(signals.exit_code)
    assert done[1:] == [143]


@pytest.mark.usefixtures("signals")
def test_what_a_parent_has_ignored_stays_so() -> None:
    signal.signal(signal.SIGHUP, signal.SIG_IGN)
    signals = Signals()
    signals.listen()
    signal.raise_signal(signal.SIGHUP)
    assert signals.number is None
