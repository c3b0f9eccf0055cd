"""How a sensor sat, where it went, and what in this spoils a map.

A jump is where poses suddenly take the robot elsewhere. REP 105 allows that in the correction of
odometry (`map -> odom`), and live navigation recovers. A map does not: what was traced before such
a jump and what is traced after it belong to different places. Other poses jump where a robot was
carried, or where two trajectories were joined.
"""

import math
from collections.abc import Iterator
from typing import NamedTuple, Self

import numpy as np

from occmap.posing import Concern, DropReason, Stamps, tracks
from occmap.posing.chain import Chain, Moving, Status, make_chain
from occmap.posing.frames import Edge, Source
from occmap.posing.tracks import Track, TrackBuilder
from occmap.types import Float64, Int64, PosedScans, UInt8

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
UNREAL_M_PER_S = 100.0
"""A quarter of the steps of no car is as fast; those of a robot of which places are in mm are."""
BESIDE = np.array([*range(-10, 0), *range(1, 11)])
"""Offsets from a step to those beside it, which say how fast the robot drives there."""
FASTEST_BESIDE = 3
"""The third fastest of those steps counts: one or two may be strides themselves."""

MS_NS = 10**6


class Jump(NamedTuple):
    """A moment at which the sensor is suddenly elsewhere."""

    stamp_ns: int
    """By the clock of the poses"""
    before: Float64
    """(3,) where the sensor was (m)"""
    after: Float64
    """(3,) where it is from then on (m)"""
    rotation: Float64
    """(3, 3) how it turned, in the frame of the map"""
    name: str
    """What jumped"""

    @property
    def metres(self) -> float:
        """How far it moved."""
        return float(np.linalg.norm(self.after - self.before))

    @property
    def radians(self) -> float:
        """How far it turned."""
        return tracks.measure_turn(self.rotation)

    def then(self, later: Self) -> Self:
        """Join it with a later one: of what leads there and back nothing is left."""
        after = later.after + later.rotation @ (self.after - later.before)
        rotation = later.rotation @ self.rotation
        return later._replace(before=self.before, after=after, rotation=rotation)


