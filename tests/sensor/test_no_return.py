"""The ranges that stand for "no return": bands at the top of all ranges, whoever states what."""

import math
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from occmap.inspection import inspect
from occmap.options import BuildOptions
from occmap.pipeline import build
from occmap.scans import stream
from occmap.sensor import ReturnOptions
from occmap.sensor.bands import Band, RangeLimits, RangeTally
from occmap.types import Scan
from tests.csv_logs import write_scans
from tests.grid.scans import FEW
from tests.samples import PLAIN, make_batch, write_late

MEASURED = [1 + beam / 100 for beam in range(2000)]
"""1.00 to 20.99 m, each once"""


def tally(ranges: Sequence[float], stated: float = math.inf, per_scan: int = 50) -> RangeTally:
    counts = RangeTally()
    for start in range(0, len(ranges), per_scan):
        block = np.array(ranges[start : start + per_scan], np.float32)
        counts.add(block, stated)
    return counts


def find(ranges: Sequence[float], stated: float = math.inf, per_scan: int = 50) -> Band | None:
    return tally(ranges, stated, per_scan).find_band()


@pytest.mark.parametrize(
    ("codes", "top", "values"),
    [
        ([50.0] * 40, 50.0, "50 m"),
        ([32.767] * 10, 32.767, "32.77 m"),
        ([32.763] * 30 + [32.767] * 5, 32.767, "32.76 m to 32.77 m"),
        ([51.15] * 40 + [51.16] * 3, 51.16, "51.15 m to 51.16 m"),
        ([51.05] * 20 + [51.10] * 20, 51.10, "51.05 m to 51.1 m"),
        ([51.14] * 30 + [51.15] * 30 + [51.25], 51.25, "51.14 m to 51.25 m"),
    ],
)
def test_values_close_together_are_one_band(codes: list[float], top: float, values: str) -> None:
    """A band begins 2.5% below its top; strays in it and above it count with it."""
    band = find(MEASURED + codes)
    assert band is not None
    assert band.count == len(codes)
    assert band.values == values
    assert band.limit == pytest.approx(0.975 * top, rel=1e-4)
    assert all(band.limit <= np.float32(code) for code in codes)


@pytest.mark.parametrize(("strays", "found"), [(1, True), (9, True), (10, False)])
def test_a_few_strays_above_a_band_do_not_hide_it(strays: int, found: bool) -> None:
    """Of the strays no two are near enough to make a band of their own."""
    far = [40 * 1.1**n for n in range(strays)]
    band = find(MEASURED + [30.0] * 50 + far)
    assert (band is not None) == found
    if band is not None:
        assert band.limit == pytest.approx(0.975 * 30, rel=1e-4)
        assert band.count == 50 + strays
        assert band.high == pytest.approx(far[-1], abs=0.01)


@pytest.mark.parametrize("codes", [[81.83], [81.91], [81.83, 81.90, 81.90, 81.91], [81.84] * 9])
def test_sick_error_codes_are_no_return_however_few(codes: list[float]) -> None:
    band = find(MEASURED + codes)
    assert band is not None
    assert (band.limit, band.count) == (81.82, len(codes))
    assert band.low == pytest.approx(min(codes), abs=2e-3)


@pytest.mark.parametrize(
    ("others", "stated", "limit", "count", "low"),
    [
        ([81.91, 8183.0], math.inf, 81.82, 2, 81.91),  # a code that was not divided by a hundred
        ([*[79.5] * 30, 81.91, 81.91], math.inf, 81.82, 2, 81.91),  # a SICK measures up to 80 m
        # 38.5 m lies in the 2.5% below 39 m, and 37 m does not: ten times as many are enough.
        ([40.0] * 100 + [38.5] * 10 + [37.0] * 1000, math.inf, 39, 100, 40),
        ([51.15] * 50, 60.0, 0.975 * 51.15, 50, 51.15),  # takes the place of what is stated
    ],
)
def test_a_band_beside_other_far_ranges(
    others: list[float], stated: float, limit: float, count: int, low: float
) -> None:
    band = find(MEASURED + others, stated)
    assert band is not None
    assert (band.limit, band.low) == pytest.approx((limit, low), rel=1e-4)
    assert band.count == count


