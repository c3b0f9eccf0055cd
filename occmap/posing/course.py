"""How a sensor sat, where it went, and what in this spoils a map.

A jump is where poses suddenly take the robot elsewhere. REP 105 allows that in the correction of
odometry (`map -> odom`), and live navigation recovers. A map does not: what was traced before such
a jump and what is traced after it belong to different places. Other poses jump where a robot was
carried, or where two trajectories were joined.

A leap goes back: damaged poses put scans where the robot cannot have been, and spoil the map there.
"""

import math
from collections.abc import Iterator, Sequence
from functools import reduce
from typing import NamedTuple, Self

import numpy as np

from occmap.choices import mark_options
from occmap.posing import POSED, Concern, DropReason, Stamps, tracks
from occmap.posing.chain import Chain, Moving, Transforms, make_chain, turn
from occmap.posing.frames import Edge, Source
from occmap.posing.tracks import Track, TrackBuilder
from occmap.types import Bool, Float64, Int64, PosedScans, UInt8

JUMP_M, JUMP_RAD = 1.0, math.radians(20)
"""A correction that moves and turns the sensor by less mends drift; at most it doubles walls."""
STRIDE_M = 1.0
"""A shorter step may be a correction of drift."""
STRIDE_S = 10.0
"""Between samples that are further apart in time a robot may have been carried."""
STRIDE_TIMES = 2.5
"""No robot drives this many times as fast as usual."""
LONG_STEPS = 2.0
"""A stride is this many times as long as nearly all steps: all steps of a sparse log are long."""
SLOW_M_PER_S = 0.3
"""A robot that stands or creeps may set out at this speed."""
SET_BACK_S = 1.0
"""Messages of one frame are late by less."""
FLICKER_M, FLICKER_SHARE, FLICKER_SAMPLES = 0.1, 0.05, 100
"""A robot that drives turns back at once at hardly any of its poses, and by less"""
FLICKER_ROW, ROW_GAP, FLICKER_TIMES, LEAST_SIDE = 10, 2, 2.0, 0.2
"""Where it does so again and again, no more samples apart, and so many times as far as noise does,
what lies before or behind that may be kept, if it is a larger share of the scans"""
UNREAL_M_PER_S, BLIND_M_PER_S = 100.0, 10.0
"""A quarter of the steps of no car is as fast, or where it sees less far than it goes from scan to
scan; those of a robot of which places are in mm are, or in cm."""
BESIDE = np.array([*range(-10, 0), *range(1, 11)])
"""Offsets from a step to those beside it, which say how fast the robot drives there."""
FASTEST_BESIDE = 3
"""The third fastest of those steps counts: one or two may be strides themselves."""

MS_NS = 10**6


class Jump(NamedTuple):
    """A moment at which the sensor is suddenly elsewhere."""

    stamp_ns: int
    """By the clock of the poses"""
    metres: float
    """How far it moved"""
    radians: float
    """How far it turned"""
    name: str
    """What jumped"""
    is_correction: bool
    """It was the correction of odometry: no robot can have moved so"""


def warn_of_mixed(chain: Chain, scans_ns: Int64, first_ns: int) -> Concern | None:
    """Say if a step holds poses of two times, or of two nodes, among each other.

    Parameters
    ----------
    scans_ns, first_ns
        Stamps (S,) of the used scans, and of the first scan of the log, by the clock of the poses.
    """
    for step in (leg.step for leg in chain.legs if isinstance(leg, Moving)):
        name, track = f"{step.parent} -> {step.child}", step.track
        if track.set_back_s > SET_BACK_S:
            found = f"the stamps of {name} were set back by {track.set_back_s:.3g} s"
            why = "poses of two times are mixed; `stamps=record` takes the recorder's times"
            return Concern(f"{found}: {why}", {"stamps": Stamps.RECORD.value})
        found = f"{name} jumps to and fro"
        if remedy := leave_row_out(track, scans_ns, first_ns):
            why = "was the clock set back, or do two nodes send it?"
            keep = f"{mark_options(remedy)} keeps what is not mixed"
            return Concern(f"{found} for a while: {why} {keep}", remedy)
        share = len(list_turns(track, scans_ns, 1.0)) / len(track)
        if share > FLICKER_SHARE and len(track) >= FLICKER_SAMPLES:
            found += f" at {share:.0%} of its {len(track):,} samples"
            return Concern(f"{found}: do two nodes send it? give one trajectory with `poses`")
    return None


