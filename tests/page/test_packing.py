import zlib
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from occmap.page.raster import Packed, pack


def unpack(packed: Packed) -> NDArray[np.uint32]:
    """As page.js does."""
    plain = np.frombuffer(zlib.decompress(packed.data), np.uint8)
    planes = plain.reshape(packed.planes, packed.rows, packed.columns).astype(np.uint32)
    shifts = 8 * np.arange(packed.planes, dtype=np.uint32)
    return np.asarray((planes << shifts[:, None, None]).sum(axis=0, dtype=np.uint32))


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
