"""Pages: what a command found, as one HTML file that opens anywhere, with no network.

Here is the document, of texts, tables and plots, and the page of `check`; the writer that the
suffix .html asks for; and comparisons with a picture of what was found: a PNG, or a page where the
name ends in .html.
"""

import json
import re
import shlex
import sys
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import reduce
from importlib.metadata import version
from pathlib import Path
from platform import python_version
from typing import Any, Literal

import numpy as np

from occmap.cells import CellBox, OccupancyMap, keep_largest
from occmap.difference import MapDifference, compare_maps, paint
from occmap.difference.maps import load_map
from occmap.evidence.manifest import describe_files
from occmap.inspection import Inspection, findings
from occmap.options import BuildOptions, spell_flags
from occmap.report import Noted, join_names, name_stdin
from occmap.scans.tracing import Progress, ignore_progress
from occmap.scoring.compare import ScoredVariant, Variant, VariantComparison, compare
from occmap.types import Paths, UInt8
from occmap.writers import Product, WriteOptions, Writer, check_picture, refuse_input
from occmap.writers.atomic import open_atomic

HERE = Path(__file__).parent
MOST_NAMES = 3
"""Logs that a title names at most"""
BOKEH_ID = re.compile(r'(?<=")(p\d{4,}|[0-9a-f]{8}(-[0-9a-f]{4}){3}-[0-9a-f]{12})(?=")')
"""Drawn at random or counted on through the process: a page numbers them anew, from 0"""


@dataclass(frozen=True)
class Block:
    """A part of a section; one that holds nothing is not shown."""

    kind: Literal["facts", "table", "list", "code", "plot"]
    rows: Sequence[Sequence[Any]] = ()
    """The rows of a table, or names and values"""
    head: Sequence[str] = ()
    """Names of the columns of a table; one that begins with # holds numbers"""
    texts: Sequence[str] = ()
    """Items of a list, or lines of code"""
    tone: Literal["", "warning", "problem"] = ""
    title: str = ""
    plot: Any = None
    """A Bokeh figure"""


@dataclass(frozen=True)
class Section:
    """A card of the page."""

    title: str
    blocks: Sequence[Block]
    wide: bool = True
    """Whether it is as wide as the page"""


@dataclass(frozen=True)
class Stage:
    """Maps to look at, beside what there is under the pointer."""

    plots: Sequence[Any]
    """Bokeh figures, which are called map-0, map-1 ..."""
    data: dict[str, Any]
    """What the script knows of them; see page.js"""
    note: str
    """What of the map is not shown as it is; "" where all is"""
    titles: Sequence[str] = ("",)


@dataclass(frozen=True)
class Page:
    """What is on a page."""

    title: str
    subtitle: str
    sections: Sequence[Section]
    stage: Stage | None = None


def write_page(path: Path, page: Page) -> None:
    """Write a page.

    Raises
    ------
    OutputError
        It cannot be written; then nothing is left behind.
    """
    with open_atomic(path) as (file,):
        file.write(compose(page).encode("utf-8", "replace"))


def compose(page: Page) -> str:
    """Compose the HTML; whatever logs and files are called, it is text and nothing else."""
    from bokeh.embed import components  # noqa: PLC0415  an extra, and late: it takes long to load
    from bokeh.resources import Resources  # noqa: PLC0415  likewise
    from jinja2 import Environment, FileSystemLoader, StrictUndefined  # noqa: PLC0415  likewise

    of_stage = page.stage.plots if page.stage else ()
    of_sections = [b.plot for each in page.sections for b in each.blocks if b.kind == "plot"]
    figures = [*of_stage, *of_sections]
    script, divs = components(figures) if figures else ("", ())
    numbers: dict[str, str] = {}
    script, *divs = (
        BOKEH_ID.sub(lambda it: numbers.setdefault(it[0], f"bokeh-{len(numbers)}"), each)
        for each in (script, *divs)
    )
    resources = Resources("inline", components=["bokeh"], minified=True)
    environment = Environment(
        loader=FileSystemLoader(HERE), autoescape=True, undefined=StrictUndefined, trim_blocks=True
    )
    environment.filters["spell"] = spell_flags
    html = environment.get_template("page.html").render(
        page=page,
        maps=divs[: len(of_stage)],
        plots=iter(divs[len(of_stage) :]),
        bokeh=resources.render() + script if figures else "",
        style=(HERE / "page.css").read_text(),
        script=(HERE / "page.js").read_text(),
        data=to_script(page.stage.data if page.stage else {}),
    )
    return name_stdin(html)


def to_script(value: Any) -> str:
    """Write JSON, of dataclasses too, in which no `</script>` can occur, whatever names it has."""
    text = json.dumps(value, allow_nan=False, separators=(",", ":"), default=vars)
    return text.replace("<", "\\u003c").replace(">", "\\u003e").replace("&", "\\u0026")


def name_logs(names: Iterable[str]) -> str:
    """Name logs in a title."""
    return join_names(dict.fromkeys(names), MOST_NAMES)


def describe_maker(inputs: Iterable[Mapping[str, Any]]) -> Section:
    """Say which command made the page, with which versions, of which files."""
    blocks = []
    program = Path(sys.argv[0])
    if "occmap" in {program.stem, program.parent.name}:  # else a program of somebody else's
        blocks.append(Block("code", texts=[shlex.join(["occmap", *sys.argv[1:]])]))
    versions = ", ".join(f"{name} {version(name)}" for name in ("occmap", "numpy", "bokeh"))
    blocks.append(Block("facts", rows=[("versions", f"{versions}, Python {python_version()}")]))
    files = [(each["name"], f"{each['bytes']:,}", each["sha256"]) for each in inputs]
    blocks.append(Block("table", files, ("file", "#bytes", "SHA-256")))
    return Section("How it was made", blocks)