def leave_row_out(track: Track, scans_ns: Int64, first_ns: int) -> dict[str, str]:
    """Find the option that keeps most scans (S,) before or behind where a track is mixed.

    That is the longest row of samples at which it clearly turns back at once. Empty: there is no
    such row, or hardly a scan beside it.
    """
    turns = list_turns(track, scans_ns, FLICKER_TIMES)
    row = max(np.split(turns, np.flatnonzero(np.diff(turns) > ROW_GAP) + 1), key=len)
    if len(row) < FLICKER_ROW:
        return {}
    start_ns, end_ns = int(track.stamp_ns[row[0] - 1]), int(track.stamp_ns[row[-1] + 1])
    sides = np.array([np.mean(scans_ns <= start_ns), np.mean(scans_ns >= end_ns)])
    is_enough = sides.max() >= LEAST_SIDE
    return keep_longest(sides, [(start_ns, end_ns)], first_ns) if is_enough else {}


def keep_longest(
    parts: Float64 | Int64, gaps: Sequence[tuple[int, int]], first_ns: int
) -> dict[str, str]:
    """Write the options, in whole ms, that keep the part of a log that has most scans.

    Parameters
    ----------
    parts
        (G + 1,) how many scans each has, or which share of them.
    gaps
        Where each gap between two parts starts and ends.
    """
    longest, remedy = int(np.argmax(parts)), {}
    if longest > 0:
        remedy["start_s"] = f"{-((first_ns - gaps[longest - 1][1]) // MS_NS) / 1e3:.12g}"
    if longest < len(gaps):
        remedy["end_s"] = f"{(gaps[longest][0] - first_ns) // MS_NS / 1e3:.12g}"
    return remedy


def warn_of_jumps(chain: Chain | None, track: Track, first_ns: int) -> Concern | None:
    """Say which jump between used scans is the largest, and which options keep one part.

    Where poses are mixed, they jump for no other reason.

    Parameters
    ----------
    chain
        What poses are looked up in. None: they stand beside the scans, and are its only step.
    track
        Where the sensor was at its scans.
    first_ns
        Stamp of the first scan of the log, by the clock of the poses.
    """
    if chain and (mixed := warn_of_mixed(chain, track.stamp_ns, first_ns)):
        return mixed
    stated = make_chain([Edge("", "", track, Source.ODOMETRY)], None)
    if not (found := find_jumps(chain or stated, track.stamp_ns)):
        return None
    scans, jumps = np.diff([0, *found, len(track)]), list(found.values())
    remedy = keep_longest(scans, [(each.stamp_ns, each.stamp_ns) for each in jumps], first_ns)
    worst = max(jumps, key=lambda jump: jump.metres + jump.radians)
    text = (
        f"{worst.name} jumps by {worst.metres:.3g} m and {math.degrees(worst.radians):.0f} deg "
        f"{(worst.stamp_ns - first_ns) / 1e9:.3f} s after the first scan"
    )
    text += f", the largest of {len(jumps)} jumps" if len(jumps) > 1 else ""
    unless = "" if worst.is_correction else "unless the robot did so, as in a simulator, "
    keep = f"{mark_options(remedy)} keeps the longest part, {scans.max() / len(track):.0%} of them"
    why = "scans from before and after do not fit together"
    return Concern(f"{text}: {unless}{why}; {keep}", remedy)


def find_jumps(chain: Chain, stamp_ns: Int64) -> dict[int, Jump]:
    """Find between which scans the sensor at the end of a chain is suddenly elsewhere.

    A correction jumps where its pose holds until then, any other step where a body moves faster
    than a robot can. What jumps there and back with no scan in between harms nothing.

    Parameters
    ----------
    stamp_ns
        (S,) of the scans, in the order of time.

    Returns
    -------
    dict
        By the number of scans before each jump, in the order of time.
    """
    breaks: dict[int, tuple[int, str, bool]] = {}
    """By the first stamp after a jump: the last one that is clearly before it, and what jumps"""
    for step, holds in ((leg.step, leg.holds) for leg in chain.legs if isinstance(leg, Moving)):
        samples_ns = step.track.stamp_ns
        name = f"{step.parent} -> {step.child}" if step.child else "the pose beside the scans"
        for at in np.union1d(np.flatnonzero(holds[:-1]), find_strides(step.track)):
            after_ns = int(samples_ns[at + 1])
            # A pose that holds does so until just before the next sample.
            before_ns = after_ns - 1 if holds[at] else int(samples_ns[at])
            breaks[after_ns] = before_ns, name, bool(holds[at])
    times = np.array(sorted(breaks), np.int64)
    before = chain.at(np.array([breaks[each][0] for each in times.tolist()], np.int64))
    moved = chain.at(times).then(before.invert())
    scans = np.where(moved.status == POSED, np.searchsorted(stamp_ns, times), 0)
    found: dict[int, Jump] = {}
    for number in np.unique(scans[(scans > 0) & (scans < len(stamp_ns))]).tolist():
        rows = np.flatnonzero(scans == number)
        # What leads there and back leaves nothing.
        whole = reduce(Transforms.then, (moved.take(row) for row in rows[::-1]))
        start, time_ns = before.position[rows[:1]], int(times[rows[-1]])
        metres = float(np.linalg.norm(turn(whole.rotation, start) + whole.position - start))
        radians = float(np.arccos(np.clip((np.trace(whole.rotation[0]) - 1) / 2, -1, 1)))
        if metres > JUMP_M or radians > JUMP_RAD:
            found[number] = Jump(time_ns, metres, radians, *breaks[time_ns][1:])
    return found


