"""Scans that come in runs end in the same batches as single ones, and leave the same way."""

import math
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from occmap.options import BuildOptions, Selection
from occmap.posing import DropReason, PosingOptions, Stamps
from occmap.readers import open_log
from occmap.scans.mounts import open_drive
from occmap.scans.stream import Selector, find_oddity, stack
from occmap.scans.tally import LeftOut, Tally
from occmap.sensor import ReturnCounts, ReturnOptions
from occmap.sensor.bands import RangeLimits
from occmap.types import Float64, Kind, Rays, Scan, ScanBatch
from tests.posing.scenes import SECOND, attach, batch_at, bolted, build, drive, turned
from tests.readers.runs import flatten
from tests.samples import make_batch

RUN = ScanBatch(
    *("laser", -1.0, 0.5, 0.1, 30.0),
    stamp_ns=np.arange(5) * SECOND,
    record_ns=np.arange(5) * SECOND + 7,
    ranges=np.arange(10, dtype=np.float32).reshape(5, 2),
    time_increment=np.arange(5) / 1000,
    topic="/scan",
)


def list_scans(batches: Iterable[ScanBatch]) -> list[tuple[int, float, list[float]]]:
    columns = ((each.stamp_ns, each.time_increment, each.ranges) for each in batches)
    rows = (zip(*(part.tolist() for part in each), strict=True) for each in columns)
    return sorted(scan for each in rows for scan in each)


def test_a_run_is_a_batch_as_it_is() -> None:
    (batch,) = stack([RUN], Stamps.HEADER)

    assert batch.stamp_ns.tolist() == [0, SECOND, 2 * SECOND, 3 * SECOND, 4 * SECOND]
    assert batch.ranges is RUN.ranges
    assert batch.time_increment is RUN.time_increment
    assert (batch.frame, batch.angle_min, batch.angle_increment) == ("laser", -1.0, 0.5)
    assert (batch.range_min, batch.range_max, batch.topic) == (0.1, 30.0, "/scan")
    assert batch.pose is None
    (batch,) = stack([RUN], Stamps.RECORD)
    assert (batch.stamp_ns - RUN.stamp_ns).tolist() == [7] * 5


def test_scans_that_differ_in_the_time_between_beams_are_stacked() -> None:
    (batch,) = stack(RUN.split(), Stamps.HEADER)
    assert batch.time_increment.tolist() == [0, 0.001, 0.002, 0.003, 0.004]


def test_batches_come_in_the_order_of_the_log() -> None:
    singles = [scan._replace(stamp_ns=scan.stamp_ns - 9 * SECOND) for scan in RUN.split()]
    batches = list(stack([*singles, RUN], Stamps.HEADER))
    assert [batch.stamp_ns[0] for batch in batches] == [-9 * SECOND, 0]


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        ({"angle_min": math.nan}, LeftOut.BAD_ANGLES),
        ({"angle_increment": math.inf}, LeftOut.BAD_ANGLES),
        ({"angle_increment": 1.7e308}, LeftOut.BAD_ANGLES),  # that of the last beam is infinite
        ({"ranges": np.zeros((5, 0), np.float32)}, LeftOut.NO_BEAMS),
    ],
)
def test_a_run_that_cannot_be_used_is_counted(change: dict[str, Any], reason: LeftOut) -> None:
    run = replace(RUN, **change)
    selector = Selector(BuildOptions())

    assert list(selector.select([run])) == []
    assert (selector.read, selector.left_out) == (5, {reason: 5})


def test_lasers_that_take_turns_are_thinned_each_by_itself() -> None:
    scans = [scan._replace(topic=topic) for scan in RUN.split() for topic in ("/a", "/b")]
    chosen = Selector(BuildOptions(selection=Selection(stride=2))).select(scans)
    assert [some.topic for some in chosen] == ["/a", "/b"] * 3


