"""What changed between two maps on one lattice: cells by class, the largest blob, a picture."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from itertools import permutations

import numpy as np

from occmap import report
from occmap.cells import Box, CellBox, CellClass
from occmap.difference.maps import ClassMap, Place
from occmap.errors import MapError
from occmap.grid.tiles import MAX_CELLS
from occmap.report import HIDDEN, Count, Printed, Row, Share, printed_as
from occmap.types import Bool, Int64, UInt8
from occmap.writers.edits import LOG_ODDS, Shape, cover


def find_largest_blob(mask: Bool) -> tuple[int, CellBox] | None:
    """Count the cells of the largest blob, and find its box; None where the mask is empty.

    A blob is connected over the edges or corners of its cells; of several alike it is the lowest.
    """
    row, start, end = runs = find_runs(mask)
    if not len(row):
        return None
    labels = label_connected(len(row), *find_contacts(runs, mask.shape[1]))
    cells = np.bincount(labels, weights=end - start)
    row, start, end = runs[:, labels == np.argmax(cells)]
    box = CellBox(int(row[0]), int(start.min()), int(row[-1]) + 1, int(end.max()))
    return int(cells.max()), box


def find_runs(mask: Bool) -> Int64:
    """(3, N) row, first column and column behind the last of each run of cells in a mask (H, W)."""
    change = np.diff(np.pad(mask, [(0, 0), (1, 1)]).view(np.int8), axis=1)
    row, start = np.nonzero(change == 1)
    _, end = np.nonzero(change == -1)
    return np.stack([row, start, end])


def find_contacts(runs: Int64, cols: int) -> tuple[Int64, Int64]:
    """Pairs of runs in neighbouring rows that share an edge or a corner; (C,) each.

    What a run touches in the row above it begins with the first run that ends where it starts or
    later, and goes up to the last one that starts where it ends or earlier.
    """
    row, start, end = runs
    stride = cols + 2  # a run that ends with a row touches none that begins the next
    above = (row + 1) * stride
    first = np.searchsorted(row * stride + end, above + start, "left")
    last = np.searchsorted(row * stride + start, above + end, "right")
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
    while (labels[one] != labels[other]).any():
        lowest = np.minimum(labels[one], labels[other])
        for touched in (labels[one], labels[other]):
            np.minimum.at(labels, touched, lowest)
        while not np.array_equal(labels, labels[labels]):
            labels = labels[labels]
    return labels


LATTICE_TOLERANCE = 0.05
"""In cells: other tools round the origin to millimetres."""
SAME_RESOLUTION = 1e-6
"""Relative: so little that it does not add up to a cell across a map."""

FREE, OCCUPIED, NEITHER = CellClass.FREE, CellClass.OCCUPIED, CellClass.NEITHER
COLOURS = {
    (NEITHER, NEITHER): (205, 205, 205),
    (FREE, FREE): (254, 254, 254),
    (OCCUPIED, OCCUPIED): (0, 0, 0),
    (FREE, NEITHER): (204, 121, 167),
    (OCCUPIED, NEITHER): (136, 34, 85),
    (NEITHER, FREE): (86, 180, 233),
    (NEITHER, OCCUPIED): (230, 159, 0),
    (OCCUPIED, FREE): (0, 114, 178),
    (FREE, OCCUPIED): (213, 94, 0),
}
"""Of what a cell was and is: warm is new and occupied, blue new and free, wine a lost wall, pink
lost floor. Colour-blind people tell these apart, too (Okabe and Ito, 2008; wine: Tol, 2021). Where
cells share a pixel, the latest of these shows."""


@dataclass(frozen=True)
class ChangedBlob:
    """Connected cells that changed."""

    cells: int
    """Cells that are connected over their edges or corners"""
    extent: Box
    """Lowest x and y, highest x and y (m; cells where the maps are bare images)"""


@dataclass(frozen=True, eq=False, kw_only=True)
class MapDifference(Printed):
    """What changed between two maps: what occmap diff prints."""

    share: Share
    """Share of the known cells that changed"""
    known: Count
    """Cells that are occupied or free in either map"""
    changed_cells: Count = field(metadata=printed_as("changed"))
    """Cells that changed"""
    changed: dict[str, Count] = field(metadata=printed_as("by_class"))
    """Cells that changed, by what they were and are, such as free to occupied"""
    edited: Count | None
    """Those of them where the shapes of `edits` lie, and may have changed them; null without"""
    largest: ChangedBlob | None = field(metadata=printed_as("largest_blob"))
    """The largest connected change; null where nothing changed"""
    columns: Count
    """Cells of both maps together from left to right (along x)"""
    rows: Count
    """Cells of both maps together from bottom to top (along y)"""
    evidence: tuple[str | None, str | None]
    """Name of what was observed for each map, equal where each cell was observed alike, in whatever
    file; null for an image that does not say"""
    notes: tuple[str, ...] = ()
    """What a user should know, one sentence each, as on stderr"""
    before: UInt8 = field(metadata=HIDDEN)
    after: UInt8 = field(metadata=HIDDEN)
    """(H, W) of CellClass, over both maps; NEITHER is also what a map does not reach"""
    place: Place = field(metadata=HIDDEN)
    """Where cell (0, 0) of both lies"""


def tell_changes(difference: MapDifference) -> Iterator[Row]:
    """Sum up a difference in a few rows."""
    known = f"{difference.share:.3%} of {report.count(difference.known, 'known cell')}"
    by_class = [f"{cells:,} {name}" for name, cells in difference.changed.items() if cells]
    total = f"{report.count(difference.changed_cells, 'cell')}, {known}"
    yield from report.label_first("changed", [total, *by_class])
    if difference.edited is not None:
        drawn = report.count(difference.edited, "changed cell")
        yield "edits", f"{drawn} in shapes that were drawn"
    if difference.largest:
        low_x, low_y, high_x, high_y = report.write_metres(difference.largest.extent)
        blob = report.count(difference.largest.cells, "connected cell")
        yield "largest", f"{blob}, x {low_x} to {high_x}, y {low_y} to {high_y}"
    before, after = difference.evidence
    if before and before == after:
        other = "; what changed is the rendering or the image" if difference.changed_cells else ""
        yield "evidence", f"{before}, of both{other}"
    elif before and after:
        yield from report.label_first("evidence", [before, after])


def compare_maps(before: ClassMap, after: ClassMap, shapes: Sequence[Shape] = ()) -> MapDifference:
    """Compare two maps cell by cell; they may be of different size.

    Parameters
    ----------
    shapes
        Edits that were drawn over one of them or both.

    Raises
    ------
    MapError
        They lie on different lattices, or too far apart.
    """
    place, shift = align(before, after)
    first = CellBox(0, 0, *before.classes.shape)
    second = CellBox(0, 0, *after.classes.shape).move(*shift)
    both = first.join(second)
    if both.cells > MAX_CELLS:
        found = f"both maps together take {both.cols} x {both.rows} cells, too many to compare"
        raise MapError(found, where=after.path, fix="check that both are in one map frame")
    one, other = place_in(both, first, before.classes), place_in(both, second, after.classes)
    corner = Place(place.resolution, *place.measure(both)[:2])
    blob = find_largest_blob(one != other)
    changed, known = count_changes(one, other), int(np.count_nonzero(one | other))
    notes = [*before.notes, *after.notes]
    if before.evidence and after.evidence and before.align != after.align:
        turns = (f"{each.path} is turned by {each.align or 0} degrees" for each in (before, after))
        notes.append(f"{', '.join(turns)}: to see what changed, build both with one `align`")
    changed_cells = sum(changed.values())
    box = both.move(round(place.y / place.resolution), round(place.x / place.resolution))
    is_drawn = cover((it for it in shapes if it.change in LOG_ODDS), box, place.resolution)
    return MapDifference(
        share=changed_cells / max(known, 1),
        known=known,
        changed_cells=changed_cells,
        changed=changed,
        edited=int(np.count_nonzero(is_drawn & (one != other))) if shapes else None,
        largest=blob and ChangedBlob(blob[0], corner.measure(blob[1])),
        columns=both.cols,
        rows=both.rows,
        evidence=(before.evidence, after.evidence),
        notes=tuple(notes),
        before=one,
        after=other,
        place=corner,
    )


def align(before: ClassMap, after: ClassMap) -> tuple[Place, tuple[int, int]]:
    """Find the row and column of the first map that the second one's cell (0, 0) lies on.

    Raises
    ------
    MapError
        There is no such cell, or a bare image differs in size from the other map.
    """
    a, b = before.place, after.place
    if a is None or b is None:
        if before.classes.shape != after.classes.shape:
            bare = before.path if a is None else after.path
            found = "a PNG does not say where it lies, and the two maps differ in size"
            raise MapError(found, where=bare, fix="compare the maps as PGM with YAML, or as .npz")
        return a or b or Place(1.0, 0.0, 0.0), (0, 0)
    if abs(a.resolution - b.resolution) > SAME_RESOLUTION * a.resolution:
        found = f"its cells are {b.resolution:g} m, those of {before.path} {a.resolution:g} m"
        raise MapError(found, where=after.path, fix="build both with one `resolution`")
    row, col = (b.y - a.y) / a.resolution, (b.x - a.x) / a.resolution
    if max(abs(row - round(row)), abs(col - round(col))) > LATTICE_TOLERANCE:
        found = f"lies {col:.3f} columns and {row:.3f} rows from {before.path}: not on one lattice"
        fix = "maps that occmap builds with one `resolution` share a lattice"
        raise MapError(found, where=after.path, fix=fix)
    return a, (round(row), round(col))


def place_in(both: CellBox, box: CellBox, classes: UInt8) -> UInt8:
    """Put a map, which covers a box, into a larger one; its other cells are neither."""
    larger = np.full(both.shape, NEITHER, np.uint8)
    larger[box.within(both)] = classes
    return larger


def count_changes(before: UInt8, after: UInt8) -> dict[str, int]:
    """Count cells by what they were and are, where these differ."""
    counts = np.bincount((3 * before + after).ravel(), minlength=9)
    return {
        f"{was.name.lower()} to {now.name.lower()}": int(counts[3 * was + now])
        for was, now in permutations(CellClass, 2)
    }


def paint(difference: MapDifference) -> UInt8:
    """(H, W, 3) red, green, blue, highest y on top: the map, and in colour what changed."""
    table = np.zeros((3, 3, 3), np.uint8)
    for (was, now), colour in COLOURS.items():
        table[was, now] = colour
    return table[difference.before, difference.after][::-1]
