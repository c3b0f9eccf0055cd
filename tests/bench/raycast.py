"""What a laser would measure among solid boxes; compiled, for the workloads are large."""

import numpy as np

from occmap.jit import kernel
from occmap.types import Float64


def cast_scans(poses: Float64, bearings: Float64, boxes: Float64) -> Float64:
    """Return the distance (S, B) to the nearest box, inf where there is none.

    Parameters
    ----------
    poses, bearings, boxes
        (S, 3) x, y, yaw; (B,) rad; (N, 4) x0, y0, x1, y1 (m). No pose lies inside a box.
    """
    ranges = np.empty((len(poses), len(bearings)))
    _cast_scans(poses, bearings, boxes, ranges)
    return ranges


@kernel
def _cast_scans(poses: Float64, bearings: Float64, boxes: Float64, ranges: Float64) -> None:
    for s in range(poses.shape[0]):
        for b in range(bearings.size):
            bearing = poses[s, 2] + bearings[b]
            # A beam along an axis would divide by zero; so little aside changes no range.
            step_x, step_y = 1 / (np.cos(bearing) + 1e-12), 1 / (np.sin(bearing) + 1e-12)
            nearest = np.inf
            for i in range(boxes.shape[0]):
                ax, bx = (boxes[i, 0] - poses[s, 0]) * step_x, (boxes[i, 2] - poses[s, 0]) * step_x
                ay, by = (boxes[i, 1] - poses[s, 1]) * step_y, (boxes[i, 3] - poses[s, 1]) * step_y
                enter = max(min(ax, bx), min(ay, by))
                if 0 < enter < nearest and enter <= min(max(ax, bx), max(ay, by)):
                    nearest = enter
            ranges[s, b] = nearest
