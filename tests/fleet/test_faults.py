"""Workers and drivers die, disks fill: the same map comes out, or one line and no file."""

import errno
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from concurrent.futures import CancelledError, ProcessPoolExecutor
from contextlib import contextmanager
from dataclasses import replace
from multiprocessing import get_context
from pathlib import Path
from threading import Thread

import pytest
from distributed import Client
from distributed.comm.core import CommClosedError

from occmap.errors import FleetError, LogError, MapError, UsageError
from occmap.fleet import Fleet, cluster, open_scratch
from occmap.fleet.cluster import Job, hold_signals, open_cluster
from occmap.fleet.tasks import Setting
from occmap.options import BuildOptions
from occmap.pipeline import build
from occmap.posing import PosingOptions
from occmap.report.results import Report
from occmap.scans import Keep
from occmap.scans.tracing import ignore_progress
from occmap.store import open_store, read_all
from tests.cli.runner import occmap, spawn
from tests.samples import DRIVES
from tests.store.test_store import digest_evidence, read_digest

resource = pytest.importorskip("resource", reason="Windows has neither SIGKILL nor such limits")
LOGS = [DRIVES[0], DRIVES[4]]
OPTIONS = BuildOptions(jobs=1)
PATIENCE_S = 60
SETTING = Setting(OPTIONS, Keep(), Path(), 1, 0, 0)
JOB = Job("log", "drive.mcap")


