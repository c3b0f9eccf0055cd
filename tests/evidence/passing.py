"""A robot that drives down a corridor again and again, past thin walls and, once, a person."""

import math
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np

from occmap.types import Float64
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


class Look(NamedTuple):
    """One scan: when, from where along the corridor, and what was measured (B,) m."""

    stamp: float
    x: float
    ranges: Float64


class Person(NamedTuple):
    """Walks along the corridor's axis, or stands."""

    on_pass: int
    x: float
    y: float
    speed: float

    def at(self, seconds: float) -> tuple[float, float]:
        return self.x + self.speed * seconds, self.y


def drive(passes: int, person: Person) -> Iterator[Look]:
    for index in range(passes):
        for step in range(int(LENGTH / STEP_M)):
            x, seconds = step * STEP_M, step * STEP_S
            at = person.at(seconds) if index == person.on_pass else (1e6, 1e6)
            ranges = office.cast_rays((x, 0.0), BEARINGS, WALLS, (*at, RADIUS))
            yield Look(index * PASS_S + seconds, x, ranges)


def write_passes(path: Path, passes: int, person: Person) -> Path:
    beams = ",".join(f"r{beam}" for beam in range(BEAMS))
    head = (
        f"# angle_min: {math.radians(FIRST)}\n# angle_increment: {math.radians(STEP)}\n"
        f"# range_max: 1e6\nstamp,x,y,yaw,{beams}\n"
    )
    rows = [
        f"{look.stamp},{look.x},0,0,{','.join(f'{r:.6g}' for r in look.ranges)}\n"
        for look in drive(passes, person)
    ]
    path.write_text(head + "".join(rows))
    return path
