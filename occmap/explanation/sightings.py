"""Which scans hit a cell or cleared it: each traced once more, as its build traced it."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from occmap.explanation.history import CellHistory, Numbers, Seen
from occmap.explanation.provenance import Use
from occmap.options import BuildOptions
from occmap.readers import Log, open_log
from occmap.report.printed import Count
from occmap.scans.engines import plan_grid
from occmap.scans.logs import count_scans
from occmap.scans.mounts import open_drive
from occmap.scans.tally import Tally
from occmap.scans.tracing import Progress
from occmap.sensor.returns import interpret
from occmap.types import Int64, PosedScans


@dataclass(frozen=True)
class Sighting:
    """What one scan did to the cell."""

    stamp_ns: int
    """When the scan was taken, as its log says it (ns)"""
    log: str
    """The log, as it was given"""
    build: Count
    """Which build of the evidence used it, counted from 0 as in the manifest"""
    topic: str
    """The topic, or the kind of line"""
    seen: Seen
    """What the scan added to the cell"""
    x: float
    """Where the sensor was (m)"""
    y: float
    """Where the sensor was (m)"""
    distance: float
    """From there to the middle of the cell (m)"""


def find_sightings(
    uses: Sequence[Use], history: CellHistory, progress: Progress
) -> tuple[list[Sighting], int]:
    """Trace all scans of the logs once more, and see what each does to the cell.

    Returns
    -------
    sightings, used
        In the order of the logs; and how many scans of these logs the builds used.
    """
    from occmap.grid.probe import look_at_cell  # noqa: PLC0415  late: it brings numba

    opened = [(use, open_log(use.log, use.options.reading)) for use in uses]
    total = sum(count_scans(log, use.options.selection.topics) for use, log in opened)
    sightings: list[Sighting] = []
    tally = Tally(lambda scans: progress(scans, total))
    for use, log in opened:
        spec, cell = plan_grid(use.options), (history.cell.row, history.cell.column)
        for posed in pose_again(log, use.options, tally):
            rays, beams = interpret(posed, use.options.returns)
            numbers = look_at_cell(rays, spec, *cell)
            sightings += list_sightings(use, posed, numbers, history)
            tally.use(len(numbers), beams)
    return sightings, tally.scans_used


def pose_again(log: Log, options: BuildOptions, tally: Tally) -> Iterator[PosedScans]:
    """Read and pose the scans of a log as a build does, by the limits that all of it shows."""
    for attached in open_drive(log, options).settle().read(tally):
        if attached.posed is not None:
            yield attached.posed


def list_sightings(
    use: Use, posed: PosedScans, numbers: Int64, history: CellHistory
) -> Iterator[Sighting]:
    """List the scans of a batch that added something (S, 2) to the cell."""
    low_x, low_y, high_x, high_y = history.cell.extent
    middle = np.array([low_x + high_x, low_y + high_y]) / 2
    for scan in np.flatnonzero(numbers.any(axis=1)):
        place = posed.position[scan].reshape(-1, 3)  # one, or one a beam
        sensor = place[len(place) // 2, :2]
        yield Sighting(
            int(posed.batch.stamp_ns[scan]),
            str(use.log),
            use.build,
            posed.batch.topic,
            Seen.read(numbers[scan].tolist(), history.seen.kind),
            x=float(sensor[0]),
            y=float(sensor[1]),
            distance=float(np.hypot(*(sensor - middle))),
        )


def add_up(sightings: Sequence[Sighting]) -> Numbers:
    """Sum up what scans added to the cell."""
    first, second = (sum(each.seen.numbers[part] for each in sightings) for part in (0, 1))
    return first, second
