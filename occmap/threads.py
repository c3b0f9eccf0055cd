"""Threads that work on batches while the next one is read; kernels and NumPy release the GIL."""

import os
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Generic, Self, TypeVar

Item = TypeVar("Item")


def count_cores() -> int:
    """Cores that this process may use."""
    if hasattr(os, "sched_getaffinity"):  # not on macOS or Windows
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


class Threads(Generic[Item]):
    """Calls a function for each item given, in `jobs` threads, counting the caller's own.

    Where two items for each thread are waiting, the giver works on the next one itself. So a fast
    reader does not fill the memory, and never more than `jobs` threads compete for cores and their
    caches. Of all errors that of the earliest item is raised, whichever thread was faster.
    """

    def __init__(self, work: Callable[[Item], None], jobs: int) -> None:
        self._work = work
        self._most_waiting = 2 * (jobs - 1)
        self._given: dict[Future[None], Item] = {}
        self._pool = ThreadPoolExecutor(jobs - 1, "occmap") if jobs > 1 else None

    def give(self, item: Item) -> None:
        """Work on an item now or soon."""
        for future in [future for future in self._given if future.done()]:
            if future.exception() is None:
                del self._given[future]
        earliest = next(iter(self._given), None)
        if earliest is not None and earliest.done():
            earliest.result()
        if self._pool is None or len(self._given) >= self._most_waiting:
            self._work(item)
        else:
            self._given[self._pool.submit(self._work, item)] = item

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        """Finish all work, also after an error: an earlier item may fail, too."""
        if self._pool is None:
            return
        try:
            # What no thread has begun is done here, last things first.
            for future, item in reversed(list(self._given.items())) if kind is None else ():
                if future.cancel():
                    del self._given[future]
                    self._work(item)
        finally:
            try:
                if kind is None or issubclass(kind, Exception):
                    for future in self._given:
                        future.result()
            finally:
                self._pool.shutdown(cancel_futures=True)
