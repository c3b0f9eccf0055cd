"""The options that commands share, so that a flag means the same everywhere.

Most set a field of `BuildOptions`: they are spelt like it, and take its type and its default.
"""

import math
from enum import StrEnum
from pathlib import Path
from typing import Any

import click

from occmap.cli.console import Console, Verbosity
from occmap.cli.sections import BareOption, join, option
from occmap.cli.values import (
    FROM_SCANS,
    NUMBERS,
    PATH,
    one_of,
    parse_align,
    parse_numbers,
    take_one,
)
from occmap.command import spell_flag
from occmap.keywords import drop_none, list_options, list_values
from occmap.options import BuildOptions
from occmap.sensor.models import describe_model
from occmap.writers import Shade

HINTS, DEFAULTS = list_options(BuildOptions), list_values(BuildOptions())
TYPES: dict[Any, Any] = {float: float, int: int, Path: PATH}

SHORT = {"resolution": ("-r",)}

MAP, MODEL, RANGES = "Map", "Sensor model", "What a range means"
SCANS, POSES, FILES, RUN = "Which scans", "Where the scans were taken", "Files", "Run"


def field(section: str, name: str, metavar: str, text: str, usual: str = "", **more: Any) -> Any:
    """Declare the option for a field of BuildOptions.

    Parameters
    ----------
    metavar
        What stands for the value; "" where it is one of some words, which --help lists.
    usual
        What --help shows as the default, where that is not a number.
    more
        Settings of the option that replace what the field says.
    """
    hint, default = drop_none(HINTS[name]), DEFAULTS[name]
    settings: dict[str, Any] = {"metavar": metavar, "type": TYPES.get(hint)}
    if isinstance(default, StrEnum):
        settings = {**one_of(hint), "default": default.value, "show_default": True}
    elif name in NUMBERS:
        settings["type"] = lambda text: parse_numbers(name, text)
    elif isinstance(default, int | float):
        settings |= {"default": default, "show_default": math.isfinite(default)}
    settings |= {"multiple": default == (), "help": text}
    if usual:
        settings["show_default"] = usual
    return option(section, *SHORT.get(name, ()), spell_flag(name), name, **settings | more)


def fields(section: str, **rows: tuple[str, ...]) -> Any:
    """Declare options for fields of BuildOptions, each by its metavar, its text and its default."""
    return join(*(field(section, name, *row) for name, row in rows.items()))


output = option(
    FILES,
    "-o",
    "--output",
    "outputs",
    type=PATH,
    multiple=True,
    metavar="FILE",
    help="Write the map here; the suffix picks the format: .pgm, .png, .tif or .tiles for large "
    "maps, .html for a page, .mcap for Foxglove and RViz, .tum or .csv for the trajectory, .npz "
    "for evidence to render, merge and resume, or .zarr for the same in blocks. May repeat.",
)


def one_output(name: str, metavar: str, text: str) -> Any:
    """Declare the option that names the one file that a command writes."""
    names = FILES, "-o", "--output", name
    return option(*names, type=PATH, multiple=True, callback=take_one, metavar=metavar, help=text)


thresholds = fields(
    FILES,
    occupied_thresh=(
        "P",
        "Occupied above this probability.",
        "the model's --cut; in the YAML 0.65",
    ),
    free_thresh=("P", "Free below this probability.", "the model's --cut; in the YAML 0.196"),
)
writing = join(
    output,
    field(FILES, "mode", "", "What the pixels of a PGM mean."),
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
resume = fields(
    FILES,
    resume=("NPZ", "Add to the evidence in this file, which -o may name again."),
    resume_if_there=("NPZ", "As --resume if the file exists; otherwise start a new map."),
)

resolution = field(MAP, "resolution", "M", "Side of a cell.")
max_cells = field(MAP, "max_cells", "N", "Refuse to make a larger map.", type=click.IntRange(min=1))
lattice = join(
    resolution,
    fields(
        MAP,
        jump=(
            "M",
            "Two neighbouring beams meet one surface if their ranges differ by at most this.",
        ),
        hit_offset=(
            "CELLS",
            "Move each hit this far behind the measured point, which is on a surface.",
        ),
        border_gap=("CELLS", "polygon: join end cells on one surface up to this far apart."),
    ),
    max_cells,
)

align = field(
    MAP,
    "align",
    "[DEG]",
    "Turn the map by this many degrees counter-clockwise; without a number, by the smallest angle "
    "that brings its walls along the axes.",
    "not turned",
    cls=BareOption,
    bare=FROM_SCANS,
    type=parse_align,
    default="0",
)
framing = fields(
    MAP,
    extent=(
        "X_MIN,Y_MIN,X_MAX,Y_MAX",
        "Cover exactly this box (m), to whole cells; an .npz still holds everything.",
        "what was observed",
    ),
    margin=("M", "Add unknown space around what was observed."),
)

min_passes = field(
    MAP,
    "min_passes",
    "K",
    "Keep the hits of a cell only if they came on at least this many visits: drops people who "
    "passed once.",
)
pass_gap = field(
    MAP, "pass_gap_s", "S", "Sightings of a cell at least this far apart are two visits."
)


def model_option(usual: str) -> Any:
    """Declare the option that names a sensor model."""
    return option(
        MODEL,
        "--model",
        metavar="NAME[:KEY=NUMBER,...]",
        help="How evidence is weighed: see `occmap models`.",
        show_default=usual,
    )


def parameter(name: str, text: str, metavar: str = "P") -> Any:
    """Declare a shorthand for a parameter of the sensor model."""
    return option(MODEL, name, type=float, metavar=metavar, help=text)


model_parameters = join(
    parameter("--p-hit", "simple: probability of occupied, given one hit."),
    parameter("--p-miss", "simple: probability of occupied, given one miss."),
    parameter("--epsilon", "quadratic: half the depth of a hit.", "M"),
    parameter("--p-min", "quadratic: keep each observation within [P, 1 - P]."),
    parameter("--prior", "Probability of occupied before any observation."),
    parameter("--cut", "A cell is occupied above this probability, free below."),
    parameter("--spread", "How much of a hit counts for each cell beside it.", "SHARE"),
    parameter("--clamp-min", "Lowest probability of an observed cell."),
    parameter("--clamp-max", "Highest probability of an observed cell."),
)
model = join(model_option(describe_model(DEFAULTS["model"])), model_parameters)
saved_model = join(model_option("what it was built with"), model_parameters)

jobs = field(RUN, "jobs", "N", "Threads.", "one for each core")
config = option(
    RUN,
    "--config",
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
