"""What a few hundred posed scans, spread over a log, tell of what a user left open.

That is the mount of a laser, where a log lacks it or has it wrong, and the turn that brings the
walls of a map along its axes. nav2 and others ignore the yaw of the origin in a map's YAML, so a
building that lies askew in its map stays so. Turning the poses before anything is traced costs no
cell its sharpness.
"""

import math
from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from functools import reduce
from pathlib import Path
from typing import NamedTuple

import numpy as np

from occmap.choices import format_mount, format_static
from occmap.clouds.mounting import CLOUDS, find_seat
from occmap.errors import MapError, MountError, PoseError
from occmap.evidence import render
from occmap.options import BuildOptions
from occmap.posing import Concern
from occmap.posing.attach import Poser
from occmap.posing.chain import Transforms, hold
from occmap.posing.frames import BASE_NAMES, Edge
from occmap.posing.sources import gather
from occmap.readers import Log, open_log
from occmap.scans import make_engine
from occmap.scans.logs import count_scans, look_ahead, read_poser
from occmap.scans.stream import Drive
from occmap.scans.tally import Tally
from occmap.sensor import ReturnOptions, interpret
from occmap.sensor.models import CountingModel
from occmap.types import IDENTITY, Cloud, Float64, Int64, Kind, Pose, PosedScans, Rays, Scan

SAMPLE_SCANS = 300
"""About so many scans of each topic are kept, spread evenly over the log."""
MAX_SAMPLE_BEAMS = 1 << 19
"""No more scans are kept once their beams are so many: this bounds the memory."""
MOST_CELLS = 10**8
"""The largest map that is made of a sample"""