@given(
    st.lists(st.tuples(st.booleans(), st.integers(1, 6)), max_size=6),
    st.sampled_from([-math.inf, 0.0, 2.5]),
    st.sampled_from([math.inf, 9.0]),
    st.integers(1, 3),
    st.booleans(),
)
@settings(max_examples=200)
def test_runs_are_selected_as_single_scans_are(
    sizes: Sequence[tuple[bool, int]], start_s: float, end_s: float, stride: int, record: bool
) -> None:
    items: list[Scan | ScanBatch] = []
    begin = 0
    for whole, size in sizes:
        stamps = (begin + np.arange(size)) * SECOND
        begin += size
        ranges = np.full((size, 2), size, np.float32)
        run = replace(RUN, stamp_ns=stamps, record_ns=stamps[::-1] + 5, ranges=ranges)
        run = replace(run, time_increment=stamps / 7)
        items += [run] if whole else run.split()
    selection = Selection((), start_s, end_s, stride)
    clock = Stamps.RECORD if record else Stamps.HEADER
    options = BuildOptions(selection=selection, posing=PosingOptions(stamps=clock))
    some, single = (Selector(options) for _ in range(2))
    batches = stack(some.select(items), clock)
    of_singles = stack(single.select(flatten(items)), clock)

    assert list_scans(batches) == list_scans(of_singles)
    assert (some.read, some.left_out) == (single.read, single.left_out)


@pytest.mark.parametrize("single", [True, False])
@pytest.mark.parametrize("range_max", [0.0, math.nan, -3.0, -math.inf])
def test_a_range_limit_that_none_can_be_is_none(range_max: float, single: bool) -> None:
    run = replace(RUN, range_min=math.nan, range_max=range_max)
    limits = RangeLimits(ReturnOptions())
    scans = run.split() if single else [run]
    (batch,) = map(limits.apply, stack(limits.watch(scans), Stamps.HEADER))
    assert (batch.range_min, batch.range_max) == (0.0, math.inf)
    (note,) = limits.list_notes()
    assert note.startswith("/scan states no usable range limit")


def test_each_topic_is_sampled_by_how_many_scans_it_has_itself(tmp_path: Path) -> None:
    path = tmp_path / "two.log"
    line = "{} 2 1.0 2.0 0 0 0 0 0 0 {} host {}\n"
    slow = (line.format("RLASER", stamp, stamp) for stamp in range(30))
    fast = (line.format("FLASER", stamp, stamp) for stamp in range(3000))
    path.write_text("".join([*slow, *fast]))
    for start_s, slow_ones in ((0, 30), (10, 20)):
        options = BuildOptions(selection=Selection(start_s=start_s))
        kept = Counter[str]()
        for part in open_drive(open_log(path, options.reading), options).sample():
            kept[part.batch.topic] += len(part.stamp_ns)
        assert kept["RLASER"] == slow_ones
        assert 300 <= kept["FLASER"] <= 600
        assert part.stamp_ns.max() > 2990e9  # the last part of it, whatever its start


@pytest.mark.parametrize(("beams", "is_odd"), [(63, False), (96, True), (0, False)])
def test_beams_at_the_end_that_are_empty_do_not_go_round(beams: int, is_odd: bool) -> None:
    """Rows of a CSV with fewer beams than others end in empty cells; a beam is a tenth of a rad."""
    ranges = np.full((2, 400), np.nan)
    ranges[1, :beams] = 2.0
    assert ("are these degrees?" in find_oddity(make_batch(ranges))) == is_odd


def see(scans: range, beams: int = 3, x: float = 0.0) -> Rays:
    """Scans of beams that all end 2 m away, at bearings a quarter turn apart."""
    bearing = np.arange(beams) * np.pi / 2
    ways: Float64 = np.stack([np.cos(bearing), np.sin(bearing)], axis=-1)
    shape = len(scans), beams
    return Rays.along(
        np.tile([x, 1.0], (len(scans), 1, 1)),
        np.broadcast_to(ways, (*shape, 2)),
        np.full(shape, 2.0, np.float32),
        np.full(shape, Kind.HIT, np.uint8),
        np.array(scans),
        full_circle=False,
    )


