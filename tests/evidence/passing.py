"""A robot that drives down a corridor again and again, past thin walls and, once, a person."""

import math
from pathlib import Path
from typing import NamedTuple

import numpy as np

from tests.csv_logs import write_scans
from tests.samples import import_generator

office = import_generator("office")
BEAMS, FIRST, STEP = 80, -19.75, 0.5
"""Degrees: a narrow view ahead, in which no beam runs along a wall."""
BEARINGS = np.radians(FIRST + STEP * np.arange(BEAMS))
WALLS_Y = (-0.42, 0.42)
"""In the rows of cells from -0.45 and from 0.4 m, in cells of 5 cm. The sensor looks ahead, so all
beams come in flat and cross some cells of the row before they end."""
LENGTH = 6.0
"""From x = 0 (m); the corridor is open at both ends."""
WALLS = np.array([(0, y, LENGTH, y) for y in WALLS_Y])
STEP_S, STEP_M = 0.4, 0.15
PASS_S = 60.0
RADIUS = 0.15


class Person(NamedTuple):
    """Walks along the corridor's axis, or stands."""

    on_pass: int
    x: float
    y: float
    speed: float

    def at(self, seconds: float) -> tuple[float, float]:
        return self.x + self.speed * seconds, self.y


def write_passes(path: Path, passes: int, person: Person) -> Path:
    steps = np.arange(int(LENGTH / STEP_M))
    stamps, places, ranges = [], [], []
    for index in range(passes):
        for x, seconds in zip(steps * STEP_M, steps * STEP_S, strict=True):
            at = person.at(seconds) if index == person.on_pass else (1e6, 1e6)
            stamps.append(index * PASS_S + seconds)
            places.append((x, 0.0, 0.0))
            ranges.append(office.cast_rays((x, 0.0), BEARINGS, WALLS, (*at, RADIUS)))
    first, step = math.radians(FIRST), math.radians(STEP)
    shape = {"angle_min": first, "angle_increment": step, "range_max": 1e6}
    return write_scans(path, stamps, ranges, places, **shape)
