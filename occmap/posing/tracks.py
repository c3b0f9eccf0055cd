"""Tracks: where one frame was in another over time.

Rotations are vectorised: quaternions as (N, 4) rows of x, y, z, w; matrices as (N, 3, 3).
"""

from array import array
from dataclasses import dataclass
from functools import cached_property
from typing import Self

import numpy as np

from occmap.types import Bool, Float64, Int64, Pose, PosedScans

STRAIGHT_RAD = 1e-6
"""Below this angle a great arc and its chord differ by less than 1e-12: no sine is divided by."""


def rotate_by(quaternion: Float64) -> Float64:
    """Turn unit quaternions (N, 4) into rotation matrices (N, 3, 3)."""
    x, y, z, w = quaternion.T
    entries = [
        *(1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)),
        *(2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)),
        *(2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)),
    ]
    return np.stack(entries, axis=-1).reshape(-1, 3, 3)


def to_quaternions(matrix: Float64) -> Float64:
    """Turn rotation matrices (N, 3, 3) into unit quaternions (N, 4) with w >= 0 (Shepperd 1978).

    The rows of `products` are the quaternion times each of its own components, and 4. The row of
    the largest component is divided by nothing small, so it is exact for every rotation.
    """
    (xx, xy, xz), (yx, yy, yz), (zx, zy, zz) = matrix.transpose(1, 2, 0)
    products = np.array(
        [
            [1 + xx - yy - zz, xy + yx, xz + zx, zy - yz],
            [xy + yx, 1 - xx + yy - zz, yz + zy, xz - zx],
            [xz + zx, yz + zy, 1 - xx - yy + zz, yx - xy],
            [zy - yz, xz - zx, yx - xy, 1 + xx + yy + zz],
        ]
    )
    largest = np.einsum("iin->in", products).argmax(axis=0)
    rows = products[largest, :, np.arange(len(matrix))]
    rows *= np.where(rows[:, 3:] < 0, -1, 1)
    return np.asarray(rows / np.linalg.norm(rows, axis=1, keepdims=True))


def list_poses(scans: PosedScans) -> Float64:
    """(S, 7) x y z qx qy qz qw of the sensor; at the first beam where every beam has its own."""
    position, rotation = scans.at_first_beam
    return np.column_stack([position, to_quaternions(rotation)])


def angle_between(start: Float64, end: Float64) -> Float64:
    """Angles (N,) in [0, pi] between the rotations of unit quaternions (N, 4) each."""
    return 4 * np.arctan2(*_half_chords(start, _nearer(start, end)))


def slerp(start: Float64, end: Float64, fraction: Float64) -> Float64:
    """Turn from `start` to `end` (N, 4) at constant rate along the shorter arc (Shoemake 1985).

    `fraction` is (N,) in [0, 1]; q and -q are one rotation. Returns unit quaternions (N, 4).
    """
    end = _nearer(start, end)
    arc = 2 * np.arctan2(*_half_chords(start, end))
    straight = arc < STRAIGHT_RAD
    divisor = np.where(straight, 1.0, np.sin(arc))
    from_start = np.where(straight, 1 - fraction, np.sin((1 - fraction) * arc) / divisor)
    from_end = np.where(straight, fraction, np.sin(fraction * arc) / divisor)
    return from_start[:, None] * start + from_end[:, None] * end


def _nearer(start: Float64, end: Float64) -> Float64:
    """Choose `end` or -`end`, which are one rotation: the one that is nearer to `start`."""
    return np.where(np.einsum("ij,ij->i", start, end)[:, None] < 0, -end, end)


def _half_chords(start: Float64, end: Float64) -> tuple[Float64, Float64]:
    """Sine and cosine, up to one factor, of half the arc: exact at small angles, as acos is not."""
    apart, along = (np.einsum("ij,ij->i", it, it) for it in (end - start, end + start))
    return np.sqrt(apart), np.sqrt(along)


FIXED_M = 1e-4
FIXED_RAD = 1e-4
"""A frame that moves by no more than this in a whole log is taken as mounted."""

MAX_STAMP_NS = 2**62
"""The latest stamp, in the year 2116: a later one is damage. Differences of two fit an int64."""

MAX_VALUE = 1e12
"""The largest coordinate (m): light takes an hour for it, and sums stay finite."""


@dataclass(frozen=True, eq=False)
class Track:
    """Poses of one frame in another, by time; never empty."""

    stamp_ns: Int64
    """(N,), strictly increasing"""
    position: Float64
    """(N, 3) m"""
    quaternion: Float64
    """(N, 4) unit x y z w"""
    static: bool = False
    """The log says that it holds at all times; N = 1."""
    set_back_s: float = 0.0
    """By how much stamps went back, at most, from one moment of recording to the next"""

    @classmethod
    def fixed(cls, pose: Pose) -> Self:
        """Make the track of something bolted on, from a finite pose with a rotation."""
        values = np.array([pose], dtype=np.float64)
        unit = values[:, 3:] / np.linalg.norm(values[:, 3:])
        return cls(np.zeros(1, np.int64), values[:, :3], unit, static=True)

    def hold_last(self) -> Self:
        """Make the track in which the last pose holds at all times."""
        last = self.stamp_ns[-1:], self.position[-1:], self.quaternion[-1:]
        return type(self)(*last, static=True)

    def repeats(self, other: Self) -> bool:
        """Whether two tracks are one that was sent twice: of either some samples may be lost."""
        _, here, there = np.intersect1d(self.stamp_ns, other.stamp_ns, return_indices=True)
        if fixed := not (self.moves or other.moves):  # it may be sent at any time
            here = there = np.arange(1)
        is_same = np.array_equal(self.position[here], other.position[there])
        is_same &= np.array_equal(self.quaternion[here], other.quaternion[there])
        return is_same and (fixed or 2 * len(here) > min(len(self), len(other)))

    def __len__(self) -> int:
        return len(self.stamp_ns)

    @cached_property
    def moves(self) -> bool:
        """Whether the pose ever changes: fixed transforms are sent on /tf, too, in old logs."""
        return len(self) > 1 and differ(self.position, self.quaternion)

    @cached_property
    def interval_s(self) -> Float64:
        """(N - 1,) seconds between neighbouring samples."""
        return np.diff(self.stamp_ns) / 1e9

    @cached_property
    def step_m(self) -> Float64:
        """(N - 1,) metres between neighbouring samples."""
        return np.asarray(np.linalg.norm(np.diff(self.position, axis=0), axis=1))

    @cached_property
    def step_rad(self) -> Float64:
        """(N - 1,) radians between neighbouring samples."""
        return angle_between(self.quaternion[:-1], self.quaternion[1:])


