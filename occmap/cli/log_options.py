"""The options that say how logs are read: ranges, scans, and where they were taken."""

import math

from occmap.cli.options import (
    DEFAULTS,
    NO_LIMIT,
    POSES,
    RANGES,
    SCANS,
    metres,
    seconds,
)
from occmap.cli.sections import join, option
from occmap.cli.values import (
    one_of,
    parse_box,
    parse_sector,
    parse_sensor_pose,
    parse_static,
    parse_transform,
    read_by,
)
from occmap.posing.options import Deskew, Stamps
from occmap.readers.options import Echo
from occmap.sensor.returns import NoReturn

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
    seconds(SCANS, "--end", "end_s", default=math.inf, help="... and from this time on."),
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
        help="Take the poses from a file (TUM, EuRoC, KITTI or CSV: stamp,x,y,yaw) or from this "
        "topic.",
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
        **read_by(parse_static),
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
        POSES,
        "--transform",
        **read_by(parse_transform),
        metavar="X,Y,YAW",
        help="Where the logs' map frame lies in the map that is made (m, rad), so that sessions in "
        "frames of their own make one map.",
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
    option(
        POSES,
        "--max-speed",
        type=float,
        metavar="M/S",
        default=DEFAULTS.posing.max_speed,
        show_default=True,
        help="Leave out scans that lie further from those before and after.",
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
