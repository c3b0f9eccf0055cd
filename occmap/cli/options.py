"""The options that commands share, so that a flag and a path mean the same everywhere.

What `occmap.options` declares is typed as it says there. Beside plain paths there are folders,
patterns, stdin and stdout.
"""

import math
import os
import shutil
import sys
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import fields as list_fields
from dataclasses import replace
from enum import StrEnum
from pathlib import Path
from typing import Any

import click

from occmap.choices import Option, list_options, parse_number
from occmap.cli.console import Console, Verbosity, spell
from occmap.cli.declaring import BareOption, ConfigOption, join, option
from occmap.clouds import CloudOptions
from occmap.errors import UsageError
from occmap.evidence import Described, read_model
from occmap.grid.rendering import Framing
from occmap.options import (
    DEFAULT_UPDATE,
    OPTIONS,
    BuildOptions,
    Selection,
    choose_model,
    name_map,
    spell_flag,
)
from occmap.posing import PosingOptions
from occmap.readers import ReaderOptions
from occmap.report.results import Report
from occmap.scans.logs import find_inputs, keep_stdin
from occmap.sensor import ReturnOptions
from occmap.sensor.models import PARAMETERS, SensorModel, describe_model, parse_model
from occmap.writers import Shade, find_writer

PATH = click.Path(path_type=Path, readable=False)
"""Where click would look whether it can be read, occmap's own error says more."""
FROM_SCANS = OPTIONS["align"].declared.none[0]
BY_THEMSELVES = ("align", "shade")
"""Options that are typed in ways of their own"""
Values = Mapping[str, Any]
"""What click has read, by the names of the options."""

TYPES = {float: float, int: int, Path: PATH, str: None, tuple[str, ...]: None}
"""How click reads the values of a type; those of any other are several numbers, or an enum's"""
MAP, MODEL, RANGES = "Map", "Sensor model", "What a range means"
SCANS, POSES, FILES, RUN = "Which scans", "Where the scans were taken", "Files", "Run"


def field(section: str, name: str, *short: str, **more: Any) -> Any:
    """Declare an option of a build as it is declared there.

    It may have a `short` flag as well, and `more` settings, which replace these.
    """
    known = OPTIONS[name]
    is_many = known.default == ()
    text = spell(known.declared.help) + " May repeat." * is_many
    settings = {"metavar": known.metavar, "multiple": is_many, "help": text}
    return option(section, *short, known.flag, name, **settings | describe_values(known) | more)


def describe_values(known: Option) -> dict[str, Any]:
    """Say how click reads the values of an option, and which default --help shows."""
    kind, default = known.kind, known.default
    if isinstance(default, StrEnum):
        return {
            "type": click.Choice([member.value for member in kind]),
            "callback": lambda _ctx, _param, value: kind(value),
            "default": default.value,
            "show_default": True,
        }
    if known.declared.form:
        return {"type": known.parse}
    if isinstance(default, int | float):
        shown = math.isfinite(default)
        return {"type": TYPES[kind], "default": default, "show_default": shown}
    return {"type": TYPES[kind]}


def group(section: str, *kinds: Any) -> Any:
    """Declare all options of groups of them, in the order in which they stand there."""
    names = [name for kind in kinds for name in list_options(kind) if name not in BY_THEMSELVES]
    return join(*(field(section, name) for name in names))


def fields(section: str, names: str) -> Any:
    """Declare options for fields of BuildOptions, in the order of --help; blanks part `names`."""
    return join(*(field(section, name) for name in names.split()))


def paths(section: str, *names: str, metavar: str, text: str) -> Any:
    """Declare an option that names files, and may repeat."""
    text = f"{text} May repeat."
    return option(section, *names, type=PATH, multiple=True, metavar=metavar, help=text)


output = paths(
    FILES,
    "-o",
    "--output",
    "outputs",
    metavar="FILE",
    text="Write the map here; the suffix picks the format: .pgm, .png, .tif or .tiles for large "
    "maps, .html for a page, .mcap for Foxglove and RViz, .tum or .csv for the trajectory, .npz "
    "for evidence to render, merge and resume, or .zarr for the same in blocks.",
)


