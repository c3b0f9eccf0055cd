"""Trajectories as text: where the laser was at each scan, in the two forms that evo reads.

The poses are those of the laser in the map, at the scans that the map was made of, by ascending
time. Where several lasers or logs went into the map, one after the other follows.
"""

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from occmap.types import Journey, Trajectory
from occmap.writers import Product, WriteOptions
from occmap.writers.atomic import open_atomic


class TumWriter:
    """`stamp x y z qx qy qz qw`, the stamp in seconds: for `evo_traj tum`, and for `poses`."""

    description = "trajectory in the TUM format, for evo, and to build with"
    needs_evidence, needs_journey = False, True

    def targets(self, path: Path) -> tuple[Path, ...]:
        """Return the file."""
        return (path,)

    def write_product(self, path: Path, product: Product, _: WriteOptions) -> tuple[Path, ...]:
        """Write the poses; return the file's path.

        Raises
        ------
        UsageError, OutputError
            Nobody kept them, or the file cannot be written.
        """
        write_lines(path, list_tum(product.take_journey(path)))
        return (path,)


class EurocWriter(TumWriter):
    """`stamp,x,y,z,qw,qx,qy,qz`, the stamp in nanoseconds: `evo_traj euroc`, and spreadsheets."""

    description = "trajectory as CSV in the form of EuRoC, for evo"

    def write_product(self, path: Path, product: Product, _: WriteOptions) -> tuple[Path, ...]:
        """Write the poses; return the file's path.

        Raises
        ------
        UsageError, OutputError
            As in the TUM format.
        """
        write_lines(path, list_euroc(product.take_journey(path)))
        return (path,)


def list_tum(journey: Journey) -> Iterator[str]:
    """Write a line for each pose; a stamp has all of its nanoseconds."""
    yield "# stamp x y z qx qy qz qw (s, m)"
    for trajectory in journey.trajectories:
        yield describe(trajectory)
        for stamp_ns, pose in list_poses(trajectory):
            sign, (seconds, rest) = "-" * (stamp_ns < 0), divmod(abs(stamp_ns), 10**9)
            yield " ".join([f"{sign}{seconds}.{rest:09}", *(f"{number:.9g}" for number in pose)])


def list_euroc(journey: Journey) -> Iterator[str]:
    """Write a line for each pose; the scalar part of the quaternion comes first."""
    yield "#timestamp [ns],p_x [m],p_y [m],p_z [m],q_w [],q_x [],q_y [],q_z []"
    for trajectory in journey.trajectories:
        yield describe(trajectory)
        for stamp_ns, (x, y, z, qx, qy, qz, qw) in list_poses(trajectory):
            yield ",".join([str(stamp_ns), *(f"{each:.9g}" for each in (x, y, z, qw, qx, qy, qz))])


def describe(trajectory: Trajectory) -> str:
    """Say in a comment whose poses follow."""
    names = f"{trajectory.frame} in {trajectory.parent}, at the scans of {trajectory.topic}"
    return "# " + "".join(c if c.isprintable() else "?" for c in names)


def list_poses(trajectory: Trajectory) -> Iterator[tuple[int, list[float]]]:
    """Give stamps and poses by ascending time; logs have scans that come late."""
    order = np.argsort(trajectory.stamp_ns, kind="stable")
    stamps, poses = trajectory.stamp_ns[order], trajectory.pose[order]
    yield from zip(stamps.tolist(), poses.tolist(), strict=True)


def write_lines(path: Path, lines: Iterator[str]) -> None:
    """Write a text file whole or not at all; raises OutputError."""
    with open_atomic(path) as (file,):
        for line in lines:
            file.write(f"{line}\n".encode())
