"""The options that say how logs are read: ranges, scans, and where they were taken."""

from occmap.cli.options import POSES, RANGES, SCANS, choice, field
from occmap.cli.sections import join

ranges = join(
    field(RANGES, "min_range", "M", "Ignore nearer ranges."),
    field(
        RANGES,
        "max_range",
        "M",
        "Use beams up to here; a longer one is free up to here.",
        show_default="no limit",
    ),
    field(
        RANGES,
        "range_max",
        "M",
        "The sensor's limit: at or beyond it nothing came back.",
        show_default="what the log states",
    ),
    choice(RANGES, "no_return", "Where nothing came back: free up to the limit, or nothing known."),
    field(
        RANGES,
        "ignore_sectors",
        "FROM,TO",
        "Leave out the beams from one bearing counter-clockwise to another (rad, as the sensor "
        "sees it): the robot blocks them. May repeat.",
        multiple=True,
    ),
    field(
        RANGES,
        "footprint",
        "X_MIN,Y_MIN,X_MAX,Y_MAX",
        "Leave out what is measured in this box around the sensor (m, as the sensor sees it): it "
        "is the robot.",
    ),
)

reading = join(
    choice(SCANS, "echo", "MultiEchoLaserScan: the echo of a beam that counts."),
    field(SCANS, "min_height", "M", "PointCloud2: use points from this height over the sensor on."),
    field(SCANS, "max_height", "M", "PointCloud2: use points up to this height over the sensor."),
)
scan_topic = field(
    SCANS,
    "topics",
    "TOPIC",
    "Use the scans of this topic. May repeat.",
    multiple=True,
    show_default="all",
)
selection = join(
    scan_topic,
    field(SCANS, "start_s", "S", "Leave out scans before this time after the first."),
    field(SCANS, "end_s", "S", "Leave out scans from this time after the first on."),
    field(SCANS, "stride", "N", "Use every N-th of these scans."),
    reading,
)

posing = join(
    field(
        POSES,
        "poses",
        "FILE|TOPIC",
        "Take the poses from a file (TUM, EuRoC, KITTI or CSV: stamp,x,y,yaw) or from this topic.",
    ),
    field(
        POSES,
        "sensor_pose",
        "X,Y,YAW[,ROLL,PITCH]",
        "Where the laser sits on the robot (metres, radians).",
    ),
    field(
        POSES,
        "static_transforms",
        "PARENT,CHILD,X,Y,Z,ROLL,PITCH,YAW",
        "A fixed transform that the log lacks (m, rad). May repeat.",
        multiple=True,
    ),
    field(
        POSES,
        "map_frame",
        "FRAME",
        "Map in this frame.",
        show_default="map, else odom, else the root",
    ),
    field(
        POSES,
        "transform",
        "X,Y,YAW",
        "Where the logs' map frame lies in the map that is made (m, rad), so that sessions in "
        "frames of their own make one map.",
    ),
    field(POSES, "base_frame", "FRAME", "The moving body that --sensor-pose is on."),
    field(POSES, "max_pose_gap_s", "S", "Interpolate no poses across a longer gap."),
    field(
        POSES, "max_speed", "M/S", "Leave out scans that lie further from those before and after."
    ),
    field(POSES, "time_offset_s", "S", "Add this to the stamps of scans."),
    choice(POSES, "stamps", "Believe the time that the driver wrote, or the recorder's."),
    choice(POSES, "deskew", "Give every beam of a scan a pose of its own."),
)
