"""`occmap check`: what is in logs and what will go wrong, before they are mapped."""

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import click

from occmap.choices import take
from occmap.cli import options
from occmap.cli.console import Console, Verbosity, write_command, write_rows
from occmap.cli.declaring import CONFIG, Answer, command, fail_if
from occmap.inspection import findings, inspect
from occmap.inspection.findings import Inspection, LogFindings
from occmap.options import BuildOptions
from occmap.readers import Role, Stream
from occmap.report import Row, label_first
from occmap.report.limits import CHECK
from occmap.writers import check_picture

LABEL = 10
"""Width of the column of labels"""


@command(
    "check",
    Inspection,
    options.LOGS,
    options.one_output("output", "FILE.html", "Write the findings as a page as well."),
    options.RESOLUTION,
    options.MAX_CELLS,
    *options.READING,
    fail_if(CHECK, "dropped_scans > 5%"),
    CONFIG,
)
def check_command(console: Console, /, logs: tuple[Path, ...], **values: Any) -> Answer:
    """Say what is in logs, and what will go wrong with them.

    It takes the options of `occmap build` that concern scans, poses and ranges, and ends with the
    command line that it recommends. Exits with 1 if a build with the options given would fail.

      occmap check drive.mcap
      occmap check room.bag --sensor-pose 0,0,3.14159 --resolution 0.02
      occmap check intel.log.gz --json
    """
    check_picture(values["output"], logs, [".html"])
    chosen = take(BuildOptions, values)
    inspection = inspect(options.gather_logs(console, logs, chosen), chosen)
    if values["output"]:
        from occmap.page import write_inspection  # noqa: PLC0415  late: few want it

        write_inspection(values["output"], inspection)
    if console.verbosity is Verbosity.QUIET:
        for problem in inspection.problems:
            console.tell(f"error: {problem}")
    failure = None if inspection.buildable else click.exceptions.Exit(1)
    return Answer(inspection, format_inspection(inspection), failure)


def format_inspection(inspection: Inspection) -> Iterator[str]:
    """Write all findings; problems and the recommended command come last."""
    for log in inspection.logs:
        yield log.path
        yield from write_rows(((f"  {name}", text) for name, text in list_log(log)), LABEL)
        yield ""
    rows = [] if inspection.map is None else [("map", findings.describe_map(inspection.map))]
    rows += [("warning", text) for text in inspection.warnings]
    rows += [("problem", text) for text in inspection.problems]
    yield from write_rows(rows, LABEL)
    if inspection.command:
        yield from ("", write_command(inspection.command))


def list_log(log: LogFindings) -> Iterator[Row]:
    """List all about one log."""
    yield from label_first("topics", list_streams(log.streams))
    for topic in log.scans:
        yield "", ""
        yield from findings.list_facts(topic)
    if log.coverage:
        yield "", ""
    yield from label_first("sources", findings.list_sources(log.coverage))
    yield from label_first("note", log.other_notes)


def list_streams(streams: Sequence[Stream]) -> Iterator[str]:
    """List the topics with their types and counts, and what each is good for."""
    width = max((len(stream.topic) for stream in streams), default=0)
    kinds = max((len(stream.type) for stream in streams), default=0)
    for stream in streams:
        role = "" if stream.role is Role.OTHER else f"  {stream.role}s"
        yield f"{stream.topic:<{width}}  {stream.type:<{kinds}}  {stream.count:>8,}{role}"
