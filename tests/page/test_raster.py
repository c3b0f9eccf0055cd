import zlib
from base64 import b64decode
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from occmap import api
from occmap.api import Map
from occmap.cells import CellBox, OccupancyMap
from occmap.evidence import to_grid
from occmap.page import raster as rasters
from occmap.page.raster import Seen, make_raster, name_layers, pack_layer
from tests.writers.maps import map_of


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Map:
    path = tmp_path_factory.mktemp("raster") / "m.npz"
    return api.build_map("sample_logs/drive.csv", resolution=0.1, outputs=path)


@pytest.fixture(scope="module")
def seen(made: Map) -> Seen:
    return Seen.of(made.evidence)


def unpack(packed: rasters.Packed) -> NDArray[np.uint32]:
    """As page.js does."""
    plain = np.frombuffer(zlib.decompress(b64decode(packed.data)), np.uint8)
    planes = plain.reshape(packed.planes, packed.rows, packed.columns).astype(np.uint32)
    shifts = 8 * np.arange(packed.planes, dtype=np.uint32)
    return np.asarray((planes << shifts[:, None, None]).sum(axis=0, dtype=np.uint32))


def layer(raster: rasters.Raster, name: str) -> np.ndarray[tuple[int, ...], np.dtype[np.uint32]]:
    return unpack(raster.layers[name])


def test_layers_are_those_of_the_map(made: Map, seen: Seen) -> None:
    raster = make_raster(made, seen)
    assert (raster.x, raster.y, raster.size, raster.step) == (*made.origin, 0.1, 1)
    assert min(made.origin) < 0
    for number, mask in ((3, made.occupied), (1, made.free), (0, ~made.observed)):
        np.testing.assert_array_equal(layer(raster, "class") == number, mask)
    np.testing.assert_allclose(
        layer(raster, "p")[made.observed] / 100, made.probability[made.observed], atol=0.005
    )
    for name, counts in (("hits", made.hits), ("misses", made.misses)):
        np.testing.assert_array_equal(layer(raster, name) / seen.grid.unit, counts)


def test_visits_and_last_sights_are_those_of_the_log(made: Map, seen: Seen) -> None:
    raster = make_raster(made, seen)
    is_seen = layer(raster, "visits") > 0
    np.testing.assert_array_equal(is_seen, (made.hits > 0) | (made.misses > 0))
    np.testing.assert_array_equal(layer(raster, "last") > 0, is_seen)
    first, last = 1_700_000_000.0, 1_700_000_082.6
    shown = next(each for each in name_layers([raster], seen) if each.key == "last")
    assert shown.start <= first < shown.start + shown.scale
    end = shown.start + layer(raster, "last").max() * shown.scale
    assert end - shown.scale <= last < end


def test_a_cropped_map_has_its_own_part_of_the_evidence(made: Map, seen: Seen) -> None:
    part = OccupancyMap.take(made, slice(7, 30), slice(3, 90))
    raster = make_raster(part, seen)
    np.testing.assert_array_equal(layer(raster, "hits") / seen.grid.unit, made.hits[7:30, 3:90])


@pytest.mark.parametrize("step", [2, 8])
def test_a_coarse_cell_is_the_one_most_likely_occupied(
    step: int, made: Map, seen: Seen, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("occmap.page.raster.MOST_CELLS", made.log_odds.size / step**2)
    raster = make_raster(made, seen)
    assert raster.step == step
    row, col = made.box[:2]
    begin, left = row // step * step, col // step * step
    assert (raster.x, raster.y) == pytest.approx((left * 0.1, begin * 0.1))
    classes, hits = layer(raster, "class"), layer(raster, "hits") / seen.grid.unit
    rows, cols = made.shape
    assert classes.shape == (-(-(row + rows - begin) // step), -(-(col + cols - left) // step))
    box = CellBox(begin, left, begin + step * len(classes), left + step * classes.shape[1])
    whole = to_grid(made.evidence).read(box)[0]
    log_odds = np.full(whole.shape, -np.inf)
    log_odds[row - begin :, col - left :][:rows, :cols] = np.where(
        made.observed, made.log_odds, -np.inf
    )
    for i, j in [(0, 0), (3, 5), (len(classes) - 1, 2), (len(classes) // 2, classes.shape[1] - 1)]:
        block = slice(i * step, (i + 1) * step), slice(j * step, (j + 1) * step)
        best = np.unravel_index(log_odds[block].argmax(), (step, step))
        assert hits[i, j] == whole[block][best]
        occupied = log_odds[block][best] > np.log(0.32 / 0.68)
        assert (classes[i, j] == 3) == occupied


def test_a_page_that_would_be_too_large_is_thinned(made: Map, seen: Seen) -> None:
    size = sum(len(each.data) for each in make_raster(made, seen).layers.values())
    for most, step in ((size, 1), (size - 1, 2)):
        raster = make_raster(made, seen, most)
        assert raster.step == step
        assert sum(len(each.data) for each in raster.layers.values()) <= most


def test_a_map_without_evidence_has_classes_and_probabilities() -> None:
    grid = map_of([[0.9, 0.1, np.nan, 0.5]], origin=(-0.05, 3.0))
    raster = make_raster(grid, None)
    assert layer(raster, "class").tolist() == [[3, 1, 0, 2]]
    assert layer(raster, "p").tolist() == [[90, 10, 255, 50]]
    assert (raster.x, raster.y) == (-0.05, 3.0)


def test_16_million_cells_are_not_thinned_for_their_number() -> None:
    assert rasters.MOST_CELLS >= 4000 * 4000


@pytest.mark.parametrize(
    ("largest", "planes"), [(0, 1), (255, 1), (256, 2), (65535, 2), (65536, 3), (2**32 - 1, 4)]
)
def test_numbers_survive_with_as_few_bytes_as_they_need(largest: int, planes: int) -> None:
    numbers: NDArray[Any] = np.array([[0, largest // 2, largest], [1 % (largest + 1), 0, 0]])
    packed = pack_layer(numbers)
    assert (packed.planes, packed.largest) == (planes, largest)
    np.testing.assert_array_equal(unpack(packed), numbers)


def test_a_number_too_large_is_the_largest() -> None:
    assert unpack(pack_layer(np.array([[2**40]]))).tolist() == [[2**32 - 1]]


def test_the_ground_of_clouds_is_a_layer_as_high_as_the_floor_and_ramp(tmp_path: Path) -> None:
    made = api.build_map("sample_logs/hall.mcap", resolution=0.1, outputs=tmp_path / "m.npz")
    seen = Seen.of(made.evidence)
    raster = make_raster(made, seen)
    shown = next(each for each in name_layers([raster], seen) if each.key == "ground")
    heights = shown.start + layer(raster, "ground") * shown.scale
    known = layer(raster, "ground") > 0
    col, row = ((np.array(at) - (raster.x, raster.y)) / 0.1 for at in ((1.0, 3.0), (8.0, 3.0)))
    for (x, y), low, high in ((col, -0.03, 0.02), (row, 0.21, 0.27)):
        assert known[int(y), int(x)]
        assert low < heights[int(y), int(x)] < high
