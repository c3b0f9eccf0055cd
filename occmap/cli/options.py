"""The options that commands share, so that a flag means the same everywhere.

Most set a field of `BuildOptions`: they are spelt like it, and take its type, its default and its
text.
"""

import math
import re
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import fields as list_fields
from dataclasses import is_dataclass
from enum import StrEnum
from functools import cache
from pathlib import Path
from typing import Annotated, Any, get_args, get_origin, get_type_hints

import click

from occmap.cli.console import Console, Verbosity, spell
from occmap.cli.sections import BareOption, ConfigOption, SectionOption, join, option
from occmap.command import MODEL_PARAMETERS, spell_flag
from occmap.errors import UsageError
from occmap.keywords import NONE, drop_none, find_form, list_options, list_values
from occmap.options import BuildOptions
from occmap.plain import read_texts
from occmap.sensor.models import SensorModel, describe_model, parse_model
from occmap.wording import count
from occmap.writers import Shade

PATH = click.Path(path_type=Path, readable=False)
"""Where click would look whether it can be read, occmap's own error says more."""
FROM_SCANS = NONE["align"][0]
FORM = re.compile(r"\((.*?)\)")
"""A tuple, as it is written in Python"""
Values = Mapping[str, Any]
"""What click has read, by the names of the options."""

HINTS, DEFAULTS = list_options(BuildOptions, include_extras=True), list_values(BuildOptions())
TYPES = {float: float, int: int, Path: PATH, str: None, tuple[str, ...]: None}
"""How click reads the values of a type; those of any other are several numbers, or an enum's"""
MAP, MODEL, RANGES = "Map", "Sensor model", "What a range means"
SCANS, POSES, FILES, RUN = "Which scans", "Where the scans were taken", "Files", "Run"


def parse_numbers(name: str, text: str) -> Any:
    """Read an option of several numbers with commas between.

    Raises
    ------
    UsageError
        There are too many or too few numbers, one is not a number, or an angle is in degrees.
    """
    read, form = find_form(name, get_args(drop_none(HINTS[name]))[0])
    typed = FORM.sub(lambda found: found[1].replace(" ", ""), form)
    where, fix = f"{spell_flag(name)} {text}", f"write {typed}"
    values = [value.strip() for value in text.split(",")]
    frames = 2 if name == "static_transforms" else 0
    try:
        numbers = [read_number(value, where, fix) for value in values[frames:]]
        return read([*values[:frames], *numbers])
    except UsageError as error:
        raise UsageError(error.found, where=where, fix=error.fix or fix) from None
    except ValueError:
        belong = [str(each.count(",") + 1) for each in FORM.findall(form.partition(" in ")[0])]
        found = f"{count(len(values), 'value')} where {' or '.join(belong)} belong"
        raise UsageError(found, where=where, fix=fix) from None


def read_number(word: str, where: str, form: str) -> float:
    """Read a finite decimal number; raises UsageError, with the form that is expected."""
    with suppress(ValueError):
        if math.isfinite(number := float(word)):
            return number
    raise UsageError(f"{word.strip()!r} is not a number", where=where, fix=form)


@cache
def read_help() -> dict[str, str]:
    """Read what each field of BuildOptions is for, from the text below it."""
    groups = [BuildOptions, *filter(is_dataclass, get_type_hints(BuildOptions).values())]
    return {name: spell(text) for group in groups for name, text in read_texts(group).items()}


class FieldOption(SectionOption):
    """An option that sets a field of BuildOptions, whose text is read when it is asked for."""

    @property
    def help(self) -> str:
        """What the option does."""
        text = read_help()[str(self.name)]
        return f"{text} May repeat." if self.multiple else text

    @help.setter  # noqa: A003  the name is click's
    def help(self, _text: str | None) -> None:
        """Take no other text, as click would give it."""


def field(section: str, name: str, *short: str, **more: Any) -> Any:
    """Declare the option for a field of BuildOptions: its type, default and text are the field's.

    It may have a `short` flag as well, and `more` settings, which replace these.
    """
    hint, default = drop_none(HINTS[name]), DEFAULTS[name]
    kind, metavar = get_args(hint) if get_origin(hint) is Annotated else (hint, None)
    settings = {"cls": FieldOption, "metavar": metavar, "multiple": default == ()}
    settings |= describe_values(name, kind, default)
    return option(section, *short, spell_flag(name), name, **settings | more)


def describe_values(name: str, kind: Any, default: Any) -> dict[str, Any]:
    """Say how click reads the values of an option, and which default --help shows."""
    if isinstance(default, StrEnum):
        return {
            "type": click.Choice([member.value for member in kind]),
            "callback": lambda _ctx, _param, value: kind(value),
            "default": default.value,
            "show_default": True,
        }
    if kind not in TYPES:
        return {"type": lambda text: parse_numbers(name, text)}
    if isinstance(default, int | float):
        shown = math.isfinite(default)
        return {"type": TYPES[kind], "default": default, "show_default": shown}
    return {"type": TYPES[kind]}


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
        help="PNG: light is occupied, as in Elfes' figures.",
    ),
)
resume = fields(FILES, "resume resume_if_there")

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
    return None if text == FROM_SCANS else read_number(text, f"--align {text}", form)


align = option(
    MAP,
    "--align",
    cls=BareOption,
    bare=FROM_SCANS,
    type=parse_align,
    default="0",
    metavar="[DEG]",
    show_default="not turned",
    help="Turn the map by this many degrees counter-clockwise; without a number, by the smallest "
    "angle that brings its walls along the axes.",
)
framing = fields(MAP, "extent margin")
min_passes, pass_gap = field(MAP, "min_passes"), field(MAP, "pass_gap_s")

ranges = fields(RANGES, "min_range max_range range_max no_return ignore_sectors footprint")
selection = fields(SCANS, "topics start_s end_s stride echo min_height max_height")
posing = fields(
    POSES,
    "poses sensor_pose static_transforms map_frame transform base_frame "
    "max_pose_gap_s max_speed time_offset_s stamps deskew",
)
reading = join(ranges, selection, posing)


def model_option(usual: str) -> Any:
    """Declare the option that names a sensor model."""
    return option(
        MODEL,
        "--model",
        metavar="NAME[:KEY=NUMBER,...]",
        help="How evidence is weighed: see `occmap models`.",
        show_default=usual,
    )


model_parameters = join(
    *(
        option(MODEL, spell_flag(name), type=float, metavar=metavar, help=text)
        for name, (metavar, text) in MODEL_PARAMETERS.items()
    )
)
model = join(model_option(describe_model(DEFAULTS["model"])), model_parameters)
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
    given = {key: values[key] for key in MODEL_PARAMETERS if values[key] is not None}
    known = [each.name for each in list_fields(parse_model(name))]  # type: ignore[arg-type]  # a dataclass
    flags = ", ".join(spell_flag(key) for key in MODEL_PARAMETERS if key in known)
    for key in given:
        if key not in known:
            raise UsageError(
                f"{spell_flag(key)} does not go with the model {name}",
                fix=f"it has {flags}; see `occmap models` for --model",
            )
    pairs = [text.partition(":")[2], *(f"{key}={value!r}" for key, value in given.items())]
    return parse_model(f"{name}:{','.join(filter(None, pairs))}")


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
