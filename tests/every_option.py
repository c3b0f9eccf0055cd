"""Every option of a build, as a notebook gives it, and the value that it is."""

import math
import os
from pathlib import Path
from typing import Any

import numpy as np

from occmap.posing import Deskew, Stamps
from occmap.readers import Echo
from occmap.sensor import NoReturn
from occmap.sensor.models import SimpleModel
from occmap.types import Pose, PoseSample, Update
from occmap.writers import MapMode, Shade

HALF = math.sqrt(0.5)

GIVEN: dict[str, dict[str, tuple[Any, Any]]] = {
    "": {
        "resolution": (1, 1.0),
        "update": ("beam", Update.BEAM),
        "model": ("simple:cut=0.4", SimpleModel(cut=0.4)),
        "hit_offset": (0.25, 0.25),
        "jump": (np.float32(0.5), 0.5),
        "border_gap": (np.int64(3), 3),
        "max_cells": (1000, 1000),
        "min_passes": (2, 2),
        "pass_gap_s": (30, 30.0),
        "resume_if_there": ("a.npz", Path("a.npz")),
        "resume": ("a.npz", Path("a.npz")),
        "jobs": (1, 1),
        "fit": (True, True),
    },
    "returns": {
        "min_range": (0.5, 0.5),
        "max_range": (6, 6.0),
        "range_max": (30, 30.0),
        "no_return": ("clear", NoReturn.CLEAR),
        "ignore_sectors": ([[2.5, -2.5]], ((2.5, -2.5),)),
        "footprint": (np.array([-1, -1, 1, 1]), (-1.0, -1.0, 1.0, 1.0)),
    },
    "selection": {
        "topics": ("/scan", ("/scan",)),
        "start_s": (5, 5.0),
        "end_s": (5, 5.0),
        "stride": (2, 2),
    },
    "reading": {"echo": ("last", Echo.LAST)},
    "clouds": {
        "min_height": (0.2, 0.2),
        "max_height": (1, 1.0),
        "range_margin": (0, 0.0),
        "ground": ("flat", "flat"),
        "sensor_height": (1, 1.0),
        "own_points": ("off", {}),
    },
    "posing": {
        "poses": (Path("poses.tum"), "poses.tum"),
        "sensor_pose": ((1, 2, 0, math.pi / 2, 0), Pose(1.0, 2.0, 0.0, HALF, 0.0, 0.0, HALF)),
        "static_transforms": (
            [("a", "b", 1, 2, 3, 0, 0, math.pi / 2)],
            (PoseSample(0, "a", "b", Pose(1, 2, 3, 0, 0, HALF, HALF), static=True),),
        ),
        "map_frame": ("map", "map"),
        "transform": ((1, 2, math.pi / 2, 3), Pose(1.0, 2.0, 3.0, 0.0, 0.0, HALF, HALF)),
        "align": (None, None),
        "level": ([2, -1.5], (2.0, -1.5)),
        "height_drift": ("off", {}),
        "base_frame": ("base", "base"),
        "max_pose_gap_s": (None, None),
        "max_speed": (2, 2.0),
        "time_offset_s": (-1, -1.0),
        "stamps": ("record", Stamps.RECORD),
        "deskew": ("auto", Deskew.AUTO),
    },
    "framing": {"extent": ([0, 0, 2, 1], (0.0, 0.0, 2.0, 1.0)), "margin": (2, 2.0)},
    "writing": {
        "mode": ("scale", MapMode.SCALE),
        "occupied_thresh": (0.9, 0.9),
        "free_thresh": (0.1, 0.1),
        "shade": ("light", Shade.LIGHT_OCCUPIED),
        "edits": (os.devnull, Path(os.devnull)),  # a file without a shape
        "georeference": ([52.5, 13.4, -9], (52.5, 13.4, -9.0)),
    },
}
"""Options by their groups, each as a notebook gives it, and the value that it is"""
EVERY = [(group, name, *values) for group, them in GIVEN.items() for name, values in them.items()]
