"""The loops' own numbers are those of the types and of the lattice."""

from occmap.grid import Lattice
from occmap.grid.kernels.units import CELL_SHIFT, HALF_CELL, HIT, SKIP, UNITS_PER_CELL
from occmap.types import Kind


def test_kinds_are_those_of_the_rays() -> None:
    assert (SKIP, HIT) == (Kind.SKIP, Kind.HIT)


def test_a_cell_is_so_many_units_wide() -> None:
    assert Lattice(0.5).units_per_metre == 2 * UNITS_PER_CELL
    assert 3 * UNITS_PER_CELL >> CELL_SHIFT == 3
    assert (3 * UNITS_PER_CELL - 1) >> CELL_SHIFT == 2
    assert 2 * HALF_CELL == UNITS_PER_CELL
