"""Transforms: where one frame was in another, at many moments at once."""

from enum import IntEnum
from typing import NamedTuple, Self

import numpy as np

from occmap.arrays import Float64, UInt8
from occmap.posing.rotations import rotate_by
from occmap.posing.tracks import Track, find_usable
from occmap.types import Pose

UNMOVED = Pose.planar(0.0, 0.0, 0.0)
"""Stands in for a pose that cannot be used."""


class Status(IntEnum):
    """Whether there is a pose at a stamp, and if not, why; the names are those of `DropReason`.

    Of the legs of a chain, the one with the highest number counts.
    """

    POSED = 0
    BEFORE = 1
    AFTER = 2
    GAP = 3
    NOT_FINITE = 4
    NO_TRANSFORM = 5


class Transforms(NamedTuple):
    """Where one frame was in another at N stamps, or at all times (N = 1)."""

    position: Float64
    """(N, 3) m; like the rotation, meaningless where the status is not POSED"""
    rotation: Float64
    """(N, 3, 3)"""
    status: UInt8
    """(N,) of Status"""

    @classmethod
    def of(cls, position: Float64, quaternion: Float64) -> Self:
        """Make it of positions (N, 3) in m and unit quaternions (N, 4)."""
        return cls(position, rotate_by(quaternion), np.zeros(len(position), np.uint8))

    @classmethod
    def fixed(cls, pose: Pose) -> Self:
        """Make it of one pose that holds at all times."""
        track = Track.fixed(pose)
        return cls.of(track.position, track.quaternion)

    @classmethod
    def read(cls, poses: Float64) -> Self:
        """Make it of poses (N, 7) as they were recorded, of which some may be unusable."""
        usable, norm = find_usable(poses)
        poses = np.where(usable[:, None], poses, UNMOVED)
        found = cls.of(poses[:, :3], poses[:, 3:] / norm[:, None])
        found.status[~usable] = Status.NOT_FINITE
        return found

    def then(self, below: Self) -> Self:
        """Go on to a frame that was found in this one."""
        return type(self)(
            self.position + turn(self.rotation, below.position),
            self.rotation @ below.rotation,
            np.maximum(self.status, below.status),
        )

    def invert(self) -> Self:
        """Where the upper frame was in the lower one."""
        back = self.rotation.swapaxes(1, 2)
        return type(self)(-turn(back, self.position), back, self.status)


def turn(rotation: Float64, position: Float64) -> Float64:
    """Rotate vectors (N, 3) by matrices (N, 3, 3); either N may be 1."""
    turned: Float64 = (rotation @ position[..., None])[..., 0]
    return turned
