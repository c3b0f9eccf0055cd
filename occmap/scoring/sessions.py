"""Where the map frame of one session lies in that of another, by the walls that both saw."""

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from occmap.cells import Evidence
from occmap.choices import format_mount
from occmap.errors import PoseError
from occmap.evidence import render, to_grid
from occmap.options import BuildOptions
from occmap.readers import open_log
from occmap.scans.mounts import open_drive, sample_scans
from occmap.scoring.fit import REACH_M, Match, Transform, Walls, fit
from occmap.sensor import interpret
from occmap.types import IDENTITY, Float64, Kind, Pose, Update


def find_transform(
    paths: Sequence[Path], options: BuildOptions, past: Evidence
) -> tuple[Pose, str]:
    """Find the `transform` by which the walls of logs lie on those of evidence, and say so.

    Raises
    ------
    OccmapError
        A log cannot be read, or it is not sure where they lie.
    """
    fix = "give the `transform` and leave `fit` out"
    if past.manifest.update == Update.CLOUD:
        raise PoseError("`fit` takes scans of planar lasers, not clouds", where=past.where, fix=fix)
    grid = render(to_grid(past), options.model, options.max_cells)
    walls = Walls.of(grid.occupied, np.array(grid.origin), grid.resolution, REACH_M)
    hits = list_hits(paths, options)
    found = fit(hits, walls) if len(hits) else Match(Transform(0.0, 0.0, 0.0), 0.0, 0.0)
    told = (
        f"{found.share:.0%} of their hits lie on its walls, and {found.rival:.0%} at the best "
        "other place"
    )
    logs = ", ".join(map(str, paths))
    if not found.is_sure:
        text = f"it is not sure where {logs} lie on it: {told}"
        raise PoseError(text, where=past.where, fix=fix)
    if found.transform.is_far(walls.pivot):
        text = f"{logs} may lie on it best beyond what is searched: {told}"
        raise PoseError(text, where=past.where, fix="try again with a first `transform`")
    moved = turn_back(found.transform, options).after(options.posing.transform or IDENTITY)
    given = format_mount(Pose.planar(*moved))
    pose = Pose.planar(*map(float, given.split(",")))  # the one that the user may type
    return pose, f"{past.where}: {logs} fit it with `transform=({given})`: {told}"


def list_hits(paths: Sequence[Path], options: BuildOptions) -> Float64:
    """(N, 2) where a map would have the hits of some scans of all logs (m)."""
    hits, deeper = [np.zeros((0, 2))], np.float32(options.hit_offset * options.resolution)
    for path in paths:
        drive = open_drive(open_log(path, options.reading), options)
        for part in sample_scans(drive.log, drive.topics, drive.poser, options):
            rays, _ = interpret(part, options.returns)
            end = rays._replace(distance=rays.distance + deeper).end
            hits.append(end[rays.kind == Kind.HIT])
    return np.concatenate(hits)


def turn_back(moved: Transform, options: BuildOptions) -> Transform:
    """Find what does the same before a map is turned by `align`."""
    align = math.radians(options.posing.align or 0.0)
    x, y = Transform(0.0, 0.0, -align).move(np.array([moved.x, moved.y])).tolist()
    return Transform(x, y, moved.yaw)
