"""What depth cameras see, without what hangs in the air at edges, and less noisy.

They measure one over the depth, which grows evenly along any plane. Some drivers write their images
as clouds: these are told by where their points lie, and are cleaned alike.
"""

import math

import numpy as np

from occmap.jit import kernel
from occmap.types import Bool, Cloud, Float32, Int32

FLYING_M, FLYING_SHARE, FLYING_PIXELS = 0.1, 0.03, 10
"""At an edge, a pixel so far (m, this share of its depth, or widths of a pixel there) from both
things mixes the two"""
EDGE, BESIDE, STEEPER = 2, 3, 2
"""An edge blurs so many pixels; so many more beside them show how a surface slants, and an edge is
so many times as steep"""
RIM = EDGE + BESIDE
FEWEST = 1 << 8
"""Fewer pixels show no noise, and fewer points not if they are pixels"""
AVERAGED, GAP, ROWS = 8, 4, 32
"""Noise is averaged over every second pixel up to here on either side; pixels so far apart in some
rows, at least so many, show how much of it there is"""
ALIKE, QUIET, LOUDEST = 5, 5e-4, 0.01
"""Two pixels lie on the surface of the one between them if they differ from it by so many times the
noise together (1 / m); less noise than this does not matter, and no camera has more"""
NEAREST_M = 1e-3
"""Nearer than this is nothing"""
MARGIN = max(RIM, AVERAGED)
NOTHING = np.float32(np.nan)


def clean(depth: Float32, focal: float) -> Float32:
    """Leave out pixels (H, W) that hang in the air, and average noise; NaN where nothing is left.

    Parameters
    ----------
    depth
        m; below `NEAREST_M` or not finite where nothing came back.
    focal
        How many pixels are a metre at 1 m.
    """
    seen = np.where((depth >= NEAREST_M) & (depth < np.inf), depth, NOTHING)
    wide = np.pad(seen, MARGIN, constant_values=NOTHING)
    width, cleaned = wide.shape[1], wide.reshape(-1)
    inverse, flying = np.reciprocal(cleaned), np.zeros(cleaned.size, np.bool_)
    share = max(FLYING_SHARE, FLYING_PIXELS / focal)
    if (noise := measure_noise(inverse.reshape(wide.shape))) > QUIET:
        total, many = np.empty((2, inverse.size), np.float32)
        for way in (1, width):
            total[:], many[:] = inverse, 1
            for apart in range(2, AVERAGED + 1, 2):
                add_pairs(inverse, apart * way, ALIKE * noise, total, many)
            np.divide(total, many, out=inverse)
        np.reciprocal(inverse, out=cleaned)
    for way in (1, -1, width, -width):
        mark_flying(inverse, way, share, flying)
    cleaned[flying] = NOTHING
    return wide[MARGIN:-MARGIN, MARGIN:-MARGIN]


