"""Scans that come in runs, as single ones that can be compared."""

from collections.abc import Iterable

import numpy as np

from occmap.types import Pose, Scan, ScanRun


def flatten(items: Iterable[Scan | ScanRun]) -> list[Scan]:
    """Every scan by itself."""
    return [
        scan for item in items for scan in (item.split() if isinstance(item, ScanRun) else [item])
    ]


def list_fields(scans: Iterable[Scan]) -> list[list[object]]:
    """Every field, in a form in which what is not a number equals itself."""
    return [
        [str(list(field)) if isinstance(field, Pose | np.ndarray) else field for field in scan]
        for scan in scans
    ]
