"""Scans whose poses leap away and back: they are left out, counted and noted; moves stay."""

import math
import struct
from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import chain, pairwise
from pathlib import Path

import numpy as np
import pytest

from occmap.inspection import inspect
from occmap.options import BuildOptions, Selection
from occmap.pipeline import build
from occmap.posing import PosingOptions, Stamps
from occmap.posing.leaps import LONG_ROW_STEPS, MOST_SCANS
from occmap.report.results import Build
from occmap.scans import stream
from occmap.scans.stream import stack
from occmap.types import Pose, Scan, ScanBatch
from tests.posing.scenes import at, attach, batch_at, bolted, drive
from tests.posing.scenes import build as make_poser
from tests.samples import REAL_LOGS, Planar, write_csv

DRIVE: list[Planar] = [(second / 2, 0.0, 0.0) for second in range(40)]
LEAP = "further from their neighbours than `max_speed` allows"


def flip(value: float, bit: int) -> float:
    (number,) = struct.unpack("<Q", struct.pack("<d", value))
    (flipped,) = struct.unpack("<d", struct.pack("<Q", number ^ 1 << bit))
    return float(flipped)


def map_drive(folder: Path, poses: list[Planar], **posing: float) -> Build:
    log = write_csv(folder / "log.csv", poses, [1.0, 1.5, 2.0], step=0.1)
    return build([log], BuildOptions(posing=PosingOptions(**posing)))  # type: ignore[arg-type]


@pytest.mark.parametrize("scan", [0, 1, 7, 38, 39])
@pytest.mark.parametrize("x", [1e3, -2e6, flip(3.5, 57), flip(19.5, 56)])
def test_a_scan_that_leaps_is_left_out_and_told(tmp_path: Path, scan: int, x: float) -> None:
    report = map_drive(tmp_path, [*DRIVE[:scan], (x, 0.0, 0.0), *DRIVE[scan + 1 :]]).report
    assert report.scans.dropped == {LEAP: 1}
    assert (report.scans.read, report.scans.used) == (40, 39)
    (note,) = (note for note in report.notes if "`max_speed=inf`" in note)
    assert f"the scan at {scan}.000 s lies" in note
    assert report.map.columns < 600


def test_all_is_kept_on_request(tmp_path: Path) -> None:
    poses = [*DRIVE[:7], (1e3, 0.0, 0.0), *DRIVE[8:]]
    report = map_drive(tmp_path, poses, max_speed=math.inf).report
    assert not report.scans.dropped
    assert report.map.columns > 1000 / 0.05
    (note,) = (note for note in report.notes if "max_speed" in note)
    assert "the scan at 7.000 s lies 997 m from its neighbour, 1 s away: the map reaches" in note


@pytest.mark.parametrize(
    "poses",
    [
        [*DRIVE[:20], *((x + 300, y, yaw) for x, y, yaw in DRIVE[20:])],
        [(30.0 * second, 0.0, 0.0) for second in range(40)],
        [(0.0, 0.0, 0.0), (1e3, 0.0, 0.0), (0.0, 0.0, 0.0)],
        [(80.0 * second, 0.0, 0.0) for second in range(40)],
    ],
    ids=["carried elsewhere", "a car", "three scans", "a train, or wrong units"],
)
def test_what_may_be_so_is_kept(tmp_path: Path, poses: list[Planar]) -> None:
    report = map_drive(tmp_path, poses).report
    assert report.scans.used == len(poses)
    assert not any("`max_speed=inf`" in note for note in report.notes)


def test_a_transform_that_leaps_takes_its_scans_along() -> None:
    """Scans twice as often as transforms: the ones halfway there and back are wrong, too."""
    samples = drive("odom", "base_link", seconds=range(41))
    samples[20] = at(20, "odom", "base_link", Pose.planar(4000.0, 0.0, 0.0))
    poser = make_poser(*samples, bolted("base_link", "laser", Pose.planar(0, 0, 0)))
    seconds = [half / 2 for half in range(81)]
    (posed,), dropped = attach(poser, batch_at(seconds))
    assert {str(reason): scans for reason, scans in dropped.items()} == {LEAP: 3}
    assert posed.position[:, 0].tolist() == [s for s in seconds if not 19 < s < 21]