def find_strides(track: Track) -> Int64:
    """Find the steps (K,) that are far too fast for a robot that drives as it does beside them.

    Such a step takes at most 10 s and is longer than 1 m and than twice nearly all steps (19 of
    20). It is 2.5 times as fast as nearly all of them, and as the third fastest of the ten steps to
    either side.
    """
    if len(track) < 3:
        return np.zeros(0, np.int64)
    speed = track.step_m / np.maximum(track.interval_s, 1e-3)
    usual = max(SLOW_M_PER_S, float(np.quantile(speed, 0.95)))
    long_m = max(STRIDE_M, LONG_STEPS * float(np.quantile(track.step_m, 0.95)))
    far = (track.step_m > long_m) & (track.interval_s <= STRIDE_S)
    steps = np.flatnonzero(far & (speed > STRIDE_TIMES * usual))
    beside = steps[:, None] + BESIDE
    known = (beside >= 0) & (beside < len(speed))
    beside_m_per_s = np.where(known, speed[np.clip(beside, 0, len(speed) - 1)], 0)
    fast = np.partition(beside_m_per_s, -FASTEST_BESIDE, axis=1)[:, -FASTEST_BESIDE]
    return np.asarray(steps[speed[steps] > STRIDE_TIMES * fast])


def list_turns(track: Track, scans_ns: Int64, times: float) -> Int64:
    """List the samples (K,) among the scans (S,) at which a track turns back at once.

    Each lies so many times as far from the way between its neighbours as these lie apart.
    """
    before, here, after = (track.position[at : len(track) - 2 + at] for at in range(3))
    aside = np.linalg.norm(here - (before + after) / 2, axis=1)
    turns = aside > np.maximum(FLICKER_M, times * np.linalg.norm(after - before, axis=1))
    among = np.searchsorted(scans_ns, track.stamp_ns[1:-1])
    return np.flatnonzero(turns & (among > 0) & (among < len(scans_ns))) + 1


SLACK_M = 1.0
"""A shorter step is not a leap, however short the time: stamps are rounded, odometry corrected."""
SPARSE_S = 10.0
"""A longer step in time is a pause, in which a robot may have been carried."""
FASTEST = 50.0
"""With `max_speed=inf` all scans are kept, and steps above this speed (m/s) are noted as leaps."""
MOST_ROWS = 1000
"""Ten seconds of scans that all leap. Where stamps are in a wrong unit, ten seconds hold the whole
log, and to look at all of it for each row would take hours."""
LONG_ROW_STEPS = 3
"""A row with at least this many steps shows where the robot is."""


