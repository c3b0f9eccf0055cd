"""Poses in the plane, as the text formats state them."""

import math

import numpy as np

from occmap.types import UNKNOWN_POSE, Float64, Pose


def stack_planar(x: Float64, y: Float64, yaw: Float64) -> Float64:
    """Build poses (S, 7) from places and headings (S,), as `Pose.planar` does.

    A pose of which one of the three is not finite is unknown.
    """
    poses = np.zeros((len(x), 7))
    is_known = np.isfinite(x + y + yaw)
    half = (np.where(is_known, yaw, 0.0) / 2).tolist()
    poses[:, 0], poses[:, 1] = x, y
    poses[:, 5], poses[:, 6] = list(map(math.sin, half)), list(map(math.cos, half))
    poses[~is_known] = UNKNOWN_POSE
    return poses


def make_planar(x: float, y: float, yaw: float) -> Pose:
    """Build one pose likewise."""
    return Pose.planar(x, y, yaw) if math.isfinite(x + y + yaw) else UNKNOWN_POSE
