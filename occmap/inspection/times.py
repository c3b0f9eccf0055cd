"""Stamps of a topic: whether they run forward, and how far they are from the record times."""

from array import array

import numpy as np

from occmap.arrays import Int64
from occmap.inspection.findings import TimeFindings
from occmap.posing.options import Stamps
from occmap.posing.tracks import MAX_STAMP_NS
from occmap.types import Scan, ScanRun

LONGEST_RUN_NS = 10**16
"""A simulation lasts no longer than this: 115 days."""
EARLIEST_DATE_NS = 631_152_000 * 10**9
"""A log with the date of its recording is of 1990 or later."""


class StampLog:
    """The times of every scan of a topic, 24 bytes each."""

    def __init__(self) -> None:
        self._header = array("q")
        self._record = array("q")
        self._increment = array("d")

    def add(self, some: Scan | ScanRun) -> None:
        """Take the times of one scan, or of all scans of a run."""
        if isinstance(some, ScanRun):
            self._header.frombytes(np.clip(some.stamp_ns, -MAX_STAMP_NS, MAX_STAMP_NS).tobytes())
            self._record.frombytes(np.clip(some.record_ns, -MAX_STAMP_NS, MAX_STAMP_NS).tobytes())
            self._increment.frombytes(some.time_increment.tobytes())
        else:
            self._header.append(min(max(some.stamp_ns, -MAX_STAMP_NS), MAX_STAMP_NS))
            self._record.append(min(max(some.record_ns, -MAX_STAMP_NS), MAX_STAMP_NS))
            self._increment.append(some.time_increment)

    @property
    def header_ns(self) -> Int64:
        """(N,) what the driver wrote."""
        return np.array(self._header, np.int64)

    @property
    def record_ns(self) -> Int64:
        """(N,) when the recorder stored it."""
        return np.array(self._record, np.int64)

    def sum_up(self, suggested_stamps: Stamps, poses_ns: int | None = None) -> TimeFindings:
        """Sum up the times of at least one scan.

        Parameters
        ----------
        poses_ns
            The stamp of some pose that is not stated beside a scan, if there is one.
        """
        header, record = self.header_ns, self.record_ns
        steps = np.diff(header) / 1e9
        offset = (header.astype(np.float64) - record) / 1e9
        all_equal = len(header) > 1 and bool((header == header[0]).all())
        all_zero = bool((header == 0).all())
        duration_s = float(header.max() - header.min()) / 1e9
        simulated = (
            not all_equal and poses_ns is not None and is_simulated(header, record, poses_ns)
        )
        tenth = max(len(offset) // 10, 1)
        drift_s = float(np.median(offset[-tenth:]) - np.median(offset[:tenth]))
        increments = np.array(self._increment)
        increments = increments[np.isfinite(increments)]
        return TimeFindings(
            start_ns=int(header.min()),
            end_ns=int(header.max()),
            duration_s=duration_s,
            rate_hz=(len(header) - 1) / duration_s if duration_s else 0.0,
            largest_gap_s=float(steps.max(initial=0)),
            offset_s=float(np.median(offset)),
            drift_s=0.0 if simulated else drift_s,
            jumps_back=int(np.count_nonzero(steps < 0)),
            largest_jump_back_s=float((-steps).max(initial=0)),
            duplicates=int(np.count_nonzero(steps == 0)),
            time_increment_s=float(np.median(increments)) if len(increments) else 0.0,
            all_equal=all_equal,
            all_zero=all_zero,
            simulated=simulated,
            suggested_stamps=suggested_stamps,
        )


def is_simulated(header: Int64, record: Int64, poses_ns: int) -> bool:
    """Whether scans and poses have stamps of a simulation's clock, which begins at 0.

    The clock of a laser may begin at 0 as well, but then the poses have dates.
    """
    began = max(int(header.max()), poses_ns) < LONGEST_RUN_NS
    return began and int(header.min()) >= 0 and int(record.min()) >= EARLIEST_DATE_NS
