"""Scans of a log, counted, and those that come in runs as single ones that can be compared."""

from collections.abc import Iterable

import numpy as np

from occmap.readers import Log
from occmap.types import Cloud, Pose, Scan, ScanRun


def count_scans(log: Log) -> int:
    """How many scans of the usual topic are read."""
    return len(list(log.scans({"/scan"})))


def flatten(items: Iterable[Scan | ScanRun]) -> list[Scan]:
    """Every scan by itself."""
    return [
        scan for item in items for scan in (item.split() if isinstance(item, ScanRun) else [item])
    ]


def list_fields(scans: Iterable[Scan | Cloud]) -> list[list[object]]:
    """Every field, in a form in which what is not a number equals itself."""
    return [
        [str(list(field)) if isinstance(field, Pose | np.ndarray) else field for field in scan]
        for scan in scans
    ]