class Sample:
    """Takes every n-th scan of one topic that a drive reads; n follows from how many it has.

    Of a part of a log every scan is taken: how many lie between two times is not known before they
    are read.
    """

    def __init__(self, drive: Drive) -> None:
        self.parts: list[PosedScans] = []
        selection = drive.options.selection
        is_part = math.isfinite(selection.start_s) or math.isfinite(selection.end_s)
        of_topic = count_scans(drive.log, drive.topics) // len(drive.topics)
        self._expected = 0 if is_part else of_topic // selection.stride
        self._seen = 0
        self._beams = 0

    def take(self, posed: PosedScans) -> None:
        """Take scans of a batch."""
        scans, beams = posed.batch.ranges.shape
        most = SAMPLE_SCANS
        if posed.batch.clouds is not None:  # which have no beams, and take more memory
            most, beams = CLOUDS, MAX_SAMPLE_BEAMS // (2 * CLOUDS)
        every = max(self._expected // most, 1)
        rows = np.arange(-self._seen % every, scans, every)
        self._seen += scans
        if len(rows) and self._beams < MAX_SAMPLE_BEAMS:
            self._beams += len(rows) * beams
            self.parts.append(posed.take(rows))


def sample_scans(drive: Drive) -> list[PosedScans]:
    """Pose some of the scans that a build uses, spread evenly over a log."""
    for _ in drive.rounds():  # the second time without scans that leap away
        samples: defaultdict[str, Sample] = defaultdict(lambda: Sample(drive))
        for posed in drive.read(Tally()):
            samples[posed.batch.topic].take(posed)
    return [part for sample in samples.values() for part in sample.parts]


def sample_rays(paths: Sequence[Path], options: BuildOptions) -> Iterator[Rays]:
    """Interpret some scans of all logs, spread evenly over each.

    Raises
    ------
    OccmapError
        A log cannot be read, or has no scans or no poses.
    """
    for path in paths:
        for part in sample_scans(open_drive(open_log(path, options.reading), options)):
            yield interpret(part, options.returns)[0]


def estimate_agreement(parts: Sequence[PosedScans], options: BuildOptions) -> float | None:
    """Estimate the share of hits that lie in cells which the map of a log calls occupied.

    Returns
    -------
    float or None
        None where the sample makes no map, or one too large to be made in passing.
    """
    engine = make_engine(replace(options, model=CountingModel(), max_cells=MOST_CELLS))
    try:
        for part in parts:
            engine.add(interpret(part, options.returns)[0])
        return render(engine.finish(), CountingModel(), MOST_CELLS).agreement
    except MapError:
        return None


def encode_cells(points: Float64, cell: float) -> Int64:
    """Number the cells (...,) of a size (m) that points (..., 2) are nearest to."""
    cells = np.rint(np.clip(points / cell, -(2**30), 2**30)).astype(np.int64)
    return np.asarray((cells[..., 0] << 32) + cells[..., 1])


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


class Posing(NamedTuple):
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
    if options.posing.poses is None and all(scan.pose is not None for scan in first):
        return Drive(log, Poser(gather([], options.posing), options.posing), options)
    posing = prepare(log, first, options)
    if posing.faults and posing.poser.fixed is None:
        raise next(iter(posing.faults.values())).placed(log.path)
    return Drive(log, posing.poser, options)


def prepare(log: Log, first: Sequence[Scan | Cloud], options: BuildOptions) -> Posing:
    """Find the way to the frames of the first scans; where the mount is missing, guess it.

    Raises
    ------
    PoseError, LogError
        The trajectory that the user chose cannot be used.
    """
    poser = read_poser(log, options.posing, [scan.topic for scan in first])
    frames = {scan.frame for scan in first if scan.pose is None or options.posing.poses}
    faults = poser.find_chains(frames)
    if not faults or len(frames) > 1 or options.posing.sensor_pose is not None:
        return Posing(poser, faults)
    at_body = Poser(poser.sources, replace(options.posing, sensor_pose=IDENTITY))
    if at_body.find_chains(frames):  # more than the mount is missing
        return Posing(poser, faults)
    # Read the scans as if the sensor were the body, and find the mount that suits them best.
    guess = guess_place(at_body, sample_scans(Drive(log, at_body, options)), options)
    ((frame, fault),) = faults.items()
    if guess and isinstance(fault, MountError):
        faults = {frame: fault.named(format_mount(guess.mount), guess.why)}
    mount = guess.mount if guess else IDENTITY
    posing = replace(options.posing, sensor_pose=mount)
    return Posing(Poser(at_body.sources, posing), faults, mount, is_guess=guess is None)


class Guess(NamedTuple):
    """Where a laser may sit."""

    mount: Pose
    why: str
    """What speaks for it, and how well the scans then fit each other"""


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
        return Guess(mount, f"where tf has {leaf!r}, a frame that no scan is in{share}")
    place = "measure x and y, or walls are doubled"
    return Guess(mount, f"which suits the scans best of all turns{share}; {place}")


def guess_by_floor(parts: Sequence[PosedScans]) -> Guess | None:
    """Guess how a 3D sensor sits, by the floor that it sees; None where it sees none."""
    seat = find_seat(parts)
    if seat is None:
        return None
    found = f"by the floor {seat.height:.2f} m below it"
    by_walls = ", and by walls; measure x and y" if seat.has_yaw else "; measure x, y and yaw"
    return Guess(seat.mount, f"{found}{by_walls}, or walls are doubled")


def list_leaves(poser: Poser, frame: str) -> dict[str, Pose]:
    """List where frames are mounted on the body of a sensor, if no other frame is below them."""
    tree = poser.sources.tree
    base = poser.options.base_frame or tree.find_base(frame)
    uppers = {base, *(edge.parent for edge in tree.edges)}
    ways = {leaf: tree.find_path(base, leaf) for leaf in tree.frames if leaf not in uppers}
    places = {leaf: place_on(steps) for leaf, steps in ways.items() if steps}
    return {leaf: place for leaf, place in places.items() if place}


def list_misfits(
    paths: Sequence[Path], options: BuildOptions, agreement: float | None, tally: Tally
) -> Iterator[str]:
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
    for path in paths:
        drive = open_drive(open_log(path, options.reading), options)
        parts = sample_scans(drive)
        for topic in drive.topics:
            mine = [part for part in parts if part.batch.topic == topic]
            if better := find_better(drive.poser, mine, options.returns):
                yield f"{path}: {topic}: {warn_of_misfit(better).text}"


def find_better(poser: Poser, parts: Sequence[PosedScans], options: ReturnOptions) -> str:
    """Find the option, with its value, by which the scans of a sensor fit clearly better.

    Returns
    -------
    str
        Such as "sensor_pose=0,0,3.14159"; "" where they fit as they are.
    """
    turn = choose_turn([count_marked(parts, turn, options) for turn in TURNS])
    if turn is None or turn == IDENTITY:
        return ""
    mount = find_mount(poser, parts[0].batch.frame)
    mended = {} if mount is None else mount.write(turn_mount(mount.pose, turn))
    return "".join(f"{option}={value}" for option, value in mended.items())


def warn_of_misfit(better: str) -> Concern:
    """Say that an option, given with its value, suits the scans better."""
    option, _, value = better.partition("=")
    given = f"({value})" if option == "sensor_pose" else value  # in Python that one is a tuple
    text = f"the scans would fit each other better with `{option}={given}`"
    return Concern(text, {option: value})


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
    hits: list[Float64] = []
    for part in parts:
        rays, _ = interpret(mount_scans(part, mount), options)
        hits.append(rays.end[rays.kind == Kind.HIT])
    return len(np.unique(encode_cells(np.concatenate(hits or [np.zeros((0, 2))]), MOUNT_CELL_M)))


def mount_scans(part: PosedScans, mount: Pose) -> PosedScans:
    """Place a sensor on its body; so far its scans are posed as if it were the body."""
    sensor = Transforms.fixed(mount)
    position = part.position + part.rotation @ sensor.position[0]
    return PosedScans(part.batch, position, part.rotation @ sensor.rotation[0])


GAPS = (2, 4, 8, 16, 32)
"""A chord of a wall joins the ends of two beams that are this many beams apart."""
CHORD_M = 0.5
"""Chords are from this long (m) to twice as long: shorter ones show the noise of ranges."""
STRAIGHT_M = 0.02
"""Where a wall is straight, the beam in the middle ends at most this far from the chord (m)."""
BINS = 360
"""Bins of the histogram over a quarter turn"""
BLUR = 9
"""Neighbouring bins that are added up, so that noise does not split a direction"""
NARROW_DEG = (5.0, 3.0)
"""Only chords this near to the direction found before count in the next mean."""
COMMON_SHARE = 1 / 3
"""In a building, at least this share of the length of all chords lies within 3 degrees of one
direction. Logs of buildings have 0.5 to 0.74; walls in all directions would have a fifteenth."""
DIGITS = 2
"""The angle is rounded to hundredths of a degree, so that a map can be made again by hand."""


def settle_align(paths: Sequence[Path], options: BuildOptions) -> tuple[BuildOptions, list[str]]:
    """Find the turn of a map where the user leaves it to the scans; a note says if they show none.

    Raises
    ------
    OccmapError
        A log cannot be read, or has no scans or no poses.
    """
    if options.posing.align is not None:
        return options, []
    chords = [list_chords(rays) for rays in sample_rays(paths, options)]
    turn, share = find_turn(np.concatenate([np.zeros((0, 2)), *chords]))
    notes = []
    if share < COMMON_SHARE:
        turn = 0.0
        common = f"{share:.0%} of the length of walls lies within 3 degrees of one direction"
        found = common if any(map(len, chords)) else "no beams of laser scans show a straight wall"
        notes.append(f"{found}, so the map is not turned; give an angle with `align=DEG`")
    return replace(options, posing=replace(options.posing, align=turn)), notes


def list_chords(rays: Rays) -> Float64:
    """List straight pieces of walls that single scans see, as vectors (N, 2) in metres."""
    hit, end = rays.kind == Kind.HIT, rays.end
    chords = [np.zeros((0, 2))]
    for gap in (gap for gap in GAPS if gap < hit.shape[1]):
        half = gap // 2
        start, middle, stop = end[:, :-gap], end[:, half:-half], end[:, gap:]
        chord, bow = stop - start, middle - (start + stop) / 2
        length = np.hypot(chord[..., 0], chord[..., 1])
        across = np.abs(bow[..., 0] * chord[..., 1] - bow[..., 1] * chord[..., 0])
        seen = hit[:, :-gap] & hit[:, half:-half] & hit[:, gap:]
        long = (length >= CHORD_M) & (length < 2 * CHORD_M)
        chords.append(chord[seen & long & (across < STRAIGHT_M * length)])
    return np.concatenate(chords)


def find_turn(chords: Float64) -> tuple[float, float]:
    """Find the smallest turn by which walls run along the axes.

    Directions count modulo a quarter turn and by length. The fullest part of a histogram is a first
    estimate, which the mean of the directions near it refines. The mean is taken of four times the
    angles, so that angles a quarter turn apart are the same (Mardia and Jupp 2000, directional
    statistics).

    Parameters
    ----------
    chords
        (N, 2) pieces of walls.

    Returns
    -------
    turn, share
        Degrees, counter-clockwise, from -45 to 45; and how much of the length of all chords lies
        within 3 degrees of the direction found.
    """
    length = np.hypot(chords[:, 0], chords[:, 1])
    if not length.any():
        return 0.0, 0.0
    angle = np.degrees(np.arctan2(chords[:, 1], chords[:, 0])) % 90
    bins, _ = np.histogram(angle, BINS, (0, 90), weights=length)
    sums = np.convolve(np.pad(bins, BLUR // 2, "wrap"), np.ones(BLUR), "valid")
    wall = (float(np.argmax(sums)) + 0.5) * 90 / BINS
    for narrow in NARROW_DEG:
        off = wrap(angle - wall)
        near = np.abs(off) < narrow
        mean = np.sum(length[near] * np.exp(4j * np.radians(off[near])))
        wall += float(np.degrees(np.angle(mean))) / 4
    share = float(length[np.abs(wrap(angle - wall)) < NARROW_DEG[-1]].sum() / length.sum())
    return round(float(wrap(np.array(-wall))), DIGITS) + 0.0, share


def wrap(angle: Float64) -> Float64:
    """Reduce angles by quarter turns to -45 to 45 degrees."""
    return np.asarray((angle + 45) % 90 - 45)
