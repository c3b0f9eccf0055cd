"""Messages of points as clouds: PointCloud2, Livox's own, and images of depth cameras.

Points stay as their driver wrote them, with NaN or zeros where nothing came back.
"""

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from io import BytesIO
from pathlib import Path
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from occmap.errors import DamageError, LogError
from occmap.jit import kernel
from occmap.readers import NoteList
from occmap.readers.depth import clean
from occmap.readers.fields import get, get_bytes, get_header, get_list, get_row, get_whole, look
from occmap.types import Cloud, Float32, Int64, UInt8
from occmap.values import as_text, shorten

TIME_FIELDS = ("t", "time", "timestamp", "offset_time", "time_stamp", "time_offset")
"""What drivers call the time of a point."""
LONGEST_SWEEP_NS = 1_000_000_000
"""No sensor takes longer for a cloud; times beyond this are not those of points."""
BEYOND = "which reach more than a second from the stamp: all points are taken at it"
_FLOAT = np.dtype(np.float32)
US, MS = 1e3, 1e6
Columns: TypeAlias = Mapping[str, NDArray[Any]]
"""(N,) each: the fields of points, by the names that their driver or file gives them"""
Layout: TypeAlias = Mapping[str, tuple[str, int]]
"""NumPy's type of each field of a point, and its place"""
UNITS = {1.0: "ns", US: "us", MS: "ms", 1e9: "s"}

ROS_KINDS = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 8: "f8"}
"""NumPy's names of the number types of sensor_msgs/PointField."""
FOXGLOVE_KINDS = {1: "u1", 2: "i1", 3: "u2", 4: "i2", 5: "u4", 6: "i4", 7: "f4", 8: "f8"}
"""Those of foxglove.PackedElementField."""


def convert_cloud(message: Any, topic: str, record_ns: int) -> Cloud:
    """Convert a sensor_msgs/PointCloud2; raises DamageError where it is not as it says."""
    order = ">" if get_whole(message, "is_bigendian") else "<"
    sizes = ("height", "width", "point_step", "row_step")
    rows, width, step, row_step = (get_whole(message, name) for name in sizes)
    steps = row_step if rows > 1 else width * step, step
    fields = read_fields(message, "datatype", ROS_KINDS)
    columns = view_columns(get_bytes(message, "data"), fields, (rows, width), steps, order)
    return make_cloud(columns, get_header(message), topic, record_ns)


def convert_listed(message: Any, topic: str, record_ns: int) -> Cloud:
    """Convert a sensor_msgs/PointCloud, which lists its points, and numbers of each in channels."""
    listed = [[get(point, axis) for axis in "xyz"] for point in get_list(message, "points")]
    points = np.array(listed, np.float32).reshape(-1, 3)
    columns: dict[str, NDArray[Any]] = dict(zip("xyz", points.T, strict=True))
    for channel in get_list(message, "channels"):
        numbers = np.asarray(get_row(channel, "values"))
        if len(numbers) == len(points):
            columns[as_text(get(channel, "name"))] = numbers
    return make_cloud(columns, get_header(message), topic, record_ns)


def read_fields(message: Any, type_name: str, kinds: Mapping[int, str]) -> Layout:
    """Read what the points of a message hold that is used: NumPy's type and the place of each."""
    fields = {}
    for field in get_list(message, "fields"):
        name, kind = as_text(get(field, "name")), kinds.get(get_whole(field, type_name))
        if kind and name in (*"xyz", *TIME_FIELDS):
            fields[name] = kind, get_whole(field, "offset")
    return fields


