"""The progress bar: scans read so far and scans a second, on a terminal only."""

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from threading import Event, Thread

from occmap.cli.console import Console, Verbosity
from occmap.pipeline import Progress, ignore_progress

REDRAW_S = 0.5
"""The clock of the bar runs on while a long step reports nothing."""


@contextmanager
def show_progress(console: Console) -> Iterator[Progress]:
    """Show a bar while the block runs, unless nobody would see it."""
    if console.verbosity is Verbosity.QUIET or sys.stderr is None or not sys.stderr.isatty():
        yield ignore_progress
        return
    from tqdm import tqdm  # noqa: PLC0415  late: only who sees a bar waits for it

    with tqdm(unit=" scans", leave=False, dynamic_ncols=True) as bar:

        def advance(scans: int, total: int) -> None:
            bar.total = max(total, bar.n + scans)  # a log may hold more than its index says
            bar.update(scans)

        def redraw() -> None:
            while not done.wait(REDRAW_S):
                bar.refresh()

        done = Event()
        clock = Thread(target=redraw, daemon=True)
        clock.start()
        try:
            yield advance
        finally:
            done.set()
            clock.join()
