"""Scans of logs that are read once and posed again and again."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from occmap.errors import PoseError
from occmap.options import BuildOptions
from occmap.posing.attach import Poser
from occmap.posing.options import PosingOptions
from occmap.posing.rotations import to_quaternions
from occmap.readers import Log
from occmap.report.doubts import list_frames
from occmap.scans.mounts import open_drive
from occmap.scans.tally import Tally, refuse_unused
from occmap.scans.tracing import Remarks
from occmap.types import IDENTITY, Float64, Pose, PosedScans, ScanBatch

MOST_SCANS = 1000
"""Scans of all logs together: more tell little more, and each is traced over thirty times."""
MOST_OFFSET_S = 0.5
"""No larger time offset is tried, either way."""
ALIKE = 1e-3
"""Mounts that differ by less (m, rad) count as one: no map shows the difference."""


@dataclass(frozen=True, eq=False)
class KeptLog:
    """Scans of one log, and what is needed to say where they were taken."""

    path: str
    poser: Poser
    batches: tuple[ScanBatch, ...]

    @property
    def stated(self) -> bool:
        """Whether all poses stand beside the scans, so that their times do not matter."""
        chosen = self.poser.sources.trajectory is not None
        return not chosen and all(batch.pose is not None for batch in self.batches)

    def pose(self, options: PosingOptions) -> list[PosedScans]:
        """Pose the scans with other options; those that then have no pose are left out."""
        poser = Poser(self.poser.sources, options, self.poser.fixed)
        return [posed for _, posed, _ in poser.attach(self.batches) if posed is not None]

    @property
    def scans(self) -> int:
        """How many scans are kept."""
        return sum(len(batch.stamp_ns) for batch in self.batches)


def keep_logs(
    logs: Sequence[Log], options: BuildOptions, tally: Tally, remarks: Remarks
) -> list[KeptLog]:
    """Read logs as a build does, and keep scans that have a pose at every time offset.

    Raises
    ------
    OccmapError
        As a build, or no scan is left.
    """
    most = max(MOST_SCANS // len(logs), 1)
    kept = [keep_log(log, options, most, tally, remarks) for log in logs]
    refuse_unused(remarks.logs, tally)
    remarks.notes += list_frames(tally)
    read, used = sum(log.scans for log in kept), tally.scans_used
    if read < used:
        remarks.notes.append(f"{read:,} of {used:,} scans are tried, spread over the logs")
    kept = [drop_outer(log, options.posing) for log in kept]
    if not any(log.scans for log in kept):
        raise PoseError(
            f"no scan has a pose both {MOST_OFFSET_S:g} s before its time and {MOST_OFFSET_S:g} s "
            "after it",
            where=", ".join(remarks.logs),
            fix="give a longer log",
        )
    return kept


def keep_log(log: Log, options: BuildOptions, most: int, tally: Tally, remarks: Remarks) -> KeptLog:
    """Read a log, and keep at most so many of the scans that have a pose."""
    drive = open_drive(log, options).settle()
    kept: list[ScanBatch] = []
    seen, every = 0, 1
    for _, posed, _ in drive.read(tally):
        if posed is not None:
            kept += take_every([posed.batch], every, -seen % every)
            seen += len(posed.batch.stamp_ns)
        while sum(len(part.stamp_ns) for part in kept) > most:
            kept, every = take_every(kept, 2), 2 * every
    tally.scans_used += seen
    remarks.note(log.path, log.notes, drive.list_notes())
    return KeptLog(str(log.path), drive.poser, tuple(kept))


def take_every(batches: Sequence[ScanBatch], n: int, first: int = 0) -> list[ScanBatch]:
    """Take every n-th of the scans of all batches, counted from the first on."""
    taken = []
    for batch in batches:
        scans = len(batch.stamp_ns)
        rows = np.arange(first, scans, n)
        first = (first - scans) % n
        if len(rows):
            taken.append(batch.take(rows))
    return taken


def drop_outer(log: KeptLog, options: PosingOptions) -> KeptLog:
    """Drop the scans without a pose at some time offset, so that all maps are of the same scans."""
    for offset in (-MOST_OFFSET_S, MOST_OFFSET_S):
        shifted = replace(options, time_offset_s=options.time_offset_s + offset)
        log = replace(log, batches=tuple(posed.batch for posed in log.pose(shifted)))
    return log


def find_mount(logs: Sequence[KeptLog], options: PosingOptions) -> Pose | None:
    """Find the `sensor_pose` that leaves every pose of a scan as it is.

    Returns
    -------
    Pose or None
        None where no single one does: lasers sit at different places, one turns on its body, or
        the log does not tell which frame the body is.
    """
    if options.sensor_pose is not None:
        return options.sensor_pose
    on_body = replace(options, sensor_pose=IDENTITY)
    mounts = []
    for log in logs:
        sensor, body = log.pose(options), log.pose(on_body)
        if [len(each.position) for each in sensor] != [len(each.position) for each in body]:
            return None
        mounts += [measure_mount(*pair) for pair in zip(sensor, body, strict=True)]
    every = np.concatenate(mounts)
    if np.abs(every - every[0]).max() >= ALIKE:
        return None
    return Pose(*every[0, :, 3].tolist(), *to_quaternions(every[:1, :, :3])[0].tolist())


def measure_mount(sensor: PosedScans, body: PosedScans) -> Float64:
    """Measure where a sensor sits on its body at each scan: (S, 3, 4), turn and position.

    The height is left out, as it is of `sensor_pose`: no map shows it.
    """
    (position, turn), (origin, orientation) = sensor.at_first_beam, body.at_first_beam
    back = orientation.swapaxes(1, 2)
    place = back @ (position - origin)[:, :, None]
    place[:, 2] = 0
    return np.concatenate([back @ turn, place], axis=2)
