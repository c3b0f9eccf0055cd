"""Compile the kernels of a build now, to ship them: `python -m occmap.grid.warm` in a container."""

import numpy as np

from occmap.grid.engine import GridEngine
from occmap.grid.lattice import Lattice
from occmap.grid.spec import GridSpec, tabulate
from occmap.types import Kind, Rays, Update


def compile_kernels() -> None:
    """Trace few scans and many by every update, for counts and for a radial model."""
    tables = tabulate(lambda u: 0.4 + 0.1 * u, lambda w: 0.6 - 0.1 * w, depth=0.05)
    for update in Update:
        for radial in (None, tables):
            warm_up(GridSpec(update, Lattice(0.05), radial=radial))


def warm_up(spec: GridSpec) -> None:
    """Compile or load the kernels of one grid: those for few scans, and those for many."""
    engine = GridEngine(spec)
    for scans in (1, 500):
        engine.add(make_scans(scans))
    engine.finish()


def make_scans(scans: int) -> Rays:
    """A corner of a room, from one place."""
    return Rays(
        origin=np.zeros((scans, 1, 2)),
        turn=np.tile(np.eye(2), (scans, 1, 1, 1)),
        bearing=np.array([[1.0, 0.0], [0.0, 1.0]]),
        distance=np.ones((scans, 2), np.float32),
        kind=np.full((scans, 2), Kind.HIT, np.uint8),
        stamp_ns=np.zeros(scans, np.int64),
        full_circle=False,
    )


if __name__ == "__main__":
    compile_kernels()
