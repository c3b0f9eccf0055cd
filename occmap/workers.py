"""Threads that work on batches while the next one is read; kernels and NumPy release the lock."""

import os
from collections.abc import Callable
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from types import TracebackType
from typing import Generic, Self, TypeVar

Item = TypeVar("Item")


def count_cores() -> int:
    """Cores that this process may use."""
    if hasattr(os, "sched_getaffinity"):  # not on macOS or Windows
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


class Workers(Generic[Item]):
    """Calls a function for each item given, in `jobs` threads, or at once where `jobs` is 1.

    No more than two items a thread wait, so that a fast reader does not fill the memory. The first
    error of any thread is raised where items are given.
    """

    def __init__(self, work: Callable[[Item], None], jobs: int) -> None:
        self._work = work
        self._most_waiting = 2 * jobs
        self._waiting: set[Future[None]] = set()
        self._pool = ThreadPoolExecutor(jobs, "occmap") if jobs > 1 else None

    def give(self, item: Item) -> None:
        """Work on an item now or soon."""
        if self._pool is None:
            self._work(item)
            return
        self._waiting.add(self._pool.submit(self._work, item))
        if len(self._waiting) >= self._most_waiting:
            done, self._waiting = wait(self._waiting, return_when=FIRST_COMPLETED)
            for future in done:
                future.result()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Wait for all work, or drop what has not begun if there was an error."""
        if self._pool is None:
            return
        self._pool.shutdown(cancel_futures=kind is not None)
        if kind is None:
            for future in self._waiting:
                future.result()
