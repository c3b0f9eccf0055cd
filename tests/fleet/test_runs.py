"""What tasks leave for each other."""

from pathlib import Path
from typing import Any

import numpy as np

from occmap.fleet.runs import read_mapped, write_mapped


def test_large_arrays_lie_beside_the_value_and_are_read_from_there(tmp_path: Path) -> None:
    path = tmp_path / "log.parts"
    arrays: list[Any] = [np.arange(5), np.arange(3, dtype=np.uint8), np.zeros((0, 7))]
    arrays += [np.arange(70.0).reshape(10, 7)]
    write_mapped(path, ("tf", arrays))
    name, read = read_mapped(path)
    assert name == "tf"
    for array, written in zip(read, arrays, strict=True):
        assert np.array_equal(array, written)
        assert (array.shape, array.dtype) == (written.shape, written.dtype)
        assert array.flags.aligned
        assert not array.flags.owndata


def test_a_log_without_poses_of_its_own_keeps_no_arrays(tmp_path: Path) -> None:
    write_mapped(tmp_path / "log.parts", ["part"])
    assert read_mapped(tmp_path / "log.parts") == ["part"]
