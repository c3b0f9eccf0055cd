"""Trace the scans of logs: read, posed and interpreted, each log with several threads."""

import math
from collections import Counter, defaultdict
from collections.abc import Callable, Iterator
from functools import partial
from typing import Any, NamedTuple, Protocol, TypeAlias, TypeVar

import numpy as np

from occmap.cells import Evidence, Slices
from occmap.clouds import draw
from occmap.errors import MapError, UsageError, name_log
from occmap.evidence import list_misfit, make_empty
from occmap.evidence.manifest import plan_manifest
from occmap.grid import Lattice
from occmap.grid.rendering import Reach
from occmap.grid.tiles import TileGrid, unite
from occmap.options import BuildOptions
from occmap.readers import open_log
from occmap.report import join_names
from occmap.scans import Keep, make_engine
from occmap.scans.logs import count_scans, settle_update
from occmap.scans.mounts import open_drive
from occmap.scans.stream import Drive, write_doubts
from occmap.scans.tally import LeftOut, Tally, refuse_unused
from occmap.sensor import ReturnCounts, interpret
from occmap.threads import Threads
from occmap.types import Bool, Float64, Int64, Paths, PosedScans, Rays, Update

HANDED_BEAMS = 1 << 12
"""Fewer beams are traced sooner than handed to a thread, which waits for Python's lock: with two
threads, a log of 20,000 laser frames with one scan each took six times as long."""


class TakesRays(Protocol):
    """Whatever scans are given to."""

    def add(self, seen: Any, /) -> None:
        """Add the rays of a batch, or its posed clouds; any number of threads may."""


Taker = TypeVar("Taker", bound=TakesRays)


def trace_drive(drive: Drive, begin: Callable[[], Taker], tally: Tally) -> Taker:
    """Read a drive and trace its scans; return what took them.

    Only a log read to its end shows for sure which ranges mean "no return", and which scans leap
    away. Where the first scans let something else seem right, the log is read once more.

    Parameters
    ----------
    begin
        Called each time that the log is read; returns what takes its rays. Where it is read once
        more, what took them first is of no use.
    """
    for _ in range(2):
        counts, taker = tally.start_over(), begin()
        try:
            trace_stream(drive, taker, counts)
        except MapError as error:
            # Without scans that leap away the map may be small enough.
            if drive.is_settled or not drive.poser.may_leap() or drive.foresee():
                doubts = "; ".join(write_doubts(drive.list_doubts()))
                raise MapError(error.found, where=error.where, fix=doubts or error.fix) from None
        else:
            if drive.settle():
                break
        counts.advance(-counts.advanced)  # the same scans are read once more
    if counts.shown_every:
        counts.trajectories += drive.poser.list_trajectories(str(drive.log.path))
    tally.add(counts)
    return taker


def trace_stream(drive: Drive, taker: TakesRays, tally: Tally) -> None:
    """Trace the scans of a log as a stream."""

    def work(seen: Rays | PosedScans) -> None:
        with tally.time("trace"):
            taker.add(seen)

    with name_log(drive.log.path), Threads(work, drive.options.jobs) as threads:
        for seen in read_seen(drive, tally):
            is_short = isinstance(seen, Rays) and seen.kind.size < HANDED_BEAMS
            (work if is_short else threads.give)(seen)


WHOLE_S, FEWEST = 4.0, 40
"""Of a standstill of up to a minute clouds of about so many seconds count, spread over it, and of a
longer one a sixteenth; but so many at least, if it has as many"""


class Standstill:
    """Chooses the clouds of one sensor that count.

    Where it stands still it has one view, again and again, which outweighs what it sees once it
    drives: tables were free that a robot stood far from for a minute, and then passed. Those that
    count are spread evenly, since people pass at any time, but not one in so many: clouds may be
    sectors of a turn.
    """

    def __init__(self) -> None:
        self._last_ns = -math.inf
        """When a cloud counted last"""

    def choose(self, stamps_ns: Int64, stood_s: Float64) -> Bool:
        """Choose the clouds (S,) that count, of the next ones, about which it stands so long."""
        counts = np.ones(len(stamps_ns), np.bool_)
        for at, (stamp_ns, long_s) in enumerate(zip(stamps_ns.tolist(), stood_s, strict=True)):
            is_late = not 0 <= stamp_ns - self._last_ns < long_s * 1e9 / FEWEST
            counts[at] = is_late or draw(stamp_ns) * long_s < WHOLE_S
            self._last_ns = stamp_ns if counts[at] else self._last_ns
        return counts


def read_views(drive: Drive, tally: Tally) -> Iterator[PosedScans]:
    """Read the usable scans of a drive, batch by batch, and of its clouds those that count."""
    views: defaultdict[tuple[str, str], Standstill] = defaultdict(Standstill)
    for posed in drive.read(tally):
        if not posed.batch.clouds:
            yield posed
            continue
        stood_s = drive.poser.measure_standstills(posed)
        counts = views[posed.batch.topic, posed.batch.frame].choose(posed.stamp_ns, stood_s)
        tally.dropped += Counter({LeftOut.STOOD: int((~counts).sum())})
        yield posed.take(counts)


