"""Connected cells of a mask, as runs along the rows that touch each other."""

from typing import NamedTuple

import numpy as np

from occmap.grid.lattice import CellBox
from occmap.types import Bool, Int64


class Blob(NamedTuple):
    """Cells that are connected over their edges or corners."""

    cells: int
    box: CellBox


class Runs(NamedTuple):
    """Neighbouring cells of one row each, in the order of rows and columns; (N,) each."""

    row: Int64
    start: Int64
    end: Int64
    """Not part of the run"""


def find_largest_blob(mask: Bool) -> Blob | None:
    """Find the blob of the most cells, of several the lowest; None where the mask is empty."""
    runs = find_runs(mask)
    if not len(runs.row):
        return None
    labels = label_connected(len(runs.row), *find_contacts(runs, mask.shape[1]))
    cells = np.bincount(labels, weights=runs.end - runs.start)
    inside = labels == np.argmax(cells)
    row, start, end = (part[inside] for part in runs)
    box = CellBox(int(row[0]), int(start.min()), int(row[-1]) + 1, int(end.max()))
    return Blob(int(cells.max()), box)


def find_runs(mask: Bool) -> Runs:
    """Find the runs of cells in each row of a mask (H, W)."""
    padded = np.zeros((mask.shape[0], mask.shape[1] + 2), np.int8)
    padded[:, 1:-1] = mask
    change = np.diff(padded, axis=1)
    row, start = np.nonzero(change == 1)
    _, end = np.nonzero(change == -1)
    return Runs(row, start, end)


def find_contacts(runs: Runs, cols: int) -> tuple[Int64, Int64]:
    """Pairs of runs in neighbouring rows that share an edge or a corner; (C,) each.

    What a run touches in the row above it begins with the first run that ends where it starts or
    later, and goes up to the last one that starts where it ends or earlier.
    """
    stride = cols + 2  # a run that ends with a row touches none that begins the next
    above = (runs.row + 1) * stride
    first = np.searchsorted(runs.row * stride + runs.end, above + runs.start, "left")
    last = np.searchsorted(runs.row * stride + runs.start, above + runs.end, "right")
    count = np.maximum(last - first, 0)
    lower = np.repeat(np.arange(len(count)), count)
    step = np.arange(len(lower)) - np.repeat(np.cumsum(count) - count, count)
    return lower, np.repeat(first, count) + step


def label_connected(count: int, one: Int64, other: Int64) -> Int64:
    """(count,) labels of things that pairs connect: the smallest number among the connected.

    Every round gives each label the smallest that it touches, then follows labels to their end, so
    that a long snake takes few rounds.
    """
    labels = np.arange(count)
    while True:
        lowest = np.minimum(labels[one], labels[other])
        target = labels.copy()
        np.minimum.at(target, labels[one], lowest)
        np.minimum.at(target, labels[other], lowest)
        while not np.array_equal(target, target[target]):
            target = target[target]
        if np.array_equal(target[labels], labels):
            return labels
        labels = target[labels]
