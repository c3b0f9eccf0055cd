"""A cluster of processes on this machine, for all tests here."""

from collections.abc import Iterator

import dask
import pytest
from distributed import Client, LocalCluster, utils

LOOKS = "admin.tick.", "admin.system-monitor.", "scheduler.work-stealing-", "worker.memory.monitor-"
"""How often workers look after themselves: an eighth of a core goes by with that, by default"""
PATIENCE_S = 15
"""A worker that a test killed is there again sooner, unless it was killed while it started."""


@pytest.fixture(scope="package")  # idle workers take a tenth of a core
def clusters() -> Iterator[list[LocalCluster]]:
    """The cluster that tests use, once there is one."""
    started: list[LocalCluster] = []
    # At times a worker that a test killed is asked for a result: for half a minute, by default.
    timeout, profile = "distributed.comm.timeouts.connect", "distributed.worker.profile.enabled"
    # To profile takes time, and so does what a worker imports where it is not forked after that.
    method = "distributed.worker.multiprocessing-method"
    seldom = {f"distributed.{look}interval": "1s" for look in LOOKS}
    with dask.config.set({timeout: "5s", profile: False, method: "forkserver", **seldom}):
        utils.get_mp_context().set_forkserver_preload(["distributed", "occmap.fleet.tasks"])
        yield started
    for cluster in started:
        cluster.close()


@pytest.fixture
def address(clusters: list[LocalCluster]) -> str:
    """The scheduler of two workers; a cluster that lost one for good is replaced."""
    if clusters and not is_whole(clusters[-1]):
        clusters.pop().close()
    if not clusters:
        # A task may kill one worker, not three: each takes seconds to start anew.
        with dask.config.set({"distributed.scheduler.allowed-failures": 1}):
            clusters.append(LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=":0"))
    return str(clusters[-1].scheduler_address)


def is_whole(cluster: LocalCluster) -> bool:
    """Whether both workers are there, or soon will be."""
    with Client(cluster) as client:
        try:
            client.wait_for_workers(2, PATIENCE_S)
        except TimeoutError:
            return False
    return True
