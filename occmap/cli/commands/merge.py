"""`occmap merge`: saved evidence added up and taken apart."""

from pathlib import Path
from typing import Any

import click

from occmap.cli import options
from occmap.cli.answers import Answer, answering, fail_if
from occmap.cli.console import Console
from occmap.cli.saved import put_out
from occmap.cli.sections import join
from occmap.report.limits import SAVED
from occmap.report.results import Report
from occmap.store.merging import combine

subtracted = options.paths(
    options.FILES, "--subtract", metavar="NPZ", text="Take the evidence in this file away."
)


@answering("merge", Report)
@click.argument("paths", nargs=-1, required=True, type=options.PATH, metavar="NPZ|ZARR...")
@join(options.writing, subtracted, options.min_passes, options.max_cells)
@join(fail_if(SAVED, "unknown > 60%"), options.printing)
def command(console: Console, /, paths: tuple[Path, ...], **values: Any) -> Answer:
    """Add saved evidence, or take some of it away, exactly.

    The sum has the same cells as one build of all the logs, whatever the order; what is subtracted
    leaves no trace. All must have one resolution, update and kind of model. The visits that
    --min-passes counts are those of one build, too: one that goes on from log to log is one.

      occmap merge monday.npz tuesday.npz -o both.npz
      occmap merge both.npz --subtract monday.npz -o tuesday.npz -o tuesday.pgm
    """
    taken = values["subtract"]
    return put_out(console, [*paths, *taken], lambda: combine(paths, taken), values)
