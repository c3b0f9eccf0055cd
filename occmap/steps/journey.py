"""What a build keeps of where the robot went, for the outputs that show it."""

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from occmap.arrays import Float64, Int64
from occmap.posing.rotations import to_quaternions
from occmap.sensor.returns import ReturnOptions, interpret
from occmap.types import Attached, Journey, Kind, PosedScans, ScanHits, Trajectory

SHOWN_SCANS = 400
"""How many scans of all logs are shown: a slider with more steps cannot be set by hand."""
SHOWN_HITS = 400
"""How many hits of a scan are shown: enough to draw its walls, however many beams it has."""
STATED_FRAME, STATED_LASER = "map", "laser"
"""Names for the frames of logs that state poses beside their scans and name no frame."""


@dataclass(eq=False)
class _Way:
    """What is known of one laser of one log so far."""

    parent: str
    stamps: list[Int64] = field(default_factory=list)
    poses: list[Float64] = field(default_factory=list)
    dropped: list[tuple[int, str]] = field(default_factory=list)


class JourneyRecorder:
    """Takes the poses of all scans, and the hits of some; one thread at a time may call it."""

    def __init__(self, every: int, returns: ReturnOptions) -> None:
        """Keep the hits of every n-th scan, whose ranges mean what `returns` says."""
        self._every = every
        self._returns = returns
        self._ways: dict[tuple[str, str, str], _Way] = {}
        self._scans: list[ScanHits] = []
        self._seen = 0

    def start_over(self) -> "JourneyRecorder":
        """Make an empty recorder with the same settings."""
        return JourneyRecorder(self._every, self._returns)

    def add(self, other: "JourneyRecorder") -> None:
        """Add what another recorder took."""
        for key, theirs in other._ways.items():
            way = self._ways.setdefault(key, _Way(theirs.parent))
            way.stamps += theirs.stamps
            way.poses += theirs.poses
            way.dropped += theirs.dropped
        self._scans += other._scans

    def follow(self, log: Path, parent: str | None, attached: Attached) -> None:
        """Record the poses of a batch, and hits of some of its scans.

        Parameters
        ----------
        parent
            The frame of the map; None where the log states poses and names no frames.
        """
        batch, posed, reasons = attached
        key = str(log), batch.topic, batch.frame.lstrip("/")
        way = self._ways.setdefault(key, _Way((parent or STATED_FRAME).lstrip("/")))
        if posed is not None:
            way.stamps.append(posed.batch.stamp_ns)
            way.poses.append(read_poses(posed))
            self._sample(posed)
        if reasons:
            kept = () if posed is None else posed.batch.stamp_ns
            lost = np.setdiff1d(batch.stamp_ns, kept)
            why = ", or ".join(map(str, reasons))  # it is not known which reason is whose
            way.dropped += [(stamp_ns, why) for stamp_ns in lost.tolist()]

    def _sample(self, scans: PosedScans) -> None:
        """Keep the hits of every n-th scan."""
        which = np.arange(-self._seen % self._every, len(scans.batch.stamp_ns), self._every)
        self._seen += len(scans.batch.stamp_ns)
        rays, _ = interpret(scans.take(which), self._returns)
        columns = rays.stamp_ns.tolist(), rays.origin[:, 0].tolist(), rays.end, rays.kind
        for stamp_ns, (x, y), end, kind in zip(*columns, strict=True):
            hits = end[kind == Kind.HIT].astype(np.float32)
            hits = hits[:: max(-(-len(hits) // SHOWN_HITS), 1)]
            self._scans.append(ScanHits(stamp_ns, (x, y), hits[:, 0], hits[:, 1]))

    def finish(self) -> Journey:
        """Return what was kept, laser by laser, in the order in which it was recorded."""
        trajectories = []
        for (log, topic, frame), way in self._ways.items():
            names = log, topic, way.parent, frame if frame != way.parent else STATED_LASER
            stamps = np.concatenate([*way.stamps, np.zeros(0, np.int64)])
            poses = np.concatenate([*way.poses, np.zeros((0, 7))])
            trajectories.append(Trajectory(*names, stamps, poses, tuple(way.dropped)))
        return Journey(tuple(trajectories), tuple(self._scans))


def read_poses(scans: PosedScans) -> Float64:
    """(S, 7) x y z qx qy qz qw of the laser; at the first beam where every beam has its own."""
    position, rotation = scans.at_first_beam
    return np.column_stack([position, to_quaternions(rotation)])
