"""Errors reach another process as they are."""

import pickle

import pytest

from occmap import errors
from occmap.errors import OccmapError

KINDS = [each for each in vars(errors).values() if isinstance(each, type)]


@pytest.mark.parametrize("kind", [k for k in KINDS if issubclass(k, OccmapError)])
def test_an_error_survives_pickling(kind: type[OccmapError]) -> None:
    error = kind("holds no scans", where="a.mcap", fix="give another")
    again = pickle.loads(pickle.dumps(error))
    assert type(again) is kind
    assert (again.found, again.where, again.fix) == ("holds no scans", "a.mcap", "give another")
    assert str(again) == str(error)
    assert again.exit_code == error.exit_code