def state(xs: Sequence[float], seconds: Sequence[float] | None = None) -> ScanBatch:
    """Scans whose poses stand beside them, one a second unless told otherwise."""
    batch = batch_at(range(len(xs)) if seconds is None else seconds)
    return replace(batch, pose=np.array([Pose.planar(x, 0.0, 0.0) for x in xs]))


def sift(whole: ScanBatch, size: int) -> tuple[list[int], list[str]]:
    """Which scans are used, where so many are a batch; and what is said."""
    poser = make_poser()
    rows = np.arange(len(whole.stamp_ns))
    posed, _ = attach(poser, *(whole.take(rows[at : at + size]) for at in rows[::size]))
    stamps = np.concatenate([each.batch.stamp_ns for each in posed])
    return np.flatnonzero(np.isin(whole.stamp_ns, stamps)).tolist(), poser.notes


HERE = [0.5 * second for second in range(20)]
THERE = [x + 300 for x in HERE]
WAYS = {
    "carried": (state([*HERE, *THERE]), []),
    "one scan": (state([*HERE[:9], 4e3, *HERE[10:]]), [9]),
    "near each other": (state([*HERE[:7], 4e3, 3.5, -2e3, *HERE[10:]]), [7, 8, 9]),
    "from afar and back": (state([*HERE[:9], 2e3, 4e3, 2e3, *HERE[12:]]), [9, 10, 11]),
    "a while elsewhere": (state([*HERE[:6], *THERE[6:12], *HERE[12:]]), [*range(6, 12)]),
    "long elsewhere": (state([*HERE, *THERE, *(x + 20 for x in HERE)]), []),
    "a first and a last one": (state([9e3, *HERE[1:-1], 9e3]), [0, 19]),
    "the second and the last but one": (state([0, 9e3, *HERE[2:-2], 9e3, 9.5]), [1, 18]),
    "beside a pause": (state([*HERE, 9e3, *HERE], [*range(20), *range(99, 120)]), [20]),
    "back after ten seconds": (state([*HERE, 9e3, *HERE], [*range(21), *range(29, 49)]), [20]),
    "back a little later": (
        state([*HERE, 9e3, *HERE], [*range(21), *(29.001 + s for s in range(20))]),
        [],
    ),
    "too far in ten seconds": (
        state([*HERE, 9e3, *(x + 600 for x in HERE)], [*range(21), *range(29, 49)]),
        [],
    ),
    "last after ten seconds": (state([*HERE, 9e3], [*range(20), 29]), [20]),
    "last a little later": (state([*HERE, 9e3], [*range(20), 29.001]), []),
    "two by turns": (state([x for pair in zip(HERE, THERE, strict=True) for x in pair]), []),
    "a train": (state([80.0 * second for second in range(40)]), []),
    "three scans": (state([0, 1e3, 0]), []),
}


@pytest.mark.parametrize("size", [1, 2, 3, 5, 8, 60])
@pytest.mark.parametrize("way", WAYS)
def test_how_scans_are_batched_changes_nothing(way: str, size: int) -> None:
    whole, outliers = WAYS[way]
    used, notes = sift(whole, size)
    assert sorted({*range(len(whole.stamp_ns))} - {*used}) == outliers
    assert len(notes) == (1 if outliers else 0)
    assert notes == sift(whole, 60)[1]


@pytest.mark.parametrize(("elsewhere", "is_left_out"), [(999, True), (1000, False)])
def test_a_row_continues_another_at_most_a_thousand_scans_later(
    elsewhere: int, is_left_out: bool
) -> None:
    there = [4e3 if scan % 2 else -4e3 for scan in range(elsewhere)]
    xs = [*HERE[:5], *there, *HERE[5:10]]
    used, _ = sift(state(xs, [0.005 * scan for scan in range(len(xs))]), 60)
    assert len(xs) - len(used) == (elsewhere if is_left_out else 0)


