"""One cell, scan by scan: what is seen through a window of one cell is what the engine adds up."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from occmap.cells import CellBox
from occmap.errors import MapError
from occmap.grid import Lattice
from occmap.grid.engine import find_near, look_at_cell
from occmap.grid.tiles import GridSpec
from occmap.types import Rays, Update
from tests.grid.scans import FEW, Drive, drives, make_rays, observe, take
from tests.grid.test_engine import KINDS_OF_MAP, all_specs


@KINDS_OF_MAP
@FEW
@given(drive=drives(), place=st.floats(0, 1))
def test_each_scan_adds_what_it_does_alone(drive: Drive, place: float, kind_of_map: int) -> None:
    rays, resolution = drive
    spec = all_specs(resolution)[kind_of_map]
    alone = [observe(spec, [take(rays, [s])]) for s in range(len(rays.kind))]
    cells = sorted({cell for each in alone for layer in each for cell in layer}) or [(0, 0)]
    row, col = cells[round(place * (len(cells) - 1))]
    for cell in ((row, col), (row + 1, col), (row, col - 3)):
        seen = look_at_cell(rays, spec, *cell)
        assert seen.tolist() == [[each.first[cell], each.second[cell]] for each in alone]


def fan(origins: list[tuple[float, float]]) -> Rays:
    """Two beams of a metre from each place: along x and along y."""
    return make_rays(np.array(origins).reshape(-1, 1, 2), [(1, 0), (0, 1)], 1.0)


SPEC = GridSpec(Update.BEAM, Lattice(0.1))


def test_scans_far_from_the_cell_are_not_traced() -> None:
    rays = fan([(0.05, 0.05), (0.95, 0.05), (3, 0), (0, 3), (-0.05, 0.05)])
    assert find_near(rays, SPEC, CellBox.at(0, 9)).tolist() == [True, True, False, False, True]
    # A miss on the way; both beams begin in it; too far; too far; the end.
    assert look_at_cell(rays, SPEC, 0, 9).tolist() == [[0, 1], [0, 2], [0, 0], [0, 0], [1, 0]]


def test_nothing_is_seen_without_scans() -> None:
    assert look_at_cell(fan([]), SPEC, 0, 9).shape == (0, 2)


def test_a_sensor_too_far_away_is_refused() -> None:
    with pytest.raises(MapError, match="is too far away"):
        look_at_cell(fan([(1e16, 0)]), SPEC, 0, 9)