@pytest.mark.parametrize(
    "ranges",
    [
        MEASURED,
        MEASURED + [40.0] * 9,
        MEASURED * 30,
        MEASURED + [40 - n / 100 for n in range(200)] * 30 + [40.0] * 50,
        MEASURED + [40.0] * 99 + [38.5] * 10,
        [5.0] * 400,
        [5.0] * 400 + [1 + n / 10 for n in range(14)],
        [0.0] * 400,
        [math.inf, math.nan, -math.inf, -1.0],
        [],
    ],
    ids=["once", "rare", "standstill", "far wall", "not ten times as many", "one range", "drawn",
         "zeros", "special", "none"],
)  # fmt: skip
def test_measurements_are_no_band(ranges: list[float]) -> None:
    assert find(ranges) is None


@pytest.mark.parametrize(("different", "found"), [(15, False), (16, True)])
def test_sixteen_different_ranges_tell_enough(different: int, found: bool) -> None:
    ranges = [1 + number / 10 for number in range(different - 1)]
    assert (find([*ranges, *[30.0] * 50]) is not None) == found


def test_a_limit_that_the_scans_state_is_none_of_the_values() -> None:
    """What is at the limit or above it is no return without being looked for."""
    assert find(MEASURED + [30.0] * 50, stated=30.0) is None
    above = tally([*MEASURED, *[30.0] * 50, 31.0, math.inf, 77.0], stated=30.0)
    assert (above.above, above.largest, above.find_band()) == (2, 77.0, None)
    assert tally(MEASURED, stated=float(np.finfo(np.float32).max)).above == 0


@pytest.mark.parametrize(
    ("middle", "most", "found"), [(30, math.inf, True), (30, 30, True), (29.7, math.inf, False)]
)
def test_noise_on_the_limit_that_is_stated_is_a_band(
    middle: float, most: float, found: bool
) -> None:
    """As of simulators that cut ranges off and then add noise; below the limit it may be a wall."""
    noise = np.random.default_rng(5).normal(middle, 0.05, 400)
    band = find([*MEASURED, *np.minimum(noise, most)], stated=30.0)
    assert (band is not None) == found
    assert band is None or band.limit == pytest.approx(0.975 * 30, abs=0.01)


RANGES = st.lists(
    st.sampled_from([1.0, 5.0, 28.4, 29.24, 29.26, 29.9, 30.0, 30.01, 31.5, 81.83, 8183.0])
    | st.floats(0.5, 40, width=32),
    max_size=80,
)


@FEW
@given(rare=RANGES, common=RANGES, cuts=st.integers(1, 60), seed=st.integers(0, 2**32))
def test_neither_order_nor_scans_change_what_is_found(
    rare: list[float], common: list[float], cuts: int, seed: int
) -> None:
    ranges = MEASURED[::50] + rare + common * 12
    shuffled = np.random.default_rng(seed).permutation(ranges).tolist()
    once = find(ranges, per_scan=10**9)
    assert find(sorted(ranges), per_scan=cuts) == once
    assert find(sorted(ranges)[::-1], per_scan=cuts) == once
    assert find(shuffled, per_scan=cuts) == once


def find_slowly(ranges: Sequence[float]) -> tuple[float, int] | None:
    """Where a band begins and how many readings it has: the rule, from all the ranges at once."""
    far = np.array(ranges)
    for top in sorted(set(ranges), reverse=True):
        if np.count_nonzero(far > top) >= 10:
            return None
        inside = np.count_nonzero((far >= 0.975 * top) & (far <= top))
        below = np.count_nonzero((far >= 0.95 * top) & (far < 0.975 * top))
        each = sorted(ranges.count(value) for value in set(ranges) if 0.975 * top <= value <= top)
        if inside >= 10 and inside >= 10 * below and 2 * sum(each[-3:]) >= inside:
            return 0.975 * top, int(np.count_nonzero(far >= 0.975 * top))
    return None