def find_outliers(track: Track, max_speed: float) -> Bool:
    """(N,) which scans of a laser are outliers, by where it was at each (N).

    A leap is a step between two scans of a laser, at most ten seconds apart, that no robot makes
    in that time. Scans, in the order of time, are cut into parts where there is a pause, and parts
    into rows where there is a leap. A row of at least four scans is long: it shows where the robot
    is. Two kinds of scans are outliers, and are left out:

    - A long row, or the first one of a part, ends with a leap, and at most ten seconds and a
      thousand rows later a long row continues where it ended. (After a long row, the last row of
      the part need not be long.) All scans between the two rows are outliers.
    - The first row of a part, or its last one, is a single scan beside a long row. It is an
      outlier.

    Where no row continues, the robot was carried, or stamps or poses do not mean what they seem to,
    and all scans are kept.

    Parameters
    ----------
    max_speed
        Faster steps (m/s) are leaps.
    """
    pauses = track.interval_s > SPARSE_S
    cuts = np.flatnonzero(pauses | find_leaps(track, max_speed))
    first, last = np.append(0, cuts + 1), np.append(cuts, len(track) - 1)
    opens, closes = np.append(True, pauses[cuts]), np.append(pauses[cuts], True)
    is_long, is_single = last - first >= LONG_ROW_STEPS, first == last
    begin_ns, end_ns = track.stamp_ns[first], track.stamp_ns[last]
    begin, end = track.position[first], track.position[last]
    # No row of the next part begins so soon.
    soon = np.searchsorted(begin_ns, end_ns + int(SPARSE_S * 1e9), side="right")
    outliers = np.zeros(len(track), np.bool_)
    row = 0
    while row < len(first) - 1:
        following, back = row + 1, first[:0]
        if is_long[row] or opens[row]:
            others = np.arange(following, soon[row])[:MOST_ROWS]
            metres = np.linalg.norm(begin[others] - end[row], axis=1)
            leaps = is_too_far(metres, (begin_ns[others] - end_ns[row]) / 1e9, max_speed)
            back = others[~leaps & (is_long[others] | (is_long[row] & closes[others]))]
        if len(back):
            outliers[first[following] : first[back[0]]] = True
            following = back[0]
        elif opens[row] and not closes[row] and is_single[row] and is_long[following]:
            outliers[first[row]] = True
        elif closes[following] and not closes[row] and is_single[following] and is_long[row]:
            outliers[first[following]] = True
        row = following
    return outliers


def find_leaps(track: Track, max_speed: float) -> Bool:
    """(N - 1,) which steps of a laser between its scans (N) are leaps."""
    is_far = is_too_far(track.step_m, track.interval_s, max_speed)
    return is_far & (track.interval_s <= SPARSE_S)


def is_too_far(metres: Float64, seconds: Float64, max_speed: float) -> Bool:
    """(N,) whether steps are longer than a robot can go in that time."""
    fastest = FASTEST if max_speed == math.inf else max_speed
    return np.asarray(metres > np.maximum(SLACK_M, fastest * seconds))


def describe_first(track: Track, outliers: Bool, offset_ns: int) -> str:
    """Say where the first outlier of a laser lies.

    Parameters
    ----------
    offset_ns
        What was added to the stamps of the scans.
    """
    first = int(np.argmax(outliers))
    # The first scan of a part has its neighbour after it.
    step = first - 1 if first and track.interval_s[first - 1] <= SPARSE_S else first
    seconds = (int(track.stamp_ns[first]) - offset_ns) / 1e9
    away = f"{track.step_m[step]:,.6g} m from its neighbour, {track.interval_s[step]:.3g} s away"
    return f"the scan at {seconds:.3f} s lies {away}"


TILTED_RAD = math.radians(3)
"""A tilted scan plane meets the floor: at 3 degrees and 30 cm above it, within 6 m."""
STEEP_RAD = math.radians(30)
"""A scan plane tilted by more sees mostly floor or ceiling."""
LEAST_REACH_M = 1.0
"""Ranges that are cut to less than this make no map."""
STILL_M, STILL_RAD = 0.02, math.radians(1)
"""What moves less than this in a whole drive stands still: poses are noisy even then."""
STILL_SCANS = 20
"""Fewer scans do not tell whether the robot drove."""


class Course(TrackBuilder):
    """What became of the scans of one sensor, and where it was: 72 bytes for each with a pose."""

    def __init__(self) -> None:
        super().__init__()
        self._lost: list[tuple[Int64, UInt8]] = []
        self.is_of_clouds = False
        """Its sensor has no scan plane"""

    def see(self, posed: PosedScans, stamp_ns: Int64) -> None:
        """Record the poses of some scans, with stamps (S,) by the clock of the poses.

        Of de-skewed scans, those of their first beams count.
        """
        self.is_of_clouds = posed.batch.clouds is not None
        self.add(stamp_ns, stamp_ns, tracks.list_poses(posed))

    def lose(self, stamp_ns: Int64, status: UInt8) -> None:
        """Record scans (S,) that have no usable pose, with their own stamps."""
        self._lost.append((stamp_ns, status))

    def list_lost(self) -> Iterator[tuple[int, DropReason]]:
        """List the stamps of scans that have no usable pose, each with the reason."""
        reasons = list(DropReason)
        for stamp_ns, status in self._lost:
            for each, code in zip(stamp_ns.tolist(), status.tolist(), strict=True):
                yield each, reasons[code - 1]

    def list_poses(self) -> tuple[Int64, Float64]:
        """List the stamps (N,) and poses (N, 7) of the scans that were seen, in their order."""
        times, poses = self.samples
        return times[:, 0].copy(), poses


