"""`occmap check`: what is in logs and what will go wrong, before they are mapped."""

from pathlib import Path
from typing import Any

import click

from occmap.cli import COMMANDS, limits, log_options, options
from occmap.cli.console import Console, Verbosity
from occmap.cli.findings import format_inspection
from occmap.cli.sections import SectionCommand, join
from occmap.cli.streams import gather_logs
from occmap.cli.values import PATH
from occmap.gates.measures import CHECK
from occmap.inspection import inspect
from occmap.keywords import take
from occmap.options import BuildOptions
from occmap.writers.outputs import check_picture

HELP = f"""{COMMANDS["check"]}

It takes the options of `occmap build` that concern scans, poses and ranges, and ends with the
command line that it recommends. Exits with 1 where a build with the options given would fail.

\b
  occmap check drive.mcap
  occmap check room.bag --sensor-pose 0,0,3.14159 --resolution 0.02
  occmap check intel.log.gz --json
"""


page = options.one_output("output", "FILE.html", "Write the findings as a page as well.")


@click.command("check", cls=SectionCommand, help=HELP, short_help=COMMANDS["check"])
@click.argument("logs", nargs=-1, required=True, type=PATH, metavar="LOG...")
@join(page, options.resolution, options.max_cells, log_options.ranges)
@join(log_options.selection, log_options.posing)
@join(limits.fail_if(CHECK), options.config, options.as_json, options.verbosity)
@click.pass_context
def command(ctx: click.Context, /, logs: tuple[Path, ...], **values: Any) -> None:
    """Look into logs, and print what was found."""
    if values["output"]:
        check_picture(values["output"], logs, [".html"])
    console = ctx.ensure_object(Console)
    chosen = take(BuildOptions, values)
    inspection = inspect(gather_logs(console, logs, chosen), chosen)
    if values["output"]:
        from occmap.page.inspection import write_inspection  # noqa: PLC0415  late: few want it

        write_inspection(values["output"], inspection)
    if console.verbosity is Verbosity.QUIET:
        for problem in inspection.problems:
            console.tell(f"error: {problem}")
    failed = limits.answer(console, "check", inspection, format_inspection(inspection), values)
    if not inspection.buildable:
        ctx.exit(1)
    limits.leave(failed)
