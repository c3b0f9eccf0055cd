"""The workers of a build, by Dask: found, looked at, and given tasks; the owner of distributed."""

import logging
import os
import signal
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import CancelledError
from contextlib import contextmanager, nullcontext, suppress
from dataclasses import dataclass
from functools import partial
from importlib.metadata import version
from multiprocessing import resource_tracker
from pathlib import Path
from threading import Thread
from time import sleep
from typing import TYPE_CHECKING, Any, TypeAlias, TypeVar

from occmap.errors import FleetError
from occmap.plugins import need_extra
from occmap.report import count
from occmap.types import Paths

if TYPE_CHECKING:
    from distributed import Client

log = logging.getLogger(__name__)
LOCAL = "local"
"""The address that stands for processes on this machine"""
PATIENCE_S = 5
"""A scheduler that is there answers within milliseconds"""
LEAST_BYTES = 512 << 20
"""The least memory for a worker (bytes): a third of it is gone before the first scan"""
LOST = CancelledError, OSError
"""What Dask raises where the scheduler is gone"""
MUST_EQUAL = ("occmap", "numpy", "numba")
"""Packages that may make other cells in another version"""
_MALLOC = "distributed.nanny.pre-spawn-environ.MALLOC"
ALLOCATOR = {
    f"{_MALLOC}_TRIM_THRESHOLD_": 64 << 20,
    f"{_MALLOC}_MMAP_THRESHOLD_": 4 << 20,
    f"{_MALLOC}_ARENA_MAX": 1,
}
"""For workers of this machine: as Dask sets it, the C library gives every array back at once, and
new pages for the next take a third of a worker's time; and each thread would keep its own"""


@dataclass(frozen=True)
class Job:
    """What a task is about."""

    name: str
    """What its files are called"""
    where: str
    """As an error names it: the path of a log, or a block"""

    def find_stub(self, folder: Path, task: Callable[..., Any]) -> Path:
        """The file that a task leaves its result in, of a build with this scratch folder."""
        return folder / f"{self.name}.{task.__name__}"


AnyJob = TypeVar("AnyJob", bound=Job)
Result = TypeVar("Result")
Task: TypeAlias = Callable[[Any, AnyJob], Result]
"""From what all tasks of a build share, and a job"""


class Cluster:
    """Workers that are alike, and fit for the work."""

    def __init__(self, client: "Client", address: str, describe: Callable[[str], None]) -> None:
        self._client = client
        self._address = address
        self._describe = describe
        workers = client.scheduler_info(n_workers=-1)["workers"]
        limits = [each["memory_limit"] for each in workers.values() if each["memory_limit"]]
        self.memory = min(limits, default=None)
        """What the smallest worker may take (bytes); None: no limit"""
        link = client.dashboard_link
        self._crew = f"{count(len(workers), 'worker')}{link and f', {link}'}"

    def run(
        self,
        task: Task[AnyJob, Result],
        setting: Any,
        jobs: Sequence[AnyJob],
        tell: Callable[[Result], None] = lambda _result: None,
    ) -> list[Result]:
        """Do jobs, each by one worker; where some fail, the first of them in order says why.

        Parameters
        ----------
        task
            What its name begins with is what the user is told of.
        tell
            Called with each result, in whatever order they come.

        Raises
        ------
        OccmapError
            Of the first job that failed, or its workers died, or the scheduler did.
        """
        from distributed import as_completed  # noqa: PLC0415  late: an extra

        phase, _, _ = task.__name__.partition("_")
        results: dict[Any, Result] = {}
        try:
            if self._client.status != "running":  # Dask would wait for ever
                raise CancelledError
            # Not pure: Dask takes equal calls for one, and a log that is given twice counts twice.
            futures = self._client.map(partial(task, setting), jobs, pure=False, retries=0)
            for future in as_completed(futures):
                if future.status != "finished":
                    break
                results[future] = future.result()
                tell(results[future])
                future.release()
                self._describe(f"{phase} {len(results)}/{len(jobs)}, {self._crew}")
            # After a failure others are still waited for: one that comes before it may fail, too.
            pairs = zip(jobs, futures, strict=True)
            return [results[it] if it in results else self._wait_for(job, it) for job, it in pairs]
        except LOST as error:  # maybe while a result was fetched
            kept = sum(job.find_stub(setting.folder, task).exists() for job in jobs)
            so_far = f"; {max(kept, len(results))} of {len(jobs)} tasks of {phase!r} are done"
            raise self._explain(error, so_far, str(setting.folder)) from None

    def _wait_for(self, job: Job, future: Any) -> Any:
        """Wait for the result of a job.

        Raises
        ------
        OccmapError
            The job failed, or killed its workers.
        """
        from distributed import KilledWorker  # noqa: PLC0415  late: an extra

        try:
            return future.result()
        except KilledWorker as error:
            limit = f", which had {self.memory >> 20} MiB of memory" if self.memory else ""
            found = f"killed its workers {error.allowed_failures + 1} times{limit}"
            raise FleetError(found, where=job.where, fix="give workers more memory") from None

    def ask(self, question: Callable[..., Any], *args: Any) -> list[Any]:
        """Ask every worker; an error is an answer. Raises FleetError if the scheduler is gone."""
        try:
            return list(self._client.run(question, *args, on_error="return").values())
        except LOST as error:
            raise self._explain(error) from None

    def _explain(self, error: Exception, so_far: str = "", kept: str = "what is done") -> Exception:
        """Make an error of Dask one that says what is lost, and what is not."""
        if getattr(error, "errno", None) is not None:  # of the system, as of a full disk
            return error
        fix = f"start it again, and type the same command: it goes on from {kept}"
        return FleetError(f"the scheduler is gone{so_far}", where=self._address, fix=fix)


