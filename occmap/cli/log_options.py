"""The options that say how logs are read: ranges, scans, and where they were taken."""

from occmap.cli.options import POSES, RANGES, SCANS, fields

ranges = fields(
    RANGES,
    min_range=("M", "Ignore nearer ranges."),
    max_range=(
        "M",
        "Use beams only up to here; a longer one clears the space up to here.",
        "no limit",
    ),
    range_max=(
        "M",
        "Ranges at or beyond this count as no return.",
        "what the log states",
    ),
    no_return=("", "A beam without return clears the space up to the limit, or says nothing."),
    ignore_sectors=(
        "FROM,TO",
        "Leave out the beams from one bearing counter-clockwise to another (rad, as the sensor "
        "sees it): the robot blocks them. May repeat.",
    ),
    footprint=(
        "X_MIN,Y_MIN,X_MAX,Y_MAX",
        "Leave out what is measured in this box around the sensor (m, as the sensor sees it): it "
        "is the robot.",
    ),
)

selection = fields(
    SCANS,
    topics=("TOPIC", "Use the scans of this topic. May repeat.", "all"),
    start_s=("S", "Use scans from this time after the first on."),
    end_s=("S", "Use scans before this time after the first."),
    stride=("N", "Use every N-th of these scans."),
    echo=("", "MultiEchoLaserScan: the echo of a beam that counts."),
    min_height=("M", "PointCloud2: use points from this height over the sensor on."),
    max_height=("M", "PointCloud2: use points up to this height over the sensor."),
)

posing = fields(
    POSES,
    poses=(
        "FILE|TOPIC",
        "Take the poses from a file (TUM, EuRoC, KITTI or CSV: stamp,x,y,yaw) or from this topic.",
    ),
    sensor_pose=("X,Y,YAW[,ROLL,PITCH]", "Where the laser sits on the robot (metres, radians)."),
    static_transforms=(
        "PARENT,CHILD,X,Y,Z,ROLL,PITCH,YAW",
        "A fixed transform that the log lacks (m, rad). May repeat.",
    ),
    map_frame=("FRAME", "Map in this frame.", "map, else odom, else the root"),
    transform=(
        "X,Y,YAW",
        "Pose of the logs' map frame in the new map (m, rad), to join sessions that have a frame "
        "each.",
    ),
    base_frame=("FRAME", "The moving body that --sensor-pose is on."),
    max_pose_gap_s=("S", "Leave out scans in a longer gap between poses."),
    max_speed=("M/S", "Leave out scans whose poses leap away faster than this, and back."),
    time_offset_s=("S", "Add this to the stamps of scans."),
    stamps=("", "Use the times that the driver wrote, or the recorder's."),
    deskew=("", "Give every beam of a scan a pose of its own."),
)
