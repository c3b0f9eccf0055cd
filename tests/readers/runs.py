"""Texts that are opened, scans that are counted and compared, and memory that is bounded."""

import tracemalloc
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from occmap.readers import Log
from occmap.readers.carmen import CarmenLog, CarmenReader
from occmap.readers.csv import CsvLog, CsvReader
from occmap.types import Cloud, Pose, Scan, ScanBatch


@contextmanager
def bounded_memory(most: int = 64_000_000) -> Iterator[None]:
    """Fail where a block holds more bytes at a time."""
    tracemalloc.start()
    try:
        yield
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert peak < most


def open_csv(folder: Path, content: str | bytes) -> CsvLog:
    path = folder / "log.csv"
    path.write_bytes(content.encode() if isinstance(content, str) else content)
    return CsvReader().open(path)


def open_carmen(folder: Path, content: str | bytes) -> CarmenLog:
    path = folder / "log.log"
    path.write_bytes(content.encode() if isinstance(content, str) else content)
    return CarmenReader().open(path)


def count_scans(log: Log) -> int:
    """How many scans of the usual topic are read."""
    return len(list(log.scans({"/scan"})))


def flatten(items: Iterable[Scan | ScanBatch]) -> list[Scan]:
    """Every scan by itself."""
    return [
        scan for item in items for scan in (item.split() if isinstance(item, ScanBatch) else [item])
    ]


def list_fields(scans: Iterable[Scan | Cloud]) -> list[list[object]]:
    """Every field, in a form in which what is not a number equals itself."""
    return [
        [str(list(field)) if isinstance(field, Pose | np.ndarray) else field for field in scan]
        for scan in scans
    ]


def expect_equal(scan: Scan, expected: Scan) -> None:
    """Compare all fields, where nan is like nan."""
    assert list_fields([scan]) == list_fields([expected])
    assert scan.ranges.dtype == np.float32
