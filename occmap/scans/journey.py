"""What a build keeps of where the robot went, for the outputs that show it."""

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import replace
from itertools import chain
from pathlib import Path

import numpy as np

from occmap.posing.rotations import to_quaternions
from occmap.sensor.returns import ReturnOptions, interpret
from occmap.types import Attached, Float64, Journey, Kind, PosedScans, ScanHits, Trajectory

SHOWN_SCANS = 400
"""How many scans of all logs are shown: a slider with more steps cannot be set by hand."""
SHOWN_HITS = 400
"""How many hits of a scan are shown: enough to draw its walls, however many beams it has."""
STATED_FRAME, STATED_LASER = "map", "laser"
"""Names for the frames of logs that state poses beside their scans and name no frame."""


class JourneyRecorder:
    """Takes the poses of all scans, and the hits of some; one thread at a time may call it."""

    def __init__(self, every: int, returns: ReturnOptions) -> None:
        """Keep the hits of every n-th scan, whose ranges mean what `returns` says."""
        self._every = every
        self._returns = returns
        self._pieces: list[Trajectory] = []
        """Of each batch, in the order in which they were recorded"""
        self._scans: list[ScanHits] = []
        self._seen = 0

    def start_over(self) -> "JourneyRecorder":
        """Make an empty recorder with the same settings."""
        return JourneyRecorder(self._every, self._returns)

    def add(self, other: "JourneyRecorder") -> None:
        """Add what another recorder took."""
        self._pieces += other._pieces
        self._scans += other._scans

    def follow(self, log: Path, parent: str | None, attached: Attached) -> None:
        """Record the poses of a batch, and hits of some of its scans.

        Parameters
        ----------
        parent
            The frame of the map; None where the log states poses and names no frames.
        """
        batch, posed, reasons = attached
        stamp_ns, pose = np.zeros(0, np.int64), np.zeros((0, 7))
        if posed is not None:
            stamp_ns, pose = posed.batch.stamp_ns, read_poses(posed)
            self._sample(posed)
        lost = np.setdiff1d(batch.stamp_ns, stamp_ns).tolist() if reasons else []
        why = ", or ".join(map(str, reasons))  # it is not known which reason is whose
        dropped = tuple((each, why) for each in lost)
        frames = (parent or STATED_FRAME).lstrip("/"), batch.frame.lstrip("/")
        self._pieces.append(Trajectory(str(log), batch.topic, *frames, stamp_ns, pose, dropped))

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
        lasers: defaultdict[tuple[str, str, str], list[Trajectory]] = defaultdict(list)
        for piece in self._pieces:
            lasers[piece.log, piece.topic, piece.frame].append(piece)
        return Journey(tuple(map(join_pieces, lasers.values())), tuple(self._scans))


def join_pieces(pieces: Sequence[Trajectory]) -> Trajectory:
    """Join what is known of one laser; one that is in the frame of the map gets one of its own."""
    first = pieces[0]
    return replace(
        first,
        frame=STATED_LASER if first.frame == first.parent else first.frame,
        stamp_ns=np.concatenate([piece.stamp_ns for piece in pieces]),
        pose=np.concatenate([piece.pose for piece in pieces]),
        dropped=tuple(chain.from_iterable(piece.dropped for piece in pieces)),
    )


def read_poses(scans: PosedScans) -> Float64:
    """(S, 7) x y z qx qy qz qw of the laser; at the first beam where every beam has its own."""
    position, rotation = scans.at_first_beam
    return np.column_stack([position, to_quaternions(rotation)])
