import zlib
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from occmap.page.raster import Packed, pack, pack_few


def unpack(packed: Packed) -> NDArray[np.uint32]:
    """As page.js does."""
    plain = np.frombuffer(zlib.decompress(packed.data), np.uint8)
    planes = plain.reshape(packed.planes, packed.rows, packed.columns).astype(np.uint32)
    shifts = 8 * np.arange(packed.planes, dtype=np.uint32)
    numbers = np.asarray((planes << shifts[:, None, None]).sum(axis=0, dtype=np.uint32))
    if packed.table:
        numbers = np.array(packed.table, np.uint32)[np.cumsum(numbers, axis=1) % 256]
    return numbers


@pytest.mark.parametrize(
    ("largest", "planes"), [(0, 1), (255, 1), (256, 2), (65535, 2), (65536, 3), (2**32 - 1, 4)]
)
def test_numbers_survive_with_as_few_bytes_as_they_need(largest: int, planes: int) -> None:
    numbers: NDArray[Any] = np.array([[0, largest // 2, largest], [1 % (largest + 1), 0, 0]])
    packed = pack(numbers)
    assert (packed.planes, packed.largest) == (planes, largest)
    np.testing.assert_array_equal(unpack(packed), numbers)


def test_a_number_too_large_is_the_largest() -> None:
    assert unpack(pack(np.array([[2**40]]))).tolist() == [[2**32 - 1]]


def test_few_numbers_are_packed_as_places_in_a_table() -> None:
    rng = np.random.default_rng(5)
    numbers = rng.choice([0, 3, 70_000, 2**31], (9, 20))
    packed = pack_few(numbers)
    assert (packed.table, packed.planes, packed.largest) == ((0, 3, 70_000, 2**31), 1, 2**31)
    np.testing.assert_array_equal(unpack(packed), numbers)
    many = np.arange(600).reshape(20, 30)
    assert pack_few(many) == pack(many)
