import math
from pathlib import Path

import pytest

from occmap.errors import LogError
from occmap.posing.trajectory import parse_stamp_ns, read_trajectory
from occmap.types import PoseSample


def read(tmp_path: Path, text: str) -> list[PoseSample]:
    path = tmp_path / "poses.txt"
    path.write_text(text)
    return list(read_trajectory(path))


@pytest.mark.parametrize(
    ("text", "stamp_ns"),
    [
        ("1305031102.175304000", 1305031102175304000),
        ("1663967370.849346399", 1663967370849346399),
        ("1.305031102175304001e+09", 1305031102175304001),
        ("0", 0),
        ("-0.25", -250000000),
        ("0.0000000004", 0),
    ],
)
def test_stamps_are_exact(text: str, stamp_ns: int) -> None:
    assert parse_stamp_ns(text) == stamp_ns


@pytest.mark.parametrize("text", ["", "noon", "nan", "inf", "1e10", "1e999999999"])
def test_what_is_no_time_is_refused(text: str) -> None:
    with pytest.raises(ValueError, match="is not"):
        parse_stamp_ns(text)


def test_tum(tmp_path: Path) -> None:
    text = "# stamp x y z qx qy qz qw\n\n1.5 1 2 3 0 0 0.6 0.8\n  2.5\t4 5 6 0 0 0 1\n"
    first, second = read(tmp_path, text)
    assert first.stamp_ns == first.record_ns == 1_500_000_000
    assert first.pose == (1, 2, 3, 0, 0, 0.6, 0.8)
    assert (first.parent, first.child, first.static) == ("map", "", False)
    assert second.pose == (4, 5, 6, 0, 0, 0, 1)


def test_csv_with_a_heading(tmp_path: Path) -> None:
    (sample,) = read(tmp_path, "Stamp, X, Y, Yaw\n# comment\n3,1,2,1.5707963267948966\n")
    half = math.sqrt(0.5)
    assert sample.stamp_ns == 3 * 10**9
    assert sample.pose == pytest.approx((1, 2, 0, 0, 0, half, half))


def test_csv_columns_may_stand_in_any_order_beside_others(tmp_path: Path) -> None:
    text = "y,x,name,z,roll,pitch,yaw,stamp\n2,1,run7,3,3.141592653589793,0,0,9\n"
    (sample,) = read(tmp_path, text)
    assert sample.pose == pytest.approx((1, 2, 3, 1, 0, 0, 0))


def test_csv_with_a_quaternion(tmp_path: Path) -> None:
    (sample,) = read(tmp_path, "stamp,x,y,qx,qy,qz,qw\n1,2,3,0.1,0.2,0.3,0.4\n")
    assert sample.pose == (2, 3, 0, 0.1, 0.2, 0.3, 0.4)


def test_a_byte_order_mark_is_passed_over(tmp_path: Path) -> None:
    path = tmp_path / "poses.csv"
    path.write_bytes(b"\xef\xbb\xbfstamp,x,y,yaw\r\n1,2,3,0\r\n")
    assert next(read_trajectory(path)).pose[:2] == (2, 3)


def test_a_lost_tracker_writes_nan(tmp_path: Path) -> None:
    tum, csv = "1 nan nan nan nan nan nan nan\n", "stamp,x,y,yaw\n1,2,3,inf\n"
    assert math.isnan(read(tmp_path, tum)[0].pose.qw)
    assert math.isnan(read(tmp_path, csv)[0].pose.qw)


@pytest.mark.parametrize(
    ("text", "line", "found"),
    [
        ("1 2 3\n", 1, "3 values where 8 belong"),
        ("# TUM\n1 0 0 0 0 0 0 1\n2 0 0 0 0 0 0 1 7\n", 3, "9 values where 8 belong"),
        ("1 0 0 0 0 0 here 1\n", 1, "'here' is not a number"),
        ("1305031102175304000 0 0 0 0 0 0 1\n", 1, "is not a time in seconds"),
        ("stamp,x,yaw\n1,2,3\n", 1, "has no column y"),
        ("stamp,x,y\n1,2,3\n", 1, "has no column yaw"),
        ("stamp,x,y,qw\n1,2,3,1\n", 1, "has no column qx, qy, qz"),
        ("stamp,x,y,yaw\n1,2,3,0\n\n2,,3,0\n", 4, "'' is not a number"),
        ("stamp,x,y,yaw\n1,2,3\n", 2, "3 values where 4 belong"),
        ("9" * 100_000, 1, "1 values where 8 belong"),
    ],
)
def test_a_bad_line_is_named(tmp_path: Path, text: str, line: int, found: str) -> None:
    with pytest.raises(LogError) as caught:
        read(tmp_path, text)
    message = str(caught.value)
    assert message.startswith(f"{tmp_path / 'poses.txt'}:{line}: ")
    assert found in message
    assert "\n" not in message
    assert len(message) < 400 + len(str(tmp_path))


@pytest.mark.parametrize("text", ["", "# nothing\n", "stamp,x,y,yaw\n"])
def test_an_empty_trajectory_is_refused(tmp_path: Path, text: str) -> None:
    with pytest.raises(LogError, match="holds no poses"):
        read(tmp_path, text)


def test_a_missing_file_is_refused(tmp_path: Path) -> None:
    with pytest.raises(LogError, match="No such file"):
        list(read_trajectory(tmp_path / "none.tum"))


def test_a_binary_file_is_no_trajectory(tmp_path: Path) -> None:
    path = tmp_path / "drive.bag"
    path.write_bytes(b"#ROSBAG V2.0\nE\0\0\0\x10\0\0\0")
    with pytest.raises(LogError, match="no text, so no trajectory"):
        list(read_trajectory(path))