@contextmanager
def open_cluster(address: str, jobs: int, describe: Callable[[str], None]) -> Iterator[Cluster]:
    """Find the workers at an address, or start as many as asked for on this machine.

    What they log is not for the user of a map.

    Parameters
    ----------
    describe
        Told how far the work is.

    Raises
    ------
    UsageError, FleetError
        Dask is not installed, nobody answers, or the workers are not fit for the work.
    """
    with need_extra("dask", "`dask` needs the library distributed"):
        import distributed  # noqa: F401, PLC0415  late: an extra, and it takes half a second
    for name in ("distributed", "distributed.client"):
        logging.getLogger(name).setLevel(logging.CRITICAL)
    workers = start_local(jobs) if address == LOCAL else nullcontext(address)
    with workers as place, connect(place, address) as client:
        try:
            client.wait_for_workers(1, timeout=PATIENCE_S)
        except TimeoutError:
            fix = f"start some: dask worker {address}"
            raise FleetError("the scheduler has no workers", where=address, fix=fix) from None
        cluster = Cluster(client, address, describe)
        refuse_unfit(cluster)
        Thread(target=miss_workers, args=(client, address), daemon=True).start()
        yield cluster


def miss_workers(client: "Client", address: str) -> None:
    """Say so once where no worker is left for a while: Dask waits for another one for ever."""
    with suppress(Exception):  # of any kind, where the client is closed at this very moment
        while client.status == "running":
            sleep(2 * PATIENCE_S)
            if client.status == "running" and not client.scheduler_info()["workers"]:
                log.warning("%s: no worker is left; waiting for another one", address)
                return


@contextmanager
def start_local(jobs: int) -> Iterator[Any]:
    """Start so many workers on this machine; they end with the block.

    Ctrl-C, and a terminal that closes, reach all processes of a command. Workers never see that,
    and this process does once they are all there: then it ends them in order.
    """
    import dask  # noqa: PLC0415  late: an extra
    import distributed  # noqa: PLC0415  likewise

    with (
        hold_signals() as let_go,
        dask.config.set(ALLOCATOR),
        distributed.LocalCluster(
            n_workers=jobs,
            threads_per_worker=1,
            dashboard_address=":0",
            silence_logs=logging.CRITICAL,
            config={"distributed.worker.profile.enabled": False},  # it takes time
        ) as workers,
    ):
        let_go()
        yield workers


@contextmanager
def hold_signals() -> Iterator[Callable[[], object]]:
    """Let what a terminal sends wait until it is let go; processes started before never get it."""
    if os.name == "nt":  # which has no such signals
        yield lambda: None
        return
    resource_tracker.ensure_running()  # where it starts later, it lets SIGINT go
    terminal = {signal.SIGINT, signal.SIGHUP}
    let_go = partial(signal.pthread_sigmask, signal.SIG_UNBLOCK, terminal)
    signal.pthread_sigmask(signal.SIG_BLOCK, terminal)
    try:
        yield let_go
    finally:
        let_go()


def connect(place: Any, address: str) -> "Client":
    """Connect to workers on this machine, or to the scheduler at an address.

    Raises
    ------
    FleetError
        Nobody answers.
    """
    from distributed import Client  # noqa: PLC0415  late: an extra

    try:
        return Client(place, timeout=PATIENCE_S)
    except (OSError, ValueError) as error:
        found = f"no scheduler answers within {PATIENCE_S} s"
        if isinstance(error, ValueError):
            found = "is no address of a scheduler, such as tcp://HOST:8786"
        fix = "start one with `dask scheduler`, or build with `dask=local`"
        raise FleetError(found, where=address or "''", fix=fix) from None


def refuse_unfit(cluster: Cluster) -> None:
    """Refuse workers that might make other cells, or would wait for memory for ever.

    Raises
    ------
    FleetError
        Saying how many there are and what they run, or how much memory the smallest has.
    """
    mine, theirs = list_versions(), cluster.ask(list_versions)
    if other := [each for each in theirs if each != mine]:
        workers = f"{len(other)} of {count(len(theirs), 'worker')}"
        found = f"{workers} run {other[0]}, and this process runs {mine}"
        raise FleetError(found, fix="install the same versions everywhere")
    if cluster.memory is not None and cluster.memory < LEAST_BYTES:
        least = LEAST_BYTES >> 20
        found = f"a worker may take {cluster.memory >> 20} MiB of memory, and {least} are the least"
        raise FleetError(found, fix="start fewer workers, or give each more memory")


def list_versions() -> str:
    """Versions of what decides which cells a scan observes."""
    return ", ".join(f"{name} {version(name)}" for name in MUST_EQUAL)


def refuse_unseen_files(cluster: Cluster, paths: Paths) -> None:
    """Refuse to begin where not every worker sees the same files.

    Raises
    ------
    FleetError
        Naming the first that some of them do not see.
    """
    answers = cluster.ask(list_missing, paths)
    if missing := [each for each in answers if isinstance(each, list) and each]:
        found = f"is not there on {len(missing)} of {count(len(answers), 'worker')}"
        raise FleetError(found, where=missing[0][0], fix="give a whole path that all of them share")


def list_missing(paths: Paths) -> list[Path]:
    """List the paths that are not there."""
    return [path for path in paths if not path.exists()]