@pytest.fixture(scope="module")
def expected(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    path = tmp_path_factory.mktemp("alone") / "map.npz"
    build(LOGS, OPTIONS, [path])
    return path.read_bytes()


def build_by(address: str, folder: Path, options: BuildOptions = OPTIONS) -> Report:
    """Build `map.npz` in a folder by workers, whose scratch folder lies beside it."""
    observe = Fleet(address, folder / "scratch").observe
    return build(LOGS, options, [folder / "map.npz"], observe=observe).report


def wait_for(folder: Path, pattern: str) -> list[Path]:
    """Wait until there is some file of a kind in a folder."""
    end = time.monotonic() + PATIENCE_S
    while time.monotonic() < end:
        if found := list(folder.glob(pattern)):
            return found
        time.sleep(0.002)
    raise TimeoutError(pattern)


@contextmanager
def kill_worker(address: str, folder: Path, pattern: str) -> Iterator[None]:
    """Kill one of the workers as soon as there is some file of a kind in a folder."""
    with Client(address) as client:
        victim = next(iter(client.run(os.getpid).values()))

    def kill() -> None:
        wait_for(folder, pattern)
        os.kill(victim, signal.SIGKILL)

    killer = Thread(target=kill)
    killer.start()
    yield
    killer.join()


@pytest.mark.parametrize("phase", ["*/*.survey_log", "*/*.trace_log", "*/*.reduce_block"])
def test_a_worker_is_killed(address: str, tmp_path: Path, expected: bytes, phase: str) -> None:
    with kill_worker(address, tmp_path / "scratch", phase):
        build_by(address, tmp_path)
    assert (tmp_path / "map.npz").read_bytes() == expected


def test_a_map_that_is_too_large_names_the_log(address: str, tmp_path: Path) -> None:
    with pytest.raises(MapError) as caught:
        build_by(address, tmp_path, replace(OPTIONS, max_cells=1000))
    assert caught.value.where == str(LOGS[0])


@pytest.mark.parametrize("phase", ["slices/*/c/*", "classes/1/c/*"])
def test_a_worker_that_writes_a_store_is_killed(address: str, tmp_path: Path, phase: str) -> None:
    logs, options = DRIVES[:1], replace(OPTIONS, resolution=0.02)
    build(logs, options, [tmp_path / "alone.zarr"])
    fleet = Fleet(address, tmp_path / "scratch")
    with kill_worker(address, tmp_path, f".occmap-*/{phase}"):
        fleet.build(logs, options, [tmp_path / "fleet.zarr"], ignore_progress)
    one, other = (open_store(tmp_path / f"{name}.zarr") for name in ("alone", "fleet"))
    assert read_all(one).tiles
    assert read_digest(one) == digest_evidence(read_all(other))
    for level in one.root["classes"]:
        assert (one.root["classes"][level][:] == other.root["classes"][level][:]).all()


def start_build(address: str, scratch: Path, output: Path) -> subprocess.Popen[str]:
    """Start a build by workers in a process of its own."""
    line = [sys.executable, "-m", "occmap", "build", *map(str, LOGS), "-o", str(output)]
    line += ["--dask", address, "--scratch", str(scratch)]
    return subprocess.Popen(line, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


@pytest.mark.parametrize("phase", ["*/*.survey_log", "*/*.trace_log", "*/*.reduce_block"])
def test_a_build_whose_driver_was_killed_goes_on_where_it_was(
    address: str, tmp_path: Path, expected: bytes, phase: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    scratch, output = tmp_path / "scratch", tmp_path / "map.npz"
    with start_build(address, scratch, output) as first:
        done = {path: path.stat().st_mtime_ns for path in wait_for(scratch, phase)}
        first.kill()
    assert not output.exists()
    monkeypatch.setattr("occmap.fleet.shutil.rmtree", lambda *_, **__: None)
    build_by(address, tmp_path)
    assert output.read_bytes() == expected
    assert {path: path.stat().st_mtime_ns for path in done} == done


def test_what_was_removed_from_the_scratch_folder_is_made_anew(
    address: str, tmp_path: Path, expected: bytes, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("occmap.fleet.shutil.rmtree", lambda *_, **__: None)
    build_by(address, tmp_path)
    (scratch,) = (tmp_path / "scratch").glob("build-*")
    for left in [*scratch.glob("block*"), *scratch.glob("log00001.*.run")]:
        left.unlink()
    (scratch / "log00000.trace_log").write_bytes(b"")
    with pytest.raises(MapError, match=r"log00001.*the same command"):
        build_by(address, tmp_path)
    build_by(address, tmp_path)
    assert (tmp_path / "map.npz").read_bytes() == expected


def test_a_store_whose_driver_was_killed_is_begun_anew(address: str, tmp_path: Path) -> None:
    scratch, output = tmp_path / "scratch", tmp_path / "map.zarr"
    with start_build(address, scratch, output) as first:
        wait_for(tmp_path, ".occmap-*.tmp/slices/*/c")
        first.kill()
    assert not output.exists()
    Fleet(address, scratch).build(LOGS, OPTIONS, [output], ignore_progress)
    build(LOGS, OPTIONS, [tmp_path / "alone.zarr"])
    digests = {read_digest(open_store(path)) for path in tmp_path.glob("*.zarr")}
    assert len(digests) == 1
    assert sorted(path.name for path in tmp_path.iterdir()) == ["alone.zarr", "map.zarr"]


def test_of_two_equal_builds_the_second_waits_and_both_are_whole(
    address: str, tmp_path: Path
) -> None:
    scratch, output = tmp_path / "scratch", tmp_path / "map.zarr"
    with start_build(address, scratch, output) as first:
        wait_for(scratch, "*/*.survey_log")
        first.send_signal(signal.SIGSTOP)
        with start_build(address, scratch, output) as second:
            assert second.stderr is not None
            assert "lock-" in (said := second.stderr.readline())
            assert said.endswith(": waiting for another occmap that writes to it\n")
            first.send_signal(signal.SIGCONT)
            assert [each.communicate(timeout=PATIENCE_S)[1] for each in (first, second)] == ["", ""]
    assert (first.returncode, second.returncode) == (0, 0)
    assert read_digest(open_store(output)) == digest_evidence(read_all(open_store(output)))
    assert [path.name for path in tmp_path.iterdir()] == ["map.zarr"]


@contextmanager
def start_apart(folder: Path) -> Iterator[tuple[str, subprocess.Popen[bytes]]]:
    """Start a scheduler and a worker in processes of their own; give the first, and its address."""
    known = folder / "scheduler.json"
    flags = ["--no-dashboard", "--scheduler-file", str(known)]
    begun: list[subprocess.Popen[bytes]] = []

    def start(name: str, *more: str) -> None:
        line = [sys.executable, "-m", f"distributed.cli.dask_{name}", *flags, *more]
        quiet = subprocess.DEVNULL
        begun.append(subprocess.Popen(line, stdout=quiet, stderr=quiet))

    try:
        start("scheduler", "--port", "0")
        wait_for(folder, known.name)
        start("worker", "--nthreads", "1", "--no-nanny")
        with Client(scheduler_file=str(known)) as client:
            client.wait_for_workers(1, PATIENCE_S)
            address = str(client.scheduler.address)
        yield address, begun[0]
    finally:
        for process in begun:
            process.kill()
            process.wait()
        known.unlink(missing_ok=True)


def test_a_scheduler_is_killed(
    address: str, tmp_path: Path, expected: bytes, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What is done by then is done for the next scheduler, too."""
    folder, scratch, output = tmp_path / "dask", tmp_path / "scratch", tmp_path / "map.npz"
    folder.mkdir()
    with start_apart(folder) as (lost, scheduler), start_build(lost, scratch, output) as building:
        (found, *_) = wait_for(scratch, "*/*.trace_log")
        scheduler.kill()
        _, said = building.communicate(timeout=PATIENCE_S)
    assert building.returncode == 1
    (told,) = said.splitlines()
    for part in (f"{lost}: the scheduler is gone", "of 2 tasks", "same command", found.parent):
        assert str(part) in told
    done = found.stat().st_mtime_ns
    monkeypatch.setattr("occmap.fleet.shutil.rmtree", lambda *_, **__: None)
    build_by(address, tmp_path)
    assert output.read_bytes() == expected
    assert found.stat().st_mtime_ns == done


def make_deadly() -> Callable[[Setting, Job], int]:
    """A task that kills its worker; made here, it goes there as it is, without all of tests."""

    def die(_setting: Setting, _job: Job) -> int:
        os.kill(os.getpid(), signal.SIGKILL)
        return 0

    return die


def run_job(found: cluster.Cluster) -> None:
    found.run(make_deadly(), SETTING, [JOB])


def ask_workers(found: cluster.Cluster) -> None:
    cluster.refuse_unseen_files(found, [])


FULL = OSError(errno.ENOSPC, "No space left on device")


@pytest.mark.parametrize(
    ("called", "error", "act", "expected", "told"),
    [
        ("run", OSError("Timed out"), ask_workers, FleetError, "gone; start it again, and type"),
        ("map", CommClosedError(), run_job, FleetError, "scheduler is gone; 0 of 1 tasks"),
        ("map", CancelledError(), run_job, FleetError, "scheduler is gone; 0 of 1 tasks"),
        ("map", OSError(), run_job, FleetError, "scheduler is gone; 0 of 1 tasks"),
        ("map", FULL, run_job, OSError, "No space left"),
    ],
)
def test_a_connection_that_closes_is_a_scheduler_that_is_gone_and_a_full_disk_is_not(
    address: str,
    monkeypatch: pytest.MonkeyPatch,
    called: str,
    error: Exception,
    act: Callable[[cluster.Cluster], None],
    expected: type[Exception],
    told: str,
) -> None:
    def fail(*_: object, **__: object) -> None:
        raise error

    with open_cluster(address, 1, print) as found:
        monkeypatch.setattr(found._client, called, fail)
        with pytest.raises(expected, match=told):
            act(found)


def test_that_no_worker_is_left_is_said_once_and_a_lost_scheduler_is_not_waited_for(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    told: list[str] = []

    def hear(text: str, *values: object) -> None:
        told.append(text % values)
        scheduler.kill()

    monkeypatch.setattr(cluster.log, "warning", hear)
    with start_apart(tmp_path) as (address, scheduler), open_cluster(address, 1, print) as found:
        monkeypatch.setattr(cluster, "PATIENCE_S", 0.2)
        Thread(target=cluster.miss_workers, args=(found._client, address), daemon=True).start()
        with pytest.raises(FleetError, match="the scheduler is gone; 0 of 1 tasks"):
            found.run(make_deadly(), SETTING, [JOB])
        while found._client.status == "running":
            time.sleep(0.01)
        with pytest.raises(FleetError, match="the scheduler is gone; 0 of 1 tasks"):
            found.run(make_deadly(), SETTING, [JOB])
    assert told == [f"{address}: no worker is left; waiting for another one"]


def test_nobody_answers_whatever_jobs_say(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cluster, "PATIENCE_S", 0.5)
    words = ["build", DRIVES[0], "-o", tmp_path / "map.pgm", "--dask", "tcp://127.0.0.1:9"]
    assert "--jobs does nothing" in occmap(*words, "--jobs", "2").err
    (told,) = occmap(*words).err.splitlines()
    assert "no scheduler answers" in told
    assert list(tmp_path.iterdir()) == []


def limit_files() -> None:
    """Let no file grow beyond 16 kB, as on a disk that is full."""
    signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (16_000, 16_000))


def test_a_full_disk_is_one_line_and_nothing_is_published(tmp_path: Path) -> None:
    output = tmp_path / "map.npz"
    words = ["build", DRIVES[0], "-o", output, "--dask", "local", "--jobs", "1"]
    done = spawn(*words, preexec_fn=limit_files)
    assert done.returncode == 1
    (told,) = done.stderr.splitlines()
    assert "cannot be written (File too large)" in told
    assert [path.name for path in tmp_path.iterdir()] == ["map.npz.scratch"]


def test_a_task_that_kills_its_workers_is_named(address: str) -> None:
    told = r"drive.mcap: killed its workers 2 times, which had \d+ M"
    with open_cluster(address, 2, print) as found, pytest.raises(FleetError, match=told):
        found.run(make_deadly(), SETTING, [JOB])


@pytest.mark.parametrize("address", [",", ":"])
def test_what_is_no_address_is_called_that(address: str) -> None:
    with pytest.raises(FleetError, match="is no address of a scheduler, such as tcp://HOST:8786"):
        cluster.connect(address, address)


def test_workers_run_other_versions(address: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cluster, "version", lambda name: "0.9" if name == "numba" else "1")
    found = r"\d of \d workers? run occmap .*, and this process runs occmap 1, numpy 1, numba 0.9"
    with pytest.raises(FleetError, match=found), open_cluster(address, 2, lambda _: None):
        pass


def test_a_worker_with_little_memory_is_refused(
    address: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(cluster, "LEAST_BYTES", 1 << 50)
    found = r"a worker may take \d+ MiB of memory"
    with pytest.raises(FleetError, match=found), open_cluster(address, 2, print):
        pass


def test_a_log_that_only_some_see(address: str, tmp_path: Path) -> None:
    with open_cluster(address, 2, lambda _: None) as found:
        cluster.refuse_unseen_files(found, [tmp_path])
        with pytest.raises(FleetError, match=r"a.mcap: is not there on (\d) of \1 worker"):
            cluster.refuse_unseen_files(found, [tmp_path, tmp_path / "a.mcap"])


def test_the_first_log_that_fails_is_named(address: str, tmp_path: Path) -> None:
    logs = [DRIVES[0], tmp_path / "missing.mcap", tmp_path / "gone.mcap"]
    observe = Fleet(address, tmp_path / "scratch").observe
    with pytest.raises(LogError, match=r"missing\.mcap: no such file or directory"):
        build(logs, OPTIONS, [tmp_path / "map.pgm"], observe=observe)


def test_dask_is_not_installed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(UsageError, match=r"install it: pip install 'dask>="):
        build_by("local", tmp_path)


def test_ctrl_c_waits_for_workers_to_start_and_never_reaches_them() -> None:
    masked = set[int]()
    signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell's job may ignore it
    with pytest.raises(KeyboardInterrupt), hold_signals() as let_go:  # noqa: PT012  one by one
        signal.raise_signal(signal.SIGINT)
        with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as started:
            masked = started.submit(signal.pthread_sigmask, signal.SIG_BLOCK, []).result()
        let_go()
    assert {signal.SIGINT, signal.SIGHUP} <= masked
    assert not {signal.SIGINT, signal.SIGHUP} & signal.pthread_sigmask(signal.SIG_BLOCK, [])


def interrupt(scratch: Path, options: BuildOptions) -> Path:
    """The folder of a build that was interrupted before anything was done, and left none."""
    with pytest.raises(KeyboardInterrupt), open_scratch(scratch, LOGS, options, Keep()) as made:
        raise KeyboardInterrupt
    assert not scratch.exists()
    return made


def test_a_scratch_folder_that_the_user_made_stays(tmp_path: Path) -> None:
    with open_scratch(tmp_path, LOGS, OPTIONS, Keep()) as made:
        assert made.parent == tmp_path
    assert not [*tmp_path.iterdir()]


def test_a_build_goes_on_only_where_its_trajectory_is_the_same(tmp_path: Path) -> None:
    poses = tmp_path / "poses.tum"
    options = replace(OPTIONS, posing=PosingOptions(poses=str(poses)))
    poses.write_text("0 0 0 0 0 0 0 1\n")
    begun = interrupt(tmp_path / "scratch", options)
    assert interrupt(tmp_path / "scratch", options) == begun
    poses.write_text("0 5 0 0 0 0 0 1\n9 5 0 0 0 0 0 1\n")
    assert interrupt(tmp_path / "scratch", options) != begun


def test_what_another_build_left_is_named_and_kept(address: str, tmp_path: Path) -> None:
    left = interrupt(scratch := tmp_path / "scratch", replace(OPTIONS, resolution=0.2))
    left.mkdir(parents=True)
    report = build_by(address, tmp_path)
    assert [note for note in report.notes if note.startswith(f"{left}: of a build with another")]
    assert [*scratch.iterdir()] == [left]
