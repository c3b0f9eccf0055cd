"""Clouds of points, brought down to a scan."""

import math
from typing import Any

import numpy as np

from occmap.arrays import Float32, Float64
from occmap.errors import DamageError
from occmap.readers.options import ReaderOptions
from occmap.readers.shapes import HEADER, Shape, as_bytes, as_flag, read_frame, read_stamp
from occmap.types import Scan
from occmap.values import as_float32, as_stamp, as_text

BEARINGS = 720
"""A cloud is flattened to half a degree: finer than most spinning lidars in the plane, and coarse
enough that one turn leaves few bearings empty."""

_FORMATS = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 8: "f8"}
"""NumPy's names of the number types of sensor_msgs/PointField."""

CLOUD: Shape = {
    "header": HEADER,
    "height": as_stamp,
    "width": as_stamp,
    "fields": [{"name": as_text, "offset": as_stamp, "datatype": as_stamp}],
    "is_bigendian": as_flag,
    "point_step": as_stamp,
    "row_step": as_stamp,
    "data": as_bytes,
}


def convert_cloud(options: ReaderOptions, message: Any, topic: str, record_ns: int) -> Scan:
    """Convert a sensor_msgs/PointCloud2: the nearest point of each bearing between two heights.

    Heights and bearings are those of the cloud's own frame, whose z is taken to point up; not so
    in a camera's optical frame. A bearing without a point is +inf. The limits are unknown.

    Raises
    ------
    DamageError
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
    fields = {field.name: field for field in message.fields if field.datatype in _FORMATS}
    if not fields.keys() >= set("xyz"):
        raise DamageError("is a cloud of points without x, y and z")
    columns = [(np.dtype(order + _FORMATS[fields[c].datatype]), fields[c].offset) for c in "xyz"]
    rows, width, step = message.height, message.width, message.point_step
    row_step = message.row_step if rows > 1 else width * step
    if row_step < width * step or any(not 0 <= at <= step - t.itemsize for t, at in columns):
        raise DamageError("is a cloud whose points lie over one another")
    if min(rows, width) < 0 or (rows - 1) * row_step + width * step > len(message.data):
        raise DamageError(f"announces {rows} x {width} points in {len(message.data)} bytes")
    if rows * width == 0:
        return np.empty((0, 3))
    data = np.ascontiguousarray(message.data).data
    points = [
        np.ndarray((rows, width), kind, data, at, (row_step, step)).ravel() for kind, at in columns
    ]
    stacked = np.stack(points, axis=1).astype(np.float64)
    return stacked[np.isfinite(stacked).all(axis=1)]


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
