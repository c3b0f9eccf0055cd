"""`occmap build`: one map from one or more logs. `occmap demo`: one of a simulated drive."""

import shutil
from collections.abc import Iterator, Sequence
from importlib.resources import files
from pathlib import Path
from time import perf_counter
from typing import Any

import click
from click.core import ParameterSource

from occmap.choices import read_value, take
from occmap.cli import options
from occmap.cli.console import Console, write_rows
from occmap.cli.declaring import CONFIG, PATH, TEXT, Answer, CliOption, command, fail_if, flag
from occmap.errors import LogError, OccmapError, PoseError, UsageError
from occmap.options import DEFAULT_UPDATE, OPTIONS, RUN, BuildOptions, choose_model
from occmap.pipeline import build
from occmap.plugins import guess
from occmap.readers import open_log
from occmap.report import Note, label_first
from occmap.report.limits import BUILD
from occmap.report.results import Report
from occmap.scans.logs import Inputs
from occmap.scans.mounts import open_drive
from occmap.types import Update
from occmap.writers.atomic import refuse_unwritable

DASK = CliOption(
    RUN,
    "--dask",
    type=TEXT,
    metavar="local|ADDRESS",
    help="Build by processes on this machine, as many as --jobs, or by the workers of a Dask "
    "scheduler, such as tcp://HOST:8786.",
)
SCRATCH = CliOption(
    RUN,
    "--scratch",
    type=PATH,
    metavar="DIR",
    show_default="beside the first output",
    help="With --dask: a folder for intermediate files, shared by all workers. A build that is "
    "killed and run again goes on where it was.",
)
SKIP = flag(RUN, "--skip-unreadable", text="Leave out logs without scans or poses, as damage.")
STRICT = flag(RUN, "--strict", text="Write the map, then exit with 1 if a log is damaged.")

USUAL = (
    *("outputs", "resume", "resolution", "extent", "min_passes", "range_max", "max_range"),
    *("no_return", "model", "topics", "start_s", "end_s", "poses", "sensor_pose"),
    *("static_transforms", "time_offset_s", "min_height", "max_height", "limits", "jobs"),
    *("as_json", "quiet"),
)
"""The options that people ask for first"""


@command(
    "build",
    Report,
    click.Argument(["words"], nargs=-1, metavar="[beam|polygon|surface] LOG..."),
    options.OUTPUTS,
    *options.fields(name for name in OPTIONS if name not in {"update", "model"}),
    *options.list_model(choose_model(DEFAULT_UPDATE).name),
    *(fail_if(BUILD, "agreement < 70%"), DASK, SCRATCH, SKIP, STRICT, CONFIG),
    usual=USUAL,
)
def build_command(console: Console, /, words: tuple[str, ...], **values: Any) -> Answer:
    """Build one map from one or more logs.

    The first word may say how a scan becomes observations of cells: each beam by itself (beam); a
    whole scan as one region (polygon); or each beam and, between neighbours that meet one surface,
    what lies between them (surface). Without it: surface. Clouds have one update only. A log that
    is called `beam` is written ./beam.

      occmap build drive.mcap -o map.pgm
      occmap build polygon intel.log.gz -o intel.pgm -o intel.png --resolution 0.1
      occmap build room.bag -o room.pgm --sensor-pose 0,0,3.14159
    """
    given, chosen = read_request(words, values)
    console.announce(*list_idle(values))
    logs, notes = options.gather_logs(console, given, chosen, values["outputs"])
    if values["skip_unreadable"]:
        logs, unread = keep_readable(logs, chosen)
        console.announce(*unread)
        notes += unread
    values["outputs"] = options.place_outputs(console, values["outputs"], logs[0])
    start = perf_counter()
    report = run_build(console, logs, chosen, values).add_notes(notes)
    seconds = perf_counter() - start
    rate = report.scans.used / max(seconds, 1e-9)
    # What took long; the stages of several threads add up.
    stages = ", ".join(f"{name} {spent:.2f}" for name, spent in report.seconds.items())
    took = ("time", f"{seconds:.2f} s, {rate:,.0f} scans/s ({stages})")
    failure = None
    if values["strict"] and report.damage:
        first, *others = report.damage
        more = f"; {len(others)} more" if others else ""
        failure = LogError(f"{first} (--strict{more})", fix="the map was written")
    return options.answer(report, took, failure=failure)


