"""Pages: what a command found, as one HTML file that opens anywhere, with no network.

Here is the writer that the suffix .html asks for, and comparisons with a picture of what was found:
a PNG, or a page where the name ends in .html.
"""

from collections.abc import Sequence
from dataclasses import replace
from functools import reduce
from pathlib import Path

import numpy as np

from occmap.cells import OccupancyMap, keep_largest
from occmap.difference import MapDifference, compare_maps, paint
from occmap.difference.maps import load_map
from occmap.grid import CellBox
from occmap.options import BuildOptions
from occmap.page.document import write_page
from occmap.plugins import need_extra
from occmap.scans.tracing import Progress, ignore_progress
from occmap.scoring.compare import ScoredVariant, Variant, VariantComparison, compare
from occmap.types import UInt8
from occmap.writers import Product, WriteOptions, Writer, check_picture, refuse_input

LARGEST_PX, SMALLEST_PX = 1000, 360
"""The longer side of a panel."""
UNKNOWN = 50
"""How dark an unknown cell is"""
RED, BLUE = (214, 39, 40), (110, 160, 230)


def compare_logs(
    paths: Sequence[Path],
    variants: Sequence[Variant],
    options: BuildOptions,
    picture: Path | None,
    progress: Progress = ignore_progress,
) -> VariantComparison:
    """Score several ways to map logs, and draw all maps and where they disagree, if wanted.

    Raises
    ------
    OccmapError
        As `occmap.scoring.compare.compare`, or the picture cannot be written.
    """
    check_picture(picture, paths)
    comparison = compare(paths, variants, options, progress)
    if picture is None:
        return comparison
    if picture.suffix.lower() == ".html":
        from occmap.page.pages import write_comparison  # noqa: PLC0415  late: it brings Bokeh

        write_comparison(picture, comparison)
    else:
        write_picture(picture, comparison.results)
    return replace(comparison, files=(str(picture),))


class Frame:
    """The cells that any of several maps covers, and how large they are drawn."""

    def __init__(self, maps: Sequence[OccupancyMap]) -> None:
        self._box = reduce(CellBox.join, map(CellBox.of, maps))
        self.shape = self._box.shape
        longest = max(self.shape)
        self._step = -(-longest // LARGEST_PX)
        self._times = -(-SMALLEST_PX // longest)

    def locate(self, grid: OccupancyMap) -> tuple[slice, slice]:
        """Rows and columns of a map's cells."""
        return CellBox.of(grid).within(self._box)

    def draw(self, cells: UInt8) -> UInt8:
        """Draw (H, W) cells: the largest of those that share a pixel, highest y on top."""
        small = keep_largest(cells, self._step)[::-1]
        drawn: UInt8 = small.repeat(self._times, axis=0).repeat(self._times, axis=1)
        return drawn


def write_picture(path: Path, results: Sequence[ScoredVariant]) -> None:
    """Draw the maps, the best first, and where they disagree.

    Raises
    ------
    OutputError
        The picture cannot be written.
    """
    from occmap.writers.images import Panel, write_panels  # noqa: PLC0415  late: it brings pillow

    maps = [result.map for result in results]
    frame, panels = Frame(maps), []
    for result in results:
        score = result.score
        numbers = f"share {score.share:.3f}, log-likelihood {score.log_likelihood:.3f}"
        panels.append(Panel((result.name, numbers), paint_map(result.map, frame)))
    if len(results) > 1:
        legend, pixels = paint_disagreement(maps, frame)
        panels.append(Panel(("where they disagree", legend), pixels))
    write_panels(path, panels)


def paint_map(grid: OccupancyMap, frame: Frame) -> UInt8:
    """Paint probability as grey, dark is occupied; (h, w, 3)."""
    darkness = np.full(frame.shape, UNKNOWN, np.uint8)
    level = 255 - np.rint(255 * (1 - grid.probability)).astype(np.uint8)
    darkness[frame.locate(grid)] = np.where(grid.observed, level, UNKNOWN)
    return np.repeat(255 - frame.draw(darkness)[..., None], 3, axis=2)


def paint_disagreement(maps: Sequence[OccupancyMap], frame: Frame) -> tuple[str, UInt8]:
    """Paint what all maps say of a cell, red where they contradict each other; a legend says so."""
    free, occupied = np.zeros((2, *frame.shape), np.bool_)
    decided = np.zeros(frame.shape, np.int64)
    for grid in maps:
        box = frame.locate(grid)
        free[box] |= grid.free
        occupied[box] |= grid.occupied
        decided[box] += grid.free | grid.occupied
    contradicted = free & occupied
    partly = (decided > 0) & (decided < len(maps)) & ~contradicted
    darkness = np.where(decided > 0, np.where(occupied, 255, 0), UNKNOWN).astype(np.uint8)
    pixels = np.repeat(255 - frame.draw(darkness)[..., None], 3, axis=2)
    for cells, colour in ((partly, BLUE), (contradicted, RED)):
        pixels[frame.draw(cells.astype(np.uint8)) > 0] = colour
    known = max(int(np.count_nonzero(decided)), 1)
    red, blue = (np.count_nonzero(mask) / known for mask in (contradicted, partly))
    return f"red: free or occupied ({red:.1%}), blue: known or not ({blue:.1%})", pixels


def compare_files(
    before: Path, after: Path, thresholds: WriteOptions, picture: Path | None
) -> MapDifference:
    """Load two maps, compare them, and draw what changed, if wanted.

    Parameters
    ----------
    thresholds
        For formats that hold probabilities.

    Raises
    ------
    OccmapError
        A map cannot be read, they do not lie on one lattice, or the picture cannot be written.
    """
    check_picture(picture, [before, after])
    maps = [load_map(path, thresholds) for path in (before, after)]
    difference = compare_maps(maps[0], maps[1], thresholds.shapes)
    if picture is None:
        return difference
    refuse_input(picture, [each.image for each in maps if each.image])
    if picture.suffix.lower() == ".html":
        from occmap.page.pages import write_difference  # noqa: PLC0415  late: it brings Bokeh

        write_difference(picture, difference, (before, after))
    else:
        from occmap.writers.images import write_colours  # noqa: PLC0415  late: it brings pillow

        write_colours(picture, paint(difference))
    return difference


class HtmlWriter(Writer):
    """One page with everything in it: the map, its layers, the way, and how it came about."""

    description = "page for any browser: the map in layers, the way, what was found"
    needs_evidence = shows_journey = True

    def targets(self, path: Path) -> tuple[Path, ...]:
        """Return the file.

        Raises
        ------
        UsageError
            Bokeh, which is an extra, is not installed.
        """
        with need_extra("report", "a page is drawn by Bokeh", where=path):
            import bokeh  # noqa: F401, PLC0415  an extra
            import jinja2  # noqa: F401, PLC0415  likewise
        return super().targets(path)

    def write_product(
        self, path: Path, product: Product, options: WriteOptions
    ) -> tuple[Path, ...]:
        """Write the page; return its path.

        Raises
        ------
        OutputError
            It cannot be written; then nothing is left behind.
        """
        from occmap.page.pages import describe_product  # noqa: PLC0415  late: it brings Bokeh

        write_page(path, describe_product(product, options))
        return (path,)
