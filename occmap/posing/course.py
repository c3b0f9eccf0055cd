"""How a sensor sat, where it went, and what in this spoils a map."""

import math
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from occmap.posing.chain import Chain, make_chain
from occmap.posing.frames import Edge, Source
from occmap.posing.jumps import Jump, find_jumps
from occmap.posing.options import Concern, Stamps
from occmap.posing.rotations import measure_turn
from occmap.posing.tracks import TrackBuilder
from occmap.types import Float64, Int64, PoseBatch, PosedScans

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


class Stance(NamedTuple):
    """How a sensor sat in the frame of the map, as the median of its scans."""

    upside_down: bool
    tilt: float
    """Between its scan plane and the map's (rad)"""
    height: float
    """z (m)"""
    ahead: float
    """How far its x axis points up (rad); below 0: down"""


class Course:
    """Where the sensor of one topic was; grows with the scans that it is shown, 48 bytes each."""

    def __init__(self) -> None:
        self.is_of_clouds = False
        """Its sensor has no scan plane"""
        self._chain: Chain | None = None
        """What their poses were looked up in; None where they stand beside the scans"""
        self._stated = TrackBuilder()
        """The poses that stand beside the scans"""
        self._stamps: list[Int64] = [np.empty(0, np.int64)]
        self._seats: list[Float64] = [np.empty((0, 5))]
        """x, y, z, and how far the z axis and the x axis of the sensor point up"""
        self._first: Float64 | None = None
        self._turned = 0.0

    def see(self, posed: PosedScans, stamp_ns: Int64, chain: Chain | None) -> None:
        """Record the poses of some scans; of de-skewed ones, those of their first beams.

        Parameters
        ----------
        stamp_ns
            (S,) of the scans, by the clock of the poses.
        chain
            What their poses were looked up in; None where they stand beside the scans.
        """
        pose = posed.batch.pose
        self.is_of_clouds = posed.batch.clouds is not None
        if chain is None and pose is not None:
            stated = PoseBatch(stamp_ns, stamp_ns, pose, "", "", static=False, topic="")
            self._stated.add_batch(stated, Stamps.HEADER)
        self._chain = chain
        self._stamps.append(stamp_ns)
        position, rotation = posed.at_first_beam
        self._seats.append(np.column_stack([position, rotation[:, 2, [2, 0]]]))
        self._first = rotation[0] if self._first is None else self._first
        self._turned = max(self._turned, float(measure_turn(self._first, rotation).max()))

    @property
    def stamp_ns(self) -> Int64:
        """(S,) stamps of the scans, by the clock of the poses."""
        return np.concatenate(self._stamps)

    def find_jumps(self) -> list[Jump]:
        """Find when it jumped; poses beside scans show that only when all of them are known."""
        chain = self._chain
        if chain is None and (track := self._stated.build()) is not None:
            chain = make_chain([Edge("", "", track, Source.ODOMETRY)], None)
        return find_jumps(chain) if chain else []

    @property
    def bounds(self) -> Float64:
        """(2, 3) the lowest and the highest x, y and z (m)."""
        places = np.concatenate(self._seats)[:, :3]
        return np.stack([places.min(axis=0, initial=np.inf), places.max(axis=0, initial=-np.inf)])

    @property
    def stands(self) -> bool:
        """Whether it never moved, though there were scans enough to see it move."""
        far = float(np.diff(self.bounds, axis=0).max())
        has_seen = len(self.stamp_ns) >= STILL_SCANS
        return has_seen and far < STILL_M and self._turned < STILL_RAD

    @property
    def stance(self) -> Stance | None:
        """How it sat; None where no scan had a pose."""
        *_, height, up, ahead = np.concatenate(self._seats).T
        if not len(up):
            return None
        return Stance(
            upside_down=bool(np.median(up) < 0),
            tilt=float(np.median(np.arccos(np.clip(np.abs(up), 0, 1)))),
            height=float(np.median(height)),
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