def read_request(words: Sequence[str], values: dict[str, Any]) -> tuple[list[Path], BuildOptions]:
    """Read the command line as a whole.

    Raises
    ------
    UsageError
        Something is missing, or a value is out of its range.
    """
    update, logs = split_words(words)
    if not values["outputs"]:
        raise UsageError("where to write the map is not given", fix="add -o map.pgm")
    model = options.collect_model(values, choose_model(update))
    return logs, take(BuildOptions, {**values, "update": update, "model": model})


def keep_readable(logs: list[Path], chosen: BuildOptions) -> Inputs:
    """Leave out logs without readable scans or without poses, with a note on each; never all."""
    readable, lost = list[Path](), list[str]()
    for path in logs:
        try:
            open_drive(open_log(path, chosen.reading), chosen)
            readable.append(path)
        except (LogError, PoseError) as error:
            lost.append(Note(f"{path}: left out: {error.found}", damage=True))
    return (readable, lost) if readable else (logs, [])


def list_idle(values: options.Values) -> Iterator[str]:
    """Say which options do nothing, as they are for a build by many workers."""
    if values["dask"] is None and values["scratch"] is not None:
        yield "--scratch does nothing without --dask"
    usual = click.get_current_context().get_parameter_source("jobs") is ParameterSource.DEFAULT
    if values["dask"] not in {None, "local"} and not usual:
        yield "--jobs does nothing with the workers of a Dask scheduler: start as many as you want"


def split_words(words: Sequence[str]) -> tuple[Update, list[Path]]:
    """Tell the update, where one is named, from the logs.

    Raises
    ------
    UsageError
        There is no log, or the first word looks like a mistyped update.
    """
    updates = [update.value for update in Update]
    first, update = words[0] if words else "", DEFAULT_UPDATE
    if first in updates:
        update, words = Update(first), words[1:]
    elif first.isalpha() and (fix := guess(first.lower(), updates)) and not Path(first).exists():
        raise UsageError(f"{first!r} is neither a log nor an update", fix=fix)
    if late := [word for word in words if word in updates and not Path(word).exists()]:
        fix = f"type: occmap build {late[0]} LOG -o map.pgm"
        raise UsageError(f"{late[0]!r} is an update, which stands before the logs", fix=fix)
    if not words:
        raise UsageError("no log is given", fix="type: occmap build LOG -o map.pgm")
    return update, [read_value("LOG", Path, word) for word in words]


def run_build(
    console: Console, logs: list[Path], chosen: BuildOptions, values: dict[str, Any]
) -> Report:
    """Build in this process, or by the workers that --dask names."""
    outputs = values["outputs"]
    if values["dask"] is None:
        return build(logs, chosen, outputs, console.advance).report
    from occmap.fleet import Fleet  # noqa: PLC0415  late: few builds need it

    scratch = values["scratch"] or outputs[0].with_name(f"{outputs[0].name}.scratch")
    fleet = Fleet(values["dask"], scratch, console.describe)
    return fleet.build(logs, chosen, outputs, console.advance)


SAMPLES = "drive.mcap", "floor_plan.pgm", "floor_plan.yaml"
"""A simulated drive through an office, and the plan of it"""


@command(
    "demo", Report, click.Argument(["folder"], type=PATH, default="occmap-demo", metavar="[FOLDER]")
)
def demo_command(console: Console, /, folder: Path) -> Answer:
    """Map a simulated drive, to see what occmap does.

    The log, the plan of the office and the maps are put into FOLDER (occmap-demo), and what to type
    next is said.

      occmap demo
    """
    with refuse_unwritable(folder):
        folder.mkdir(parents=True, exist_ok=True)
        for name in SAMPLES:
            shutil.copyfile(find_sample(name), folder / name)
    log, made = folder / SAMPLES[0], [folder / f"map.{suffix}" for suffix in ("pgm", "png", "npz")]
    report = build([log], BuildOptions(), made, console.advance).report
    commands = (
        f"occmap check {log}",
        f"occmap build beam {log} -o {folder / 'beam.png'}",
        f"occmap explain {made[2]} 11.18 -1.18 --log {log}",
        f"occmap score {folder / 'map.yaml'} --truth {folder / SAMPLES[2]}",
        "occmap build YOUR_LOG -o map.pgm",
    )
    rows = [("look at", str(made[1])), *label_first("next", commands)]
    told = options.answer(report)
    return told._replace(lines=[*told.lines, *write_rows(rows)])


def find_sample(name: str) -> Path:
    """Find a sample in the install, or in the clone that it is of; raises OccmapError if absent."""
    package = Path(str(files("occmap")))
    for folder in (package / "samples", package.parent / "sample_logs"):
        if (folder / name).is_file():
            return folder / name
    raise OccmapError(f"the sample {name} is not a part of this install", fix="install it anew")
