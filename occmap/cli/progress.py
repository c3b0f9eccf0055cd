"""The progress bar: scans read so far and scans a second, on a terminal only."""

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from threading import Event, Thread
from typing import Any

from occmap.cli.console import Console, Verbosity

REDRAW_S = 0.5
"""The clock of the bar runs on while a long step reports nothing."""


class Bar:
    """Shows how far the work is, where there is a terminal to show it on."""

    def __init__(self, tqdm: Any = None) -> None:
        self._tqdm = tqdm

    def __call__(self, scans: int, total: int) -> None:
        """Show that `scans` more scans were read, of `total` in all."""
        if self._tqdm is not None:
            self._tqdm.total = max(total, self._tqdm.n + scans)  # an index may count too few
            self._tqdm.update(scans)

    def describe(self, text: str) -> None:
        """Show which phase of the work goes on."""
        if self._tqdm is not None:
            self._tqdm.set_postfix_str(text)


@contextmanager
def show_progress(console: Console) -> Iterator[Bar]:
    """Show a bar while the block runs, unless nobody would see it."""
    if console.verbosity is Verbosity.QUIET or sys.stderr is None or not sys.stderr.isatty():
        yield Bar()
        return
    from tqdm import tqdm  # noqa: PLC0415  late: only who sees a bar waits for it

    with tqdm(unit=" scans", leave=False, dynamic_ncols=True) as bar:
        done = Event()
        clock = Thread(target=redraw, args=(bar, done), daemon=True)
        clock.start()
        try:
            yield Bar(bar)
        finally:
            done.set()
            clock.join()


def redraw(bar: Any, done: Event) -> None:
    """Draw a bar anew, with what time it is, until all is done."""
    while not done.wait(REDRAW_S):
        bar.refresh()
