"""Where sensors sit on the robot, and what a sample of their scans tells of that.

A log is opened here, since its scans are asked for the mount of a laser where the log lacks it.
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from functools import reduce
from pathlib import Path
from typing import NamedTuple, TypeAlias

import numpy as np

from occmap.choices import format_mount, format_static, mark_options
from occmap.clouds.mounting import find_seat
from occmap.errors import MountError, PoseError
from occmap.options import BuildOptions
from occmap.posing import Concern
from occmap.posing.attach import Poser
from occmap.posing.chain import Transforms, hold
from occmap.posing.frames import BASE_NAMES, Edge
from occmap.posing.sources import gather
from occmap.readers import Log, open_log
from occmap.scans import encode_cells, estimate_agreement, list_hits
from occmap.scans.logs import look_ahead, read_poser
from occmap.scans.stream import Drive
from occmap.scans.tally import Tally
from occmap.sensor import ReturnOptions, interpret
from occmap.types import IDENTITY, Cloud, Pose, PosedScans, Scan

MOUNT_CELL_M = 0.1
"""Side of the cells in which the hits of a sample are counted (m)"""
TURNS = [
    Pose.from_xyzrpy((0.0, 0.0, 0.0), (roll, 0.0, yaw))
    for roll in (0.0, math.pi)
    for yaw in (0.0, math.pi / 2, math.pi, -math.pi / 2)
]
"""The eight ways in which people mount a laser"""
CLEAR_WIN = 0.9
"""The right mount lays the walls of many scans over each other: it marks fewer cells than this
share of what any other one marks."""
FEWEST_MARKED = 50
"""Fewer cells with hits are too few to tell one turn from another."""
SUSPECT, SUSPECT_OF_SEVERAL = 0.65, 0.9
"""Where less of the hits agree, one of the lasers may be turned. A mirrored laser that sees all
around leaves 0.6, and more where others beside it are right. Real logs of one laser have 0.68 and
more, and are not worth a second look."""
FEW_SCANS = 200
"""In logs of no more scans even a single mirrored laser leaves up to 0.88, as the robot turned
little; those are read again at once. Of 280 pieces of logs none was suspected wrongly."""


class PosePlan(NamedTuple):
    """How the scans of a log are posed, with the options given or with those that would help."""

    poser: Poser
    faults: Mapping[str, PoseError] = {}
    """By frame: why its scans have no pose with the options given"""
    assumed: Pose | None = None
    """The mount that the poser uses though the user did not give it"""
    is_guess: bool = False
    """The assumed mount is a place holder, since the scans do not tell the right one"""


def open_drive(log: Log, options: BuildOptions) -> Drive:
    """Choose the scans of a log, and read its poses, unless it states them beside its scans.

    Raises
    ------
    LogError, UsageError
        As `look_ahead`.
    PoseError
        No scan frame has a chain of transforms to a map frame.
    """
    first = look_ahead(log, options)
    if options.posing.takes_stated(*first):
        return Drive(log, Poser(gather([], options.posing), options.posing), options)
    plan = prepare(log, first, options)
    if plan.faults and plan.poser.fixed is None:
        raise next(iter(plan.faults.values())).placed(log.path)
    return Drive(log, plan.poser, options)


def prepare(log: Log, first: Sequence[Scan | Cloud], options: BuildOptions) -> PosePlan:
    """Find the way to the frames of the first scans; where the mount is missing, guess it.

    Raises
    ------
    PoseError, LogError
        The trajectory that the user chose cannot be used.
    """
    poser = read_poser(log, options.posing, [scan.topic for scan in first])
    frames = {scan.frame for scan in first if not options.posing.takes_stated(scan)}
    faults = poser.find_chains(frames)
    if not faults or len(frames) > 1 or options.posing.sensor_pose is not None:
        return PosePlan(poser, faults)
    at_body = Poser(poser.sources, replace(options.posing, sensor_pose=IDENTITY))
    if at_body.find_chains(frames):  # more than the mount is missing
        return PosePlan(poser, faults)
    # Read the scans as if the sensor were the body, and find the mount that suits them best.
    guess = guess_place(at_body, Drive(log, at_body, options).sample(), options)
    mount, why = guess or (IDENTITY, "")
    ((frame, fault),) = faults.items()
    if guess and isinstance(fault, MountError):
        faults = {frame: fault.named(format_mount(mount), why)}
    posing = replace(options.posing, sensor_pose=mount)
    return PosePlan(Poser(at_body.sources, posing), faults, mount, is_guess=guess is None)


Guess: TypeAlias = tuple[Pose, str]
"""Where a sensor may sit, and what speaks for that"""


def guess_place(poser: Poser, parts: Sequence[PosedScans], options: BuildOptions) -> Guess | None:
    """Guess where the only laser of a log sits.

    That is where tf mounts some frame that no scan is in, or else at the body's origin, turned in
    one of eight ways.

    Parameters
    ----------
    parts
        Its scans, posed as if it were the body.

    Returns
    -------
    Guess or None
        None where nothing is clearly better than all else.
    """
    if parts and parts[0].batch.clouds is not None:
        return guess_by_floor(parts)
    marked = [count_marked(parts, turn, options.returns) for turn in TURNS]
    leaves = list_leaves(poser, parts[0].batch.frame) if parts else {}
    by_leaf = {leaf: count_marked(parts, leaves[leaf], options.returns) for leaf in leaves}
    leaf = min(by_leaf, key=by_leaf.__getitem__, default="")
    known = bool(leaf) and by_leaf[leaf] < CLEAR_WIN * min(marked)
    mount = leaves[leaf] if known else choose_turn(marked)
    if mount is None:
        return None
    agreement = estimate_agreement([mount_scans(part, mount) for part in parts], options)
    share = "" if agreement is None else f": {agreement:.0%} of the hits of a sample agree"
    if known:
        return mount, f"where tf has {leaf!r}, a frame that no scan is in{share}"
    place = "measure x and y, or walls are doubled"
    return mount, f"which suits the scans best of all turns{share}; {place}"


def guess_by_floor(parts: Sequence[PosedScans]) -> Guess | None:
    """Guess how a 3D sensor sits, by the floor that it sees; None where it sees none."""
    if (seat := find_seat(parts)) is None:
        return None
    found = f"by the floor {seat.height:.2f} m below it"
    by_walls = ", and by walls; measure x and y" if seat.has_yaw else "; measure x, y and yaw"
    return seat.mount, f"{found}{by_walls}, or walls are doubled"


def list_leaves(poser: Poser, frame: str) -> dict[str, Pose]:
    """List where frames are mounted on the body of a sensor, if no other frame is below them."""
    tree = poser.sources.tree
    base = poser.options.base_frame or tree.find_base(frame)
    uppers = {base, *(edge.parent for edge in tree.edges)}
    ways = {leaf: tree.find_path(base, leaf) for leaf in tree.frames if leaf not in uppers}
    places = {leaf: place_on(steps) for leaf, steps in ways.items() if steps}
    return {leaf: place for leaf, place in places.items() if place}


def list_misfits(options: BuildOptions, agreement: float | None, tally: Tally) -> Iterator[str]:
    """Say which lasers fit better with another mount, where the hits of a map agree little.

    The logs are then read once more, though not traced.

    Parameters
    ----------
    agreement
        Share of the hits in cells that the map calls occupied.
    tally
        What was counted while the map was made.
    """
    is_trusted = tally.lasers < 2 and tally.scans_read > FEW_SCANS
    if agreement is None or agreement >= (SUSPECT if is_trusted else SUSPECT_OF_SEVERAL):
        return
    for path in tally.logs:
        drive = open_drive(open_log(Path(path), options.reading), options)
        parts = drive.sample()
        for topic in drive.topics:
            mine = [part for part in parts if part.batch.topic == topic]
            if better := find_better_mount(drive, mine):
                yield f"{path}: {topic}: {better.text}"


def find_better_mount(drive: Drive, parts: Sequence[PosedScans]) -> Concern | None:
    """Find the mount by which the scans of a sensor fit clearly better, and say how well.

    None where they fit as they are, or nothing is mounted.
    """
    turn = choose_turn([count_marked(parts, turn, drive.options.returns) for turn in TURNS])
    if turn is None or turn == IDENTITY:
        return None
    if (mount := find_mount(drive.poser, parts[0].batch.frame)) is None:
        return None
    mended = mount.write(turn_mount(mount.pose, turn))
    text = f"the scans would fit each other better with {mark_options(mended)}"
    agreement = estimate_agreement([mount_scans(part, turn) for part in parts], drive.options)
    if agreement is not None and agreement < SUSPECT:
        text += f", by which {agreement:.0%} of the hits agree: the poses may be wrong, too"
    return Concern(text, mended)


class Mount(NamedTuple):
    """How a sensor is mounted, and how another mount is given in its place."""

    pose: Pose
    frames: tuple[str, str] | None = None
    """Of the transform by which it is given; None: by `sensor_pose`"""

    def write(self, pose: Pose) -> dict[str, str]:
        """The option, with its value, for a mount."""
        if self.frames:
            return {"static_transforms": format_static(*self.frames, pose)}
        return {"sensor_pose": format_mount(pose)}


def find_mount(poser: Poser, frame: str, *, in_3d: bool = False) -> Mount | None:
    """Find how a sensor is mounted; None where it moves, so that nothing is.

    Another mount is given as `sensor_pose` for a single laser whose body is known, and else as a
    transform in place of the last one on the way to the sensor: that keeps its height, too.
    """
    given, chain = poser.options.sensor_pose, poser.chains.get(frame)
    if given or chain is None:  # None: the poses stand beside the scans
        return Mount(given or IDENTITY)
    tree, is_alone = poser.sources.tree, len(poser.chains) == 1
    base = poser.options.base_frame or tree.find_base(frame)
    if frame not in tree:  # the poses were taken as the sensor's own
        return Mount(IDENTITY, None if is_alone else (base or BASE_NAMES[0], frame))
    steps = tree.find_path(base, frame)
    if steps and is_alone and not in_3d and (mount := place_on(steps)):
        return Mount(mount)
    if not chain.steps or (mount := place_on(chain.steps[-1:])) is None:
        return None
    return Mount(mount, (chain.steps[-1].parent, frame))


def place_on(steps: Sequence[Edge]) -> Pose | None:
    """Find where the last frame of some steps sits in the first; None where one of them moves."""
    if any(step.track.moves for step in steps):
        return None
    return reduce(Transforms.then, map(hold, steps)).first


def turn_mount(mount: Pose, turn: Pose) -> Pose:
    """Turn a sensor further than it is mounted."""
    return Transforms.fixed(mount).then(Transforms.fixed(turn)).first


def choose_turn(marked: Sequence[int]) -> Pose | None:
    """Choose the turn by which the fewest cells have a hit, if it is clearly better."""
    (best, at), (second, _) = sorted(zip(marked, range(len(TURNS)), strict=True))[:2]
    return TURNS[at] if FEWEST_MARKED <= best < CLEAR_WIN * second else None


def count_marked(parts: Sequence[PosedScans], mount: Pose, options: ReturnOptions) -> int:
    """Count the cells that have a hit when the sensor is mounted so."""
    seen = (interpret(mount_scans(part, mount), options)[0] for part in parts)
    return len(np.unique(encode_cells(list_hits(seen), MOUNT_CELL_M)))


def mount_scans(part: PosedScans, mount: Pose) -> PosedScans:
    """Place a sensor on its body; so far its scans are posed as if it were the body."""
    sensor = Transforms.fixed(mount)
    position = part.position + part.rotation @ sensor.position[0]
    return PosedScans(part.batch, position, part.rotation @ sensor.rotation[0])
