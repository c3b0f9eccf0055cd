"""Who keeps the walls and loses the people: `python -m tests.bench.people`.

A robot drives through the office of the sample logs, once or several times, with rough poses and
a glass front that reflects every fourth beam; people walk about, or boxes stand there on the first
visit only. The same drive without them says what stands. Two shares, as benchmarks of dynamic
points have them: of the cells that are occupied without people, those that stay; and of the cells
that only people were hit in, those that are not occupied.
"""

import math
import sys
import tempfile
from collections.abc import Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from occmap.evidence import find_lasting, paint_box, to_grid
from occmap.options import BuildOptions
from occmap.pipeline import build
from occmap.types import Float64
from tests.bench.tables import draw
from tests.samples import import_generator

office, drive, formats = map(import_generator, ("office", "drive", "formats"))
BEAMS, REACH_M, STEP_S, VISIT_S = 271, 8.0, 0.2, 3600.0
BEARINGS = np.radians(np.arange(BEAMS) - 135.0)
BOXES = [(-2.9, -2.2), (0.9, 1.8), (-3.2, 8.0), (3.0, 8.2), (4.6, -2.4), (7.2, 1.8), (11.2, -2.2)]
RADIUS_M = 0.22
"""Of a person, or a box"""


class Scene(NamedTuple):
    """Who is there, and how often the robot comes."""

    visits: int
    people: int = 0
    """They walk, and stand for a while, on every visit"""
    boxes: bool = False
    """They stand at the walls on the first visit"""


SCENES = {
    "six people, one visit": Scene(1, people=6),
    "six people, two visits": Scene(2, people=6),
    "boxes on the first of two visits": Scene(2, boxes=True),
    "boxes on the first of three visits": Scene(3, boxes=True),
}


class Fate(NamedTuple):
    """What became of the cells."""

    kept: float
    """Share of what stands that is occupied"""
    removed: float
    """Share of what only people were hit in that is not"""


def walk(way: Float64, steps: int, rng: np.random.Generator) -> Float64:
    """(N, 2) where a person is who goes up and down a way, and now and then stands for a while."""
    corners = np.append(0, np.cumsum(np.hypot(*np.diff(way, axis=0).T)))
    stands = np.repeat(rng.random(steps // 50 + 1) < 0.3, 50)[:steps]
    gone = rng.uniform(0, corners[-1]) + np.cumsum(~stands * rng.uniform(0.5, 1.4) * STEP_S)
    at = corners[-1] - np.abs(gone % (2 * corners[-1]) - corners[-1])
    aside = rng.normal(0, 0.25, 2)
    return np.column_stack([np.interp(at, corners, way[:, axis]) + aside[axis] for axis in (0, 1)])


def record(scene: Scene, folder: Path, seed: int = 7) -> list[Path]:
    """Write the drive without people, and with them, from the same poses."""
    faces, rng = office.office_faces(), np.random.default_rng(seed)
    glass = np.array([face for box in office.GLASS for face in office.box_faces(box)])
    places = np.array(list(drive._places_along(office.WAY)))
    stamps, poses, alone, people = [], [], [], []
    for visit in range(scene.visits):
        # Half of the visits go the other way; poses drift by decimetres, and shake.
        order = places if visit % 2 == 0 else np.add(places[::-1], (0, 0, math.pi))
        drift = np.cumsum(rng.normal(0, [0.004, 0.004, 0.0006], places.shape), axis=0)
        drift -= np.linspace(0, 1, len(places))[:, None] * drift[-1]
        rough = order + drift + rng.normal(0, [0.008, 0.008, 0.002], places.shape)
        poses += [drive.Planar(*pose) for pose in rough.tolist()]
        there = [walk(office.WAY, len(places), rng) for _ in range(scene.people)]
        if scene.boxes and visit == 0:
            there += [np.tile(box, (len(places), 1)) for box in BOXES]
        for step, (x, y, yaw) in enumerate(order):
            cast = partial(office.cast_rays, (x, y), yaw + BEARINGS)
            stands, shine = cast(faces, office.PILLAR), cast(glass, (1e6, 1e6, 0.1))
            stands = np.where(rng.random(BEAMS) < 0.25, np.minimum(stands, shine), stands)
            circles = [(*each[step], RADIUS_M) for each in there]
            far = [each for each in circles if math.dist(each[:2], (x, y)) > RADIUS_M + 0.3]
            met = [cast(np.zeros((0, 4)), each) for each in far]
            noise = rng.normal(0, 0.01, BEAMS)
            stamps.append(round(1e9 * (visit * VISIT_S + step * STEP_S)))
            alone.append(stands + noise)
            people.append(np.min([stands, *met], axis=0) + noise)
    sensor = drive.Sensor(BEAMS, float(BEARINGS[0]), math.radians(1), 0.0, REACH_M, 0)
    logs = [folder / "alone.csv", folder / "people.csv"]
    for log, ranges in zip(logs, map(np.array, (alone, people)), strict=True):
        seen = np.where(ranges < REACH_M, ranges, np.inf)
        formats.write_csv(drive.Drive(stamps, poses, seen, sensor), log)
    return logs


def judge(scene: Scene, folder: Path, rules: Mapping[str, BuildOptions]) -> dict[str, Fate]:
    """Map a scene by some rules, which differ in what they make of the same evidence."""
    logs, fates = record(scene, folder), {}
    for name, options in rules.items():
        plain = replace(options, min_passes=None)
        alone, people = (build([log], plain, [log.with_suffix(".npz")]) for log in logs)
        box = alone.map.box.join(people.map.box)
        stands = paint_box(to_grid(alone.evidence), options.model, box).occupied
        (met, _), (hit, _) = (to_grid(of.evidence).gather(box, np.int64) for of in (alone, people))
        ghosts = (hit > 0) & office._erode(~stands & (met == 0))  # not beside what stands
        _, lasting = find_lasting(people.evidence, options.min_passes)
        occupied = paint_box(lasting, options.model, box).occupied
        fates[name] = Fate(float(occupied[stands].mean()), 1 - float(occupied[ghosts].mean()))
    return fates


def main(scenes: Mapping[str, Scene] = SCENES, **changes: Any) -> None:
    """Print a table: of each rule and scene, the shares of what is kept and what is removed."""
    default = BuildOptions(jobs=1, **changes)
    rules = {
        "default": default,
        "--min-passes 2": replace(default, min_passes=2),
        "--min-passes 2 --pass-gap 2": replace(default, min_passes=2, pass_gap_s=2.0),
    }
    columns = []
    for scene in scenes.values():
        with tempfile.TemporaryDirectory() as folder:
            columns.append(judge(scene, Path(folder), rules))
    rows = [
        (name, *(f"{100 * of[name].kept:.1f} / {100 * of[name].removed:.1f}" for of in columns))
        for name in rules
    ]
    sys.stdout.write(draw(("kept / removed (%)", *scenes), rows))


if __name__ == "__main__":
    main()
