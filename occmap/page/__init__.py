"""Pages: what a command found, as one HTML file that opens anywhere, with no network.

Here is the writer that the suffix .html asks for, and comparisons with a picture of what was found:
a PNG, or a page where the name ends in .html.
"""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from occmap.difference import MapDifference, compare_maps, load_map, paint
from occmap.options import BuildOptions
from occmap.page.document import write_page
from occmap.plugins import need_extra
from occmap.scans.tracing import Progress, ignore_progress
from occmap.scoring.compare import Variant, VariantComparison, compare
from occmap.writers import Product, WriteOptions, Writer, check_picture, refuse_input


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
        from occmap.scoring.picture import write_picture  # noqa: PLC0415  late: it brings pillow

        write_picture(picture, comparison.results)
    return replace(comparison, files=(str(picture),))


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
