"""Clusters of processes on this machine, each started once."""

from collections.abc import Iterator

import pytest
from distributed import LocalCluster


@pytest.fixture(scope="session", params=[1, 2])
def address(request: pytest.FixtureRequest) -> Iterator[str]:
    """The scheduler of one or two workers."""
    with LocalCluster(
        n_workers=request.param, threads_per_worker=1, dashboard_address=":0"
    ) as cluster:
        yield cluster.scheduler_address
