"""Rows of a CSV that are parsed together must give what they give one by one."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from occmap.errors import LogError
from occmap.types import Scan, ScanBatch
from tests.readers.runs import flatten, list_fields, open_csv

PLAIN = "# angle_min: -1.5\n# angle_increment: 0.25\nstamp,x,y,yaw,r0,r1\n"
VARYING = "stamp,x,y,yaw,frame,angle_min,angle_increment,range_max,seq,r0,r1\n"
CELLS = st.sampled_from([
    "1", "2.5", " 3", "1e39", "-.5", "inf", "-inf", "nan", "", "", " ", "1_0", "١", "fan", "1 2",
    '"4"',
])  # fmt: skip
ROW_ENDS = st.tuples(st.sampled_from(["1,2,0", "1,2,0", ",2,0", "1,nan,0", "1,2"]), CELLS, CELLS)


def read(tmp_path: Path, content: str) -> object:
    """The scans and notes of a log, or why there are none."""
    try:
        log = open_csv(tmp_path, content)
        return list_fields(log.scans(["scan"])), log.notes
    except LogError as error:
        return str(error)


@given(rows=st.lists(ROW_ENDS, max_size=6))
@settings(max_examples=200)
def test_no_row_is_read_in_two_ways(
    rows: list[tuple[str, ...]], tmp_path_factory: pytest.TempPathFactory
) -> None:
    lines = [",".join((f"{stamp}.000000001", *cells)) for stamp, cells in enumerate(rows)]
    path = tmp_path_factory.mktemp("rows")
    text = PLAIN + "".join(f"{line}\n" for line in lines)

    together = read(path, text)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("occmap.readers.text_log.BLOCK_BYTES", 1)  # a line of its own is parsed alone
        assert read(path, text) == together


def test_rows_that_are_alike_come_at_a_stroke(tmp_path: Path) -> None:
    log = open_csv(tmp_path, PLAIN + "0.5,1,2,0,1.5,\n1.5,,2,0,inf,3\n")
    (run,) = log.stacked_scans(["scan"])
    assert isinstance(run, ScanBatch)
    assert run.stamp_ns.tolist() == [500_000_000, 1_500_000_000]
    np.testing.assert_array_equal(run.ranges, np.array([[1.5, np.nan], [np.inf, 3]], np.float32))
    np.testing.assert_array_equal(run.pose, [[1, 2, 0, 0, 0, 0, 1], [np.nan, 2, 0, 0, 0, 0, 1]])


@pytest.mark.parametrize(
    "change", [("laser", "rear"), ("-1.5", "-1"), ("0.25", "0.5"), ("8,7", "9,7")]
)
def test_rows_of_another_geometry_are_read_one_by_one(
    tmp_path: Path, change: tuple[str, str]
) -> None:
    row = "{0},1,2,0,laser,-1.5,0.25,8,7,1,2\n"
    other = row.replace(*change)
    log = open_csv(tmp_path, VARYING + row.format(0) + other.format(1) + row.format(2))
    scans = list(log.stacked_scans(["scan"]))
    assert [type(scan) for scan in scans] == [Scan] * 3
    assert [scan.stamp_ns for scan in scans if isinstance(scan, Scan)] == [0, 10**9, 2 * 10**9]


def test_an_unused_column_may_differ(tmp_path: Path) -> None:
    rows = "".join(f"{i},1,2,0,laser,-1.5,0.25,8,{i},1,2\n" for i in range(3))
    (run,) = open_csv(tmp_path, VARYING + rows).stacked_scans(["scan"])
    assert run.ranges.shape == (3, 2)


def test_beams_may_be_all_that_a_row_has(tmp_path: Path) -> None:
    constants = "# stamp: 3\n# angle_min: -1.5\n# angle_increment: 0.25\n"
    scans = flatten(open_csv(tmp_path, f"{constants}r0,r1\n1,2\n3,4\n").stacked_scans(["scan"]))
    assert [scan.ranges.tolist() for scan in scans] == [[1, 2], [3, 4]]
    assert [scan.stamp_ns for scan in scans] == [3 * 10**9] * 2
