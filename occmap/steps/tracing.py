"""Read, pose, interpret and trace the scans of a log, as a stream of batches."""

from collections.abc import Callable, Iterator, Sequence
from typing import Any, NamedTuple

from occmap.cells import Ground
from occmap.errors import MountError, name_log
from occmap.grid.framing import Reach
from occmap.grid.lattice import Lattice
from occmap.options import BuildOptions
from occmap.posing.attach import Poser
from occmap.readers import Log, read_recorded
from occmap.selection import Selector
from occmap.sensor.no_return import RangeLimits
from occmap.sensor.returns import ReturnCounts, interpret
from occmap.steps.batching import batch_scans, list_oddities, stack
from occmap.steps.mounts import name_mount
from occmap.steps.opening import choose_topics, make_poser
from occmap.steps.tally import Tally
from occmap.types import Attached, PosedScans, Rays, ScanBatch
from occmap.workers import Workers

HANDED_BEAMS = 1 << 12
"""Fewer beams are traced sooner than handed to a thread, which waits for Python's lock: with two
threads, a log of 20,000 laser frames with one scan each took six times as long."""

AddRays = Callable[[Any], None]
"""Adds the rays of a batch, or its posed clouds, to the evidence; any number of threads may."""


class Drive(NamedTuple):
    """A log, which of its scans are used, and where they were taken."""

    log: Log
    topics: Sequence[str]
    """The topics whose scans are used"""
    poser: Poser


def open_drive(log: Log, options: BuildOptions) -> Drive:
    """Choose the scans of a log, and read its poses, which are few beside them.

    Raises
    ------
    LogError, PoseError, UsageError
        As `choose_topics` and `make_poser`.
    """
    topics = choose_topics(log, options.selection.topics)
    try:
        return Drive(log, topics, make_poser(log, topics, options.posing))
    except MountError as error:
        raise name_mount(log, topics, options, error) from None


def trace_logs(
    logs: Sequence[Log], options: BuildOptions, begin: Callable[[], AddRays], tally: Tally
) -> list[tuple[Log, list[str]]]:
    """Read logs and trace their scans; return each log with the notes on it.

    Only a log read to its end shows for sure which ranges mean "no return". Where the first scans
    led to another limit, all these logs are read once more.

    Parameters
    ----------
    begin
        Called each time that the logs are read; returns what takes their rays.
    """
    limits = [RangeLimits(options.returns) for _ in logs]
    for _ in range(2):
        counts = tally.start_over()
        add_rays = begin()
        notes = []
        for log, limit in zip(logs, limits, strict=True):
            with counts.time("poses"):
                drive = open_drive(log, options)
            odd = trace(drive, options, add_rays, limit, counts)
            notes.append([*drive.poser.notes, *odd, *limit.list_notes()])
        right = [limit.settle() for limit in limits]
        if all(right):
            break
        counts.advance(-counts.advanced)  # the same scans are read once more
    tally.add(counts)
    return list(zip(logs, notes, strict=True))


def find_ground(
    logs: Sequence[Log], options: BuildOptions, known: Ground | None
) -> tuple[Ground, list[str]]:
    """Find the ground below all drives, in a pass of its own; say what there is to say of it.

    Parameters
    ----------
    known
        Ground of evidence that the build is added to; it stays as it is.
    """
    from occmap.clouds.ground import GroundFinder  # noqa: PLC0415  late: it brings numba

    finder = GroundFinder()
    for log in logs:
        drive = open_drive(log, options)
        selector = Selector(options.selection, options.posing.stamps)
        scans = selector.select(read_recorded(log, drive.topics))
        batches = filter(finder.wants, stack(scans, selector.stamps))
        with name_log(log.path), Workers(finder.add, options.jobs) as workers:
            for _, posed, _ in drive.poser.attach(batches):
                if posed is not None:
                    workers.give(posed)
    return finder.find(options.clouds, known)


def trace(
    drive: Drive, options: BuildOptions, add_rays: AddRays, limits: RangeLimits, tally: Tally
) -> list[str]:
    """Trace the scans of a log as a stream; say what is odd about them.

    Parameters
    ----------
    limits, tally
        Learn from the scans, and count them; the notes of the poser grow as well.
    """
    selector = Selector(options.selection, options.posing.stamps)
    reach = Reach(Lattice(options.resolution), options.max_cells)
    odd: dict[str, None] = {}

    def work(seen: Rays | PosedScans) -> None:
        with tally.time("trace"):
            add_rays(seen)

    with name_log(drive.log.path), Workers(work, options.jobs) as workers:
        batches = batch_scans(read_recorded(drive.log, drive.topics), selector, limits)
        # Here, not in a worker: each of many short NumPy calls would wait for the GIL.
        for attached in pose_scans(drive, batches, selector, tally):
            odd |= dict.fromkeys(list_oddities(attached.batch))
            if tally.recorder:
                tally.recorder.follow(drive.log.path, drive.poser.fixed, attached)
            if attached.posed is not None and attached.batch.clouds:
                tally.use(len(attached.posed.batch.stamp_ns), ReturnCounts())
                workers.give(attached.posed)
            elif attached.posed is not None:
                with tally.time("interpret"):
                    rays, beams = interpret(attached.posed, options.returns)
                tally.use(len(rays.kind), beams)
                reach.stretch(rays)
                (workers.give if rays.kind.size >= HANDED_BEAMS else work)(rays)
    concerns = drive.poser.list_concerns(selector.first_ns or 0, options.returns.max_range)
    return [*odd, *(f"{topic}: {concern.text}" for topic, concern in concerns)]


def pose_scans(
    drive: Drive, batches: Iterator[ScanBatch], selector: Selector, tally: Tally
) -> Iterator[Attached]:
    """Pose the scans of a log as a stream; count what becomes of them.

    Parameters
    ----------
    batches
        Of the scans that the selector passes on.
    """
    for attached in tally.time_each("pose", drive.poser.attach(tally.time_each("read", batches))):
        tally.drop(attached.dropped)
        yield attached
        tally.advance(len(attached.batch.stamp_ns))
    tally.frames[str(drive.log.path)] = drive.poser.fixed
    tally.lasers = max(tally.lasers, len(drive.topics))
    tally.scans_read += selector.read
    tally.drop(dict(selector.left_out))