Moment = tuple[int, int, float]
"""A scan: its number, stamp (ns) and x (m)"""


def is_far(scan: Moment, other: Moment) -> bool:
    return abs(other[2] - scan[2]) > max(1.0, 50 * (other[1] - scan[1]) / 1e9)


def is_soon(scan: Moment, other: Moment) -> bool:
    return other[1] - scan[1] <= 10e9


def cut(scans: Sequence[Moment]) -> list[list[list[Moment]]]:
    """Cut scans into parts at each pause, and parts into rows at each leap."""
    parts = [[[scans[0]]]]
    for before, scan in pairwise(scans):
        if scan[1] <= before[1] or not is_soon(before, scan):
            parts.append([[scan]])
        elif is_far(before, scan):
            parts[-1].append([scan])
        else:
            parts[-1][-1].append(scan)
    return parts


def find_continuation(rows: Sequence[list[Moment]]) -> int | None:
    """Which row continues the first one."""
    last = rows[0][-1]
    for later, row in enumerate(rows[1:], start=1):
        shows = len(row) > 3 or (len(rows[0]) > 3 and row is rows[-1])
        if shows and is_soon(last, row[0]) and not is_far(last, row[0]):
            return later
    return None


def find_outliers(scans: Sequence[Moment]) -> Iterator[Moment]:
    """The rule of `occmap.posing.leaps`, of all scans of one laser, as it is said there."""
    for rows in cut(scans):
        at = 0
        while at + 1 < len(rows):
            row, following = rows[at], rows[at + 1]
            back = find_continuation(rows[at:]) if len(row) > 3 or not at else None
            if back:
                yield from chain.from_iterable(rows[at + 1 : at + back])
            elif not at and len(row) == 1 and len(following) > 3:
                yield from row
            elif len(row) > 3 and following is rows[-1] and len(following) == 1:
                yield from following
            at += back or 1


def wander(seed: int) -> list[Scan]:
    """Scans of up to four lasers of one to three geometries each, with leaps, pauses and jumps of
    the clock; the first range of a scan is its number."""
    rng = np.random.default_rng(seed)
    scans = int(rng.integers(1, 120))
    steps = np.full(scans, rng.choice([0.05, 0.3, 1.0, 3.0]))
    steps[rng.random(scans) < 0.05] = rng.choice([12.0, 60.0, 9.0, 0.0, -5.0])
    stamp_ns = np.round(np.cumsum(steps) * 1e9).astype(np.int64) + 10**12
    leaps = np.flatnonzero(rng.random(scans) < rng.choice([0.02, 0.1, 0.3, 0.6]))
    place = np.zeros(scans)
    for leap in leaps:
        place[leap:] = rng.choice([0, 0, 0, 300, 3000])
    x = place + np.cumsum(rng.normal(0, 0.2, scans))
    topic, frame, shape = (rng.integers(0, rng.choice([1, 1, 2, 3]), scans) for _ in range(3))
    return [
        Scan(
            int(stamp_ns[scan]),
            f"laser{frame[scan]}",
            0.0,
            0.1,
            np.full(3 + shape[scan] % 2, scan),
            0.0,
            1000.0 + shape[scan],
            pose=Pose.planar(float(x[scan]), 0.0, 0.0),
            topic=f"/scan{topic[scan]}",
        )
        for scan in range(scans)
    ]


@pytest.mark.parametrize("seed", range(40))
def test_scans_are_judged_by_their_laser_whatever_their_geometry(
    monkeypatch: pytest.MonkeyPatch, seed: int
) -> None:
    scans = wander(seed)
    lasers: dict[tuple[str, str], list[Moment]] = {}
    for number, scan in enumerate(scans):
        x = scan.pose.x if scan.pose else math.nan
        lasers.setdefault((scan.topic, scan.frame), []).append((number, scan.stamp_ns, x))
    outliers = {number for some in lasers.values() for number, *_ in find_outliers(some)}
    said = []
    for beams in (1, 10, 40, 150, 1 << 18):
        monkeypatch.setattr(stream, "BATCH_BEAMS", beams)
        poser = make_poser()
        posed, dropped = attach(poser, *stack(scans, Stamps.HEADER))
        used = {int(number) for each in posed for number in each.batch.ranges[:, 0]}
        assert used == {*range(len(scans))} - outliers
        assert sum(dropped.values()) == len(outliers)
        said.append(poser.notes)
    assert all(each == said[0] for each in said)


