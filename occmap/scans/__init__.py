"""The steps of a build: from the path of a log to what its scans observe.

`tracing.trace_drive` is the way of a log. `check`, `compare`, `tune` and `explain` go it, too. Here
are the engine for rays, and the empty grids, for an update and a model.
"""

from typing import TYPE_CHECKING

from occmap.grid import Lattice
from occmap.grid.tiles import WINDOW_CELLS, GridSpec, TileGrid, tabulate
from occmap.options import BuildOptions
from occmap.sensor.models import RadialModel

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