def take_one(_ctx: click.Context, param: click.Parameter, values: tuple[Any, ...]) -> Any:
    """Take the only value of an option, None if there is none; raises UsageError for several."""
    if len(values) > 1:
        given = ", ".join(map(str, values))
        raise UsageError(
            f"{param.opts[-1]} takes one file, and is given {len(values)}: {given}",
            fix="run the command once for each",
        )
    return next(iter(values), None)


def one_output(name: str, metavar: str, text: str) -> Any:
    """Declare the option that names the one file that a command writes."""
    names = FILES, "-o", "--output", name
    return option(*names, type=PATH, multiple=True, callback=take_one, metavar=metavar, help=text)


thresholds = fields(FILES, "occupied_thresh free_thresh")
writing = join(
    output,
    field(FILES, "mode"),
    thresholds,
    option(
        FILES,
        spell_flag("shade"),
        "shade",
        flag_value=Shade.LIGHT_OCCUPIED.value,
        callback=lambda _ctx, _param, value: Shade(value or Shade.DARK_OCCUPIED),
        help=OPTIONS["shade"].declared.help,
    ),
)
resume = join(
    fields(FILES, "resume resume_if_there"),
    option(FILES, spell_flag("fit"), is_flag=True, help=OPTIONS["fit"].declared.help),
)

resolution = field(MAP, "resolution", "-r")
max_cells = field(MAP, "max_cells", type=click.IntRange(min=1))
lattice = join(resolution, fields(MAP, "jump hit_offset border_gap"), max_cells)


def parse_align(text: str) -> float | None:
    """Read an angle in degrees, or the word that leaves it to the scans.

    Raises
    ------
    UsageError
        It is neither.
    """
    form = f"write degrees such as 12.5, or {FROM_SCANS}"
    return None if text == FROM_SCANS else parse_number(text, f"--align {text}", form)


align = option(
    MAP,
    "--align",
    cls=BareOption,
    bare=FROM_SCANS,
    type=parse_align,
    default="0",
    metavar="[DEG]",
    show_default="not turned",
    help=OPTIONS["align"].declared.help,
)
framing = group(MAP, Framing)
min_passes, pass_gap = field(MAP, "min_passes"), field(MAP, "pass_gap_s")

ranges = group(RANGES, ReturnOptions)
selection = group(SCANS, Selection, ReaderOptions, CloudOptions)
posing = group(POSES, PosingOptions)
reading = join(ranges, selection, posing)


def model_option(usual: str) -> Any:
    """Declare the option that names a sensor model."""
    return option(
        MODEL,
        "--model",
        metavar=OPTIONS["model"].metavar,
        help=OPTIONS["model"].declared.help,
        show_default=usual,
    )


model_parameters = join(
    *(
        option(MODEL, spell_flag(name), type=float, metavar=metavar, help=text)
        for name, (metavar, text) in PARAMETERS.items()
    )
)
model = join(model_option(describe_model(choose_model(DEFAULT_UPDATE))), model_parameters)
saved_model = join(model_option("what it was built with"), model_parameters)


def collect_model(values: Values, usual: SensorModel) -> SensorModel:
    """Make the sensor model; a shorthand such as --p-hit goes before what --model says.

    `usual` is the one to take where --model says nothing.

    Raises
    ------
    UsageError
        No such model, or a parameter that it does not have or allow.
    """
    text = values["model"] or describe_model(usual)
    name = text.partition(":")[0]
    given = {key: values[key] for key in PARAMETERS if values[key] is not None}
    known = [each.name for each in list_fields(parse_model(name))]  # type: ignore[arg-type]  # a dataclass
    for key in given:
        if key not in known:
            found = f"{spell_flag(key)} does not go with the model {name}"
            flags = ", ".join(spell_flag(key) for key in PARAMETERS if key in known)
            raise UsageError(found, fix=f"it has {flags}; see `occmap models` for --model")
    pairs = [text.partition(":")[2], *(f"{key}={value!r}" for key, value in given.items())]
    return parse_model(f"{name}:{','.join(filter(None, pairs))}")


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