def warn_of_mixed(chain: Chain) -> Concern | None:
    """Say if a step holds poses of two times, or of two nodes, among each other."""
    for step in (leg.step for leg in chain.legs if isinstance(leg, Moving)):
        name, track = f"{step.parent} -> {step.child}", step.track
        if track.set_back_s > SET_BACK_S:
            found = f"the stamps of {name} were set back by {track.set_back_s:.3g} s"
            why = "poses of two times are mixed; `stamps=record` takes the recorder's times"
            return Concern(f"{found}: {why}", {"stamps": Stamps.RECORD.value})
        share = measure_flicker(track)
        if share > FLICKER_SHARE and len(track) >= FLICKER_SAMPLES:
            found = f"{name} jumps to and fro at {share:.0%} of its {len(track):,} samples"
            return Concern(f"{found}: do two nodes send it? give one trajectory with `poses`")
    return None


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
    if chain and (mixed := warn_of_mixed(chain)):
        return mixed
    stated = make_chain([Edge("", "", track, Source.ODOMETRY)], None)
    found = find_jumps(chain or stated, track.stamp_ns)
    if not found:
        return None
    scans, jumps = np.diff([0, *found, len(track)]), list(found.values())
    longest = int(np.argmax(scans))
    remedy = {}
    if longest > 0:  # rounded so that no scan of another part is kept
        start_ms = -(-(jumps[longest - 1].stamp_ns - first_ns) // MS_NS)
        remedy["start_s"] = f"{start_ms / 1e3:.12g}"
    if longest < len(jumps):
        remedy["end_s"] = f"{(jumps[longest].stamp_ns - first_ns) // MS_NS / 1e3:.12g}"
    keep = " and ".join(f"`{name}={value}`" for name, value in remedy.items())
    worst = max(jumps, key=lambda jump: jump.metres + jump.radians)
    text = (
        f"{worst.name} jumps by {worst.metres:.3g} m and {math.degrees(worst.radians):.0f} deg "
        f"{(worst.stamp_ns - first_ns) / 1e9:.3f} s after the first scan"
    )
    text += f", the largest of {len(jumps)} jumps" if len(jumps) > 1 else ""
    return Concern(
        f"{text}: scans from before and after do not fit together; {keep} keeps the longest "
        f"part, {scans[longest] / len(track):.0%} of them",
        remedy,
    )


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
    breaks: dict[int, tuple[int, Edge]] = {}
    """By the first stamp after a jump: the last one that is clearly before it, and what jumps"""
    for leg in (leg for leg in chain.legs if isinstance(leg, Moving)):
        samples_ns = leg.step.track.stamp_ns
        for at in np.union1d(np.flatnonzero(leg.holds[:-1]), find_strides(leg.step.track)):
            after_ns = int(samples_ns[at + 1])
            # A pose that holds does so until just before the next sample.
            breaks[after_ns] = after_ns - 1 if leg.holds[at] else int(samples_ns[at]), leg.step
    times = np.array(sorted(breaks), np.int64)
    after = chain.at(times)
    before = chain.at(np.array([breaks[each][0] for each in times.tolist()], np.int64))
    scans = np.searchsorted(stamp_ns, times).tolist()
    found: dict[int, Jump] = {}
    for at in np.flatnonzero(np.maximum(before.status, after.status) == Status.POSED).tolist():
        time_ns, rotation = int(times[at]), after.rotation[at] @ before.rotation[at].T
        step = breaks[time_ns][1]
        name = f"{step.parent} -> {step.child}" if step.child else "the pose beside the scans"
        jump = Jump(time_ns, before.position[at], after.position[at], rotation, name)
        earlier = found.get(scans[at])
        found[scans[at]] = earlier.then(jump) if earlier else jump
    return {
        number: jump
        for number, jump in found.items()
        if 0 < number < len(stamp_ns) and (jump.metres > JUMP_M or jump.radians > JUMP_RAD)
    }


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
    strides: Int64 = steps[speed[steps] > STRIDE_TIMES * fast]
    return strides


def measure_flicker(track: Track) -> float:
    """Measure at what share of the samples of a track it turns back at once."""
    before, here, after = (track.position[at : len(track) - 2 + at] for at in range(3))
    aside = np.linalg.norm(here - (before + after) / 2, axis=1)
    turns = aside > np.maximum(FLICKER_M, np.linalg.norm(after - before, axis=1))
    return np.count_nonzero(turns) / len(track)


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
STANDS = (
    "the laser never moves, so the map is what it sees from one place; if the robot drove, its "
    "poses are missing: give them with `poses`"
)


class Course:
    """What became of the scans of one sensor, and where it was: 72 bytes for each with a pose."""

    def __init__(self) -> None:
        self.is_posed = False
        """Some scan has a pose"""
        self._poses = TrackBuilder()
        self._lost: list[tuple[Int64, UInt8]] = []
        self.is_of_clouds = False
        """Its sensor has no scan plane"""

    def see(self, posed: PosedScans, stamp_ns: Int64) -> None:
        """Record the poses of some scans, with stamps (S,) by the clock of the poses.

        Of de-skewed scans, those of their first beams count.
        """
        self.is_posed, self.is_of_clouds = True, posed.batch.clouds is not None
        self._poses.add(stamp_ns, stamp_ns, tracks.list_poses(posed))

    def lose(self, stamp_ns: Int64, status: UInt8) -> None:
        """Record scans (S,) that have no usable pose, with their own stamps."""
        self._lost.append((stamp_ns, status))

    def list_lost(self) -> Iterator[tuple[int, DropReason]]:
        """List the stamps of scans that have no usable pose, each with the reason."""
        for stamp_ns, status in self._lost:
            for each, code in zip(stamp_ns.tolist(), status.tolist(), strict=True):
                yield each, DropReason[Status(code).name]

    def list_poses(self) -> tuple[Int64, Float64]:
        """List the stamps (N,) and poses (N, 7) of the scans that were seen, in their order."""
        times, poses = self._poses.samples
        return times[:, 0].copy(), poses

    def build(self) -> Track:
        """Put all that was seen, at least one scan, in the order of time."""
        track = self._poses.build()
        assert track is not None
        return track


def stands(track: Track) -> bool:
    """Whether a sensor never moved, though there were scans enough to see it move."""
    moves = tracks.differ(track.position, track.quaternion, STILL_M, STILL_RAD)
    return len(track) >= STILL_SCANS and not moves


def suspect_places(track: Track) -> str:
    """Say if a sensor moves faster than any does between most scans; "" if it does not."""
    speed = track.step_m / track.interval_s
    if len(speed) < STILL_SCANS or np.quantile(speed, 0.75) < UNREAL_M_PER_S:
        return ""
    found = f"the sensor moves at {np.quantile(speed, 0.75):.3g} m/s"
    return f"{found}: places are metres; are these millimetres, or are the times wrong?"


class Stance(NamedTuple):
    """How a sensor sat in the frame of the map, as the median of its scans."""

    upside_down: bool
    tilt: float
    """Between its scan plane and the map's (rad)"""
    height: float
    """z (m)"""
    ahead: float
    """How far its x axis points up (rad); below 0: down"""

    @classmethod
    def measure(cls, track: Track) -> Self:
        """Measure how a sensor sat."""
        ahead, _, up = tracks.rotate_by(track.quaternion)[:, 2].T
        return cls(
            upside_down=bool(np.median(up) < 0),
            tilt=float(np.median(np.arccos(np.clip(np.abs(up), 0, 1)))),
            height=float(np.median(track.position[:, 2])),
            ahead=float(np.arcsin(np.clip(np.median(ahead), -1, 1))),
        )


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
        yield Concern(f"{found}: the laser looks at the floor or the ceiling, not at walls", None)
    elif reach < LEAST_REACH_M:
        yield Concern(f"{found}: it meets the floor")
    elif max_range > reach:
        found += f": {stance.height:.2g} m over the floor, which it meets {reach:g} m away"
        yield Concern(f"{found}; end there with `max_range={reach:g}`", {"max_range": f"{reach:g}"})