def stands(track: Track) -> bool:
    """Whether a sensor never moved, though there were scans enough to see it move."""
    moves = tracks.differ(track.position, track.quaternion, STILL_M, STILL_RAD)
    return len(track) >= STILL_SCANS and not moves


def suspect_places(track: Track, middle_m: float) -> Concern | None:
    """Say if a sensor moves faster than any does between most scans.

    A slower one is as doubtful where scans do not overlap, by their median range.
    """
    if len(track) <= STILL_SCANS:
        return None
    speed, step_m = np.quantile([track.step_m / track.interval_s, track.step_m], 0.75, axis=1)
    if speed < (BLIND_M_PER_S if step_m > 2 * middle_m else UNREAL_M_PER_S):
        return None
    found = f"the sensor moves at {speed:.3g} m/s: places are metres"
    why = "are these millimetres or centimetres, or are the times wrong?"
    return Concern(f"{found}; {why}", command="")


class Stance(NamedTuple):
    """How a sensor sat in the frame of the map, as the median of its scans."""

    upside_down: bool
    tilt: float
    """Between its scan plane and the map's (rad)"""
    height: float
    """z (m)"""
    ahead: float
    """How far its x axis points up (rad); below 0: down"""
    swing: float
    """How much its scan plane nods or rolls, but for the tenth at either end (rad)"""

    @classmethod
    def measure(cls, track: Track) -> Self:
        """Measure how a sensor sat."""
        rise = tracks.rotate_by(track.quaternion)[:, 2]
        ahead, _, up = rise.T
        lowest, highest = np.quantile(np.arcsin(np.clip(rise[:, :2], -1, 1)), (0.1, 0.9), axis=0)
        return cls(
            upside_down=bool(np.median(up) < 0),
            tilt=float(np.median(np.arccos(np.clip(np.abs(up), 0, 1)))),
            height=float(np.median(track.position[:, 2])),
            ahead=float(np.arcsin(np.clip(np.median(ahead), -1, 1))),
            swing=float((highest - lowest).max()),
        )


UPRIGHT = 0.5
"""A way over ground leads in a plane whose normal has more than this of z"""
FLAT = 0.2
"""As thick as that, of its lesser width, is what counts as a plane"""


def warn_of_axes(track: Track) -> Concern | None:
    """Say if the way of a sensor lies in a plane that stands upright, as in poses without z up."""
    if len(track) < 3:
        return None
    variance, axes = np.linalg.eigh(np.cov(track.position.T))
    x, y, z = np.rint(tracks.rotate_by(track.quaternion)[:, :, 2].mean(axis=0)).tolist()
    is_flat = variance[0] < FLAT**2 * variance[1]
    if z or not is_flat or variance[1] < 1 or abs(axes[2, 0]) > UPRIGHT:
        return None
    found = "its way lies in a plane that stands upright, as where z is not up in the poses"
    if not (x or y):
        return Concern(f"{found}; turn them to those of a robot: x ahead, y left", command="")
    level = {"level": f"{90 * y + 0.0:.0f},{-90 * x + 0.0:.0f}"}
    return Concern(f"{found}; if it is not, {mark_options(level)} lays it flat", level)


def list_tilts(stance: Stance, max_range: float) -> Iterator[Concern]:
    """Say how far the scan plane of a sensor is tilted, and where it meets the floor.

    Parameters
    ----------
    max_range
        Beams are used up to here (m).
    """
    if stance.tilt < TILTED_RAD:
        return
    found = f"the scan plane is tilted by {math.degrees(stance.tilt):.1f} deg"
    if abs(stance.ahead) >= TILTED_RAD / 2:
        side = "down" if stance.ahead < 0 else "up"
        found += f" ({math.degrees(abs(stance.ahead)):.1f} deg {side} ahead)"
    reach = math.floor(10 * stance.height / math.sin(stance.tilt)) / 10
    if stance.tilt >= STEEP_RAD:
        why = "the laser looks at the floor or the ceiling, not at walls"
        yield Concern(f"{found}: {why}", command="")
    elif stance.swing > 2 * TILTED_RAD:
        found = f"the scan plane nods by {math.degrees(stance.swing):.0f} deg and meets the floor"
        yield Concern(f"{found}: map clouds of its scans, which `laser_assembler` makes")
    elif reach < LEAST_REACH_M:
        yield Concern(f"{found}: it meets the floor")
    elif max_range > reach:
        found += f": {stance.height:.2g} m over the floor, which it meets {reach:g} m away"
        end = {"max_range": f"{reach:g}"}
        yield Concern(f"{found}; end there with {mark_options(end)}", end)
