"""The steps of a build: from the path of a log to what its scans observe.

`tracing.trace` lists the way of a scan. `check`, `compare`, `tune` and `explain` go it, too. Here
are the engines, and the empty grids, for an update and a model.
"""

from typing import TYPE_CHECKING

from occmap.cells import Ground
from occmap.grid import Lattice
from occmap.grid.tiles import WINDOW_CELLS, GridSpec, TileGrid, tabulate
from occmap.options import BuildOptions
from occmap.sensor.models import RadialModel
from occmap.types import Update

if TYPE_CHECKING:
    from occmap.clouds.engine import CloudEngine
    from occmap.grid.engine import GridEngine


def make_engine(
    options: BuildOptions, keep_slices: bool = False, window_cells: int = WINDOW_CELLS
) -> "GridEngine":
    """Make an engine for rays by an update and a model, which keeps slices of time if asked to."""
    from occmap.grid.engine import GridEngine  # noqa: PLC0415  late: it brings numba

    slice_ns = round(options.pass_gap_s * 1e9) if keep_slices else None
    return GridEngine(plan_grid(options), window_cells, options.max_cells, slice_ns)


def choose_engine(
    options: BuildOptions,
    keep_slices: bool,
    ground: Ground | None,
    window_cells: int = WINDOW_CELLS,
) -> "GridEngine | CloudEngine":
    """Make an engine for what the update is for: rays, or clouds over ground that is known."""
    if options.update is not Update.CLOUD or ground is None:
        return make_engine(options, keep_slices, window_cells)
    from occmap.clouds.engine import CloudEngine  # noqa: PLC0415  late: it brings numba

    limits = options.returns.min_range, options.returns.max_range
    slice_ns = round(options.pass_gap_s * 1e9) if keep_slices else None
    return CloudEngine(Lattice(options.resolution), options.clouds, ground, limits, slice_ns)


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
