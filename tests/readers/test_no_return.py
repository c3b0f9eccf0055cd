"""The no-return value of logs that state no limit, or a wrong one."""

import math

import numpy as np
import pytest
from occmap.readers.no_return import RangeTally, find_limit


def tally(ranges: list[float], stated: float = math.inf, per_scan: int = 50) -> RangeTally:
    counts = RangeTally()
    for start in range(0, len(ranges), per_scan):
        block = np.array(ranges[start : start + per_scan], np.float32)
        counts.add(block, stated)
    return counts


MEASURED = [1 + beam / 100 for beam in range(2000)]
"""1.00 to 20.99 m, each once"""


@pytest.mark.parametrize("marker", [81.83, 81.91, 51.15, 50.0, 32.767])
def test_known_markers_are_found(marker: float) -> None:
    limit, note = find_limit("FLASER", tally(MEASURED + [marker] * 40))
    assert limit == float(np.float32(marker))
    assert np.float32(marker) >= limit
    assert note is not None
    assert f"40 of 2040 ranges read {marker:g} m" in note.text
    assert "--range-max" in note.text


@pytest.mark.parametrize("per_scan", [1, 7, 5000])
def test_the_split_into_scans_does_not_matter(per_scan: int) -> None:
    ranges = [*MEASURED, *[30.0] * 25, *MEASURED]
    assert tally(ranges, per_scan=per_scan).find_marker() == (30.0, 25)


def test_all_sick_error_codes_are_no_return() -> None:
    marker = tally([*MEASURED, 81.83, 81.90, 81.90, 81.91]).find_marker()
    assert marker == (float(np.float32(81.83)), 4)


@pytest.mark.parametrize(
    "ranges",
    [
        MEASURED,
        MEASURED + [40.0] * 9,
        MEASURED * 30,
        MEASURED + [40.0] * 50 + [39.99] * 20,
        [5.0] * 400,
        [0.0] * 400,
        [math.inf, math.nan],
    ],
    ids=["once", "rare", "standstill", "far wall", "one range", "zeros", "special"],
)
def test_measurements_are_no_marker(ranges: list[float]) -> None:
    limit, note = find_limit("FLASER", tally(ranges))
    assert limit == math.inf
    assert note is not None
    assert "states no range limit; no range repeats" in note.text


def test_infinite_ranges_do_not_hide_the_marker() -> None:
    assert tally([*MEASURED, *[30.0] * 25, math.inf]).find_marker() == (30.0, 25)


def test_a_marker_below_a_stated_limit_takes_its_place() -> None:
    limit, note = find_limit("ROBOTLASER1", tally(MEASURED + [81.91] * 5, stated=81.92))
    assert limit == float(np.float32(81.91))
    assert note is not None
    assert "states 81.92 m as limit" in note.text


def test_ranges_above_a_stated_limit_are_reported() -> None:
    limit, note = find_limit("ROBOTLASER1", tally(MEASURED + [81.91] * 5, stated=50.0))
    assert limit == math.inf
    assert note is not None
    assert "5 of 2005 ranges are above it, up to 81.91 m" in note.text


def test_a_true_stated_limit_needs_no_note() -> None:
    assert find_limit("ROBOTLASER1", tally(MEASURED, stated=50.0)) == (math.inf, None)
