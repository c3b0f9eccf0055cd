"""Every item is worked on once, by no more threads than asked for."""

from collections import Counter
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from threading import Event, Lock, current_thread

import pytest

from occmap.threads import Threads

PATIENCE_S = 30
"""No test waits so long unless it fails."""


def give_all(work: Callable[[int], None], jobs: int, items: int) -> None:
    with Threads(work, jobs) as threads:
        for item in range(items):
            threads.give(item)


@pytest.mark.parametrize("jobs", [1, 2, 5])
def test_every_item_is_worked_on_once(jobs: int) -> None:
    seen: Counter[int] = Counter()
    threads = set()
    lock = Lock()

    def work(item: int) -> None:
        with lock:
            seen[item] += 1
            threads.add(current_thread())

    give_all(work, jobs, 200)
    assert seen == Counter(range(200))
    assert len(threads) <= jobs


def test_the_giver_works_itself_where_enough_items_wait_and_on_what_is_left_at_the_end() -> None:
    free, begun = Event(), Event()
    own: list[int] = []

    def work(item: int) -> None:
        if current_thread() is giver:
            own.append(item)
            if item == 1:
                free.set()
        else:
            begun.set()
            assert free.wait(PATIENCE_S)

    giver = current_thread()
    with Threads(work, jobs=2) as threads:
        threads.give(0)
        assert begun.wait(PATIENCE_S)
        threads.give(1)
        threads.give(2)
        threads.give(3)
        assert own == [2, 3]  # the other thread holds 0, and 1 waits

    assert own == [2, 3, 1]


@pytest.mark.parametrize("jobs", [1, 2, 3])
@pytest.mark.parametrize("failing", [[0, 1], [0, 2], [1, 2], [1, 3], [2, 3]])
def test_the_error_of_the_earliest_item_is_raised(failing: list[int], jobs: int) -> None:
    later_failed = Event()

    def work(item: int) -> None:
        if item == failing[0]:
            later_failed.wait(0.1)  # in vain where one thread works on both
        if item in failing:
            later_failed.set()
            raise ValueError(item)

    with pytest.raises(ValueError, match=str(failing[0])):
        give_all(work, jobs, 4)


def test_after_an_error_of_the_giver_nothing_more_is_begun(monkeypatch: pytest.MonkeyPatch) -> None:
    free, begun = Event(), Event()
    done: list[int] = []
    shut_down = ThreadPoolExecutor.shutdown

    def shut_down_first(
        pool: ThreadPoolExecutor, *, wait: bool = True, cancel_futures: bool
    ) -> None:
        shut_down(pool, wait=False, cancel_futures=cancel_futures)
        free.set()
        shut_down(pool, wait=wait)

    def work(item: int) -> None:
        begun.set()
        assert free.wait(PATIENCE_S)
        done.append(item)

    def give_and_fail() -> None:
        with Threads(work, jobs=2) as threads:
            threads.give(0)
            assert begun.wait(PATIENCE_S)
            threads.give(1)
            raise KeyboardInterrupt

    monkeypatch.setattr(ThreadPoolExecutor, "shutdown", shut_down_first)
    with pytest.raises(KeyboardInterrupt):
        give_and_fail()
    assert done == [0]