def write_inspection(path: Path, inspection: Inspection) -> None:
    """Write the page of an inspection.

    Raises
    ------
    OutputError
        It cannot be written; then nothing is left behind.
    """
    logs = [Path(log.path) for log in inspection.logs]
    names = name_logs(log.name for log in logs)
    verdict = "can be mapped" if inspection.buildable else "cannot be mapped as it is"
    sections = list(tell_findings(inspection))
    if inspection.map is not None:
        facts = [("size", findings.describe_map(inspection.map))]
        sections.append(Section("The map that they would make", [Block("facts", facts)]))
    sections.append(describe_maker(describe_files(*filter(Path.exists, logs))))
    write_page(path, Page(f"Check of {names}", verdict, sections))


def tell_findings(found: Inspection) -> Iterator[Section]:
    """Say what `check` finds in logs."""
    nothing = [] if found.problems or found.warnings else ["No problems, no warnings."]
    blocks = [
        Block("list", texts=found.problems, tone="problem"),
        Block("list", texts=found.warnings, tone="warning"),
        Block("list", texts=nothing),
    ]
    if found.command:
        blocks.append(Block("code", title="Recommended", texts=[shlex.join(found.command)]))
    yield Section("What check finds", blocks)
    for log in found.logs:
        topics = Block("table", findings.list_streams(log), ("topic", "type", "#messages", "holds"))
        yield Section(f"In {log.path}", [topics, Block("facts", list(findings.list_rows(log)))])


def tell_notes(result: Noted) -> Section:
    """Say what the command said beside its numbers."""
    others = result.other_notes if result.notes else ["Nothing: no damage and no warnings."]
    blocks = [Block("list", texts=result.damage, tone="problem"), Block("list", texts=others)]
    return Section("What the command said", blocks)


LARGEST_PX, SMALLEST_PX = 1000, 360
"""The longer side of a panel."""
UNKNOWN = 50
"""How dark an unknown cell is"""
RED, BLUE = (214, 39, 40), (110, 160, 230)


def compare_logs(
    paths: Paths,
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


def write_picture(path: Path, results: Sequence[ScoredVariant]) -> None:
    """Draw the maps, the best first, and where they disagree.

    Raises
    ------
    OutputError
        The picture cannot be written.
    """
    from occmap.writers.images import write_panels  # noqa: PLC0415  late: it brings pillow

    maps = [result.map for result in results]
    box, panels = reduce(CellBox.join, (grid.box for grid in maps)), []
    for result in results:
        score = result.score
        numbers = f"share {score.share:.3f}, log-likelihood {score.log_likelihood:.3f}"
        panels.append(((result.name, numbers), paint_map(result.map, box)))
    if len(results) > 1:
        legend, pixels = paint_disagreement(maps, box)
        panels.append((("where they disagree", legend), pixels))
    write_panels(path, panels)


def paint_map(grid: OccupancyMap, box: CellBox) -> UInt8:
    """Paint probability as grey, dark is occupied; (h, w, 3) of a box around the map."""
    darkness = np.full(box.shape, UNKNOWN, np.uint8)
    level = 255 - np.rint(255 * (1 - grid.probability)).astype(np.uint8)
    darkness[grid.box.within(box)] = np.where(grid.observed, level, UNKNOWN)
    return np.repeat(255 - draw(darkness)[..., None], 3, axis=2)


def draw(cells: UInt8) -> UInt8:
    """Draw (H, W) cells: the largest of those that share a pixel, highest y on top."""
    longest = max(cells.shape)
    small, times = keep_largest(cells, -(-longest // LARGEST_PX))[::-1], -(-SMALLEST_PX // longest)
    return np.asarray(small.repeat(times, axis=0).repeat(times, axis=1))


def paint_disagreement(maps: Sequence[OccupancyMap], box: CellBox) -> tuple[str, UInt8]:
    """Paint what all maps say of a cell, red where they contradict each other; a legend says so."""
    free, occupied = np.zeros((2, *box.shape), np.bool_)
    decided = np.zeros(box.shape, np.int64)
    for grid in maps:
        inside = grid.box.within(box)
        free[inside] |= grid.free
        occupied[inside] |= grid.occupied
        decided[inside] += grid.free | grid.occupied
    contradicted = free & occupied
    partly = (decided > 0) & (decided < len(maps)) & ~contradicted
    darkness = np.where(decided > 0, np.where(occupied, 255, 0), UNKNOWN).astype(np.uint8)
    pixels = np.repeat(255 - draw(darkness)[..., None], 3, axis=2)
    for cells, colour in ((partly, BLUE), (contradicted, RED)):
        pixels[draw(cells.astype(np.uint8)) > 0] = colour
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
    needs = "report", "bokeh", "jinja2"

    def write_product(self, path: Path, product: Product, options: WriteOptions) -> None:
        """Write the page.

        Raises
        ------
        OutputError
            It cannot be written; then nothing is left behind.
        """
        from occmap.page.pages import describe_product  # noqa: PLC0415  late: it brings Bokeh

        write_page(path, describe_product(product, options))
