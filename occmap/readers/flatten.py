"""Messages that hold more than a scan, brought down to one: several echoes, clouds of points."""

import math
from typing import Any

import numpy as np

from occmap.readers.header import read_frame, read_stamp
from occmap.readers.options import Echo, ReaderOptions
from occmap.types import Float32, Float64, Scan, as_float32

BEARINGS = 720
"""A cloud is flattened to half a degree: finer than most spinning lidars in the plane, and coarse
enough that one turn leaves few bearings empty."""

_FORMATS = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 8: "f8"}
"""NumPy's names of the number types of sensor_msgs/PointField."""


def convert_multi_echo(options: ReaderOptions, message: Any, topic: str, record_ns: int) -> Scan:
    """Convert a sensor_msgs/MultiEchoLaserScan by one echo a beam.

    A beam without an echo becomes +inf: nothing came back (REP 117).
    """
    at = 0 if options.echo is Echo.FIRST else -1
    ranges = [beam.echoes[at] if len(beam.echoes) else math.inf for beam in message.ranges]
    return Scan(
        stamp_ns=read_stamp(message.header),
        frame=read_frame(message.header.frame_id),
        angle_min=message.angle_min,
        angle_increment=message.angle_increment,
        ranges=np.array(ranges, dtype=np.float32),
        range_min=message.range_min,
        range_max=message.range_max,
        time_increment=message.time_increment,
        topic=topic,
        record_ns=record_ns,
    )


def convert_cloud(options: ReaderOptions, message: Any, topic: str, record_ns: int) -> Scan:
    """Convert a sensor_msgs/PointCloud2: the nearest point of each bearing between two heights.

    Heights and bearings are those of the cloud's own frame, whose z is taken to point up; not so
    in a camera's optical frame. A bearing without a point is +inf. The limits are unknown.

    Raises
    ------
    ValueError, TypeError, LookupError
        The cloud has no x, y, z, or is not as long as it says.
    """
    points = read_points(message)
    level = (points[:, 2] >= options.min_height) & (points[:, 2] <= options.max_height)
    step = 2 * math.pi / BEARINGS
    return Scan(
        stamp_ns=read_stamp(message.header),
        frame=read_frame(message.header.frame_id),
        angle_min=step / 2 - math.pi,
        angle_increment=step,
        ranges=find_nearest(points[level, :2]),
        range_min=0.0,
        range_max=math.inf,
        topic=topic,
        record_ns=record_ns,
    )


def read_points(message: Any) -> Float64:
    """Read x, y, z (N, 3) of a sensor_msgs/PointCloud2, without the points that are not finite."""
    order = ">" if message.is_bigendian else "<"
    fields = {field.name: field for field in message.fields}
    layout = np.dtype(
        {
            "names": ["x", "y", "z"],
            "formats": [order + _FORMATS[fields[name].datatype] for name in "xyz"],
            "offsets": [fields[name].offset for name in "xyz"],
            "itemsize": message.point_step,
        }
    )
    shape, strides = (message.height, message.width), (message.row_step, message.point_step)
    data = np.ascontiguousarray(message.data)
    cloud = np.ndarray(shape, layout, buffer=data.data, strides=strides)
    points = np.stack([cloud[name].ravel() for name in "xyz"], axis=1).astype(np.float64)
    return points[np.isfinite(points).all(axis=1)]


def find_nearest(points: Float64) -> Float32:
    """Find the distance (BEARINGS,) of the nearest of points (N, 2) in each sector around zero.

    Points at zero itself stand for no return with some drivers.
    """
    distance = as_float32(np.hypot(points[:, 0], points[:, 1]))
    bearing = np.arctan2(points[:, 1], points[:, 0])
    sector = ((bearing + math.pi) * (BEARINGS / (2 * math.pi))).astype(np.int64) % BEARINGS
    nearest = np.full(BEARINGS, np.inf, np.float32)
    np.minimum.at(nearest, sector[distance > 0], distance[distance > 0])
    return nearest
