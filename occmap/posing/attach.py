"""Attachment: scans and poses become posed scans; each scan without a pose is counted."""

from collections import Counter
from collections.abc import Collection, Iterable, Iterator
from dataclasses import dataclass, field
from typing import Self

import numpy as np

from occmap.errors import PoseError
from occmap.posing.chain import REASONS, Chain, Found, Status, apply
from occmap.posing.leaps import LeapFilter
from occmap.posing.options import Deskew, DropReason, PosingOptions
from occmap.posing.resolve import resolve
from occmap.posing.rotations import rotate_by
from occmap.posing.sources import Sources, gather
from occmap.posing.tracks import MAX_STAMP_NS, Track, find_usable
from occmap.types import (
    Bool,
    Float64,
    Int64,
    Pose,
    PoseBatch,
    PosedScans,
    PoseSample,
    ScanBatch,
    UInt8,
)

MAX_TURN_S = 60.0
"""A scan that is said to take longer has a wrong time_increment."""

MAX_AUTO_TURN_S = 1.0
"""The slowest laser that is de-skewed unasked; some drivers write milliseconds for seconds."""

MOMENTS = 33
"""Poses looked up for one de-skewed scan; see `_keep_deskewed` for how close that is."""

POSES_OF_BODY = (
    "the poses beside the scans are taken as the robot's, with the laser at --sensor-pose on it; "
    "leave that out if they are the laser's own"
)

UNTURNED = (0, 0, 0, 0, 0, 0, 1)
"""Stands in for a pose that is not finite."""

Attached = tuple[list[PosedScans], dict[DropReason, int]]
"""The scans that have poses, and how many have none, by reason."""


@dataclass(eq=False)
class Poser:
    """The poses of one log, and how its scans get theirs.

    Nothing is extrapolated: a scan outside the poses of its chain of frames is left out.
    """

    sources: Sources
    options: PosingOptions
    fixed: str | None = None
    """The frame of the map; known when the first frame is resolved."""
    notes: list[str] = field(default_factory=list)
    """What was decided or left out and its user should know; grows, each sentence once."""
    chains: dict[str, Chain | None] = field(default_factory=dict)
    """By scan frame; None where there is no way to it."""

    def __post_init__(self) -> None:
        self._leaps = LeapFilter(self.options.max_speed, self.notes)
        self._noted = set(self.notes)

    @classmethod
    def build(
        cls, samples: Iterable[PoseSample | PoseBatch], options: PosingOptions | None = None
    ) -> Self:
        """Read all samples of a log once, in any order.

        Raises
        ------
        PoseError
            The chosen trajectory is neither a file nor a topic with poses.
        LogError
            The trajectory file cannot be read.
        """
        options = options or PosingOptions()
        sources = gather(samples, options)
        return cls(sources, options, notes=list(sources.notes))

    def resolve(self, frames: Collection[str]) -> None:
        """Find the chains to these scan frames, all from the same fixed frame.

        Raises
        ------
        PoseError
            No frame, of these and earlier ones, has a chain.
        """
        new = sorted(set(frames) - self.chains.keys())
        failures = self._resolve(new)
        if failures and self.fixed is None:
            raise next(iter(failures.values()))
        # Once more, as what mends one laser among others is not what mends a single one.
        failures = self._resolve(failures)
        self.chains.update(dict.fromkeys(failures))
        self._note(*(str(error) for error in failures.values()))

    def _resolve(self, frames: Iterable[str]) -> dict[str, PoseError]:
        """Find the chains to frames, one after the other; say why there is none."""
        failures: dict[str, PoseError] = {}
        for frame in frames:
            try:
                way = resolve(self.sources, self.options, frame, self.fixed)
            except PoseError as error:
                failures[frame] = error
            else:
                self.fixed, self.chains[frame] = way.fixed, way.chain
                self._note(*way.notes)
                if not way.chain.interval_s and self.sources.tree.moves:
                    self._note(f"{frame!r} never moves in {way.fixed!r}, though other frames do")
        return failures

    def attach(self, batch: ScanBatch) -> Attached:
        """Give each scan the pose of its sensor, or each beam where the scan is de-skewed.

        A pose that the log states beside the scan is used as it is, unless the user named a
        trajectory; where the user gave the sensor's pose, it is taken to be the body's.

        Raises
        ------
        PoseError
            No scan frame so far has a chain to the map frame.
        """
        if batch.pose is not None and self.sources.trajectory is None:
            if self.options.sensor_pose is not None:
                self._note(POSES_OF_BODY)
            self._note(*_list_idle(self.options))
            posed = _keep_posed(batch, _read_stated(batch.pose, self.options.sensor_pose))
            return self._leaps.drop(*posed)
        if batch.frame not in self.chains:
            self.resolve([batch.frame])
        chain = self.chains[batch.frame]
        if chain is None:
            return [], {DropReason.NO_TRANSFORM: len(batch.stamp_ns)}
        return self._leaps.drop(*self._look_up(batch, chain))

    def _look_up(self, batch: ScanBatch, chain: Chain) -> Attached:
        """Look up each scan at its stamp, or at moments between its first beam and its last."""
        deskewed = self._find_deskewed(batch, chain)
        if self.options.deskew is Deskew.ON and not deskewed.all():
            some = "some " if deskewed.any() else ""
            found = "state no believable time between beams: not de-skewed"
            self._note(f"{some}scans of {batch.frame!r} {found}")
        if not deskewed.any():
            return _keep_posed(batch, chain.at(self._to_pose_clock(batch)))
        self._note(f"de-skewed: each beam of {batch.frame!r} has a pose of its own")
        if deskewed.all():
            moments_ns = self._to_pose_clock(batch)[:, None] + _spread_moments(batch)
            return _keep_deskewed(batch, chain.at(moments_ns.ravel()), moments_ns.shape[1])
        return _join(*(self._look_up(batch.take(part), chain) for part in (deskewed, ~deskewed)))

    def _to_pose_clock(self, batch: ScanBatch) -> Int64:
        """Tell when the scans (S) began by the clock of the poses (ns)."""
        stamp_ns = np.clip(batch.stamp_ns, -MAX_STAMP_NS, MAX_STAMP_NS)
        return stamp_ns + round(self.options.time_offset_s * 1e9)

    def _find_deskewed(self, batch: ScanBatch, chain: Chain) -> Bool:
        """Tell of each scan (S) whether its beams get poses of their own.

        AUTO asks for a believable scan time and for poses dense enough to show the motion in it.
        """
        if self.options.deskew is Deskew.OFF:
            return np.zeros(len(batch.stamp_ns), np.bool_)
        duration_s = _measure_durations(batch)
        if self.options.deskew is Deskew.ON:
            return (duration_s > 0) & (duration_s <= MAX_TURN_S)
        dense = chain.is_dense(duration_s)
        return dense & (duration_s > 0) & (duration_s <= MAX_AUTO_TURN_S)

    def _note(self, *sentences: str) -> None:
        new = [each for each in dict.fromkeys(sentences) if each not in self._noted]
        self._noted.update(new)
        self.notes.extend(new)


