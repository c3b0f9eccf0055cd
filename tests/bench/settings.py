"""What the quality table is made of: the real logs, and the settings that are compared."""

import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

from occmap.choices import list_values, take
from occmap.options import OPTIONS, BuildOptions, choose_model
from occmap.posing import PosingOptions
from occmap.sensor.models import parse_model
from occmap.types import Pose, Update
from tests.samples import REAL_LOGS

DEFAULT = BuildOptions()
PLAIN = replace(DEFAULT, update=Update.BEAM, model=parse_model("simple:spread=0"), hit_offset=0.0)
POLYGON = replace(DEFAULT, update=Update.POLYGON, model=choose_model(Update.POLYGON))
OURS = "occmap, no flags"


class Recording(NamedTuple):
    """A log, and what it does not say itself."""

    path: Path
    posing: PosingOptions = DEFAULT.posing


LOGS = {
    "Intel": Recording(REAL_LOGS / "carmen/intel-corrected.log.gz"),
    "Freiburg 079": Recording(REAL_LOGS / "carmen/freiburg-079-corrected.log.gz"),
    "CSAIL": Recording(REAL_LOGS / "carmen/csail-corrected.log.gz"),
    "robotlaser": Recording(REAL_LOGS / "carmen/fr079-robotlaser.log.gz"),
    "turtlebot": Recording(REAL_LOGS / "ros1/test_turtlebot.bag"),
    "room": Recording(
        REAL_LOGS / "ros1/mylaserdata2.bag", PosingOptions(sensor_pose=Pose.planar(0, 0, math.pi))
    ),
    "floor": Recording(REAL_LOGS / "ros2/macfirst_floor_take_2"),
    "standing": Recording(REAL_LOGS / "ros1/test_replay_crash.bag"),
}
"""Those whose poses are known: a depth camera, a laser that looks all round, raw odometry, and a
robot that stands still among them."""


def list_steps() -> dict[str, BuildOptions]:
    """The way from the plain rule to the default: each step by itself, then together."""

    def simple(parameters: str) -> BuildOptions:
        return replace(PLAIN, model=parse_model(f"simple:{parameters}"))

    return {
        "beam, written from 0.65": simple("spread=0,cut=0.65"),
        "beam, cut at even odds": PLAIN,
        "with hits half a cell out": replace(PLAIN, hit_offset=0.5),
        "with hits spread": simple(""),
        "with surfaces": replace(PLAIN, update=Update.SURFACE),
        "with all three": replace(DEFAULT, model=parse_model("simple")),
        "beam, the default's model": replace(DEFAULT, update=Update.BEAM),
        "polygon": POLYGON,
        OURS: DEFAULT,
    }


def list_neighbours() -> list[dict[str, BuildOptions]]:
    """Settings to compare, the default first in each group."""
    counting = "strength=0.2 hit_weight=2 cut=0.25 cut=0.4 cut=0.5 spread=0 spread=0.04 spread=0.12"
    others = "hit_offset=0 hit_offset=0.25 hit_offset=0.75 hit_offset=1 jump=0.05 jump=0.2 jump=0.4"
    others += " no_return=clear deskew=on"
    of_polygon = "model=counting:cut=0.32,spread=0 model=counting:cut=0.5,spread=0"
    of_polygon += " model=counting:cut=0.4 jump=0.05 jump=0.2"
    of_polygon += " border_gap=0 border_gap=4 border_gap=16"
    models = [f"model=counting:{each}" for each in counting.split()]
    return [
        {OURS: DEFAULT, **vary(DEFAULT, [*models, *others.split()])},
        {"polygon": POLYGON, **vary(POLYGON, of_polygon.split())},
    ]


def vary(base: BuildOptions, changes: Sequence[str]) -> dict[str, BuildOptions]:
    """Options that differ from some in one value, which is their name."""
    pairs = [(change, *change.split("=", 1)) for change in changes]
    return {
        f"{base.update.value}, {change}": take(
            BuildOptions, list_values(base) | {name: OPTIONS[name].read(value)}
        )
        for change, name, value in pairs
    }
