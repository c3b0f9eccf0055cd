"""A cluster of processes on this machine, started once."""

from collections.abc import Iterator

import pytest
from distributed import Client, LocalCluster

PATIENCE_S = 60


@pytest.fixture(scope="session")
def cluster() -> Iterator[str]:
    """The scheduler of two workers, which are started again where a test kills them."""
    with LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=":0") as started:
        yield started.scheduler_address


@pytest.fixture
def address(cluster: str) -> str:
    """The scheduler, once both workers are there."""
    with Client(cluster) as client:
        client.wait_for_workers(2, PATIENCE_S)
    return cluster
