"""The engine, or the empty grid, for an update and a model."""

from typing import TYPE_CHECKING

from occmap.grid.lattice import Lattice
from occmap.grid.spec import WINDOW_CELLS, GridSpec, tabulate
from occmap.grid.tiles import TileGrid
from occmap.options import BuildOptions
from occmap.sensor.models import RadialModel

if TYPE_CHECKING:  # the engine brings numba, which takes longer to load than all else together
    from occmap.grid.engine import GridEngine
    from occmap.grid.sliced import SlicedEngine


def choose_engine(
    options: BuildOptions, keep_slices: bool, window_cells: int = WINDOW_CELLS
) -> "GridEngine | SlicedEngine":
    """Make an engine, one that keeps slices of time only where they are asked for."""
    if not keep_slices:
        return make_engine(options, window_cells)
    from occmap.grid.sliced import SlicedEngine  # noqa: PLC0415  late: as below

    slice_ns = round(options.pass_gap_s * 1e9)
    return SlicedEngine(plan_grid(options), slice_ns, window_cells, options.max_cells)


def make_engine(options: BuildOptions, window_cells: int = WINDOW_CELLS) -> "GridEngine":
    """Make the grid engine for an update and a model."""
    from occmap.grid.engine import GridEngine  # noqa: PLC0415  late: numba takes a third of a second

    return GridEngine(plan_grid(options), window_cells=window_cells, max_cells=options.max_cells)


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
