"""Scans and pose samples check what they are made of, whoever makes them."""

import math
from collections.abc import Sequence
from fractions import Fraction
from typing import Any

import numpy as np
import pytest

from occmap.errors import DamageError, LogError
from occmap.types import Pose, PoseSample, Scan
from occmap.values import NANOSECONDS, parse_time

HERE = Pose.planar(1.0, 2.0, 0.5)
SCAN: dict[str, Any] = {
    "stamp_ns": 5, "frame": "laser", "angle_min": -1.5, "angle_increment": 0.5,
    "ranges": [1.0, 2.0], "range_min": 0.0, "range_max": math.inf, "time_increment": 0.0,
    "pose": HERE, "topic": "/scan", "record_ns": 7,
}  # fmt: skip
SAMPLE: dict[str, Any] = {
    "stamp_ns": 5, "parent": "map", "child": "base", "pose": HERE, "topic": "/tf", "record_ns": 7,
}  # fmt: skip
NO_NUMBERS = [None, "1.5", True, [1.0], 10**400, np.ones(2), 1j]
NO_TIMES = [None, "7", 1.5, 2**63, -(2**63) - 1, math.nan]
NO_TEXTS = [None, 7, b"laser", "\ud800"]
NO_RANGES = [None, 7.0, "12", ["1", "2"], [None], [[1, 2]], [[1], [2, 3]], [10**400], [True]]
NO_POSES = [(1.0, 2.0, 0.5), [0.0] * 7, Pose("1", 0, 0, 0, 0, 0, 1)]  # type: ignore[arg-type]


def each_of(fields: str, values: Sequence[Any]) -> list[tuple[str, Any]]:
    return [(field, value) for field in fields.split() for value in values]


ALIKE = [*each_of("stamp_ns record_ns", NO_TIMES[1:]), ("stamp_ns", None)]
ALIKE += each_of("topic", NO_TEXTS) + each_of("pose", NO_POSES)
NUMBERS = "angle_min angle_increment range_min range_max time_increment"
OF_SCANS = each_of("frame", NO_TEXTS) + each_of(NUMBERS, NO_NUMBERS) + each_of("ranges", NO_RANGES)
OF_SAMPLES = [*each_of("parent child", NO_TEXTS), ("pose", None)]


@pytest.mark.parametrize(("field", "value"), ALIKE + OF_SCANS)
def test_a_scan_refuses_what_is_not_of_its_type(field: str, value: Any) -> None:
    with pytest.raises(DamageError) as caught:
        Scan(**{**SCAN, field: value})
    assert len(str(caught.value)) < 100
    assert isinstance(caught.value, LogError)


@pytest.mark.parametrize(("field", "value"), ALIKE + OF_SAMPLES)
def test_a_pose_sample_refuses_what_is_not_of_its_type(field: str, value: Any) -> None:
    with pytest.raises(DamageError):
        PoseSample(**{**SAMPLE, field: value})


def test_numbers_of_all_kinds_become_plain_ones() -> None:
    scan = Scan(
        np.int32(5), "laser", np.float32(0.5), Fraction(1, 4), [1, 2], 0, math.inf,  # type: ignore[arg-type]
        pose=Pose(1, np.float32(2), 0, 0, 0, 0, 1),  # type: ignore[arg-type]
    )  # fmt: skip

    assert [type(value) for value in scan[:4]] == [int, str, float, float]
    assert (scan.angle_min, scan.angle_increment, scan.range_min) == (0.5, 0.25, 0.0)
    assert scan.pose is not None
    assert {type(value) for value in scan.pose} == {float}
    assert math.isnan(Scan(**{**SCAN, "angle_min": math.nan}).angle_min)


@pytest.mark.parametrize("kind", [np.float64, np.float32, np.int16, np.uint8])
def test_ranges_are_copied_as_float32(kind: type[Any]) -> None:
    given = np.array([1, 2, 3], kind)
    ranges = Scan(**{**SCAN, "ranges": given}).ranges

    assert ranges.dtype == np.float32
    assert ranges.tolist() == [1, 2, 3]
    assert not np.shares_memory(ranges, given)


def test_a_range_beyond_float32_is_infinite() -> None:
    assert Scan(**{**SCAN, "ranges": [1e300, -1e300]}).ranges.tolist() == [math.inf, -math.inf]


def test_without_a_record_time_the_stamp_stands_for_it() -> None:
    assert Scan(5, "laser", 0, 0.1, np.ones(1, np.float32), 0, math.inf).record_ns == 5
    assert PoseSample(5, "map", "base", HERE).record_ns == 5


@pytest.mark.parametrize(
    ("seconds", "nanoseconds"),
    [
        ("1700000000.123456789", 1_700_000_000_123_456_789),
        ("1663967370.849346399", 1_663_967_370_849_346_399),
        ("0", 0),
        ("-1.5", -1_500_000_000),
        ("1.13486e+09", 1_134_860_000_000_000_000),
        ("1.305031102175304001e+09", 1_305_031_102_175_304_001),
        ("0.0000000014", 1),
        ("0.0000000004", 0),
        (" 2.5 ", 2_500_000_000),
        ("1700000000123", 1_700_000_000_123_000_000),
        ("1700000000123456", 1_700_000_000_123_456_000),
        ("1305031102175304001", 1_305_031_102_175_304_001),
    ],
)
def test_seconds_are_exact(seconds: str, nanoseconds: int) -> None:
    assert parse_time(seconds) == nanoseconds


@pytest.mark.parametrize(
    "wrong", ["", "noon", "nan", "inf", "1e999999999", "1e10", "1,5", "9223372036.8547758076"]
)
def test_what_is_no_time_in_seconds_is_a_value_error(wrong: str) -> None:
    with pytest.raises(ValueError, match="not a time in seconds"):
        parse_time(wrong)


@pytest.mark.parametrize("wrong", ["", "noon", "1.5", "nan", str(2**63), "9" * 5000])
def test_what_is_no_time_in_nanoseconds_is_a_value_error(wrong: str) -> None:
    assert parse_time(str(2**63 - 1), NANOSECONDS) == 2**63 - 1
    with pytest.raises(ValueError, match="not a time in nanoseconds"):
        parse_time(wrong, NANOSECONDS)
