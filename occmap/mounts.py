"""The mount of a laser: guessed from the scans where a log lacks it or has it wrong."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import reduce
from pathlib import Path

import numpy as np

from occmap.command import format_mount, format_static
from occmap.errors import MountError, PoseError
from occmap.opening import choose_topics, make_poser
from occmap.options import BuildOptions
from occmap.posing.attach import Poser
from occmap.posing.conventions import list_bases
from occmap.posing.frames import Step
from occmap.posing.rotations import rotate_by
from occmap.readers import Log, open_log, read_poses
from occmap.sampling import encode_cells, sample_scans
from occmap.sensor.returns import ReturnOptions, interpret
from occmap.types import Float64, Kind, Pose, PosedScans

MOUNT_CELL_M = 0.1
MOUNT_YAWS = (0.0, math.pi / 2, math.pi, -math.pi / 2)
UNTURNED = Pose.planar(0.0, 0.0, 0.0)
CLEAR_WIN = 0.9
"""The right mount lays the walls of many scans over each other: it marks fewer cells than this
share of what any other one marks."""


def name_mount(
    log: Log, topics: Sequence[str], options: BuildOptions, error: MountError
) -> PoseError:
    """Name the mount that suits the scans in the error that it is missing, where one does."""
    trial = replace(options, posing=replace(options.posing, sensor_pose=UNTURNED))
    poser = Poser.build(read_poses(log), trial.posing)
    try:
        mount = guess_mount(sample_scans(log, topics, poser, trial), options.returns)
    except PoseError:
        return error
    return error.named(format_mount(mount)) if mount else error


def list_misfits(paths: Sequence[Path], options: BuildOptions) -> Iterator[str]:
    """Say which lasers of logs, whose scans do not fit each other, are better mounted otherwise.

    The logs are read once more: this is for maps that are spoiled anyway.
    """
    for path in paths:
        log = open_log(path, options.reading)
        topics = choose_topics(log, options.selection.topics)
        poser = make_poser(log, topics, options.posing)
        parts = sample_scans(log, topics, poser, options)
        for topic in topics:
            mine = [part for part in parts if part.batch.topic == topic]
            if better := find_better(poser, mine, options.returns):
                yield f"{log.path}: {topic}: {describe_misfit(better)}"


def find_better(poser: Poser, parts: Sequence[PosedScans], options: ReturnOptions) -> str:
    """Find the option, with its value, by which the scans of a sensor fit clearly better.

    Returns
    -------
    str
        Such as "sensor_pose=0,0,3.14159"; "" where they fit as they are.
    """
    turn = guess_mount(parts, options)
    if turn is None or turn == UNTURNED:
        return ""
    return correct_mount(poser, parts[0].batch.frame, turn)


def describe_misfit(better: str) -> str:
    """Say which mount suits the scans better."""
    option, _, value = better.partition("=")
    return f"the scans would fit each other better with `{option}=({value})`"


def correct_mount(poser: Poser, frame: str, turn: Pose) -> str:
    """Name the option that mounts a sensor turned further than it is, with its value.

    That is `sensor_pose` for a single laser whose body is known, and else a transform in place of
    the last one on the way to the sensor; "" where that one moves, so that nothing is mounted.
    """
    given = poser.options.sensor_pose
    chain = poser.chains.get(frame)
    if given or chain is None:  # None: the poses stand beside the scans
        return f"sensor_pose={format_mount((given or UNTURNED).then(turn))}"
    tree, base = poser.sources.tree, poser.options.base_frame
    bases = [base] if base else list_bases(tree, frame)
    steps = tree.find_path(bases[0], frame) if len(bases) == 1 else None
    if steps and len(poser.chains) == 1 and not any(step.edge.track.moves for step in steps):
        mount = reduce(Pose.then, map(read_pose, steps))
        return f"sensor_pose={format_mount(mount.then(turn))}"
    last = chain.steps[-1]
    if last.edge.track.moves:
        return ""
    return f"static_transforms={format_static(last.upper, frame, read_pose(last).then(turn))}"


def read_pose(step: Step) -> Pose:
    """Where the lower frame of a step that never moves sits in the upper one."""
    track = step.edge.track
    pose = Pose(*track.position[0].tolist(), *track.quaternion[0].tolist())
    return pose.invert() if step.inverted else pose


def guess_mount(parts: Sequence[PosedScans], options: ReturnOptions) -> Pose | None:
    """Guess how a sensor is turned on its body, of the eight ways in which people mount them.

    Parameters
    ----------
    parts
        Scans posed as if the sensor were the body.

    Returns
    -------
    Pose or None
        None where no way of mounting is clearly better than the others.
    """
    mounts = [
        Pose.from_xyzrpy((0.0, 0.0, 0.0), (roll, 0.0, yaw))
        for roll in (0.0, math.pi)
        for yaw in MOUNT_YAWS
    ]
    marked = [count_marked(parts, mount, options) for mount in mounts]
    (best, at), (second, _) = sorted(zip(marked, range(len(mounts)), strict=True))[:2]
    return mounts[at] if 0 < best < CLEAR_WIN * second else None


def count_marked(parts: Sequence[PosedScans], mount: Pose, options: ReturnOptions) -> int:
    """Count the cells that have a hit when the sensor is mounted so."""
    turn = rotate_by(np.array([mount[3:]]))[0]
    hits: list[Float64] = []
    for part in parts:
        rays, _ = interpret(replace(part, rotation=part.rotation @ turn), options)
        hits.append(rays.end[rays.kind == Kind.HIT])
    return len(np.unique(encode_cells(np.concatenate(hits or [np.zeros((0, 2))]), MOUNT_CELL_M)))
