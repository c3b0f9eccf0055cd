"""Trajectories as text: where the laser was at each scan, in the two forms that evo reads.

The poses are those of the laser in the map, at the scans that the map was made of, by ascending
time. Where several lasers or logs went into the map, one after the other follows.
"""

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from occmap.errors import UsageError
from occmap.types import Journey, Trajectory
from occmap.writers import Product, WriteOptions, Writer
from occmap.writers.atomic import open_atomic


class TumWriter(Writer):
    """`stamp x y z qx qy qz qw`, the stamp in seconds: for `evo_traj tum`, and for `poses`."""

    description = "trajectory in the TUM format, for evo, and to build with"
    heading = "# stamp x y z qx qy qz qw (s, m)"
    needs_journey = shows_journey = True

    def write_product(self, path: Path, product: Product, _: WriteOptions) -> None:
        """Write the poses.

        Raises
        ------
        UsageError, OutputError
            Nobody kept them, or the file cannot be written.
        """
        if product.journey is None:
            found = "the map does not say where the robot went, only its logs do"
            raise UsageError(found, where=path, fix="name this file among the outputs of the build")
        with open_atomic(path) as (file,):
            for line in self.list_lines(product.journey):
                file.write(f"{line}\n".encode())

    def list_lines(self, journey: Journey) -> Iterator[str]:
        """Write a heading and a line for each pose, with a comment where another laser follows."""
        yield self.heading
        for trajectory in journey.trajectories:
            yield describe(trajectory)
            order = np.argsort(trajectory.stamp_ns, kind="stable")  # logs have scans that come late
            stamps, poses = trajectory.stamp_ns[order], trajectory.pose[order]
            yield from map(self.write_pose, stamps.tolist(), poses.tolist())

    def write_pose(self, stamp_ns: int, pose: list[float]) -> str:
        """Write a line; the stamp has all of its nanoseconds."""
        sign, (seconds, rest) = "-" * (stamp_ns < 0), divmod(abs(stamp_ns), 10**9)
        return " ".join([f"{sign}{seconds}.{rest:09}", *map(write_number, pose)])


class EurocWriter(TumWriter):
    """`stamp,x,y,z,qw,qx,qy,qz`, the stamp in nanoseconds: `evo_traj euroc`, and spreadsheets."""

    description = "trajectory as CSV in the form of EuRoC, for evo"
    heading = "#timestamp [ns],p_x [m],p_y [m],p_z [m],q_w [],q_x [],q_y [],q_z []"

    def write_pose(self, stamp_ns: int, pose: list[float]) -> str:
        """Write a line; the scalar part of the quaternion comes first."""
        *vector, scalar = pose
        return ",".join([str(stamp_ns), *map(write_number, [*vector[:3], scalar, *vector[3:]])])


def write_number(number: float) -> str:
    """Write eight decimals, also of a place in UTM, or nine digits where these are more."""
    return f"{number:.{8 + len(str(int(abs(number))))}g}"


def describe(trajectory: Trajectory) -> str:
    """Say in a comment whose poses follow."""
    names = f"{trajectory.frame} in {trajectory.parent}, at the scans of {trajectory.topic}"
    return "# " + "".join(c if c.isprintable() else "?" for c in names)
