"""Clouds of a 3D lidar, 64 rings x 1024 ten times a second: what a map of them costs."""

import math
import shutil
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

from occmap.options import BuildOptions
from occmap.pipeline import build
from tests.bench.limits import Row, compare
from tests.bench.measuring import Times, time_in_turn
from tests.bench.processes import OCCMAP, run
from tests.bench.workloads import START_NS
from tests.clouds.simulation import Room, list_rays

RINGS, AZIMUTHS = 64, 1024
SWEEP_NS = 100_000_000
STORE = get_typestore(Stores.ROS2_HUMBLE)
CEILING = (-0.3, 10.3, -0.3, 6.3, 2.8, 2.9)
ROOM = Room([CEILING, (3.0, 4.0, 4.5, 5.0, 0.7, 0.8), (5.0, 5.3, 1.5, 1.8, 0, 0.2)], slope=0.06)
NS_LIMIT = 1e9 / 15e6
"""15 million points a second (ns a point)"""
COPY_LIMIT, THREADS_LIMIT, MEMORY_LIMIT = 8.0, 0.6, 1.05


def write_clouds(folder: Path, clouds: int, has_times: bool = False) -> Path:
    """Write a drive as an MCAP file: through a room and back in 30 clouds each, again and again.

    Parameters
    ----------
    has_times
        Points have times of their own, and there are 20 poses a second.
    """
    rays = list_rays(RINGS, AZIMUTHS)
    x = np.linspace(0.8, 9.2, 30)
    rows = [make_rows(place, rays, has_times) for place in x]
    bag = folder / f"clouds_{clouds}"
    with Writer(bag, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        kinds = {"/tf": "tf2_msgs/msg/TFMessage", "/points": "sensor_msgs/msg/PointCloud2"}
        topics = {t: writer.add_connection(t, kind, typestore=STORE) for t, kind in kinds.items()}

        def write(topic: str, stamp_ns: int, message: Any) -> None:
            writer.write(topics[topic], stamp_ns, STORE.serialize_cdr(message, kinds[topic]))

        for number in range(clouds):
            stamp_ns, at = START_NS + number * SWEEP_NS, abs((number + 29) % 58 - 29)
            for later in (0, SWEEP_NS // 2):
                write("/tf", stamp_ns + later, make_pose(stamp_ns + later, x[at]))
            write("/points", stamp_ns, make_cloud(stamp_ns, rows[at]))
        write("/tf", stamp_ns + SWEEP_NS, make_pose(stamp_ns + SWEEP_NS, x[at]))
    return bag / f"{bag.name}.mcap"


def find_origin(x: float) -> list[float]:
    """Where the sensor is (m)."""
    return [x, 3.03, 0.6 + float(ROOM.floor(np.array(x)))]


def make_rows(x: float, rays: Any, has_times: bool) -> Any:
    """The points that are seen from a place, as bytes lie in a message."""
    origin = np.array(find_origin(x))
    fields: list[Any] = [("xyz", "<f4", 3)] + [("t", "<u4")] * has_times
    rows = np.zeros(len(rays), fields)
    rows["xyz"] = ROOM.cast(origin, rays) - origin
    if has_times:
        rows["t"] = np.arange(len(rays)) * (SWEEP_NS // len(rays))
    return rows


def make(name: str, *values: Any, **fields: Any) -> Any:
    """Make a message of a ROS type."""
    return STORE.types[name](*values, **fields)


def make_header(stamp_ns: int, frame: str) -> Any:
    """Make the header of a message."""
    stamp = make("builtin_interfaces/msg/Time", *divmod(stamp_ns, 10**9))
    return make("std_msgs/msg/Header", stamp, frame)


def make_pose(stamp_ns: int, x: float) -> Any:
    """Make the transform to the lidar."""
    place = make("geometry_msgs/msg/Vector3", *find_origin(x))
    turn = make("geometry_msgs/msg/Quaternion", 0.0, 0.0, 0.0, 1.0)
    moved = make("geometry_msgs/msg/Transform", place, turn)
    header = make_header(stamp_ns, "map")
    edge = make("geometry_msgs/msg/TransformStamped", header, "lidar", moved)
    return make("tf2_msgs/msg/TFMessage", [edge])


def make_cloud(stamp_ns: int, rows: Any) -> Any:
    """Make a PointCloud2."""
    names = [("x", 0, 7), ("y", 4, 7), ("z", 8, 7), ("t", 12, 6)][: rows.itemsize // 4]
    return make(
        "sensor_msgs/msg/PointCloud2",
        header=make_header(stamp_ns, "lidar"),
        height=1,
        width=len(rows),
        fields=[make("sensor_msgs/msg/PointField", *each, 1) for each in names],
        is_bigendian=False,
        point_step=rows.itemsize,
        row_step=rows.nbytes,
        data=rows.view(np.uint8).reshape(-1),
        is_dense=True,
    )


def measure_clouds(folder: Path, rounds: int, clouds: int = 300) -> list[Row]:
    """Build maps of clouds with one thread and with two, in this process and in ones of their own.

    Points a second, time against copying the same bytes, two threads against one, and memory.
    """
    log, points = write_clouds(folder, clouds), clouds * RINGS * AZIMUTHS
    runs = {
        str(jobs): partial(build, [log], BuildOptions(jobs=jobs), [folder / "clouds.pgm"])
        for jobs in (1, 2)
    }
    copies = {"copy": partial(shutil.copyfile, log, folder / "copy.mcap")}
    times = time_in_turn({**runs, **copies}, rounds)
    what = "clouds, MCAP to map"
    return [
        tell_speed(times, points),
        compare(times, ("1", "copy"), f"{what} / copying the file", COPY_LIMIT),
        compare(times, ("2", "1"), f"{what}: two threads / one", THREADS_LIMIT),
        compare_memory(folder, log, clouds),
    ]


def tell_speed(times: Times, points: int) -> Row:
    """What a point costs, of the shortest time, which a busy machine spoils least."""
    best = min(times.seconds["1"])
    detail = f"{points / best / 1e6:.1f} million points a second, {times.median('1'):.2f} s"
    return Row(
        "clouds, MCAP to map, one thread (ns a point)", NS_LIMIT, 1e9 * best / points, detail
    )


def compare_memory(folder: Path, log: Path, clouds: int) -> Row:
    """Peak memory of three times the clouds of the same place."""
    (folder / "more").mkdir()
    logs = {"more": write_clouds(folder / "more", 3 * clouds), "few": log}
    peaks = {name: measure_peak(each, folder) for name, each in logs.items()}
    detail = " / ".join(f"{peak / 2**20:.0f}" for peak in peaks.values()) + " MiB"
    ratio = peaks["more"] / peaks["few"] if math.isfinite(peaks["few"]) else None
    return Row("clouds: memory for 3 x the clouds", MEMORY_LIMIT, ratio, detail)


def measure_peak(log: Path, folder: Path) -> float:
    """Peak memory of a build in a process of its own (bytes)."""
    return run([OCCMAP, "build", log, "-o", folder / "peak.pgm", "--json"]).peak_bytes
