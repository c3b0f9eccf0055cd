"""Which scans of a log to use: what a user may choose, and what becomes of each scan."""

import math
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from enum import StrEnum

from occmap.choices import option
from occmap.errors import require
from occmap.posing.options import Stamps
from occmap.types import Cloud, Recorded, Scan


class LeftOut(StrEnum):
    """Why a scan is not used, before its pose is looked up."""

    NO_BEAMS = "no beams"
    BAD_ANGLES = "angles not finite"
    TIME = "outside `start_s` and `end_s`"
    STRIDE = "left out by `stride`"


NOT_ASKED_FOR = (LeftOut.TIME, LeftOut.STRIDE)
"""The user's own choice: nothing is wrong with these scans, and none of them is lost."""


def count_wanted(read: int, unused: Mapping[str, int]) -> int:
    """Count the scans that were asked for, of those read; `unused` counts scans by reason."""
    return read - sum(unused.get(reason, 0) for reason in NOT_ASKED_FOR)


@dataclass(frozen=True)
class Selection:
    """Which scans of a log to use; two parts that end and start at one time share no scan.

    Raises
    ------
    UsageError
        The values leave no scan to use.
    """

    topics: tuple[str, ...] = option(
        (), "Use the scans of this topic; by default of all.", metavar="TOPIC", flag="scan-topic"
    )
    start_s: float = option(-math.inf, "Use scans from this time after the first on.", unit="s")
    end_s: float = option(math.inf, "Use scans before this time after the first.", unit="s")
    stride: int = option(1, "Use every N-th of these scans.", unit="scans", metavar="N")

    def __post_init__(self) -> None:
        require(self.stride >= 1, f"a stride of {self.stride} is not possible", "give 1 or more")
        found = f"`start_s={self.start_s}` is not before `end_s={self.end_s}`"
        fix = "both are in seconds after the log's first scan"
        require(self.start_s < self.end_s, found, fix)


def find_flaw(scan: Scan | Cloud) -> LeftOut | None:
    """Say why nobody can use a scan; None where it can be used."""
    if isinstance(scan, Cloud):
        return None if len(scan.points) else LeftOut.NO_BEAMS
    if not len(scan.ranges):
        return LeftOut.NO_BEAMS
    if not (math.isfinite(scan.angle_min) and math.isfinite(scan.angle_increment)):
        return LeftOut.BAD_ANGLES
    return None


class Selector:
    """Says which scans of one log are used; it is shown all of them, in order."""

    def __init__(self, selection: Selection, stamps: Stamps) -> None:
        self.selection = selection
        self.stamps = stamps
        """Which of a scan's two times counts"""
        self._wants_all = replace(selection, topics=()) == Selection()
        self.first_ns: int | None = None
        """The stamp of the log's first scan; None before it is seen"""
        self._wanted = 0
        """How many scans lie in the time window so far"""
        self.read = 0
        self.left_out: Counter[LeftOut] = Counter()
        """How many of those read `select` left out, by reason"""

    def select(self, scans: Iterable[Recorded]) -> Iterator[Recorded]:
        """Pass on the scans that are used, and count the others."""
        for some, reason in self.judge(scans):
            self.read += some.scans
            if reason is None:
                yield some
            else:
                self.left_out[reason] += 1

    def judge(self, scans: Iterable[Recorded]) -> Iterator[tuple[Recorded, LeftOut | None]]:
        """Give each scan and why it is not used, or None; a run stays whole if all is used."""
        for some in scans:
            # A run is taken whole where the user wants every scan, and these can be used.
            if isinstance(some, Scan | Cloud) or (
                self._wants_all and find_flaw(some.first) is None
            ):
                yield some, self._judge_next(some.first)
            else:
                yield from ((scan, self._judge_next(scan)) for scan in some.split())

    def _judge_next(self, scan: Scan | Cloud) -> LeftOut | None:
        stamp_ns = self.stamps.choose(scan.stamp_ns, scan.record_ns)
        self.first_ns = stamp_ns if self.first_ns is None else self.first_ns
        if (flaw := find_flaw(scan)) is not None:
            return flaw
        if not self.selection.start_s <= (stamp_ns - self.first_ns) / 1e9 < self.selection.end_s:
            return LeftOut.TIME
        self._wanted += 1
        return LeftOut.STRIDE if (self._wanted - 1) % self.selection.stride else None
