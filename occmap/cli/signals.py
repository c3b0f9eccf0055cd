"""The signals that end a command, each as Ctrl-C does and with an exit code of its own."""

import os
import signal
import sys
from threading import Timer
from time import monotonic
from types import FrameType
from typing import Any

ENDING = [
    getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name)
]
"""Windows has no SIGHUP."""
GRACE_S = 1.0
"""A terminal that closes may send two signals; the second must not break off the clearing up."""


class Interrupted(KeyboardInterrupt):
    """A signal came.

    Not KeyboardInterrupt itself: once that has passed through exec(), Python ends the process by
    SIGINT, whatever its exit code was to be.
    """


class Signals:
    """Listens to signals, and remembers the first that came."""

    def __init__(self) -> None:
        self.number: int | None = None
        """The first signal that came"""
        self._raised_at = 0.0

    @property
    def exit_code(self) -> int:
        """128 plus the number of the signal, as in shells."""
        return 128 + (self.number or signal.SIGINT)

    def listen(self) -> None:
        """Raise Interrupted at each signal, unless the parent has it ignored (nohup)."""
        for number in ENDING:
            if signal.getsignal(number) in {signal.SIG_DFL, signal.default_int_handler}:
                signal.signal(number, self.receive)
        sys.unraisablehook = self.raise_later

    def ignore(self) -> None:
        """Let no signal disturb the end of a process whose work is done."""
        for number in ENDING:
            signal.signal(number, signal.SIG_IGN)

    def receive(self, number: int, _frame: FrameType | None) -> None:
        """Interrupt the main thread, once."""
        if self.number is None or monotonic() > self._raised_at + GRACE_S:
            self.number = self.number or number
            self._raised_at = monotonic()
            raise Interrupted

    def raise_later(self, dropped: Any) -> None:
        """Send a signal again that came in a destructor, where Python drops every exception."""
        if self.number is None:
            sys.__unraisablehook__(dropped)
        elif issubclass(dropped.exc_type, KeyboardInterrupt):
            self._raised_at = 0.0  # the timer below must not run out before this has returned
            Timer(0.2, send_to_itself, [self.number]).start()


def send_to_itself(number: int) -> None:
    """Send this process a signal, such that its main thread wakes up if it waits."""
    if sys.platform == "win32":  # there, os.kill ends a process at once
        signal.raise_signal(number)
    else:
        os.kill(os.getpid(), number)