def view_packed(message: Any) -> Columns:
    """See the fields of the points of a foxglove.PointCloud."""
    data, step = get_bytes(message, "data"), get_whole(message, "point_stride")
    fields = read_fields(message, "type", FOXGLOVE_KINDS)
    return view_columns(data, fields, (1, len(data) // max(step, 1)), (len(data), step))


def view_columns(
    data: UInt8, fields: Layout, shape: tuple[int, int], steps: tuple[int, int], order: str = "<"
) -> Columns:
    """See the fields of points, (N,) each, by their names.

    Parameters
    ----------
    shape, steps
        How many rows and points in each, and how many bytes from one to the next.

    Raises
    ------
    DamageError
        The points do not lie beside one another within the data.
    """
    (rows, width), (row_step, step) = shape, steps
    if min(rows, width) < 0 or (rows - 1) * row_step + width * step > len(data):
        raise DamageError(f"announces {rows} x {width} points in {len(data)} bytes")
    data, columns = np.ascontiguousarray(data), {}
    for name, (kind, at) in fields.items():
        number = np.dtype(order + kind)
        if row_step < width * step or not 0 <= at <= step - number.itemsize:
            raise DamageError("is a cloud whose points lie over one another")
        if rows * width:
            columns[name] = np.ndarray(shape, number, data.data, at, steps).reshape(-1)
        else:
            columns[name] = np.empty(0, number)
    return columns


def make_cloud(columns: Columns, header: tuple[int, str], topic: str, record_ns: int) -> Cloud:
    """Make a cloud of the fields of its points, its stamp and frame, its topic and record time.

    Raises
    ------
    DamageError
        x, y or z is absent.
    """
    if missing := [name for name in "xyz" if name not in columns]:
        raise DamageError(f"has no field {missing[0]} among {', '.join(columns) or 'none'}")
    points = stack_points([columns[name] for name in "xyz"])
    for name in TIME_FIELDS:
        if name in columns:
            offset_ns, found = find_offsets(columns[name], points, header[0])
            times = f"{name}, {found}" if found else ""
            return Cloud(*header, points, offset_ns, None, topic, record_ns, times)
    return Cloud(*header, points, None, None, topic, record_ns, may_be_image=True)


def stack_points(axes: Sequence[NDArray[Any]]) -> Float32:
    """Stack x, y and z (N,) each as points (N, 3); without a copy where they lie side by side."""
    starts = [axis.__array_interface__["data"][0] for axis in axes]
    is_alike = {(axis.dtype, axis.strides) for axis in axes} == {(_FLOAT, axes[0].strides)}
    if is_alike and starts == [starts[0], starts[0] + 4, starts[0] + 8]:
        shape, steps = (len(axes[0]), 3), (*axes[0].strides, 4)
        return np.lib.stride_tricks.as_strided(axes[0], shape, steps, writeable=False)
    points = np.empty((len(axes[0]), 3), np.float32)
    with np.errstate(invalid="ignore", over="ignore"):  # a flipped bit makes any number
        for at, axis in enumerate(axes):
            points[:, at] = axis
    return points


def find_offsets(times: NDArray[Any], points: Float32, stamp_ns: int) -> tuple[Int64 | None, str]:
    """Find when points were measured, in ns after the stamp (N,), whatever their driver's unit.

    Times may be relative to the stamp or absolute, in s, ms, us or ns. Those of a clock other than
    the stamp's are taken from the first point on. None where all points have one time, or times
    are further apart than any sensor's sweep.

    Returns
    -------
    offset_ns, found
        The times, and in words how they were read; "" where they say nothing.
    """
    values = times.astype(np.int64 if times.dtype.kind in "iu" else np.float64)
    if (read := _scale_times(values, stamp_ns)) is None:
        with np.errstate(invalid="ignore"):  # what did not come back has any time with some drivers
            used = np.isfinite(values) & np.isfinite(points).all(axis=1) & points.any(axis=1)
        if not used.any():
            return None, ""
        read = _scale_times(np.where(used, values, values[used].min()), stamp_ns)
    return read or (None, BEYOND)


def _scale_times(values: NDArray[Any], stamp_ns: int) -> tuple[Int64 | None, str] | None:
    """Bring times (N,) to ns after the stamp, and say how; None where they reach too far."""
    least, most = (values.min(), values.max()) if values.size else (0, 0)
    if least == most:
        return None, ""
    low, high = float(least), float(most)
    unit, is_absolute = find_time_unit(low, high, values.dtype)
    after = "of a clock" if is_absolute else "after the stamp"
    # Counted from the earliest one, since nanoseconds of a clock are more than a float can tell.
    start_ns = low * unit - (stamp_ns if is_absolute else 0)
    if is_absolute and abs(start_ns) > LONGEST_SWEEP_NS:
        start_ns, after = 0, "of a clock other than the stamp's, so they begin at the stamp"
    if not max(abs(start_ns), abs(start_ns + (high - low) * unit)) <= LONGEST_SWEEP_NS:
        return None  # or one is NaN
    passed = values - least
    passed *= values.dtype.type(unit)
    offset_ns = passed if passed.dtype == np.int64 else np.rint(passed).astype(np.int64)
    offset_ns += round(start_ns)
    return offset_ns, f"in {UNITS[unit]} {after}"


def find_time_unit(low: float, high: float, dtype: np.dtype[Any]) -> tuple[float, bool]:
    """Find how many ns the unit of points' times has, and whether they are a clock's.

    A clock has counted 1e9 seconds since 2001; a sweep takes half a millisecond to two seconds, and
    in whole milliseconds it would have too few steps.
    """
    for unit in UNITS:
        if low * unit > 1e18 and (high - low) * unit <= 10 * LONGEST_SWEEP_NS:
            return unit, True
    largest = max(abs(low), abs(high))
    beyond = ((1e9, 2), (MS, 0 if dtype == np.int64 else 500), (US, 2e6))
    return next((unit for unit, most in beyond if largest <= most), 1.0), False


def tell_clouds(clouds: Iterable[Cloud], path: Path, notes: NoteList) -> Iterator[Cloud]:
    """Hand on the clouds of a log; say how the times of points are read, and what holds none.

    Raises
    ------
    LogError
        No cloud holds a point; raised behind the last.
    """
    topic, has_points = "", False
    for cloud in clouds:
        topic = cloud.topic
        if cloud.times:
            notes.add(f"{topic}: its points have the time {cloud.times}")
        # Mostly a few show it.
        if cloud.points[:64].any() or cloud.points.any():
            has_points = True
        else:
            notes.add(f"{topic}: clouds without a point among others")
        yield cloud
    if topic and not has_points:
        fix = "see what the sensor recorded, or name another with `topics`"
        raise LogError(f"no cloud on {topic} holds a point", where=path, fix=fix)


def parse_livox(encoding: str, data: memoryview) -> Mapping[str, Any]:
    """Parse a livox_ros_driver/CustomMsg, whose points a library would read one by one."""
    raw = bytes(data) + b"\0"  # CDR leaves out what would fill up the last point
    end = 16 + int.from_bytes(raw[12:16], "little")  # of the frame's name
    is_cdr = encoding == "cdr"
    start = end + (4 - end) % 8 * is_cdr  # of the time that those of points are counted from
    count, step = int.from_bytes(raw[start + 16 : start + 20], "little"), 20 if is_cdr else 19
    if (is_cdr and raw[:2] != b"\0\1") or len(raw) < start + 20 + count * step:
        raise DamageError(f"announces {count} points in {len(data)} bytes")
    sec, nanosec = np.frombuffer(raw, "<u4", 2, 4).tolist()
    fields = {"offset_time": ("u4", 0), "x": ("f4", 4), "y": ("f4", 8), "z": ("f4", 12)}
    points = np.frombuffer(raw, np.uint8, count * step, start + 20)
    columns = view_columns(points, fields, (1, count), (count * step, step))
    stamp = {"sec": sec, "nanosec": nanosec}
    frame = raw[16:end].rstrip(b"\0").decode("utf-8", "surrogateescape")
    return {"header": {"stamp": stamp, "frame_id": frame}, "points": columns}


def convert_livox(message: Any, topic: str, record_ns: int) -> Cloud:
    """Convert what `parse_livox` gives."""
    return make_cloud(message["points"], get_header(message), topic, record_ns)


_DEPTHS = {"16UC1": ("u2", 1e-3), "mono16": ("u2", 1e-3), "32FC1": ("f4", 1.0)}
"""What depths are written as by encoding, and how many metres one is (REP 118)."""
_COMPRESSED_HEAD = np.dtype([("form", "<i4"), ("a", "<f4"), ("b", "<f4")])
"""What compressed_depth_image_transport puts before a PNG."""


class Camera(NamedTuple):
    """The pinhole camera of a depth image: pixels a metre at 1 m, and where its axis meets it."""

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float


def read_camera(message: Any) -> Camera:
    """Read a sensor_msgs/CameraInfo; raises DamageError where it is of no pinhole camera."""
    name = "k" if look(message, "k") is not None else "K"  # in ROS 1
    k, p = get_row(message, name), get_row(message, name.replace("k", "p").replace("K", "P"))
    # Depth images are rectified, which P is for; drivers that do not rectify leave it empty.
    row = p if len(p) == 12 and p[0] else k
    if len(row) not in {9, 12}:
        raise DamageError("states no matrix")
    fx, cx, fy, cy = row[[0, 2, 5, 6] if len(row) == 12 else [0, 2, 4, 5]].tolist()
    camera = Camera(get_whole(message, "width"), get_whole(message, "height"), fx, fy, cx, cy)
    if not (math.isfinite(sum(camera)) and min(fx, fy) > 0):
        raise DamageError("states no focal length")
    return camera


def is_depth(message: Any) -> bool:
    """Whether an image, or a compressed one, holds depths; raises DamageError."""
    if look(message, "encoding") is not None:
        return get(message, "encoding") in _DEPTHS
    return "compressedDepth" in as_text(get(message, "format"))


def convert_depth(camera: Camera, message: Any, topic: str, record_ns: int) -> Cloud:
    """Convert a sensor_msgs/Image of depths: a point for each pixel that has one."""
    encoding, order = get(message, "encoding"), ">" if get_whole(message, "is_bigendian") else "<"
    if encoding not in _DEPTHS:
        raise DamageError(f"is written as {shorten(encoding)}, which no depth is")
    kind, unit = _DEPTHS[encoding]
    rows, width, step = (get_whole(message, name) for name in ("height", "width", "step"))
    fields = {"z": (kind, 0)}
    steps = step, np.dtype(kind).itemsize
    depth = view_columns(get_bytes(message, "data"), fields, (rows, width), steps, order)["z"]
    with np.errstate(invalid="ignore", over="ignore"):  # a flipped bit makes any number
        depth = depth.reshape(rows, width) * np.float32(unit)
    return _project(camera, depth, message, topic, record_ns)


def convert_compressed_depth(camera: Camera, message: Any, topic: str, record_ns: int) -> Cloud:
    """Convert a sensor_msgs/CompressedImage, as compressed_depth_image_transport writes it.

    Depths that were floats lie in the PNG as a / depth + b, and 0 where there is none.
    """
    from PIL import Image  # noqa: PLC0415  late: few logs need it

    data, head = get_bytes(message, "data"), _COMPRESSED_HEAD
    try:
        _, a, b = np.frombuffer(data, head, 1)[0].tolist()
        with Image.open(BytesIO(data[head.itemsize :].tobytes()), formats=["PNG"]) as image:
            packed = np.asarray(image).astype(np.float32)
    except (ValueError, OSError, SyntaxError, Image.DecompressionBombError) as error:
        form = f"where `format` is {shorten(get(message, 'format'))}"
        raise DamageError(f"holds no PNG of depths, {form} ({type(error).__name__})") from None
    if packed.ndim != 2:
        raise DamageError("holds a PNG of colours, which no depth is")
    depth = packed * np.float32(1e-3)
    if get(message, "format").startswith("32FC1"):
        with np.errstate(divide="ignore", invalid="ignore"):
            depth = np.where(packed > 0, np.float32(a) / (packed - np.float32(b)), 0)
    return _project(camera, depth, message, topic, record_ns)


def _project(camera: Camera, depth: Float32, message: Any, topic: str, record_ns: int) -> Cloud:
    """Put the pixels of an image (H, W), of depths in m, where they lie in the optical frame."""
    if depth.shape != (camera.height, camera.width):
        found = f"has {depth.shape[1]} x {depth.shape[0]} pixels"
        raise DamageError(f"{found}, where its camera has {camera.width} x {camera.height}")
    cleaned = np.ascontiguousarray(clean(depth, min(camera.fx, camera.fy)))
    points = np.empty((depth.size, 3), np.float32)
    many = project(cleaned, camera, points)
    return Cloud(*get_header(message), points[:many], None, None, topic, record_ns)


@kernel
def project(depth: Float32, camera: Camera, points: Float32) -> int:
    """Fill points (N, 3) with those of an image (H, W), row after row; return how many it has."""
    many = 0
    for row in range(camera.height):
        up = (row - camera.cy) / camera.fy
        for col in range(camera.width):
            z = depth[row, col]
            if z > 0:
                x, y = (col - camera.cx) / camera.fx * z, up * z
                points[many, 0], points[many, 1], points[many, 2] = x, y, z
                many += 1
    return many
