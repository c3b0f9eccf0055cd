"""Compile the kernels of a build now, to ship them: `python -m occmap.grid.warm` in a container."""

import numpy as np

from occmap.grid.engine import GridEngine
from occmap.grid.lattice import Lattice
from occmap.grid.spec import GridSpec, tabulate
from occmap.types import Kind, Rays, Update


def compile_kernels() -> None:
    """Trace one scan by every update, for counts and for a radial model."""
    rays = Rays(
        origin=np.zeros((1, 1, 2)),
        turn=np.eye(2)[None, None],
        bearing=np.array([[1.0, 0.0], [0.0, 1.0]]),
        distance=np.ones((1, 2), np.float32),
        kind=np.full((1, 2), Kind.HIT, np.uint8),
        stamp_ns=np.zeros(1, np.int64),
        full_circle=False,
    )
    tables = tabulate(lambda u: 0.4 + 0.1 * u, lambda w: 0.6 - 0.1 * w, depth=0.05)
    for update in Update:
        for radial in (None, tables):
            engine = GridEngine(GridSpec(update, Lattice(0.05), radial=radial))
            engine.add(rays)
            engine.finish()


if __name__ == "__main__":
    compile_kernels()
