"""Clouds as kernels take them: points, and the poses that they were measured from."""

from collections.abc import Iterator

import numpy as np

from occmap.clouds.kernels.heights import Cloud, choose_moments
from occmap.types import Cloud as RecordedCloud
from occmap.types import Float32, Int32, PosedScans

ALL_AT_ONCE = np.zeros(0, np.int32)
"""All points of a cloud have one pose."""


def list_clouds(posed: PosedScans) -> Iterator[Cloud]:
    """List clouds with their poses, one for each cloud or several over its time."""
    place = np.concatenate(
        [posed.rotation, posed.position[..., None]], axis=-1
    )  # (S, 3, 4) or (S, M, 3, 4)
    if place.ndim == 3:
        place = place[:, None]
    middle = place[:, place.shape[1] // 2, :, 3]
    origins = np.ascontiguousarray(middle if posed.origin is None else posed.origin)
    for cloud, poses, origin in zip(posed.batch.clouds or (), place, origins, strict=True):
        yield Cloud(pack_points(cloud.points), find_moments(cloud, len(poses)), poses, origin)


def pack_points(points: Float32) -> Float32:
    """Bring points (N, 3) that may lie among other fields of a message side by side."""
    if points.flags.carray:
        return points
    packed = np.empty((len(points), 1), "V12")  # three floats at once: 2 to 4 times as fast
    packed[:] = points.view("V12")
    return packed.view(np.float32)


def find_moments(cloud: RecordedCloud, moments: int) -> Int32:
    """Find which of a cloud's poses each of its points has (N,); empty where there is one."""
    offset_ns = cloud.offset_ns
    if moments == 1 or offset_ns is None:
        return ALL_AT_ONCE
    start, stop = int(offset_ns.min()), int(offset_ns.max())
    nearest = np.empty(len(offset_ns), np.int32)
    choose_moments(offset_ns, start, (moments - 1) / max(stop - start, 1), nearest)
    return nearest