@pytest.mark.parametrize("step_s", [0.025, 1e-5, 9.9, 60.0, 0.0, -1.0])
def test_how_many_scans_are_held_back_is_bounded(step_s: float) -> None:
    """Rows of five scans, each somewhere else: what a log of wrong poses is."""
    given = held = 0
    xs = np.repeat(np.random.default_rng(1).normal(0, 1e6, 240), 5)

    def give() -> Iterator[ScanBatch]:
        nonlocal given
        for scan, x in enumerate(xs.tolist()):
            given += 1
            yield state([x], [scan * step_s])

    for count, _ in enumerate(make_poser().attach(give()), start=1):
        held = max(held, given - count)
    assert held <= MOST_SCANS + LONG_ROW_STEPS + 1
    assert given == count == len(xs)


def test_a_note_says_how_many_scans_of_a_topic_are_left_out() -> None:
    first, second = state([*HERE[:9], 4e3, *HERE[10:]]), state([*HERE[:6], *THERE[6:9], *HERE[9:]])
    poser = make_poser()
    attach(poser, replace(first, topic="/scan"), replace(second, topic="/scan", frame="other"))
    (note,) = poser.notes
    assert note.startswith("/scan: the scan at 6.000 s lies 300.5 m from its neighbour")
    assert "4 scans left out for such leaps" in note


@pytest.mark.parametrize(
    "selection", [Selection(), Selection(stride=3), Selection(start_s=4.0, end_s=31.0)]
)
def test_jobs_and_batches_leave_out_the_same_scans(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, selection: Selection
) -> None:
    poses = [*DRIVE[:14], *((x + 900, y, yaw) for x, y, yaw in DRIVE[14:18]), *DRIVE[18:]]
    log = write_csv(tmp_path / "log.csv", poses, [1.0, 1.5, 2.0], step=0.1)
    reports = []
    for beams, jobs in ((1, 1), (1 << 18, 2)):
        monkeypatch.setattr(stream, "BATCH_BEAMS", beams)
        report = build([log], BuildOptions(selection=selection, jobs=jobs)).report
        reports.append(replace(report, seconds={}))
    assert reports[0] == reports[1]
    assert reports[0].scans.dropped[LEAP] == (1 if selection.stride == 3 else 4)
    assert sum(reports[0].scans.dropped.values()) + reports[0].scans.used == 40


def test_scans_are_held_back_only_where_they_may_be_outliers() -> None:
    poser = make_poser()
    given: list[int] = []

    def give() -> Iterator[ScanBatch]:
        for first in range(0, 40, 4):
            given.append(first)
            seconds = range(first, first + 4)
            yield state([0.5 * second for second in seconds], seconds)

    for count, _ in enumerate(poser.attach(give()), start=1):
        assert len(given) == count


def test_check_sees_the_map_that_build_makes(tmp_path: Path) -> None:
    made = map_drive(tmp_path, [*DRIVE[:7], (1e5, 0.0, 0.0), *DRIVE[8:]])
    seen = inspect([tmp_path / "log.csv"], BuildOptions())
    (topic,) = seen.logs[0].scans
    assert topic.poses.dropped == {LEAP: 1}
    assert seen.map is not None
    assert abs(seen.map.columns - made.report.map.columns) <= 2


@pytest.mark.parametrize("name", ["carmen/intel-corrected.log.gz", "ros1/test_turtlebot.bag"])
def test_no_scan_of_a_real_log_leaps(name: str) -> None:
    path = REAL_LOGS / name
    if not path.exists():
        pytest.skip(f"{path} is not there")
    report = build([path], BuildOptions(resolution=0.2)).report
    assert LEAP not in report.scans.dropped