def read_seen(drive: Drive, tally: Tally) -> Iterator[Rays | PosedScans]:
    """Read what the usable scans of a drive saw, batch by batch: as rays, or as posed clouds.

    It belongs to one thread: each of many short NumPy calls of a worker would wait for the GIL.

    Raises
    ------
    MapError
        The map would be too large.
    """
    options = drive.options
    reach = Reach(Lattice(options.resolution), options.max_cells)
    for posed in read_views(drive, tally):
        if posed.batch.clouds:
            tally.use(len(posed.stamp_ns), ReturnCounts())
            yield posed
            continue
        with tally.time("interpret"):
            rays, beams = interpret(posed, options.returns)
        tally.show(rays)
        tally.use(len(rays.kind), beams)
        reach.stretch(rays)
        yield rays


Progress: TypeAlias = Callable[[int, int], None]
"""Called now and then with the scans read since the last call, and with all that there are"""


def ignore_progress(_scans: int, _total: int) -> None:
    """Show no progress."""


class Reading:
    """Logs that are open, with what is counted, timed and told while their scans are read.

    Raises
    ------
    OccmapError
        A log cannot be read.
    """

    def __init__(self, paths: Paths, options: BuildOptions, progress: Progress) -> None:
        self.options, names = options, list(map(str, paths))
        self.tally = Tally(lambda scans: progress(scans, self.total), logs=names)
        with self.tally.time("open"):
            self.logs = [open_log(path, options.reading) for path in paths]
        self.total = sum(count_scans(log, options.selection.topics) for log in self.logs)
        """Of what progress is told; more may be added to it"""

    def list_drives(self) -> Iterator[Drive]:
        """Give the drive of each log, which is read before the next one is asked for.

        Each is read for its limits and leaps alone first, so that they hold from its first scan on.

        Raises
        ------
        OccmapError
            As `open_drive`, of any of them.
        """
        for drive in [open_drive(log, self.options) for log in self.logs]:
            drive.foresee()
            yield drive
            self.tally.note(drive.log.path, [*drive.list_notes(), *drive.log.notes])

    def list_rays(self) -> Iterator[Rays]:
        """Read the usable scans of all logs, batch by batch, and map nothing on the way.

        Raises
        ------
        OccmapError
            As a build, also where no scan can be used, or a log holds clouds: these have no beams.
        """
        for log in self.logs:
            if settle_update([log], self.options).update is Update.CLOUD:
                found = "holds clouds of points, and maps are scored by the beams of laser scans"
                fix = "give a log of scans, or choose with `topics`"
                raise UsageError(found, where=log.path, fix=fix)
        for drive in self.list_drives():
            with name_log(drive.log.path):
                for seen in read_seen(drive, self.tally):
                    assert isinstance(seen, Rays)
                    yield seen
        refuse_unused(self.tally)


class Observed(NamedTuple):
    """What the logs showed, and what there is to say of them."""

    evidence: Evidence
    """Its manifest does not say yet what it was made of"""
    tally: Tally
    options: BuildOptions
    """With the update that suits what the logs hold"""


Observe: TypeAlias = Callable[[Paths, BuildOptions, Keep, Progress], Observed]
"""Traces all usable scans of logs, as `observe` does: here, or by many workers"""


def observe(paths: Paths, options: BuildOptions, keep: Keep, progress: Progress) -> Observed:
    """Trace all usable scans of logs.

    Raises
    ------
    OccmapError
        A log cannot be read, has no scans or no poses, or the map would be too large.
    """
    reading = Reading(paths, options, progress)
    tally, options = reading.tally, settle_update(reading.logs, options)
    drives = (open_drive(log, options) for log in reading.logs)
    if options.update is Update.CLOUD:  # which are read three times, by the same poses
        from occmap.scans.levelling import find_ground  # noqa: PLC0415  late: it brings numba

        with tally.time("poses"):
            known = list(drives)
        with tally.time("ground"):
            ground, found, options = find_ground(known, options, keep.ground)
        keep, drives = keep._replace(ground=ground), (drive.renew(options) for drive in known)
        tally.notes += found
    tiles = make_empty(plan_manifest(options))
    slices: list[Slices] = []
    begin = partial(make_engine, options, keep)
    for drive in tally.time_each("poses", drives):
        of_log = Tally(tally.tell, keep.choose_shown(drive.scans * len(paths)))
        engine = trace_drive(drive, begin, of_log)
        of_log.points.update(engine.points)
        tally.add(of_log)
        with tally.time("fold"):
            misfit = add_seen(tiles, engine.finish(), drive)
            slices += engine.read_slices()
        tally.note(drive.log.path, [*drive.list_notes(keep.ground), *misfit, *drive.log.notes])
    with tally.time("fold"):
        kept = (unite(slices),) if keep.slices else ()
    plan, where = plan_manifest(options), join_names(tally.logs)
    return Observed(Evidence(plan, tiles.tiles, kept, where, ground=keep.ground), tally, options)


def add_seen(tiles: TileGrid, seen: TileGrid, drive: Drive) -> list[str]:
    """Add what a log showed to what the logs before it did; say what does not fit.

    Raises
    ------
    MapError
        The map is too large.
    """
    misfit = list(list_misfit(tiles, seen.tiles, drive.options.model, "the logs before it"))
    tiles.merge(seen)
    with name_log(drive.log.path):
        tiles.refuse_outgrown(drive.options.max_cells)
    return misfit