@pytest.mark.parametrize(("rate_hz", "expected"), [(9.9, [0.9, 33]), (2, [1.0, 1])])
def test_points_have_times_of_their_own_where_poses_show_how_the_sensor_moved(
    rate_hz: float, expected: list[float], tmp_path: Path
) -> None:
    poses = tmp_path / "poses.tum"
    poses.write_text("".join(f"{at / rate_hz} {at / rate_hz} 0 0 0 0 0 1\n" for at in range(30)))
    fields = [("x", "f4"), ("y", "f4"), ("z", "f4"), ("time", "f4")]
    cloud = np.array([(1, 0, 0, -0.1), (2, 0, 0, 0)], fields)  # stamped where the sweep ends
    np.save(tmp_path / "1000000001.0.npy", cloud)
    options = BuildOptions(posing=PosingOptions(poses=str(poses), time_offset_s=-1e9))

    (posed,) = open_drive(open_log(tmp_path), options).read(Tally())
    where = posed.position.reshape(-1, 3)
    assert [round(float(where[0, 0]), 6), len(where)] == expected


def test_where_a_laser_was_and_which_scans_have_no_pose_is_known_of_a_log() -> None:
    mount = bolted("base_link", "laser", turned(0, y=1))
    log = drive("odom", "base_link", seconds=[0, 1, 2, 6, 7])
    poser = build(*log, mount, time_offset_s=-100)
    attach(poser, batch_at([99, 100.5, 103]), batch_at([106.5]))
    (way,) = poser.list_trajectories("a.bag")
    assert (way.log, way.parent, way.frame) == ("a.bag", "odom", "laser")
    assert way.stamp_ns.tolist() == [100.5 * SECOND, 106.5 * SECOND]
    assert way.pose.tolist() == [[0.5, 1, 0, 0, 0, 0, 1], [6.5, 1, 0, 0, 0, 0, 1]]
    lost = ((99 * SECOND, DropReason.BEFORE), (103 * SECOND, DropReason.GAP))
    assert way.dropped == lost


def test_a_laser_whose_log_names_no_frames_gets_names() -> None:
    poser = build()
    stated = batch_at([1])
    attach(poser, stated)
    (way,) = poser.list_trajectories("a.log")
    assert (way.parent, way.frame, len(way.stamp_ns)) == ("map", "laser", 0)
    assert way.dropped == ((SECOND, DropReason.NO_TRANSFORM),)


def test_hits_are_kept_where_they_lie() -> None:
    tally = Tally(shown_every=1)
    tally.show(see(range(2, 3), x=5.0))
    (scan,) = tally.shown
    assert (scan.stamp_ns, scan.origin) == (2, (5.0, 1.0))
    np.testing.assert_allclose(scan.x, [7, 5, 3], atol=1e-6)
    np.testing.assert_allclose(scan.y, [1, 3, 1], atol=1e-6)


def test_a_sample_is_spread_over_all_scans_and_their_beams() -> None:
    tally = Tally(shown_every=10)
    for start in range(0, 4000, 250):
        tally.show(see(range(start, start + 250), beams=1200))
        tally.use(250, ReturnCounts())
    assert [scan.stamp_ns for scan in tally.shown] == list(range(0, 4000, 10))
    assert {len(scan.x) for scan in tally.shown} == {400}


def test_logs_add_up_and_a_second_reading_forgets_the_first() -> None:
    first = Tally(shown_every=1)
    first.show(see(range(1)))
    second = first.start_over()
    assert second.shown == []
    second.show(see(range(1, 2)))
    first.add(second)
    assert [scan.stamp_ns for scan in first.shown] == [0, 1]
