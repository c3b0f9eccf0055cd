"""`occmap render`: a map of saved evidence."""

from pathlib import Path
from typing import Any

import click

from occmap.cli import options
from occmap.cli.answers import Answer, answering, fail_if
from occmap.cli.console import Console
from occmap.cli.saved import put_out
from occmap.cli.sections import join, option
from occmap.report.limits import SAVED
from occmap.report.results import Report
from occmap.store.reading import open_saved

overview = option(
    options.MAP,
    "--overview",
    type=click.IntRange(min=1),
    metavar="N",
    help="Make each pixel N x N cells, quickly, from the pictures in a .zarr: 4, 16, 64 ...",
)


@answering("render", Report)
@click.argument("path", type=options.PATH, metavar="NPZ|ZARR")
@join(options.writing, options.framing, overview, options.min_passes, options.max_cells)
@join(options.saved_model)
@join(fail_if(SAVED, "unknown > 60%"), options.printing)
def command(console: Console, /, path: Path, **values: Any) -> Answer:
    """Make a map of saved evidence, without reading the log.

    The evidence is what `occmap build -o map.npz` wrote. Hits and misses can be weighed by any
    model that counts. The evidence of a radial model, such as quadratic, can be weighed only by
    that model, though with another --prior, --clamp-min or --clamp-max.

      occmap render map.npz -o map.pgm --p-hit 0.8
      occmap render map.npz -o map.pgm -o map.png --model counting --mode scale
      occmap render map.npz -o room.png --extent 0,0,5,4
      occmap render city.zarr -o city.png --overview 16
    """
    return put_out(console, [path], lambda: open_saved(path), values)
