"""MCAP files for RViz and Foxglove: the map, the robot's way, and the transforms to draw it with.

| topic | type | holds |
|---|---|---|
| `/map` | `nav_msgs/msg/OccupancyGrid` | the map, once, as nav2's map_server publishes it |
| `/trajectory` | `nav_msgs/msg/Path` | where the laser was at each scan, once; further lasers |
| | | and logs have `/trajectory_2` and so on |
| `/tf` | `tf2_msgs/msg/TFMessage` | the laser in the map, at the time of each scan |
"""

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
from mcap.writer import Writer as BagWriter
from numpy.typing import NDArray
from rosbags.typesys import Stores, get_typestore

from occmap.cells import OccupancyMap, list_captions
from occmap.types import Float64
from occmap.writers import MapMode, Product, WriteOptions, Writer
from occmap.writers.atomic import open_atomic
from occmap.writers.pgm import to_raw

MAP_FRAME = "map"
CELLS = np.array([-1, 0, 100], np.int8)
"""Of each CellClass"""
LAST_NS = (2**31 - 1) * 10**9
"""A ROS time has 32 bits for its seconds."""
EVER = "{nsec: 4294967295, sec: 2147483647}"
LATCHED = f"""\
- avoid_ros_namespace_conventions: false
  deadline: {EVER}
  depth: 1
  durability: 1
  history: 1
  lifespan: {EVER}
  liveliness: 1
  liveliness_lease_duration: {EVER}
  reliability: 1"""
"""RViz wants a map that late subscribers get, too; `ros2 bag play` offers topics as this says: the
last message is kept (history, depth) for all who come (durability), and sent again until it arrives
(reliability)."""

STORE = get_typestore(Stores.ROS2_HUMBLE)
ROS = SimpleNamespace(**{name.rpartition("/")[2]: kind for name, kind in STORE.types.items()})
"""Message classes by their short names"""


class McapWriter(Writer):
    """An MCAP file of ROS 2 messages, with the map at the time of the first scan."""

    description = "MCAP for RViz and Foxglove: OccupancyGrid, Path and transforms"
    shows_journey = True

    def write_product(self, path: Path, product: Product, options: WriteOptions) -> None:
        """Write the map, and where the robot went, if that is known.

        Raises
        ------
        OutputError
            It cannot be written; then nothing is left behind.
        """
        latched = {"offered_qos_profiles": LATCHED}
        with open_atomic(path) as (file,):
            bag = BagWriter(file)
            bag.start(profile="ros2", library="occmap")
            channels: dict[str, int] = {}
            for topic, message, stamp in list_messages(product, options):
                kind = message.__msgtype__
                if topic not in channels:
                    text, _ = STORE.generate_msgdef(kind, ros_version=2)
                    schema = bag.register_schema(kind, "ros2msg", text.encode())
                    offered = {} if topic == "/tf" else latched
                    channels[topic] = bag.register_channel(topic, "cdr", schema, offered)
                at = stamp.sec * 10**9 + stamp.nanosec
                bag.add_message(channels[topic], at, bytes(STORE.serialize_cdr(message, kind)), at)
            if captions := list_captions(product.grid.about):
                bag.add_metadata("occmap", captions)
            bag.finish()  # type: ignore[no-untyped-call]


def list_messages(product: Product, options: WriteOptions) -> Iterator[tuple[str, Any, Any]]:
    """Give the topic, the message and the time of all that the file holds."""
    trajectories = product.journey.trajectories if product.journey else ()
    stamps = np.concatenate([each.stamp_ns for each in trajectories] or [np.zeros(1, np.int64)])
    header = make_header(trajectories[0].parent if trajectories else MAP_FRAME, min(stamps))
    grid = product.grid
    corner = make_pose(np.array([*grid.origin, 0, 0, 0, 0, 1], np.float64))
    info = ROS.MapMetaData(header.stamp, grid.resolution, *grid.shape[::-1], corner)
    # Its rows begin at the lowest y, as those of a map do.
    cells = fill_cells(grid, options).ravel()
    yield "/map", ROS.OccupancyGrid(header, info, cells), header.stamp
    for number, trajectory in enumerate(trajectories):
        suffix = f"_{number + 1}" if number else ""
        poses = [
            ROS.PoseStamped(make_header(trajectory.parent, stamp_ns), make_pose(pose))
            for stamp_ns, pose in zip(trajectory.stamp_ns, trajectory.pose, strict=True)
        ]
        first = poses[0].header if poses else make_header(trajectory.parent, 0)
        yield f"/trajectory{suffix}", ROS.Path(first, poses), header.stamp
    for trajectory in trajectories:
        for stamp_ns, pose in zip(trajectory.stamp_ns, trajectory.pose, strict=True):
            header = make_header(trajectory.parent, stamp_ns)
            transform = ROS.Transform(ROS.Vector3(*pose[:3]), make_pose(pose).orientation)
            stamped = ROS.TransformStamped(header, trajectory.frame, transform)
            yield "/tf", ROS.TFMessage([stamped]), header.stamp


def fill_cells(grid: OccupancyMap, options: WriteOptions) -> NDArray[np.int8]:
    """(H, W) as nav2 publishes a PGM of the same mode: 0 free, 100 occupied, -1 unknown.

    In raw mode, and in scale mode, which nav2 stretches between the thresholds, it is the
    probability in per cent.
    """
    if options.mode is MapMode.TRINARY:
        return CELLS[replace(grid, decision=options.decide(grid.decision)).classes]
    return to_raw(grid).view(np.int8)  # of 255, which is unknown there, -1


def make_header(frame: str, stamp_ns: Any) -> Any:
    """Make a Header; a time that ROS cannot state becomes the nearest one that it can."""
    seconds, rest = divmod(min(max(int(stamp_ns), 0), LAST_NS), 10**9)
    return ROS.Header(ROS.Time(seconds, rest), frame)


def make_pose(pose: Float64) -> Any:
    """Make a Pose of (7,) x y z qx qy qz qw."""
    return ROS.Pose(ROS.Point(*pose[:3]), ROS.Quaternion(*pose[3:]))
