"""What all tests share."""

import gc
import os
from collections.abc import Iterator
from contextlib import chdir
from pathlib import Path

import pytest
from hypothesis import HealthCheck, settings

from occmap.cli import NEW_OBJECTS

# Machines are noisy, and some have much else to do: no test fails by the clock.
settings.register_profile("occmap", deadline=None, suppress_health_check=[HealthCheck.too_slow])
settings.load_profile("occmap")
gc.set_threshold(NEW_OBJECTS)  # as for a command; at Python's 700 a fifth of all time goes by


@pytest.fixture(autouse=True, scope="session")
def _no_disk() -> Iterator[None]:
    """Outputs need not last through a power cut, which is what each waits for."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(os, "fsync", lambda _: None)
        yield


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
