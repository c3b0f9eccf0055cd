"""The options that commands share, so that a flag and a path mean the same everywhere.

What `occmap.options` declares is typed as it says there. Beside plain paths there are folders,
patterns, stdin and stdout.
"""

import math
import os
import shutil
import sys
import tempfile
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from enum import EnumType
from pathlib import Path
from typing import Any

import click

from occmap.choices import Option, list_options
from occmap.cli.console import Console, put_on_stdout, spell, write_rows
from occmap.cli.declaring import PATH, Answer, CliOption, Value
from occmap.errors import LogError, OccmapError, UsageError
from occmap.evidence import Described, read_model
from occmap.options import FILES, OF_A_SCORED_MAP, OF_ONE_MAP, OPTIONS, BuildOptions, name_map
from occmap.plugins import list_plugins
from occmap.report import STDIN_FOLDER, Row, is_damage, label_first
from occmap.report.results import Report, tell_beams, tell_map, tell_scans
from occmap.scans.logs import Inputs, find_inputs
from occmap.sensor.models import PARAMETERS, SensorModel, describe_model, parse_model
from occmap.types import Paths
from occmap.writers import WriteOptions, find_writer

PIECE_BYTES = 1 << 20
"""So much of a file goes to stdout at once."""
Values = Mapping[str, Any]
"""What click has read, by the names of the options."""

TYPED: dict[str, dict[str, Any]] = {
    "align": {"metavar": "[DEG]", "show_default": "not turned"},
    "jobs": {"show_default": "one for each core"},
    "resolution": {"short": ["-r"]},
    "shade": {"is_flag": True, "metavar": None, "flag_value": "light", "show_default": False},
}
"""What differs, by the names of options, from how others of their types are typed"""


def field(known: Option, **more: Any) -> CliOption:
    """Make an option as it is declared, but for what `more` settings say."""
    kind, default = known.kind, known.default
    settings: dict[str, Any] = {
        "type": Value(known),
        "metavar": known.metavar or None,
        "multiple": known.is_many,
        "help": spell(known.help) + " May repeat." * known.is_many,
    }
    if isinstance(kind, EnumType):
        words = "|".join(map(str, kind))
        settings |= {"metavar": f"[{words}]", "default": default.value, "show_default": True}
    elif kind is bool:
        settings |= {"is_flag": True, "type": None}
    elif isinstance(default, int | float):
        settings |= {"default": default, "show_default": math.isfinite(default)}
    settings |= TYPED.get(known.name, {}) | more
    short = settings.pop("short", ())
    return CliOption(known.section, *short, known.flag, known.name, **settings)


def fields(names: Iterable[str]) -> list[CliOption]:
    """Make some options of a build."""
    return [field(OPTIONS[name]) for name in names]


def paths(section: str, metavar: str, text: str, *names: str) -> CliOption:
    """Make an option that names files, and may repeat."""
    text = f"{text} May repeat."
    return CliOption(section, *names, type=PATH, multiple=True, metavar=metavar, help=text)


def take_one(_ctx: click.Context, param: click.Parameter, values: tuple[Any, ...]) -> Any:
    """Take the only value of an option, None if there is none; raises UsageError for several."""
    if len(values) > 1:
        given = ", ".join(map(str, values))
        found = f"{param.opts[-1]} takes one file, and is given {len(values)}: {given}"
        raise UsageError(found, fix="run the command once for each")
    return next(iter(values), None)


def one_output(name: str, metavar: str, text: str) -> CliOption:
    """Make the option that names the one file that a command writes."""
    how = FILES, "-o", "--output", name
    return CliOption(*how, type=PATH, multiple=True, callback=take_one, metavar=metavar, help=text)


LOGS = click.Argument(["logs"], nargs=-1, required=True, type=PATH, metavar="LOG...")
OF_LOGS = fields(name for name in OPTIONS if name not in OF_ONE_MAP)
"""What a user may choose where no single map is made"""
OF_SCORED_LOGS = fields(name for name in OPTIONS if name not in OF_A_SCORED_MAP)
KEPT_CELLS = fields(["min_passes", "max_cells"])
THRESHOLDS = fields(["occupied_thresh", "free_thresh"])
OUTPUTS = paths(
    FILES,
    "FILE",
    "Write the map here; the suffix picks the format: .pgm, .png, .tif or .tiles for large maps, "
    ".html for a page, .mcap for Foxglove and RViz, .tum or .csv for the way of a build, .npz for "
    "evidence to render, merge and resume, or .zarr for the same in blocks.",
    *("-o", "--output", "outputs"),
)
WRITING = [OUTPUTS, *fields(list_options(WriteOptions))]


def list_model(usual: str) -> list[CliOption]:
    """Make the options of a sensor model; `usual` is what --help shows for the default."""
    made = [field(OPTIONS["model"], type=Value.of(str, "model"), show_default=usual)]
    for name, (metavar, text) in PARAMETERS.items():
        names = OPTIONS["model"].section, "--" + name.replace("_", "-")
        made.append(CliOption(*names, type=Value.of(float, name), metavar=metavar, help=text))
    return made


