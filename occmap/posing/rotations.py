"""Vectorised rotations: quaternions as (N, 4) rows of x, y, z, w; matrices as (N, 3, 3)."""

import numpy as np

from occmap.types import Float64

STRAIGHT_RAD = 1e-6
"""Below this angle a great arc and its chord differ by less than 1e-12: no sine is divided by."""


def rotate_by(quaternion: Float64) -> Float64:
    """Turn unit quaternions (N, 4) into rotation matrices (N, 3, 3)."""
    x, y, z, w = quaternion.T
    matrix = np.empty((len(quaternion), 3, 3))
    matrix[:, 0, 0] = 1 - 2 * (y * y + z * z)
    matrix[:, 0, 1] = 2 * (x * y - z * w)
    matrix[:, 0, 2] = 2 * (x * z + y * w)
    matrix[:, 1, 0] = 2 * (x * y + z * w)
    matrix[:, 1, 1] = 1 - 2 * (x * x + z * z)
    matrix[:, 1, 2] = 2 * (y * z - x * w)
    matrix[:, 2, 0] = 2 * (x * z - y * w)
    matrix[:, 2, 1] = 2 * (y * z + x * w)
    matrix[:, 2, 2] = 1 - 2 * (x * x + y * y)
    return matrix


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
    quaternion: Float64 = rows / np.linalg.norm(rows, axis=1, keepdims=True)
    return quaternion


def measure_turn(start: Float64, end: Float64) -> Float64:
    """Angles (N,) in [0, pi] between two rotation matrices (3, 3), or one and each of (N, 3, 3).

    The trace of a rotation matrix, such as that from the one to the other, is 1 + 2 cos of it.
    """
    trace = np.einsum("ij,...ij->...", start, end)
    angle: Float64 = np.arccos(np.clip((trace - 1) / 2, -1, 1))
    return angle


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
    side = np.einsum("ij,ij->i", start, end)
    return np.where(side[:, None] < 0, -end, end)


def _half_chords(start: Float64, end: Float64) -> tuple[Float64, Float64]:
    """Sine and cosine, up to one factor, of half the arc: exact at small angles, as acos is not."""
    apart, along = end - start, end + start
    return (
        np.sqrt(np.einsum("ij,ij->i", apart, apart)),
        np.sqrt(np.einsum("ij,ij->i", along, along)),
    )
