"""The workers of a build, by Dask: found, looked at, and given tasks; the owner of distributed."""

import logging
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol, TypeVar

from occmap.errors import FleetError, OccmapError, UsageError
from occmap.wording import count

if TYPE_CHECKING:
    from distributed import Client


class Job(Protocol):
    """What a task is given."""

    @property
    def where(self) -> str:
        """What an error is about."""


AnyJob = TypeVar("AnyJob", bound=Job)
Result = TypeVar("Result")

LOCAL = "local"
"""Stands for processes on this machine"""
PATIENCE_S = 10
"""A scheduler that is there answers within milliseconds"""
LEAST_BYTES = 512 << 20
"""Of memory for a worker: a third of it is gone before the first scan"""
MUST_EQUAL = ("occmap", "numpy", "numba")
"""What would make other cells in another version"""


class Cluster:
    """Workers that are alike, and fit for the work."""

    def __init__(self, client: "Client") -> None:
        self._client = client
        workers = client.scheduler_info(n_workers=-1)["workers"]
        limits = [each["memory_limit"] for each in workers.values() if each["memory_limit"]]
        self.workers = len(workers)
        self.memory = min(limits, default=None)
        """What the smallest worker may take (bytes); None: no limit"""

    def run(
        self,
        task: Callable[[AnyJob], Result],
        jobs: Sequence[AnyJob],
        tell: Callable[[AnyJob, Result], None] = lambda _job, _result: None,
    ) -> list[Result]:
        """Do jobs, each by one worker; where one fails, the first of them says why.

        Raises
        ------
        OccmapError
            Of the first job that failed, or its workers died.
        """
        from distributed import as_completed  # noqa: PLC0415  late: an extra

        # Not pure: Dask takes equal calls for one, and a log that is given twice counts twice.
        futures = self._client.map(task, jobs, pure=False, retries=0)
        places = {future: place for place, future in enumerate(futures)}
        results: dict[int, Result] = {}
        failed: dict[int, BaseException] = {}
        for future in as_completed(futures):
            place = places[future]
            if future.status == "finished":
                results[place] = future.result()
                tell(jobs[place], results[place])
            elif future.status == "error":
                failed[place] = future.exception()
                # What comes later does not matter any more; what comes earlier may fail, too.
                self._client.cancel([each for each in futures[place + 1 :] if not each.done()])
            future.release()
        if failed:
            place = min(failed)
            raise explain(failed[place], jobs[place], self.memory)
        return [results[place] for place in range(len(jobs))]

    def ask(self, question: Callable[..., Any], *args: Any) -> list[Any]:
        """Ask every worker; an error is an answer."""
        return list(self._client.run(question, *args, on_error="return").values())


@contextmanager
def open_cluster(address: str, processes: int) -> Iterator[Cluster]:
    """Find the workers at an address, or start as many as asked for on this machine.

    Raises
    ------
    UsageError, FleetError
        Dask is not installed, nobody answers, or the workers are not fit for the work.
    """
    with ExitStack() as stack:
        client = stack.enter_context(connect(address, processes))
        cluster = Cluster(client)
        refuse_unequal(cluster)
        refuse_small(cluster)
        yield cluster


@contextmanager
def connect(address: str, processes: int) -> Iterator["Client"]:
    """Connect to a scheduler, or start one; what they log is not for the user of a map."""
    try:
        import distributed  # noqa: PLC0415  late: an extra, and it takes half a second
    except ImportError:
        raise UsageError(
            "`dask` needs a library that is not installed", fix="install it: pip install '.[dask]'"
        ) from None
    logging.getLogger("distributed").setLevel(logging.CRITICAL)
    with ExitStack() as stack:
        place: Any = address
        if address == LOCAL:
            place = stack.enter_context(
                distributed.LocalCluster(
                    n_workers=processes,
                    threads_per_worker=1,
                    dashboard_address=":0",
                    silence_logs=logging.CRITICAL,
                )
            )
        try:
            client = stack.enter_context(distributed.Client(place, timeout=PATIENCE_S))
        except (OSError, ValueError) as error:
            reason = str(error).splitlines()[0] if isinstance(error, ValueError) else ""
            raise FleetError(
                f"no scheduler answers within {PATIENCE_S} s{reason and f' ({reason})'}",
                where=address,
                fix="start one with `dask scheduler`, or build with `dask=local`",
            ) from None
        try:
            client.wait_for_workers(1, timeout=PATIENCE_S)
        except TimeoutError:
            raise FleetError(
                "the scheduler has no workers",
                where=address,
                fix=f"start some: dask worker {address}",
            ) from None
        yield client


def refuse_unequal(cluster: Cluster) -> None:
    """Refuse workers on which the same tasks might make other cells.

    Raises
    ------
    FleetError
        Saying how many there are, and what they run.
    """
    mine = list_versions()
    theirs = cluster.ask(list_versions)
    other = [each for each in theirs if each != mine]
    if other:
        runs = other[0] if isinstance(other[0], dict) else {}
        found = [f"{name} {runs.get(name)}" for name in mine if runs.get(name) != mine[name]]
        here = [f"{name} {mine[name]}" for name in mine if runs.get(name) != mine[name]]
        raise FleetError(
            f"{len(other)} of {count(len(theirs), 'worker')} run {', '.join(found)}, "
            f"where {', '.join(here)} runs here",
            fix="install the same versions everywhere",
        )


def list_versions() -> dict[str, str]:
    """Versions of what decides which cells a scan observes."""
    return {name: version(name) for name in MUST_EQUAL}


def refuse_small(cluster: Cluster) -> None:
    """Refuse workers that would wait for memory for ever.

    Raises
    ------
    FleetError
        Saying how much the smallest has.
    """
    if cluster.memory is not None and cluster.memory < LEAST_BYTES:
        raise FleetError(
            f"a worker may take {cluster.memory >> 20} MiB of memory, and {LEAST_BYTES >> 20} MiB "
            "are the least",
            fix="start fewer workers, or give each more memory",
        )


def refuse_unseen_files(cluster: Cluster, paths: Sequence[Path]) -> None:
    """Refuse to begin where not every worker sees the same files.

    Raises
    ------
    FleetError
        Naming the first that some of them do not see.
    """
    answers = cluster.ask(list_missing, paths)
    missing = [each for each in answers if isinstance(each, list) and each]
    if missing:
        raise FleetError(
            f"is not there on {len(missing)} of {count(len(answers), 'worker')}",
            where=missing[0][0],
            fix="give a path that all of them share",
        )


def list_missing(paths: Sequence[Path]) -> list[Path]:
    """List the paths that are not there."""
    return [path for path in paths if not path.exists()]


def explain(error: BaseException, job: Job, memory: int | None) -> BaseException:
    """Say what to do where a task killed its workers; any other error speaks for itself."""
    from distributed import KilledWorker  # noqa: PLC0415  late: an extra

    if isinstance(error, OccmapError) or not isinstance(error, KilledWorker):
        return error
    limit = "" if memory is None else f", which had {memory >> 20} MiB of memory"
    return FleetError(
        f"killed its workers {error.allowed_failures + 1} times{limit}",
        where=job.where,
        fix="give workers more memory, or build with a smaller `slice`",
    )