SAVED_MODEL = list_model("what it was built with")


def collect_model(values: Values, usual: SensorModel) -> SensorModel:
    """Make the sensor model; a shorthand such as --p-hit goes before what --model says.

    `usual` is the one to take where --model says nothing.

    Raises
    ------
    UsageError
        No such model, or a parameter that it does not have or allow.
    """
    name, _, stated = (values["model"] or describe_model(usual)).partition(":")
    given = [f"{key}={values[key]!r}" for key in PARAMETERS if values[key] is not None]
    return parse_model(f"{name}:{','.join(filter(None, [stated, *given]))}")


def choose_saved_model(evidence: Described, values: Values) -> SensorModel | None:
    """Make the model that the user wants, if any; a shorthand changes the one of the evidence.

    Raises
    ------
    UsageError
        As `collect_model`.
    """
    if all(values.get(name) is None for name in ("model", *PARAMETERS)):
        return None
    return collect_model(values, read_model(evidence))


STDIN, STDOUT = Path("-"), "-"
SCRATCH = "occmap-stdout-"


def gather_logs(console: Console, logs: Paths, options: BuildOptions, others: Paths = ()) -> Inputs:
    """Find the recordings that the user means, and say what a folder holds of them.

    The notes that are given back are those of damage: no other one counts for `limits`.

    Raises
    ------
    LogError
        Nothing comes on stdin.
    """
    given = click.get_current_context().with_resource(keep_stdin(logs))
    recordings, notes = find_inputs(given, options.reading, [*others, *options.posing.files])
    console.announce(*notes)
    return recordings, list(filter(is_damage, notes))


@contextmanager
def keep_stdin(paths: Paths) -> Iterator[list[Path]]:
    """Save what comes on stdin to a file while the block runs, where a path is `-`.

    Raises
    ------
    LogError
        Nothing comes on stdin, or it is closed.
    """
    if STDIN not in paths:
        yield list(paths)
        return
    if sys.stdin is None:
        raise LogError("is closed", where="stdin", fix="pipe a log into it")
    with tempfile.TemporaryDirectory(prefix=STDIN_FOLDER) as folder:
        saved = Path(folder) / STDIN.name  # pages and evidence call it so
        with saved.open("wb") as file:
            shutil.copyfileobj(sys.stdin.buffer, file)
        if not saved.stat().st_size:
            raise LogError("is empty", where="stdin", fix="pipe a log into it")
        yield [saved if path == STDIN else path for path in paths]


def place_outputs(console: Console, outputs: Paths, first: Path) -> tuple[Path, ...]:
    """Name the maps that are to lie in a folder; what is meant for stdout goes to a file first.

    Parameters
    ----------
    first
        The first input, after which a map in a folder is called.

    Raises
    ------
    UsageError
        More is meant for stdout than one file, or a format that is a folder.
    """
    formats = {f".{each.name}" for each in list_plugins("occmap.writers")}  # some are folders
    folders = [path.suffix.lower() not in formats and os.path.isdir(path) for path in outputs]  # noqa: PTH112  a name may be too long
    placed = tuple(
        path / f"{name_map(str(first))}.pgm" if is_folder else path
        for path, is_folder in zip(outputs, folders, strict=True)
    )
    sent = [path for path in placed if path.name.partition(".")[0] == STDOUT]
    if not sent:
        return placed
    if len(sent) > 1 or console.as_json:
        raise UsageError("stdout takes one map and nothing else", fix="give another name to -o")
    suffix = "".join(sent[0].suffixes) or ".pgm"  # of two, as .ground.tif
    if find_writer(Path(f"map{suffix}")).is_folder:
        found = f"a {suffix} is a folder, which stdout cannot take"
        raise UsageError(found, where=sent[0], fix=f"name the folder, such as -o map{suffix}")
    console.stdout_is_taken = True
    saved = click.get_current_context().with_resource(send_to_stdout(f"stdout{suffix}"))
    return tuple(saved if path in sent else path for path in placed)


def answer(report: Report, *more: Row, failure: Exception | None = None) -> Answer:
    """Say all about a map: what it is, how it came about, `more`, and in which files it is.

    The file that is sent to stdout is none of these.
    """
    files = [file for file in report.files if not Path(file).parent.name.startswith(SCRATCH)]
    made = [*tell_map(report.map, report.hint), *tell_scans(report), *tell_beams(report)]
    rows = [*made, *more, *label_first("files", files)]
    return Answer(replace(report, files=tuple(files)), write_rows(rows), failure)


@contextmanager
def send_to_stdout(name: str) -> Iterator[Path]:
    """Give a file to write to while a command runs, and then send it to stdout."""
    with tempfile.TemporaryDirectory(prefix=SCRATCH) as folder:
        saved = Path(folder) / name
        try:
            yield saved
        except OccmapError as error:
            if error.where == str(saved):
                raise type(error)(error.found, where="stdout", fix=error.fix) from None
            raise
        if saved.exists():
            with saved.open("rb") as file:
                while piece := file.read(PIECE_BYTES):
                    put_on_stdout(piece, nl=False)
