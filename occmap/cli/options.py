"""The options that commands share, so that a flag means the same everywhere.

Each is named like the field that it sets; defaults come from the classes that hold the fields.
"""

import math
from pathlib import Path
from typing import Any

import click

from occmap.cli.console import Verbosity
from occmap.cli.sections import join, option
from occmap.cli.values import (
    one_of,
    parse_box,
    parse_sector,
    parse_sensor_pose,
    parse_transform,
    read_by,
    set_verbosity,
)
from occmap.pipeline import BuildOptions
from occmap.posing.options import Deskew, Stamps
from occmap.readers.options import Echo
from occmap.sensor.models import describe_model
from occmap.sensor.returns import NoReturn
from occmap.types import Update
from occmap.writers import MapMode, Shade

DEFAULTS = BuildOptions()
NO_LIMIT = "no limit"

MAP, MODEL, RANGES = "Map", "Sensor model", "What a range means"
SCANS, POSES, FILES, RUN = "Which scans", "Where the scans were taken", "Files", "Run"


def metres(section: str, name: str, **settings: Any) -> Any:
    """Declare an option that is a length."""
    return option(section, name, type=float, metavar="M", **{"show_default": True} | settings)


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
    type=click.Path(path_type=Path),
    multiple=True,
    metavar="FILE",
    help="Write the map here; the suffix picks the format: .pgm, .png, or .npz for what can be "
    "rendered, merged and resumed. May repeat.",
)
thresholds = join(
    option(
        FILES,
        "--occupied-thresh",
        type=float,
        metavar="P",
        default=DEFAULTS.writing.occupied_thresh,
        show_default=True,
        help="Occupied from this probability up.",
    ),
    option(
        FILES,
        "--free-thresh",
        type=float,
        metavar="P",
        default=DEFAULTS.writing.free_thresh,
        show_default=True,
        help="Free from this probability down.",
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

resolution = metres(MAP, "--resolution", default=DEFAULTS.resolution, help="Side of a cell.")
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
        help=f"{Update.POLYGON}: neighbouring beams see one surface where ranges differ by less.",
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


def choose_model(**default: str) -> Any:
    """Declare the option that names a sensor model."""
    return option(
        MODEL,
        "--model",
        "model_text",
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
)
model = join(
    choose_model(default=DEFAULTS.model.name, show_default=describe_model(DEFAULTS.model)),
    model_parameters,
)
saved_model = join(choose_model(show_default="what it was built with"), model_parameters)

ranges = join(
    metres(RANGES, "--min-range", default=0.0, help="Ignore nearer ranges."),
    metres(
        RANGES,
        "--max-range",
        default=math.inf,
        show_default=NO_LIMIT,
        help="Use beams up to here; a longer one is free up to here.",
    ),
    metres(
        RANGES,
        "--range-max",
        show_default="what the log states",
        help="The sensor's limit: at or beyond it nothing came back.",
    ),
    option(
        RANGES,
        "--no-return",
        **one_of(NoReturn),
        default=DEFAULTS.returns.no_return.value,
        show_default=True,
        help="Where nothing came back: free up to the limit, or nothing known.",
    ),
    option(
        RANGES,
        "--ignore-sector",
        "ignore_sectors",
        **read_by(parse_sector),
        multiple=True,
        metavar="FROM,TO",
        help="Leave out the beams from one bearing counter-clockwise to another (rad, as the "
        "sensor sees it): the robot blocks them. May repeat.",
    ),
    option(
        RANGES,
        "--footprint",
        **read_by(parse_box),
        metavar="X_MIN,Y_MIN,X_MAX,Y_MAX",
        help="Leave out what is measured in this box around the sensor (m, as the sensor sees it): "
        "it is the robot.",
    ),
)

reading = join(
    option(
        SCANS,
        "--echo",
        **one_of(Echo),
        default=DEFAULTS.reading.echo.value,
        show_default=True,
        help="MultiEchoLaserScan: the echo of a beam that counts.",
    ),
    metres(
        SCANS,
        "--min-height",
        default=DEFAULTS.reading.min_height,
        help="PointCloud2: use points from this height over the sensor ...",
    ),
    metres(SCANS, "--max-height", default=DEFAULTS.reading.max_height, help="... up to this one."),
)

scan_topic = option(
    SCANS,
    "--scan-topic",
    "topics",
    multiple=True,
    metavar="TOPIC",
    show_default="all",
    help="Use the scans of this topic. May repeat.",
)
selection = join(
    scan_topic,
    seconds(
        SCANS,
        "--start",
        "start_s",
        default=-math.inf,
        help="Leave out scans before this time after the first.",
    ),
    seconds(SCANS, "--end", "end_s", default=math.inf, help="... and after this."),
    option(
        SCANS, "--stride", type=int, metavar="N", default=1, help="Use every N-th of these scans."
    ),
    reading,
)

posing = join(
    option(
        POSES,
        "--poses",
        metavar="FILE|TOPIC",
        help="Take the poses from a file (TUM or CSV: stamp,x,y,yaw) or from this topic.",
    ),
    option(
        POSES,
        "--sensor-pose",
        **read_by(parse_sensor_pose),
        metavar="X,Y,YAW[,ROLL,PITCH]",
        help="Where the laser sits on the robot (m, rad).",
    ),
    option(
        POSES,
        "--static-tf",
        "static_transforms",
        **read_by(parse_transform),
        multiple=True,
        metavar="PARENT,CHILD,X,Y,Z,ROLL,PITCH,YAW",
        help="A fixed transform that the log lacks (m, rad). May repeat.",
    ),
    option(
        POSES,
        "--map-frame",
        metavar="FRAME",
        show_default="map, else odom, else the root",
        help="Map in this frame.",
    ),
    option(
        POSES, "--base-frame", metavar="FRAME", help="The moving body that --sensor-pose is on."
    ),
    seconds(
        POSES,
        "--max-pose-gap",
        "max_pose_gap_s",
        default=DEFAULTS.posing.max_pose_gap_s,
        show_default=True,
        help="Interpolate no poses across a longer gap.",
    ),
    seconds(
        POSES,
        "--time-offset",
        "time_offset_s",
        default=DEFAULTS.posing.time_offset_s,
        help="Add this to the stamps of scans.",
    ),
    option(
        POSES,
        "--stamps",
        **one_of(Stamps),
        default=DEFAULTS.posing.stamps.value,
        show_default=True,
        help="Believe the time that the driver wrote, or the recorder's.",
    ),
    option(
        POSES,
        "--deskew",
        **one_of(Deskew),
        default=DEFAULTS.posing.deskew.value,
        show_default=True,
        help="Give every beam of a scan a pose of its own.",
    ),
)

jobs = option(
    RUN,
    "--jobs",
    type=int,
    metavar="N",
    default=DEFAULTS.jobs,
    show_default="one for each core",
    help="Threads.",
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
