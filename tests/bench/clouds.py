"""Clouds of a 3D lidar, 64 rings x 1024 ten times a second: what a map of them costs."""

import shutil
from functools import partial
from pathlib import Path

import numpy as np

from occmap.options import BuildOptions
from occmap.pipeline import build
from tests.bench.limits import Row, compare, divide
from tests.bench.measuring import Times, time_in_turn
from tests.bench.processes import OCCMAP, run
from tests.bench.workloads import START_NS
from tests.clouds.simulation import Room, list_rays
from tests.samples import import_generator

RINGS, AZIMUTHS = 64, 1024
SWEEP_NS = 100_000_000
hall, formats = import_generator("hall"), import_generator("formats")
CEILING = (-0.3, 10.3, -0.3, 6.3, 2.8, 2.9)
ROOM = Room([CEILING, (3.0, 4.0, 4.5, 5.0, 0.7, 0.8), (5.0, 5.3, 1.5, 1.8, 0, 0.2)], slope=0.06)
NS_LIMIT = 1e9 / 15e6
"""15 million points a second (ns a point)"""
COPY_LIMIT, THREADS_LIMIT, MEMORY_LIMIT = 8.0, 0.6, 1.05


def write_clouds(folder: Path, clouds: int) -> Path:
    """Write a drive as an MCAP file: through a room and back in 30 clouds each, again and again."""
    rays = list_rays(RINGS, AZIMUTHS)
    x = np.linspace(0.8, 9.2, 30)
    sensors = np.column_stack([x, np.full(30, 3.03), 0.6 + ROOM.floor(x)])
    seen = [(ROOM.cast(sensor, rays) - sensor).astype(np.float32) for sensor in sensors]
    at = [abs((number + 29) % 58 - 29) for number in range(clouds)]
    stamps = [START_NS + number * SWEEP_NS for number in range(clouds)]
    place = sensors[at] - [0, 0, hall.SENSOR_HEIGHT]
    turn = np.tile(np.eye(3), (clouds, 1, 1))
    log = folder / f"clouds_{clouds}.mcap"
    formats.write_clouds(hall.CloudDrive(stamps, place, turn, [seen[each] for each in at]), log)
    return log


def measure_clouds(folder: Path, clouds: int = 300) -> list[Row]:
    """Build maps of clouds with one thread and with two, in this process and in ones of their own.

    Points a second, time against copying the same bytes, two threads against one, and memory.
    """
    log, points = write_clouds(folder, clouds), clouds * RINGS * AZIMUTHS
    runs = {
        str(jobs): partial(build, [log], BuildOptions(jobs=jobs), [folder / "clouds.pgm"])
        for jobs in (1, 2)
    }
    copies = {"copy": partial(shutil.copyfile, log, folder / "copy.mcap")}
    times = time_in_turn({**runs, **copies})
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
    """Peak memory of three times the clouds of the same place, in processes of their own."""
    more, few = (
        run([OCCMAP, "build", each, "-o", folder / "peak.pgm", "--json"]).peak_bytes
        for each in (write_clouds(folder, 3 * clouds), log)
    )
    return divide("clouds: memory for 3 x the clouds", MEMORY_LIMIT, more, few, "MiB")