@FEW
@given(
    counts=st.lists(st.integers(0, 130) | st.integers(0, 3), min_size=40, max_size=40),
    scale=st.floats(0.1, 2.0),
)
def test_the_tally_follows_the_rule(counts: list[int], scale: float) -> None:
    """Values half a per cent apart and never near the edge of a band."""
    values = [scale * 1.0049**n for n in range(40)]
    ranges = [value for value, count in zip(values, counts, strict=True) for _ in range(count)]
    near = [scale / 4 * (1 + n / 16) for n in range(16)]  # different ranges enough
    expected, band = find_slowly(near + ranges), find(near + ranges, per_scan=7)
    assert (band is None) == (expected is None)
    if band is not None and expected is not None:
        assert band.limit == pytest.approx(expected[0], rel=1e-4)
        assert band.count == expected[1]


def test_a_wall_behind_all_others_is_no_band() -> None:
    """Four hundred readings of a wall at 29.4 m, with noise, and nothing in the metre before it."""
    rng = np.random.default_rng(5)
    near = rng.uniform(1, 20, 5_000)
    wall = 29.4 + 0.02 * rng.standard_normal(400)
    assert find([*near, *wall]) is None
    assert find([*near, *np.full(400, 29.4)]) is not None


def test_the_tally_stays_small() -> None:
    rng = np.random.default_rng(1)
    counts = RangeTally()
    for _ in range(20):
        counts.add(rng.uniform(0.1, 30, 100_000).astype(np.float32), math.inf)
    assert len(counts._values) < 1.5 / 30 * 2**15 * 2  # of two octaves the topmost twentieth


def scan(ranges: Sequence[float], topic: str = "scan", range_max: float = math.inf) -> Scan:
    measured = np.array(ranges, np.float32)
    return Scan(0, "laser", 0.0, 0.01, measured, 0.0, range_max, topic=topic)


unlimited = partial(make_batch, [[1]], range_max=math.inf, topic="scan")


def test_limits_are_of_each_topic() -> None:
    limits = RangeLimits(ReturnOptions())
    limits.see(scan(MEASURED + [30.0] * 50, "front"))
    limits.see(scan([*MEASURED, 81.83], "rear"))
    limits.see(scan(MEASURED, "side"))
    names = "front", "rear", "side"
    applied = [limits.apply(unlimited(topic=name)).range_max for name in names]
    assert applied == [pytest.approx(29.25), 81.82, math.inf]
    # Of two limits the nearer one holds.
    assert limits.apply(make_batch([[1]], topic="front", range_max=8.0)).range_max == 8.0
    assert limits.settle()


def test_limits_that_come_late_are_applied_in_the_second_reading() -> None:
    limits = RangeLimits(ReturnOptions())
    for again in (False, True):
        limits.see(scan(MEASURED))
        first = limits.apply(unlimited()).range_max
        assert first == (pytest.approx(29.25) if again else math.inf)
        limits.see(scan([30.0] * 50))
        assert limits.apply(unlimited()).range_max == first  # one limit for all of a reading
        assert limits.settle() == again
    (note,) = limits.list_notes()
    assert "50 of 2,050 ranges (2.4%) read 30 m, taken as no return" in note


def test_the_users_limit_is_asked_for_nothing() -> None:
    limits = RangeLimits(ReturnOptions(range_max=25.0))
    limits.see(scan(MEASURED + [30.0] * 50))
    given_batch = make_batch([[1]], range_max=60.0)
    assert limits.apply(given_batch) is given_batch
    assert limits.settle()
    assert list(limits.list_notes()) == []


def tell(*scans: Scan) -> list[str]:
    limits = RangeLimits(ReturnOptions())
    for each in scans:
        limits.see(each)
    return list(limits.list_notes())


CODE = MEASURED + [51.15] * 500
CODES = MEASURED + [51.14] * 300 + [51.15] * 200
SWAPPED = scan([0.5, 2.0, 29.0], range_max=0.1)._replace(range_min=30.0)
FIRST, SECOND = (scan([*range(at, at + 8), *[50.0] * 6], range_max=60.0) for at in (1, 9))
"""Of which none shows a band by itself: it has too few readings and too few ranges"""


def test_a_few_ranges_just_above_the_limit_are_noise_of_which_nobody_is_told() -> None:
    assert tell(scan([1.0] * 1000 + [5.01], range_max=5.0)) == []
    assert len(tell(scan([1.0] * 999 + [5.01], range_max=5.0))) == 1


