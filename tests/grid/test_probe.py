"""One cell, scan by scan: what is seen through a window of one cell is what the engine adds up."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from occmap.errors import MapError
from occmap.grid import CellBox, Lattice
from occmap.grid.engine import find_near, look_at_cell
from occmap.grid.tiles import GridSpec
from occmap.types import Kind, Rays, Update
from tests.grid.scans import FEW, Drive, aim, drives, observe
from tests.grid.test_engine import KINDS_OF_MAP, all_specs


@KINDS_OF_MAP
@FEW
@given(drive=drives(), place=st.floats(0, 1))
def test_scans_add_up_to_what_the_engine_has(drive: Drive, place: float, kind_of_map: int) -> None:
    rays, resolution = drive
    spec = all_specs(resolution)[kind_of_map]
    whole = observe(spec, [rays])
    cells = sorted(whole.first.keys() | whole.second.keys()) or [(0, 0)]
    row, col = cells[round(place * (len(cells) - 1))]
    for cell in ((row, col), (row + 1, col), (row, col - 3)):
        seen = look_at_cell(rays, spec, *cell)
        assert seen.shape == (len(rays.kind), 2)
        assert seen.sum(axis=0).tolist() == [whole.first[cell], whole.second[cell]]


@KINDS_OF_MAP
@FEW
@given(drive=drives(), place=st.floats(0, 1))
def test_each_scan_adds_what_it_does_alone(drive: Drive, place: float, kind_of_map: int) -> None:
    rays, resolution = drive
    spec = all_specs(resolution)[kind_of_map]
    scans = [rays.take(slice(s, s + 1)) for s in range(len(rays.kind))]
    alone = [observe(spec, [scan]) for scan in scans]
    cells = sorted({cell for each in alone for layer in each for cell in layer}) or [(0, 0)]
    cell = cells[round(place * (len(cells) - 1))]
    seen = look_at_cell(rays, spec, *cell)
    assert seen.tolist() == [[each.first[cell], each.second[cell]] for each in alone]


def fan(origins: list[tuple[float, float]]) -> Rays:
    """Two beams of a metre from each place: along x and along y."""
    origin = np.array(origins)[:, None]
    shape = (len(origins), 2)
    direction = np.broadcast_to(aim(0, np.pi / 2, 2), (*shape, 2))
    reach, kind = np.ones(shape, np.float32), np.full(shape, Kind.HIT, np.uint8)
    stamps = np.zeros(len(origins), np.int64)
    return Rays.along(origin, direction, reach, kind, stamps, full_circle=False)


SPEC = GridSpec(Update.BEAM, Lattice(0.1))


def test_scans_far_from_the_cell_are_not_traced() -> None:
    rays = fan([(0.05, 0.05), (0.95, 0.05), (3, 0), (0, 3), (-0.05, 0.05)])
    assert find_near(rays, SPEC, CellBox.at(0, 9)).tolist() == [True, True, False, False, True]
    # A miss on the way; both beams begin in it; too far; too far; the end.
    assert look_at_cell(rays, SPEC, 0, 9).tolist() == [[0, 1], [0, 2], [0, 0], [0, 0], [1, 0]]


def test_nothing_is_seen_without_scans() -> None:
    assert look_at_cell(fan([(0, 0)]).take(slice(0, 0)), SPEC, 0, 9).shape == (0, 2)


def test_a_sensor_too_far_away_is_refused() -> None:
    with pytest.raises(MapError, match="is too far away"):
        look_at_cell(fan([(1e16, 0)]), SPEC, 0, 9)
