"""The polygon update: a whole scan at once, its measured cells the border, the inside free.

Each border cell gets one hit a scan, however many beams end there. Every other cell whose centre is
inside gets one miss a scan.

The inside is not visited: a span of free cells is +1 at its first column and -1 after its last,
and one running sum along the rows turns thousands of scans' spans into counts. The cost of a scan
is thus its border. A border cell gets no miss from its own scan, so it counts how often it lay in
a span of its own scan, and that is taken off in the end.
"""

import numpy as np

from occmap.arrays import Float32, Float64, Int32, Int64, UInt8
from occmap.grid.kernels.fill import Spans, fill_outline, make_outline, make_spans
from occmap.grid.kernels.outline import ScanBeams, Surfaces, link_beams, list_border, outline_scan
from occmap.grid.kernels.units import AT_A_TIME, PAD
from occmap.jit import kernel

BORDER_BITS = 22
"""A border cell packs, from the lowest bit: minus the number of its hits that lay inside their own
scan's region (it borrows from the next field), its hits, and the last scan that hit it."""
COUNTED = (1 << (2 * BORDER_BITS)) - 1
"""Mask of the bits of both counts, without those of the last scan."""
MOST_SCANS = (1 << 20) - 1
"""The bits above both counts hold no larger number of a scan."""


@kernel
def trace_polygons(
    origin: Float64,
    turn: Float64,
    bearing: Float64,
    distance: Float32,
    ends_x: Int32,
    ends_y: Int32,
    kinds: UInt8,
    surfaces: Surfaces,
    border: Int64,
    runs: Int32,
    mark: int,
) -> None:
    """Add every scan's border and inside.

    Parameters
    ----------
    origin, turn, bearing, distance, kinds
        (S, 1, 2), (S, K, 2, 2), (2, B), (S, B), (S, B) as in `Rays`.
    ends_x, ends_y
        (S, B) lattice units from the anchor.
    border
        (H, W + PAD) packed as `BORDER_BITS` says; scans count from `mark` + 1, and none above
        `mark` is there yet.
    runs
        H x (W + PAD), flat: changes of the misses along rows.
    """
    scans, beams = kinds.shape
    rows, cols = border.shape[0], border.shape[1] - PAD
    links, room = np.empty(beams, np.uint8), np.empty(beams, np.int32)
    cells = np.empty((beams * max(surfaces.border_gap, 1) + AT_A_TIME, 2), np.int32)
    outline, spans = make_outline(3 * beams + 4), make_spans(rows)
    for s in range(scans):
        scan = ScanBeams(
            origin[s, 0], turn[s], bearing, distance[s], kinds[s], ends_x[s], ends_y[s]
        )
        listed = link_beams(scan, surfaces, links, room)
        corners, touched = outline_scan(scan, surfaces, links, listed, outline, rows)
        spans = fill_outline(outline, corners, touched, cols, spans)
        _note_spans(touched, spans, border.shape[1], runs)
        size = list_border(scan, links, listed, surfaces, rows, cols, cells)
        _note_border(cells, size, spans, mark + s + 1, border)


@kernel
def _note_spans(touched: tuple[int, int], spans: Spans, stride: int, runs: Int32) -> None:
    """Add one miss to every cell of every span."""
    starts, counts, limits = spans.starts, spans.counts, spans.limits
    for row in range(touched[0], touched[1]):
        begin, size, place = starts[np.uint64(row)], counts[np.uint64(row)], row * stride
        if size == 2:  # nearly always
            runs[np.uint64(place + limits[np.uint64(begin)])] += 1
            runs[np.uint64(place + limits[np.uint64(begin + 1)])] -= 1
            continue
        for i in range(begin, begin + size, 2):
            runs[np.uint64(place + limits[np.uint64(i)])] += 1
            runs[np.uint64(place + limits[np.uint64(i + 1)])] -= 1


@kernel
def _note_border(cells: Int32, size: int, spans: Spans, mark: int, border: Int64) -> None:
    """Give each of the listed cells one hit, and count whether it lies in a span."""
    starts, counts, limits = spans.starts, spans.counts, spans.limits
    for i in range(size):
        row, col = np.uint64(cells[i, 0]), cells[i, 1]
        begin, in_row, passed = starts[row], counts[row], 0
        for k in range((in_row + AT_A_TIME - 1) // AT_A_TIME * AT_A_TIME):
            passed += (limits[np.uint64(begin + k)] <= col) & (k < in_row)
        # No branch: whether neighbours share a cell is a coin toss to a processor.
        cell = border[row, np.uint64(col)]
        hit = (cell & COUNTED) + (1 << BORDER_BITS) - (passed & 1)
        is_new = (cell >> (2 * BORDER_BITS)) != mark
        border[row, np.uint64(col)] = hit | (mark << (2 * BORDER_BITS)) if is_new else cell
