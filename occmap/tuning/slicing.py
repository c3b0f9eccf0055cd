"""A planar scan out of each cloud, at the height of its sensor, as a laser there would take it.

Walls are sharp in such scans where time and mount are right. For the map itself clouds are not cut.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from occmap.sensor import ReturnOptions
from occmap.types import Float64, Int64, Kind, PosedScans, Rays

BEAMS = 720
BAND_M = 0.2
"""Points that lie less far above or below their sensor are of its planar scan"""
KEPT_BAND_M, KEPT_POINTS = 0.6, 10_000
"""Of about so many points of a cloud those are kept that may lie in the band by other poses"""
NEAREST_M, FARTHEST_M = 0.3, 30.0


def thin_clouds(posed: PosedScans) -> PosedScans:
    """Keep, of clouds, copies of some points that lie near the height of their sensor."""
    every = [len(cloud.points) // KEPT_POINTS + 1 for cloud in posed.batch.clouds or ()]
    some = take_points(posed, [slice(None, None, stride) for stride in every])
    near = [np.flatnonzero(np.abs(away[:, 2]) < KEPT_BAND_M) for away, _ in list_away(some)]
    return take_points(some, near)


def take_points(posed: PosedScans, chosen: Sequence[slice | Int64]) -> PosedScans:
    """Take of each cloud the points that are chosen of it."""
    kept = []
    for cloud, which in zip(posed.batch.clouds or (), chosen, strict=True):
        times = None if cloud.offset_ns is None else cloud.offset_ns[which]
        kept.append(cloud._replace(points=cloud.points[which], offset_ns=times))
    return replace(posed, batch=replace(posed.batch, clouds=tuple(kept)))


def slice_clouds(posed: PosedScans, options: ReturnOptions) -> Rays:
    """Make a planar scan of each cloud: of each half degree the nearest point in the band."""
    scans = len(posed.batch.stamp_ns)
    origin, direction = np.zeros((scans, 1, 2)), np.zeros((scans, BEAMS, 2))
    distance, kind = np.zeros((scans, BEAMS), np.float32), np.zeros((scans, BEAMS), np.uint8)
    nearest, farthest = max(NEAREST_M, options.min_range), min(FARTHEST_M, options.max_range)
    for scan, (away, sensor) in enumerate(list_away(posed)):
        reach = np.hypot(away[:, 0], away[:, 1])
        seen = (np.abs(away[:, 2]) < BAND_M) & (reach > nearest) & (reach < farthest)
        order = np.flatnonzero(seen)[np.argsort(-reach[seen], kind="stable")]
        x_y, length = away[order, :2], reach[order]
        bearing = np.arctan2(x_y[:, 1], x_y[:, 0]) * (BEAMS / math.tau)
        beam = np.floor(bearing).astype(np.int64) % BEAMS
        # Of several points of a beam the last one is kept, which is the nearest.
        direction[scan, beam], distance[scan, beam] = x_y / length[:, np.newaxis], length
        kind[scan, beam], origin[scan, 0] = Kind.HIT, sensor[:2]
    stamp_ns = posed.batch.stamp_ns
    return Rays.along(origin, direction, distance, kind, stamp_ns, full_circle=True)


def list_away(posed: PosedScans) -> Iterator[tuple[Float64, Float64]]:
    """List for each cloud where its points lie from its sensor (N, 3), and where that is (3,) (m).

    Both are turned as the map is.
    """
    from occmap.clouds.ground import pose_points  # noqa: PLC0415  late: it brings LLVM
    from occmap.clouds.kernels.heights import list_clouds  # noqa: PLC0415  likewise

    for cloud in list_clouds(posed):
        points, pose = pose_points(cloud, len(cloud.points))
        turned = np.einsum("nij,nj->ni", pose[:, :, :3], points)
        yield turned + pose[:, :, 3] - cloud.origin, cloud.origin