class TrackBuilder:
    """Gathers samples in any order of time, 72 bytes each, and makes a track of them."""

    def __init__(self) -> None:
        self._times = array("q")
        self._values = array("d")
        self.unusable = 0
        """Samples that were left out: not usable (`find_usable`), or with no sound stamp"""

    def add(self, stamp_ns: int | Int64, record_ns: int | Int64, pose: Pose | Float64) -> None:
        """Take a sample, or many (N,): when it counts, when it was recorded, and its pose (7,)."""
        self._times.frombytes(np.array([stamp_ns, record_ns], np.int64).T.tobytes())
        self._values.frombytes(np.array(pose, np.float64).tobytes())

    @property
    def samples(self) -> tuple[Int64, Float64]:
        """(N, 2) sound stamps and times of recording, and (N, 7) poses, as they came."""
        times = np.frombuffer(self._times, np.int64).reshape(-1, 2)
        sound = (times == np.clip(times, -MAX_STAMP_NS, MAX_STAMP_NS)).all(axis=1)
        return times[sound], np.frombuffer(self._values, np.float64).reshape(-1, 7)[sound]

    def build(self) -> Track | None:
        """Sort what was gathered; None where nothing is usable.

        Of several samples with one stamp the one recorded last stays, and of those recorded at
        once the one that was added last.
        """
        times, values = self.samples
        usable, norm = find_usable(values)
        usable[find_unset(times, values)] = False
        self.unusable = int(len(self._times) // 2 - usable.sum())
        kept = np.flatnonzero(usable)
        if not len(kept):
            return None
        stamp, record = times.T
        set_back_s = measure_set_back(stamp[kept], record[kept])
        kept = kept[np.lexsort((record[kept], stamp[kept]))]
        kept = kept[np.append(np.diff(stamp[kept]) > 0, True)]
        unit = values[kept, 3:] / norm[kept, None]
        return Track(stamp[kept], values[kept, :3], unit, set_back_s=set_back_s)


def find_unset(times: Int64, values: Float64) -> Int64:
    """Find the samples whose stamp was never set, as before the clock of a simulator runs.

    It is zero, and so is the next one, recorded later at another place. Of a log without any stamps
    others say what can be done, and a simulation that begins anew is at zero once each time.

    Parameters
    ----------
    times
        (N, 2) stamps, and when they were recorded (ns).
    """
    zero, later = times[:, 0] == 0, np.diff(times[:, 1]) > 0
    at_zero = values[zero]
    is_unset = not zero.all() and (zero[1:] & zero[:-1] & later).any()
    return np.flatnonzero(zero & (is_unset and differ(at_zero[:, :3], at_zero[:, 3:])))


def measure_set_back(stamp_ns: Int64, record_ns: Int64) -> float:
    """Measure by how many seconds stamps (N,) went back at most while the recorder's went on.

    Of what was recorded at once the latest counts: a path is sent again and again from its start.
    """
    if (stamp_ns == record_ns).all():  # the log knows one time only, or the user chose the other
        return 0.0
    order = np.lexsort((stamp_ns, record_ns))
    latest = stamp_ns[order][np.append(np.diff(record_ns[order]) > 0, True)]
    return float(-np.diff(latest).min(initial=0)) / 1e9


def differ(
    position: Float64, quaternion: Float64, far_m: float = FIXED_M, far_rad: float = FIXED_RAD
) -> bool:
    """Whether any of the poses, (N, 3) m and (N, 4), differs from the first by more than that."""
    far = float(np.abs(position - position[:1]).max(initial=0))
    first = np.broadcast_to(quaternion[:1], quaternion.shape)
    return far > far_m or float(angle_between(first, quaternion).max(initial=0)) > far_rad


def find_usable(values: Float64) -> tuple[Bool, Float64]:
    """Find which rows (N, 7) are poses: finite, within MAX_VALUE, and with a rotation.

    Returns
    -------
    usable, norm
        (N,) whether each is, and the norm of its quaternion; 1 where it is not.
    """
    finite: Bool = np.all(np.abs(values) <= MAX_VALUE, axis=1)
    quaternion = np.where(finite[:, None], values[:, 3:], 0)
    norm = np.sqrt(np.einsum("ij,ij->i", quaternion, quaternion))
    usable = norm > 0
    return usable, np.where(usable, norm, 1)
