"""What all tests share."""

from collections.abc import Iterator
from contextlib import chdir
from pathlib import Path

import pytest
from hypothesis import HealthCheck, settings

# Machines are noisy, and some have much else to do: no test fails by the clock.
settings.register_profile("occmap", deadline=None, suppress_health_check=[HealthCheck.too_slow])
settings.load_profile("occmap")


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A new folder, in which the test works."""
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.fixture(scope="module")
def workplace(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """A new folder, in which all tests of a module work."""
    folder = tmp_path_factory.mktemp("workplace")
    with chdir(folder):
        yield folder
