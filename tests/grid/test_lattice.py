"""Cells and lattice units, worked out by hand, and the lines between them."""

import math

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from occmap.cells import CellBox
from occmap.errors import UsageError
from occmap.grid import Lattice
from occmap.grid.kernels.lines import Line, count_steps, draw_line, find_step, steps_after
from occmap.grid.kernels.projection import project
from occmap.grid.tiles import GridSpec
from occmap.types import Kind, Update
from tests.grid.scans import MANY, make_scan, shift


@pytest.mark.parametrize(
    ("metres", "units"),
    [
        (0.0, 0),
        (1.0, 512),  # two cells of 0.5 m, of 256 units each
        (-1.0, -512),
        (0.5 / 256, 1),
        (0.25 / 256, 0),  # a half goes to the even one
        (0.75 / 256, 2),
        (-0.25 / 256, 0),
        (-0.75 / 256, -2),
        (0.26 / 256, 1),
    ],
)
def test_a_coordinate_is_rounded_to_the_nearest_unit(metres: float, units: int) -> None:
    lattice = Lattice(0.5)
    assert lattice.to_units(np.array([metres])).tolist() == [units]


@pytest.mark.parametrize(
    ("x", "y", "cell"),
    [
        (0.0, 0.0, (0, 0)),
        (0.49, 0.51, (1, 0)),
        (-0.01, 0.0, (0, -1)),  # floor, not truncation
        (-0.5, -0.51, (-2, -1)),
        (0.4999, -0.0001, (0, 1)),  # nearer to the edge than 1/512 of a cell: rounded onto it
        (1e5, -1e5, (-200_000, 200_000)),
    ],
)
def test_a_cell_is_row_and_column_by_the_floor_of_y_and_x(
    x: float, y: float, cell: tuple[int, int]
) -> None:
    assert Lattice(0.5).to_cell(x, y) == cell


def test_kernels_and_numpy_round_alike() -> None:
    rng = np.random.default_rng(3)
    beam = shift(make_scan((0.0, Kind.HIT)), (-0.5, 0.0))
    metres = rng.uniform(-1, 1, 500) * 10.0 ** rng.integers(-4, 7, 500)
    for resolution in (0.01, 0.05, 0.3, 1.0):
        lattice = Lattice(resolution)
        units = lattice.to_units(metres)
        for x, unit in zip(metres.tolist(), units.tolist(), strict=True):
            beams = project(shift(beam, (x, 0.0)), GridSpec(Update.BEAM, lattice))
            assert beams.ends_x[0, 0] + beams.anchor[0] == unit
        assert np.abs(units - metres * 256 / resolution).max() <= 0.5 + 1e-6


def test_the_corner_of_a_cell_is_in_it() -> None:
    for resolution in (0.01, 0.05, 0.1, 0.3, 1.0):
        lattice = Lattice(resolution)
        for n in (-70_001, -3, 0, 7, 123_456):
            assert lattice.to_cell(lattice.to_metres(n), 0.0) == (0, n)


@pytest.mark.parametrize("resolution", [0.0, -0.05, 9e-10, 5e-324, math.nan, math.inf])
def test_a_resolution_that_makes_no_cells_is_refused(resolution: float) -> None:
    with pytest.raises(UsageError, match=r"`resolution=0\.05`"):
        Lattice(resolution)


def test_boxes_of_cells() -> None:
    box = CellBox(-2, 3, 1, 7)
    assert (box.rows, box.cols, box.cells) == (3, 4, 12)
    assert box.contains(CellBox(-1, 4, 1, 5))
    assert box.contains(box)
    assert not box.contains(CellBox(-1, 4, 2, 5))
    assert box.join(CellBox(0, 0, 5, 1)) == CellBox(-2, 0, 5, 7)
    assert box.move(2, -1) == CellBox(0, 2, 3, 6)
    assert box.align(4) == CellBox(-4, 0, 4, 8)
    assert CellBox(-2, 5, 1, 7).align(4) == CellBox(-4, 4, 4, 8)
    assert box.align(4).shrink(4) == CellBox(-1, 0, 1, 2)
    assert box.clip(CellBox(-5, 4, 0, 9)) == CellBox(-2, 4, 0, 7)
    assert box.clip(CellBox(5, 9, 6, 10)).cells == 0


def test_the_edge_of_a_cell_is_the_number_that_a_person_writes() -> None:
    assert Lattice(0.05).to_metres(-61) == -3.05  # and not -3.0500000000000003


def test_points_lie_in_the_box_that_encloses_them_and_so_does_what_is_near() -> None:
    points = np.array([[0.5, -0.1], [2.0, 3.9], [1.0, 1.0]])
    assert Lattice(1.0).enclose(points) == CellBox(-1, 0, 4, 3)
    assert Lattice(1.0).enclose(points, around=0.6) == CellBox(-1, -1, 5, 3)
    assert Lattice(0.5).enclose(points[:1]) == CellBox.at(-1, 1)


LONGEST = 1 << 22


@st.composite
def draw_places(draw: st.DrawFn) -> tuple[int, int, int]:
    """Steps m and cells n of a line, and one of its cells."""
    n = draw(st.integers(1, LONGEST))
    return n, draw(st.integers(0, n)), draw(st.integers(0, n))


@MANY
@given(draw_places())
@example((LONGEST, LONGEST - 1, LONGEST // 2))
@example((LONGEST - 1, LONGEST - 2, LONGEST // 2 - 1))
@example((12, 7, 6))  # a half, of which a float product is a little less
@example((1, 1, 1))
def test_steps_are_rounded_halves_up(place: tuple[int, int, int]) -> None:
    n, m, i = place
    line = Line(*draw_line(0, 0, n, m))
    made = (2 * i * m + n) // (2 * n)
    assert steps_after(line, float(i)) == count_steps(line, i) == made
    first = find_step(line, made)
    assert (2 * first * m + n) // (2 * n) == made
    assert first == 0 or (2 * (first - 1) * m + n) // (2 * n) == made - 1
