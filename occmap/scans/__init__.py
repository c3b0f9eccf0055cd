"""The steps of a build: from the path of a log to what its scans observe.

`tracing.trace_drive` is the way of a log. `check`, `compare`, `tune` and `explain` go it, too. Here
are the engine for rays, and the empty grids, for an update and a model; and what a sample of scans
is judged by.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from occmap.errors import MapError
from occmap.evidence import render
from occmap.grid import Lattice
from occmap.grid.tiles import WINDOW_CELLS, GridSpec, TileGrid, tabulate
from occmap.options import BuildOptions
from occmap.sensor import interpret
from occmap.sensor.models import CountingModel, RadialModel
from occmap.types import Float64, Int64, PosedScans

if TYPE_CHECKING:
    from occmap.grid.engine import GridEngine


def make_engine(
    options: BuildOptions, window_cells: int = WINDOW_CELLS, slice_ns: int | None = None
) -> "GridEngine":
    """Make an engine for rays by an update and a model."""
    from occmap.grid.engine import GridEngine  # noqa: PLC0415  late: it brings numba

    return GridEngine(plan_grid(options), window_cells, options.max_cells, slice_ns)


def make_grid(options: BuildOptions) -> TileGrid:
    """Make a grid with no observations yet."""
    spec = plan_grid(options)
    return TileGrid(spec.lattice, spec.kind, spec.unit)


def plan_grid(options: BuildOptions) -> GridSpec:
    """Plan how an engine turns rays into evidence."""
    model, radial = options.model, None
    if isinstance(model, RadialModel):
        radial = tabulate(model.free, model.hit, model.depth(options.resolution))
    reach = options.jump, options.border_gap, options.hit_offset
    return GridSpec(options.update, Lattice(options.resolution), *reach, radial)


MOST_CELLS = 10**8
"""The largest map that is made of a sample"""


def estimate_agreement(parts: Sequence[PosedScans], options: BuildOptions) -> float | None:
    """Estimate the share of hits that lie in cells which the map of a log calls occupied.

    Returns
    -------
    float or None
        None where the sample makes no map, or one too large to be made in passing.
    """
    engine = make_engine(replace(options, model=CountingModel(), max_cells=MOST_CELLS))
    try:
        for part in parts:
            engine.add(interpret(part, options.returns)[0])
        return render(engine.finish(), CountingModel(), MOST_CELLS).agreement
    except MapError:
        return None


def encode_cells(points: Float64, cell: float) -> Int64:
    """Number the cells (...,) of a size (m) that points (..., 2) are nearest to."""
    cells = np.rint(np.clip(points / cell, -(2**30), 2**30)).astype(np.int64)
    return np.asarray((cells[..., 0] << 32) + cells[..., 1])