jobs = field(RUN, "jobs", show_default="one for each core")
config = option(
    RUN,
    "--config",
    cls=ConfigOption,
    is_eager=True,  # before the options that it sets
    type=PATH,
    metavar="FILE",
    expose_value=False,
    help="Read options from this TOML file, by their long names; typed ones win. Without it: "
    "occmap.toml beside the logs.",
)
as_json = option(RUN, "--json", "as_json", is_flag=True, help="Print the result as JSON.")


def loudness(short: str, long: str, level: Verbosity, text: str) -> Any:
    """Declare a flag that says how much a command tells."""

    def choose(ctx: click.Context, _param: click.Parameter, given: bool) -> None:
        if given:
            ctx.ensure_object(Console).verbosity = level

    return option(RUN, short, long, is_flag=True, expose_value=False, callback=choose, help=text)


verbosity = join(
    loudness("-q", "--quiet", Verbosity.QUIET, "Print errors only, and what --json asks for."),
    loudness("-v", "--verbose", Verbosity.VERBOSE, "Print the traceback of a fault in occmap."),
)
printing = join(as_json, verbosity)


STDOUT = "-"
SCRATCH = "occmap-stdout-"


def gather_logs(
    console: Console, paths: Sequence[Path], options: BuildOptions, outputs: Sequence[Path] = ()
) -> list[Path]:
    """Find the recordings that the user means, and say what a folder holds of them.

    Raises
    ------
    LogError
        Nothing comes on stdin.
    """
    given = click.get_current_context().with_resource(keep_stdin(paths))
    others = [*outputs, Path(options.posing.poses or "")]
    found = find_inputs(given, options.reading, others)
    console.announce(*found.notes)
    return found.logs


def place_outputs(console: Console, outputs: Sequence[Path], first: Path) -> tuple[Path, ...]:
    """Name the maps that are to lie in a folder; what is meant for stdout goes to a file first.

    Parameters
    ----------
    first
        The first input, after which a map in a folder is called.
    """
    placed = tuple(
        path / f"{name_map(str(first))}.pgm" if os.path.isdir(path) and not path.suffix else path  # noqa: PTH112  a name may be too long
        for path in outputs
    )
    if all(path.stem != STDOUT for path in placed):
        return placed
    return click.get_current_context().with_resource(send_to_stdout(console, placed))


def hide_sent(report: Report) -> Report:
    """Leave out of a report the file that is sent to stdout."""
    files = [file for file in report.files if not Path(file).parent.name.startswith(SCRATCH)]
    return replace(report, files=tuple(files))


@contextmanager
def send_to_stdout(console: Console, outputs: Sequence[Path]) -> Iterator[tuple[Path, ...]]:
    """Write an output to a file while the command runs, and then to stdout.

    Raises
    ------
    UsageError
        More is meant for stdout than one file, or a format that is a folder.
    """
    name, *others = (path for path in outputs if path.stem == STDOUT)
    if others or console.as_json:
        raise UsageError("stdout takes one map and nothing else", fix="give another name to -o")
    file_name = name.with_suffix(name.suffix or ".pgm")
    if find_writer(file_name).is_folder:
        found = f"a {name.suffix} is a folder, which stdout cannot take"
        raise UsageError(found, where=name, fix=f"name the folder, such as -o map{name.suffix}")
    console.stdout_is_taken = True
    with tempfile.TemporaryDirectory(prefix=SCRATCH) as folder:
        saved = Path(folder) / f"stdout{file_name.suffix}"
        yield tuple(saved if path == name else path for path in outputs)
        if saved.exists():
            with saved.open("rb") as file:
                shutil.copyfileobj(file, sys.stdout.buffer)
            sys.stdout.buffer.flush()
