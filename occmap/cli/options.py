"""The options that commands share, so that a flag means the same everywhere.

Each is named like the field that it sets; defaults come from the classes that hold the fields.
"""

from typing import Any

import click

from occmap.cli.console import Verbosity
from occmap.cli.sections import bare_option, join, option
from occmap.cli.values import (
    FROM_SCANS,
    PATH,
    one_of,
    parse_align,
    parse_extent,
    read_by,
    set_verbosity,
    take_one,
)
from occmap.options import BuildOptions
from occmap.sensor.models import describe_model
from occmap.types import Update
from occmap.writers import MapMode, Shade

DEFAULTS = BuildOptions()
NO_LIMIT = "no limit"

MAP, MODEL, RANGES = "Map", "Sensor model", "What a range means"
SCANS, POSES, FILES, RUN = "Which scans", "Where the scans were taken", "Files", "Run"


def metres(section: str, *names: str, **settings: Any) -> Any:
    """Declare an option that is a length."""
    return option(section, *names, type=float, metavar="M", **{"show_default": True} | settings)


def seconds(section: str, *names: str, **settings: Any) -> Any:
    """Declare an option that is a time."""
    return option(section, *names, type=float, metavar="S", **settings)


def number(name: str, text: str) -> Any:
    """Declare a shorthand for a parameter of the sensor model."""
    return option(MODEL, name, type=float, metavar="P", help=text)


output = option(
    FILES,
    "-o",
    "--output",
    "outputs",
    type=PATH,
    multiple=True,
    metavar="FILE",
    help="Write the map here; the suffix picks the format: .pgm, .png, .html for a page, .mcap for "
    "Foxglove and RViz, .tum or .csv for the trajectory, or .npz for what can be "
    "rendered, merged and resumed (.zarr and .tiles: in parts). May repeat.",
)


def one_output(name: str, metavar: str, text: str) -> Any:
    """Declare the option that names the one file that a command writes."""
    return option(
        *(FILES, "-o", "--output", name),
        type=PATH,
        multiple=True,
        callback=take_one,
        metavar=metavar,
        help=text,
    )


thresholds = join(
    option(
        FILES,
        "--occupied-thresh",
        type=float,
        metavar="P",
        show_default="the model's --cut; in the YAML 0.65",
        help="Occupied above this probability.",
    ),
    option(
        FILES,
        "--free-thresh",
        type=float,
        metavar="P",
        show_default="the model's --cut; in the YAML 0.196",
        help="Free below this probability.",
    ),
)
writing = join(
    output,
    option(
        FILES,
        "--mode",
        **one_of(MapMode),
        default=MapMode.TRINARY.value,
        show_default=True,
        help="What the pixels of a PGM mean.",
    ),
    thresholds,
    option(
        FILES,
        "--light-occupied",
        "shade",
        flag_value=Shade.LIGHT_OCCUPIED.value,
        callback=lambda _ctx, _param, value: Shade(value or Shade.DARK_OCCUPIED),
        help="PNG: light is occupied, as in Elfes' figures.",
    ),
)

resolution = metres(MAP, "-r", "--resolution", default=DEFAULTS.resolution, help="Side of a cell.")
max_cells = option(
    MAP,
    "--max-cells",
    type=click.IntRange(min=1),
    metavar="N",
    default=DEFAULTS.max_cells,
    show_default=True,
    help="Refuse to make a larger map.",
)
lattice = join(
    resolution,
    metres(
        MAP,
        "--jump",
        default=DEFAULTS.jump,
        help="Neighbouring beams see one surface where ranges differ by less.",
    ),
    option(
        MAP,
        "--hit-offset",
        type=float,
        metavar="CELLS",
        default=DEFAULTS.hit_offset,
        show_default=True,
        help="A hit lies so far behind the measured point, which is on a surface.",
    ),
    option(
        MAP,
        "--border-gap",
        type=int,
        metavar="CELLS",
        default=DEFAULTS.border_gap,
        show_default=True,
        help=f"{Update.POLYGON}: close a surface over so many cells between end cells.",
    ),
    max_cells,
)

align = bare_option(
    MAP,
    "--align",
    **read_by(parse_align),
    bare=FROM_SCANS,
    default="0",
    metavar="[DEG]",
    show_default="not turned",
    help="Turn the map by this angle, counter-clockwise; without a number by the smallest one "
    "that brings its walls along the axes.",
)
framing = join(
    option(
        MAP,
        "--extent",
        **read_by(parse_extent),
        metavar="X_MIN,Y_MIN,X_MAX,Y_MAX",
        show_default="what was observed",
        help="Cover exactly this box (m), to whole cells; evidence (.npz) stays whole.",
    ),
    metres(MAP, "--margin", default=0.0, help="Add unknown space around what was observed."),
)

min_passes = option(
    MAP,
    "--min-passes",
    type=int,
    metavar="K",
    help="Forget hits of cells that were hit on fewer visits, such as people; keep walls that were "
    "hit on most.",
)
pass_gap = seconds(
    MAP,
    "--pass-gap",
    "pass_gap_s",
    default=DEFAULTS.pass_gap_s,
    show_default=True,
    help="Two visits of a cell lie at least so far apart.",
)


def model_option(**default: str) -> Any:
    """Declare the option that names a sensor model."""
    return option(
        MODEL,
        "--model",
        metavar="NAME[:KEY=NUMBER,...]",
        help="How evidence is weighed: see `occmap models`.",
        **default,
    )


model_parameters = join(
    number("--p-hit", "simple: probability of occupied, given one hit."),
    number("--p-miss", "simple: probability of occupied, given one miss."),
    option(MODEL, "--epsilon", type=float, metavar="M", help="quadratic: half the depth of a hit."),
    number("--p-min", "quadratic: no observation is surer than this."),
    number("--prior", "Probability of occupied before any observation."),
    number("--cut", "A cell is occupied above this probability, free below."),
    option(
        MODEL,
        "--spread",
        type=float,
        metavar="SHARE",
        help="How much of a hit counts for each cell beside it.",
    ),
    number("--clamp-min", "No observed cell is less probably occupied than this."),
    number("--clamp-max", "... and none more probably than this."),
)
model = join(
    model_option(show_default=describe_model(DEFAULTS.model)),
    model_parameters,
)
saved_model = join(model_option(show_default="what it was built with"), model_parameters)

jobs = option(
    RUN,
    "--jobs",
    type=int,
    metavar="N",
    default=DEFAULTS.jobs,
    show_default="one for each core",
    help="Threads.",
)
config = option(
    RUN,
    "--config",
    type=PATH,
    metavar="FILE",
    expose_value=False,
    help="Options by their long names (TOML), for what is not typed; else occmap.toml beside the "
    "logs.",
)
as_json = option(RUN, "--json", "as_json", is_flag=True, help="Print the result as JSON.")
verbosity = join(
    option(
        RUN,
        "-q",
        "--quiet",
        is_flag=True,
        expose_value=False,
        callback=set_verbosity(Verbosity.QUIET),
        help="Print errors only, and what --json asks for.",
    ),
    option(
        RUN,
        "-v",
        "--verbose",
        is_flag=True,
        expose_value=False,
        callback=set_verbosity(Verbosity.VERBOSE),
        help="Print the traceback of a fault in occmap.",
    ),
)
