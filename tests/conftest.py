"""What all tests share."""

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