def _list_idle(options: PosingOptions) -> Iterator[str]:
    """Say which options do nothing where the poses stand beside the scans."""
    given = {
        "--map-frame": options.map_frame is not None,
        "--base-frame": options.base_frame is not None,
        "--time-offset": options.time_offset_s != 0,
        "--deskew on": options.deskew is Deskew.ON,
    }
    for flag, is_given in given.items():
        if is_given:
            yield f"{flag} does nothing: the poses stand beside the scans"


def _read_stated(pose: Float64, mount: Pose | None) -> Found:
    """Read the poses (S, 7) that a log states beside its scans, of the sensor or of its body."""
    usable, norm = find_usable(pose)
    pose = np.where(usable[:, None], pose, UNTURNED)
    position = pose[:, :3]
    rotation = rotate_by(pose[:, 3:] / norm[:, None])
    if mount is not None:
        fixed = Track.fixed(mount)
        position = position + apply(rotation, fixed.position)
        rotation = rotation @ rotate_by(fixed.quaternion)
    return Found(position, rotation, np.where(usable, 0, Status.NOT_FINITE).astype(np.uint8))


def _measure_durations(batch: ScanBatch) -> Float64:
    """Measure the time (S,) from the first beam of each scan to its last (s)."""
    with np.errstate(invalid="ignore", over="ignore"):  # a log may state any number
        durations: Float64 = np.abs(batch.time_increment) * (batch.ranges.shape[1] - 1)
    return durations


def _spread_moments(batch: ScanBatch) -> Int64:
    """Spread K moments (S, K) evenly from the first beam of each scan to its last (ns)."""
    beams = batch.ranges.shape[1]
    moments = np.linspace(0, (beams - 1) * batch.time_increment, min(beams, MOMENTS), axis=1)
    moments_ns: Int64 = np.round(moments * 1e9).astype(np.int64)
    return moments_ns


def _keep_posed(batch: ScanBatch, found: Found) -> Attached:
    """Keep the scans (S) that were found."""
    posed, dropped = _judge(found.status)
    if not posed.any():
        return [], dropped
    kept = PosedScans(_take(batch, posed), found.position[posed], found.rotation[posed])
    return [kept], dropped


def _keep_deskewed(batch: ScanBatch, found: Found, moments: int) -> Attached:
    """Keep the scans that were found at all K moments (S * K), and give each beam its pose.

    Between two moments positions and matrices are interpolated linearly. At 720 degrees a second
    and ten scans a second a matrix is then off by 2e-4: 2 mm at ten metres.
    """
    posed, dropped = _judge(found.status.reshape(-1, moments).max(axis=1))
    if not posed.any():
        return [], dropped
    share = _share_moments(batch.ranges.shape[1], moments)
    position = share @ found.position.reshape(-1, moments, 3)[posed]
    rotation = share @ found.rotation.reshape(-1, moments, 9)[posed]
    rotation = rotation.reshape(*rotation.shape[:2], 3, 3)
    return [PosedScans(_take(batch, posed), position, rotation)], dropped


def _share_moments(beams: int, moments: int) -> Float64:
    """Weigh, for each beam (B), the evenly spread moments (K) around it: (B, K)."""
    at = np.linspace(0, moments - 1, beams)
    share: Float64 = np.maximum(0, 1 - np.abs(at[:, None] - np.arange(moments)))
    return share


def _judge(status: UInt8) -> tuple[Bool, dict[DropReason, int]]:
    """Tell which scans (S) are posed; count the others by reason."""
    dropped = {r: n for s, r in REASONS.items() if (n := int(np.count_nonzero(status == s)))}
    return status == Status.POSED, dropped


def _take(batch: ScanBatch, scans: Bool) -> ScanBatch:
    """Some of the scans; their ranges are copied only where these are not all."""
    return batch if scans.all() else batch.take(scans)


def _join(one: Attached, other: Attached) -> Attached:
    return [*one[0], *other[0]], dict(Counter(one[1]) + Counter(other[1]))