def measure_noise(inverse: Float32) -> float:
    """Standard deviation of one over the depth (H, W), by how rows bend; 0 where few show it.

    Where most of them bend at edges, as of slats, it is `LOUDEST` at most.
    """
    some = inverse[:: max(len(inverse) // ROWS, 1)]
    bend = np.abs(some[:, 2 * GAP :] + some[:, : -2 * GAP] - 2 * some[:, GAP:-GAP])
    bend = bend[np.isfinite(bend)]
    # The median is that of a normal distribution, and the variance that of three pixels: 1 + 1 + 4.
    noise = 1.4826 * float(np.median(bend)) / math.sqrt(6) if bend.size >= FEWEST else 0.0
    return min(noise, LOUDEST)


# Each loop runs over slices side by side, so that a processor takes many pixels at once.
@kernel
def mark_flying(inverse: Float32, way: int, share: float, flying: Bool) -> None:
    """Mark pixels with something nearer before them, and something farther after them.

    A pole is nearer than both of its sides; and along a surface, however it slants, one over the
    depth grows evenly.

    Parameters
    ----------
    inverse
        (N,) one over the depth, row after row; NaN where nothing came back, and in `MARGIN` rows
        and columns around the image.
    way
        How far it is to the pixel after each.
    share
        How far both are from it at least, as a share of its depth.
    """
    rim, size = RIM * abs(way), inverse.size - 2 * RIM * abs(way)
    ahead, start = inverse[rim - RIM * way :], inverse[rim - EDGE * way :]
    before, here, after = inverse[rim - way :], inverse[rim:], inverse[rim + way :]
    end, beyond, flies = inverse[rim + EDGE * way :], inverse[rim + RIM * way :], flying[rim:]
    least_m, least_share = np.float32(FLYING_M), np.float32(share)
    steeper = np.float32(STEEPER * 2 * EDGE / BESIDE)
    for i in range(size):
        near, far = np.fmax(start[i], before[i]), np.fmin(after[i], end[i])
        slant = np.fmax(ahead[i] - start[i], end[i] - beyond[i]) * steeper
        depth = 1 / here[i]
        least = max(least_m, least_share * depth)
        is_between = (depth - 1 / near > least) & (1 / far - depth > least)
        # Nor is a surface known where nothing shows the slant.
        flies[i] |= is_between & ~(near - far <= slant)


@kernel
def add_pairs(inverse: Float32, apart: int, alike: float, total: Float32, many: Float32) -> None:
    """Add pairs of pixels to those between them where they lie on the same surface.

    Parameters
    ----------
    apart
        How far both are from it.
    alike
        By how much both together differ from it at most.
    """
    size, most = inverse.size - 2 * apart, np.float32(alike)
    before, here, after = inverse[:size], inverse[apart:], inverse[2 * apart :]
    totals, counts = total[apart:], many[apart:]
    for i in range(size):
        is_alike = abs(before[i] - here[i]) + abs(after[i] - here[i]) < most
        totals[i] += before[i] + after[i] if is_alike else np.float32(0)
        counts[i] += np.float32(2) if is_alike else np.float32(0)


SAMPLE, STRIDE = 1 << 12, 7919
"""So many points show if all are pixels, at steps that are in time with no row"""
FINEST, OFF, MOST_PIXELS, MOST_EMPTY = 1e-4, 0.2, 1 << 12, 16
"""A pixel is wider than this (m at 1 m), points lie so far (pixels) from its middle at most, and no
more pixels from one another, in an image of no more pixels for each of them"""


def clean_cloud(cloud: Cloud) -> Cloud:
    """Clean a cloud as images are, if a depth camera may have seen all its points at once and did.

    It looks along z, and its pixels are even steps of x / z and of y / z.
    """
    points = cloud.points
    if not cloud.may_be_image or len(points) < FEWEST:
        return cloud
    if (points[:: len(points) // 64, 2] < 0).any():  # as nearly all others have
        return cloud
    stride = STRIDE + (len(points) % STRIDE == 0)
    some = points[np.arange(min(SAMPLE, len(points))) * stride % len(points)]
    some = some[some[:, 2] != 0]
    if not (some[:, 2] >= 0).any() or (some[:, 2] < 0).any():
        return cloud
    with np.errstate(invalid="ignore", over="ignore"):  # a flipped bit makes any number
        across, down = find_step(some[:, 0] / some[:, 2]), find_step(some[:, 1] / some[:, 2])
    if not (across and down):
        return cloud
    points, pixels = np.array(points), np.empty((3, len(points)), np.int32)
    many = place_pixels(points.reshape(-1), across, down, pixels)
    which, col, row = pixels[:, :many]
    if many == 0 or np.ptp(col) * np.ptp(row) > MOST_EMPTY * many:  # a flipped bit, too
        return cloud
    depth = np.zeros((np.ptp(row) + 1, np.ptp(col) + 1), np.float32)
    place = (row - row.min()) * depth.shape[1] + (col - col.min())
    depth.reshape(-1)[place] = points[which, 2]
    cleaned = clean(depth, 1 / max(across[1], down[1])).reshape(-1)
    move_points(points.reshape(-1), which, cleaned[place])
    return cloud._replace(points=points)


def find_step(slopes: Float32) -> tuple[float, float] | None:
    """Find the least of some slopes, and the width of a pixel, if they are even steps."""
    order = np.sort(slopes[np.isfinite(slopes)]).astype(np.float64)
    gaps = np.diff(order)
    if not (gaps > FINEST).any():
        return None
    steps = np.rint(gaps / np.median(gaps[gaps > FINEST])).cumsum()
    width = (order[-1] - order[0]) / max(steps[-1], 1)
    is_even = np.abs((order[1:] - order[0]) / width - steps).max() < OFF
    return (float(order[0]), float(width)) if is_even else None


@kernel
def place_pixels(
    points: Float32, across: tuple[float, float], down: tuple[float, float], pixels: Int32
) -> int:
    """Say in which column and row some points (3 N,) lie, if not far off; return how many do.

    Parameters
    ----------
    across, down
        Slopes in the middle of a column and of a row, and how far it is to the next.
    pixels
        (3, N) which points were seen, their columns and their rows; written.
    """
    many = 0
    for i in range(points.size // 3):
        x, y, z = points[3 * i], points[3 * i + 1], points[3 * i + 2]
        if 0 < z < np.inf and np.isfinite(x) and np.isfinite(y):
            col, row = (x / z - across[0]) / across[1], (y / z - down[0]) / down[1]
            if max(abs(col), abs(row)) <= MOST_PIXELS:
                pixels[0, many], pixels[1, many], pixels[2, many] = i, np.rint(col), np.rint(row)
                many += 1
    return many


@kernel
def move_points(points: Float32, which: Int32, depth: Float32) -> None:
    """Move some of the points (3 N,) to where their depths are as given; NaN where that is NaN."""
    for k in range(which.size):
        at = 3 * which[k]
        scale = depth[k] / points[at + 2]
        for axis in range(3):
            points[at + axis] *= scale
