"""What a user should know of a build and its map, beside numbers."""

import math
from collections import Counter
from collections.abc import Iterator, Sequence
from pathlib import Path

from occmap.options import BuildOptions
from occmap.report.results import LEAST_AGREEMENT, MapFacts
from occmap.scans.mounts import list_misfits
from occmap.scans.tally import LeftOut, Tally
from occmap.sensor.models import Clamped, SensorModel, find_decision
from occmap.types import Update
from occmap.writers import WriteOptions
from occmap.writers.outputs import list_idle

LONGEST_LOG_S = 1e8
"""Three years: a time that is later is a date."""
LEAST_GROUND = 0.05
"""Of the points that are ground or obstacles; where a sensor looks along a floor it is a quarter"""
LEAST_OBSTACLES = 0.001
"""Of all points of clouds; with fewer in the robot's band, the band is hardly meant"""


def list_notes(
    paths: Sequence[Path],
    options: BuildOptions,
    outputs: Sequence[Path],
    tally: Tally,
    facts: MapFacts,
) -> Iterator[str]:
    """Say what a user should know of the options, the logs and the map of a build."""
    yield from list_idle(outputs, options.writing)
    yield from list_unreached(options.model, options.writing)
    yield from options.list_idle()
    if options.resume_if_there and not options.resume_if_there.exists():
        yield f"{options.resume_if_there}: no such file, so this build adds to nothing"
    end_s = options.selection.end_s
    if end_s < math.inf and (end_s > LONGEST_LOG_S or str(LeftOut.TIME) not in tally.dropped):
        yield f"`end_s={end_s:.12g}` leaves nothing out: it is in seconds after the first scan"
    for log, times in Counter(map(str, paths)).items():
        if times > 1:
            yield f"{log}: given {times} times, and counted as often"
    yield from list_frames(tally)
    # Evidence that the logs are added to may have walls; clouds have no beams.
    if not tally.beams.hit and options.update is not Update.CLOUD:
        lack = "of the logs hit" if facts.has_walls else "hit"
        end = "" if facts.has_walls else ", so the map has no walls"
        yield f"no beam {lack} anything{end}: see the ranges in `occmap check`"
    points = tally.points
    if points and points["obstacle"] < LEAST_OBSTACLES * sum(points.values()):
        yield (
            f"hardly a point lies in the robot's band: {points['obstacle']:,} of "
            f"{sum(points.values()):,}; see `min_height`, `max_height` and the line `points`"
        )
    if points and points["ground"] < LEAST_GROUND * (points["ground"] + points["obstacle"]):
        yield (
            f"hardly a point lies on the ground: {points['ground']:,} beside "
            f"{points['obstacle']:,} of obstacles; `occmap check` says if a mount is wrong"
        )
    yield from list_disagreement(facts)
    yield from list_misfits(paths, options, facts.agreement, tally)


def list_frames(tally: Tally) -> Iterator[str]:
    """Say that logs are mapped in frames of different names, which may lie anywhere."""
    first: dict[str, str] = {}
    for log, frame in tally.frames.items():
        if frame:
            first.setdefault(frame, log)
    if len(first) > 1:
        named = ", ".join(f"{log} in {frame}" for frame, log in first.items())
        yield (
            f"the logs are mapped in different frames: {named}; where these do not lie on each "
            "other, choose one with `map_frame`, or build each log alone with its own `transform` "
            "and merge them"
        )


def list_disagreement(facts: MapFacts) -> Iterator[str]:
    """Say that the scans of a map contradict each other."""
    agreement = facts.agreement
    if agreement is not None and agreement < LEAST_AGREEMENT and facts.has_walls:
        yield (
            f"only {agreement:.0%} of the hits lie in cells that the map calls occupied: the "
            "poses do not fit the scans; see `occmap check`, try `occmap tune`, another "
            "`time_offset_s` or another trajectory"
        )


def list_unreached(model: SensorModel, writing: WriteOptions) -> Iterator[str]:
    """Say which class no cell can have, because of the bounds of the model."""
    if not isinstance(model, Clamped):
        return
    free, occupied = writing.decide(find_decision(model))
    if model.clamp_max <= occupied:
        yield f"no cell can be occupied: clamp_max {model.clamp_max:g} is not above {occupied:g}"
    if model.clamp_min >= free:
        yield f"no cell can be free: clamp_min {model.clamp_min:g} is not below {free:g}"
