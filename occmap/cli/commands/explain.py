"""`occmap explain`: what was seen at a point, and by which scans."""

import re
from pathlib import Path
from typing import Any

import click

from occmap.cli import COMMANDS, options
from occmap.cli.cells import format_explanation
from occmap.cli.console import Console
from occmap.cli.progress import show_progress
from occmap.cli.saved import choose_model
from occmap.cli.sections import SectionCommand, join, option
from occmap.cli.values import PATH
from occmap.explanation import Question, explain
from occmap.keywords import take
from occmap.store.sources import open_saved
from occmap.writers import WriteOptions

HELP = f"""{COMMANDS["explain"]}

X and Y are metres in the map frame. Each --log that the evidence was made of is read as it was
built, and its scans are listed that hit or cleared the cell; a log is known by its hash, wherever
it lies now.

\b
  occmap explain map.npz 1.5 -0.25
  occmap explain map.npz 1.5 -0.25 --log drive.mcap
  occmap explain map.npz 1.5 -0.25 --log scans.csv --poses trajectory.txt --json
"""

NUMBER = r"(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?"
NEGATIVE = re.compile(f"-{NUMBER}")
POINT = re.compile(f"-?{NUMBER},-?{NUMBER}")


class PointCommand(SectionCommand):
    """A command whose arguments may be negative numbers, which look like options."""

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        """Part X,Y, and put a space before negative numbers: no option begins with one."""
        words = [w for word in args for w in (word.split(",") if POINT.fullmatch(word) else [word])]
        return super().parse_args(ctx, [f" {w}" if NEGATIVE.fullmatch(w) else w for w in words])


logs = option(
    options.SCANS,
    "--log",
    "logs",
    type=PATH,
    multiple=True,
    metavar="LOG",
    help="List the scans of this log that observed the cell. May repeat.",
)
poses = option(
    options.POSES,
    "--poses",
    type=PATH,
    multiple=True,
    metavar="FILE",
    help="The trajectory that the log was built with. May repeat.",
)


@click.command("explain", cls=PointCommand, help=HELP, short_help=COMMANDS["explain"])
@click.argument("path", type=PATH, metavar="NPZ|ZARR")
@click.argument("x", type=float)
@click.argument("y", type=float)
@join(logs, poses, options.min_passes, options.saved_model, options.thresholds)
@join(options.as_json, options.verbosity)
@click.pass_obj
def command(console: Console, /, path: Path, **values: Any) -> None:
    """Look at a cell, and print what was found."""
    evidence = open_saved(path)
    view = {"model": choose_model(evidence, values), "writing": take(WriteOptions, values)}
    question = take(Question, values | view)
    with show_progress(console) as progress:
        explanation = explain(evidence, question, progress)
    console.note(*explanation.notes)
    if values["as_json"]:
        console.put_json("explain", explanation.to_json())
    else:
        console.put(format_explanation(explanation, with_scans=bool(values["logs"])))