@pytest.mark.parametrize(
    ("scans", "stated", "found"),
    [
        ([scan(CODES)], "no usable", "500 of 2,500 ranges (20.0%) read 51.14 m to 51.15 m"),
        ([scan(CODE, range_max=60.0)], "60 m", "500 of 2,500 ranges (20.0%) read 51.15 m"),
        ([scan(CODE, range_max=50.0)], "50 m", "500 of 2,500 ranges (20.0%) are above it, up to"),
        ([scan([0.3, 0.8], range_max=0.5)], "0.5 m", "1 of 2 ranges (50.0%) are above it, up to"),
        ([scan(MEASURED)], "no usable", "every range is used as measured"),
        ([SWAPPED], "no usable", "every range is used as measured"),
        ([FIRST, SECOND], "60 m", "12 of 28 ranges (42.9%) read 50 m"),
        (
            [scan([1, 51.15], range_max=40), scan([3, 52, 53], range_max=50), scan([1])],
            "no usable",
            "3 of 6 ranges (50.0%) are above it, up to 53 m",
        ),
    ],
)
def test_what_was_found_is_said_with_the_option_that_overrides(
    scans: list[Scan], stated: str, found: str
) -> None:
    for order in (scans, scans[::-1]):
        (note,) = tell(*order)
        assert note.startswith(f"scan states {stated}")
        assert found in note
        assert "`range_max`" in note


def test_readings_at_the_limit_that_is_stated_need_no_note() -> None:
    assert tell(scan([*MEASURED, 50.0, math.inf], range_max=50.0)) == []


@pytest.mark.parametrize("jobs", [1, 2])
def test_a_band_that_shows_late_is_no_return_from_the_first_scan_on(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, jobs: int
) -> None:
    monkeypatch.setattr(stream, "BATCH_BEAMS", 600)
    log = write_late(tmp_path / "late.csv", scans=60, marked_from=30)
    options = replace(PLAIN, jobs=jobs)
    # The first single 30 m is to be judged as the last: one lies among the scans without others.
    lines = log.read_text().splitlines()
    cells = lines[5].split(",")
    lines[5] = ",".join([*cells[:-1], "30.0"])
    log.write_text("\n".join(lines) + "\n")

    found = build([log], options)
    told = build([log], replace(options, returns=ReturnOptions(range_max=29.25)))

    assert found.map.extent == told.map.extent
    assert found.map.extent[2] < 6  # metres; 30 m would be far beyond
    np.testing.assert_array_equal(found.map.log_odds, told.map.log_odds)
    assert found.report.beams == told.report.beams
    assert found.report.beams.no_return == 30 * 12 + 1
    assert (found.report.scans.read, found.report.scans.used) == (60, 60)
    assert sum("361 of 3,600 ranges (10.0%) read 30 m" in note for note in found.report.notes) == 1


def test_check_says_of_a_band_what_build_says(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(stream, "BATCH_BEAMS", 600)
    log = write_late(tmp_path / "late.csv", scans=60, marked_from=30)
    (of_log,) = inspect([log], BuildOptions()).logs
    built = build([log], BuildOptions()).report
    said = [note for note in of_log.notes if "read 30 m" in note]
    assert len(said) == 1
    assert f"{log}: {said[0]}" in built.notes
    (topic,) = of_log.scans
    assert topic.ranges.largest < 6


@pytest.mark.parametrize(
    ("step", "stated", "far", "taken"),
    [
        (0.0, 40.0, 30.0, 0),
        (0.01, 40.0, 30.0, 80),  # the laser moves
        (0.0, 0.0, 30.0, 80),  # no limit is stated
        (0.0, 90.0, 81.83, 80),  # a code of the SICK LMS
    ],
)
def test_far_hits_of_a_laser_that_never_moves_are_no_band_below_a_stated_limit(
    tmp_path: Path, step: float, stated: float, far: float, taken: int
) -> None:
    number, beam = np.arange(40)[:, None], np.arange(60)
    ranges = np.round(2 + 0.05 * beam + 0.01 * (number % 7), 2)
    ranges[:, :2] = far  # the end of a corridor, which two beams see
    head = {"angle_min": 0, "angle_increment": 0.02, "range_max": stated}
    log = write_scans(tmp_path / "log.csv", range(40), ranges, number * (0, step, 0), **head)
    report = build([log], BuildOptions()).report
    assert report.beams.no_return == taken
    assert any("taken as no return" in note for note in report.notes) == bool(taken)
