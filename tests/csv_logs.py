"""Writes logs of scans that are worked out as arrays."""

from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike


def write_scans(
    path: Path, stamps: ArrayLike, ranges: ArrayLike, poses: ArrayLike | None = None, **head: float
) -> Path:
    """Write a CSV of scans.

    Parameters
    ----------
    stamps, ranges, poses
        (S,) s; (S, B) m; (S, 3) x, y (m) and yaw (rad), where the log states them.
    head
        What all scans share, such as `angle_increment`.
    """
    values = np.asarray(ranges, float)
    names = ["stamp", *([] if poses is None else ["x", "y", "yaw"])]
    names += [f"r{beam}" for beam in range(values.shape[1])]
    table = np.column_stack([stamps, *([] if poses is None else [poses]), values])
    lines = [*(f"# {name}: {value!r}" for name, value in head.items()), ",".join(names)]
    np.savetxt(path, table, "%.12g", ",", header="\n".join(lines), comments="")
    return path


def write_poses(path: Path, stamps: ArrayLike, poses: ArrayLike) -> Path:
    """Write a CSV of poses: (S,) s; (S, 3) x, y (m) and yaw (rad)."""
    table = np.column_stack([stamps, poses])
    np.savetxt(path, table, "%.12g", ",", header="stamp,x,y,yaw", comments="")
    return path
