"""`occmap diff`: what changed between two maps, and a limit on it."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import click

from occmap.choices import take
from occmap.cli import options
from occmap.cli.console import Console, label_first, write_rows
from occmap.cli.declaring import LIMITS, Answer, answering, fail_if, join, option
from occmap.difference import MapDifference
from occmap.page.pictures import compare_files
from occmap.report.limits import DIFF, Limit, parse_bound
from occmap.report.words import count, write_metres
from occmap.writers import WriteOptions


def limit_change(text: str) -> Limit:
    """Read how much may have changed; raises UsageError where that is not a share."""
    bound = parse_bound(text.strip(), DIFF[0], f"--fail-above {text}")
    return Limit(DIFF[0], ">", bound, in_percent=text.endswith("%"), option="--fail-above")


picture = options.one_output(
    "output", "FILE", "Write the changes here: .png is a picture, .html a page."
)
fail_above = option(
    LIMITS,
    "--fail-above",
    type=limit_change,
    metavar="SHARE",
    help="Exit with 3 if more of the known cells changed: 0.01, or 1%.",
)


@answering("diff", MapDifference)
@click.argument("before", type=options.PATH, metavar="A")
@click.argument("after", type=options.PATH, metavar="B")
@join(picture, options.thresholds, fail_above, fail_if(DIFF, "changed > 1%"))
@options.printing
def diff_command(_console: Console, /, before: Path, after: Path, **values: Any) -> Answer:
    """Say what changed between two maps, and fail above a limit.

    A and B are maps as PGM with YAML, PNG, or evidence (.npz or .zarr). They may differ in size, as
    all maps of one resolution share a lattice. A PNG does not say where it lies, so it is compared
    with a map of its size. A PNG that occmap wrote says how its cells were decided; in any other,
    dark cells are occupied.

    A cell that is neither occupied nor free is unknown or undecided; images do not tell one from
    the other, so both count as neither.

    In the picture, cells that became occupied are orange and cells that became free are blue:
    strong where they were the opposite before, pale where they were neither. Cells that became
    neither are wine red if they were occupied and pink if they were free.

      occmap diff yesterday.pgm today.pgm
      occmap diff golden.yaml build/map.pgm -o diff.png --fail-above 1%
    """
    difference = compare_files(before, after, take(WriteOptions, values), values["output"])
    limits = list(filter(None, [values["fail_above"]]))
    return Answer(difference, write_rows(list_changes(difference)), limits=limits)


def list_changes(difference: MapDifference) -> Iterator[tuple[str, str]]:
    """Sum up a difference in a few rows."""
    known = f"{difference.share:.3%} of {count(difference.known, 'known cell')}"
    by_class = [f"{cells:,} {name}" for name, cells in difference.changed.items() if cells]
    yield from label_first(
        "changed", [f"{count(difference.changed_cells, 'cell')}, {known}", *by_class]
    )
    if difference.largest:
        low_x, low_y, high_x, high_y = write_metres(difference.largest.extent)
        blob = count(difference.largest.cells, "connected cell")
        yield "largest", f"{blob}, x {low_x} to {high_x}, y {low_y} to {high_y}"
    before, after = difference.digests
    if before and after and before == after:
        yield "digest", f"{before}, of both"
    elif before and after:
        yield from label_first("digests", [before, after])
