"""Times of things that are compared: taken in turn, so that a busy machine slows all of them."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from statistics import median
from time import perf_counter


@dataclass(frozen=True)
class Times:
    """Seconds by name, one of each round."""

    seconds: Mapping[str, list[float]]

    def median(self, name: str) -> float:
        """Seconds of the middle round."""
        return median(self.seconds[name])

    def ratio(self, name: str, base: str) -> float:
        """The median of the ratios within each round."""
        pairs = zip(self.seconds[name], self.seconds[base], strict=True)
        return median(mine / its for mine, its in pairs)

    def best_ratio(self, name: str, base: str) -> float:
        """Of the shortest times, which a busy machine spoils least."""
        return min(self.seconds[name]) / min(self.seconds[base])


ROUNDS = 5
"""As many as anything is measured, and twice as many where a machine that others use shows most"""
Clock = Callable[[], float]
"""Seconds: `perf_counter`, or `process_time` where one thread's work is measured, for that does
not count what others do on the machine."""


def time_in_turn(
    runs: Mapping[str, Callable[[], object]], rounds: int = ROUNDS, clock: Clock = perf_counter
) -> Times:
    """Time every run once a round; see `take_in_turn`."""
    timers = {name: partial(time_once, run, clock) for name, run in runs.items()}
    return take_in_turn(timers, rounds)


def time_once(run: Callable[[], object], clock: Clock = perf_counter) -> float:
    """Seconds that a run takes."""
    start = clock()
    run()
    return clock() - start


def take_in_turn(timers: Mapping[str, Callable[[], float]], rounds: int = ROUNDS) -> Times:
    """Ask every timer once a round for its seconds, in an order that turns round.

    One round before the first is not counted: it loads what the others find loaded.
    """
    seconds: dict[str, list[float]] = {name: [] for name in timers}
    names = list(timers)
    for number in range(-1, rounds):
        for name in names:
            elapsed = timers[name]()
            if number >= 0:
                seconds[name].append(elapsed)
        names.reverse()
    return Times(seconds)
