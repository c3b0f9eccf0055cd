"""`occmap render`: a map of saved evidence."""

from pathlib import Path
from typing import Any

import click

from occmap.cli import COMMANDS, limits, options
from occmap.cli.console import Console
from occmap.cli.saved import choose_outputs, put_out
from occmap.cli.sections import SectionCommand, join, option
from occmap.cli.values import PATH, read_by, read_list
from occmap.errors import UsageError
from occmap.gates.measures import SAVED
from occmap.types import Box
from occmap.writers.npz import read_evidence

HELP = f"""{COMMANDS["render"]}

The evidence is what `occmap build -o map.npz` wrote. Hits and misses can be weighed by any model
that counts; the evidence of a radial model, such as quadratic, only by that one, but for
its --prior and bounds.

\b
  occmap render map.npz -o map.pgm --p-hit 0.8
  occmap render map.npz -o map.pgm -o map.png --model counting --mode scale
  occmap render map.npz -o room.png --crop 0,0,5,4
"""

CROP_FORM = "write x_min,y_min,x_max,y_max in metres, such as 0,0,5,4"


def parse_crop(text: str) -> Box:
    """Read the part of a map to keep.

    Raises
    ------
    UsageError
        The text is not of four numbers, or they span nothing.
    """
    where = f"--crop {text}"
    x_min, y_min, x_max, y_max = read_list(text, 4, where, CROP_FORM)
    if not (x_min < x_max and y_min < y_max):
        raise UsageError("the box is empty", where=where, fix=CROP_FORM)
    return x_min, y_min, x_max, y_max


part = option(
    options.MAP,
    "--crop",
    **read_by(parse_crop),
    metavar="X_MIN,Y_MIN,X_MAX,Y_MAX",
    help="Only this part of the map (m), to whole cells; an .npz stays whole.",
)


@click.command("render", cls=SectionCommand, help=HELP, short_help=COMMANDS["render"])
@click.argument("path", type=PATH, metavar="NPZ")
@join(options.writing, part, options.min_passes, options.max_cells, options.saved_model)
@join(limits.fail_if(SAVED), options.as_json, options.verbosity)
@click.pass_obj
def command(console: Console, /, path: Path, **values: Any) -> None:
    """Read evidence, and write a map of it."""
    values["outputs"] = choose_outputs(console, values["outputs"], "map.pgm", [path])
    put_out(console, "render", read_evidence(path), values)
