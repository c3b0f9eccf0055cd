"""occmap's CSV: files written by hand, good and bad."""

import gzip
import itertools
import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from occmap.errors import LogError
from occmap.readers import Note, Probe, Role, Stream, probe_path
from occmap.readers.csv import CsvReader
from occmap.readers.text_log import BLOCK_BYTES
from occmap.types import Pose, Scan
from tests.readers.runs import expect_equal, open_csv

HEADER = "stamp,x,y,yaw,angle_min,angle_increment,range_min,range_max,time_increment,r0,r1,r2"
ROW = "1700000000.123456789,1,2,0,-1.5,0.25,0.1,8,0.001,1.5,,inf"
WHOLE = f"{HEADER}\n{ROW}\n"
CONSTANTS = "# angle_min: -1.5\n#angle_increment:0.25\n"
ROSTOPIC = (
    "%time,field.header.seq,field.header.stamp,field.header.frame_id,field.angle_min,"
    "field.angle_max,field.angle_increment,field.time_increment,field.scan_time,field.range_min,"
    "field.range_max,field.ranges0,field.ranges1,field.intensities0\n"
    "1555061575721518793,7,1555061575561518641,/laser,-1.5,1.5,3,0.25,0.5,0.125,8,2.5,inf,47\n"
)


def read_text(tmp_path: Path, content: str | bytes) -> list[Scan]:
    return list(open_csv(tmp_path, content).scans(["scan"]))


FULL = Scan(
    stamp_ns=1_700_000_000_123_456_789,
    frame="laser",
    angle_min=-1.5,
    angle_increment=0.25,
    ranges=np.array([1.5, np.nan, np.inf], np.float32),
    range_min=float(np.float32(0.1)),
    range_max=8.0,
    time_increment=0.001,
    pose=Pose(1, 2, 0, 0, 0, 0, 1),
    topic="scan",
    record_ns=1_700_000_000_123_456_789,
)


@pytest.mark.parametrize(
    "content",
    [
        WHOLE,
        WHOLE.replace("\n", "\r\n"),
        f"\ufeff{HEADER}\n\n# a comment: of no meaning\n{ROW}\n\n",
        f"{HEADER}\n{ROW}".replace(",", ", "),
        WHOLE.replace(",1.5,", ',"1.5",').replace("r1", '"r1"'),
        "".join(",".join(reversed(line.split(","))) + "\n" for line in (HEADER, ROW)),
        gzip.compress(WHOLE.encode(), mtime=0),
        WHOLE.replace(",", ";"),
        WHOLE.replace(",", "\t"),
        WHOLE.replace(",", ";").replace(".", ","),
        f"# {WHOLE}",
        WHOLE.replace("stamp", "Time")
        .replace("yaw", "theta")
        .replace("r0,r1", "range_0,ranges[1]"),
        WHOLE.replace("stamp", "stamp [s]").replace("x,y,yaw", "x [m],y (m),yaw [rad]"),
        WHOLE.replace("stamp", "timestamp_ns").replace("0.1234", "01234"),
        WHOLE.replace("0.1234", "01234"),
        WHOLE.replace("stamp", "%time").replace("0.1234", "01234"),
        WHOLE.replace("stamp", "Time,header.stamp.secs,header.stamp.nsecs")
        .replace("0.123", "0,123")
        .replace("17", "1799999999.5,17"),
        WHOLE.replace("stamp", "stamp,nsec").replace("89,", "89,7,"),
    ],
    ids=itertools.count(),
)
def test_a_full_row(tmp_path: Path, content: str | bytes) -> None:
    log = open_csv(tmp_path, content)
    assert CsvReader().recognises(probe_path(log.path))
    assert log.streams == [Stream("scan", "csv", 1, Role.SCAN)]
    (scan,) = log.scans(["scan"])
    expect_equal(scan, FULL)
    assert list(log.poses()) == []


def test_constants_stand_in_for_columns(tmp_path: Path) -> None:
    content = f"{CONSTANTS}stamp,r0,r1\n# frame: front\n1,2,3\n4,nan,-inf\n# range_max: 30\n"
    same = FULL._replace(
        frame="front", range_min=0.0, range_max=30.0, time_increment=0.0, pose=None
    )
    rows = (10**9, [2, 3]), (4 * 10**9, [np.nan, -np.inf])
    for scan, (stamp_ns, ranges) in zip(read_text(tmp_path, content), rows, strict=True):
        measured = np.array(ranges, np.float32)
        expect_equal(scan, same._replace(stamp_ns=stamp_ns, record_ns=stamp_ns, ranges=measured))


def test_a_column_goes_before_a_comment_about_it(tmp_path: Path) -> None:
    content = "# stamp: seconds since 1970\nstamp,angle_min,angle_increment,r0\n5,0,0.1,1\n"
    assert [scan.stamp_ns for scan in read_text(tmp_path, content)] == [5_000_000_000]


def test_a_frame_column(tmp_path: Path) -> None:
    content = f"{CONSTANTS}stamp,frame,r0\n1,left,5\n2,right,5\n"
    assert [scan.frame for scan in read_text(tmp_path, content)] == ["left", "right"]


def test_limits_are_rounded_as_ranges_are(tmp_path: Path) -> None:
    (scan,) = read_text(tmp_path, f"{CONSTANTS}stamp,range_max,r0\n1,81.83,81.83\n")
    assert scan.ranges[0] >= scan.range_max
    assert float(scan.ranges[0]) == scan.range_max


@pytest.mark.parametrize("pose", ["1,2,nan", ",2,0", " , , "])
def test_an_unknown_pose_is_not_finite(tmp_path: Path, pose: str) -> None:
    (scan,) = read_text(tmp_path, f"{CONSTANTS}stamp,x,y,yaw,r0\n1,{pose},5\n")
    assert scan.pose is not None
    assert not all(map(math.isfinite, scan.pose))


def test_unused_columns_are_noted(tmp_path: Path) -> None:
    log = open_csv(tmp_path, f"{CONSTANTS}stamp,r0,battery,\n1,5,99,\n")
    assert log.notes == [Note("columns that are not used: battery")]
    assert len(list(log.scans(["scan"]))) == 1


def test_comments_with_numbers_that_mean_nothing_are_noted(tmp_path: Path) -> None:
    comments = (
        "# max_range: 30\n# by hand: 3\n# frame: laser\n# at: noon\n# day: 2026-01-02\n# zero: 0\n"
    )
    log = open_csv(tmp_path, comments + WHOLE)
    assert log.notes == [Note("comments that are not used: max_range, zero")]


@pytest.mark.parametrize("time", ["nan", "inf", ""])
def test_a_row_without_a_time_between_beams_is_read(tmp_path: Path, time: str) -> None:
    (scan,) = read_text(tmp_path, WHOLE.replace(",0.001,", f",{time},"))
    expect_equal(scan, FULL._replace(time_increment=0.0))


def test_another_topic_has_no_scans(tmp_path: Path) -> None:
    assert list(open_csv(tmp_path, WHOLE).scans(["/scan"])) == []


def test_a_header_alone_is_a_log_without_scans(tmp_path: Path) -> None:
    log = open_csv(tmp_path, HEADER)
    assert [stream.count for stream in log.streams] == [0]
    assert list(log.scans(["scan"])) == []


COLUMNS = ("stamp", "angle_min", "angle_increment", "yaw", "r0", "r1")
SMALL = "stamp,r0\n1,2\n"
MANY = "1,2,3\n" * (BLOCK_BYTES // 3)


@pytest.mark.parametrize(
    ("content", "found"),
    [
        *((f"#\n{WHOLE.replace(f'{name},', '')}", f"2: no column {name}; ") for name in COLUMNS),
        (f"nsec,time_h{WHOLE[5:]}", "1: no column stamp; add it"),
        (WHOLE.replace("yaw", "yaw [deg]"), r"1: no column yaw, but 'yaw \[deg\]': units are s, m"),
        (WHOLE.replace(",", " [mm],"), r"1: no column stamp, but 'stamp \[mm\]': units are s, m"),
        (f"{CONSTANTS}stamp,x,y,yaw\n1,2,3,0\n", r"3: no column r0; .*`poses`"),
        (WHOLE.replace("r2", "r1"), "1: column r1 stands twice"),
        *((content, " no header row; ") for content in ("", "\n", CONSTANTS)),
        (gzip.compress(HEADER.encode(), mtime=0)[:15], " no header row; the gzip data is cut"),
        (f"{HEADER}\r{ROW}\r{ROW}\n".encode(), " its lines end in CR alone; .* LF, as `tr"),
        (f"{CONSTANTS}# range_max: 8 m\n{SMALL}", "3: range_max: '8 m' where a number"),
        (f"{CONSTANTS}# range_max: nan\n{SMALL}", "3: range_max is nan, .*; write `# range_max: "),
        (f"{CONSTANTS}# time_increment: inf\n{SMALL}", "3: time_increment is inf, which is not"),
        (f"{CONSTANTS}stamp,r0,r1\n{MANY}# frame: x\n", f"{len(MANY) // 6 + 4}: .*frame.*top of"),
        (f"{HEADER}\n" + f"{ROW},1\n" * 1200, r"2: 13 cells .*12 \(1,200 of 1,200 lines are mal"),
        *(
            (ROSTOPIC.replace("1555061575561518641", stamp), "2: stamp: .* not a time in nanosec")
            for stamp in ("15550615755.5", "soon", "")
        ),
    ],
    ids=itertools.count(),
)
def test_what_is_no_log_of_scans_is_refused_with_its_line(
    tmp_path: Path, content: str | bytes, found: str
) -> None:
    with pytest.raises(LogError, match=f"log.csv:{found}"):
        open_csv(tmp_path, content)


@pytest.mark.parametrize(
    ("good", "bad", "complaint"),
    [
        (",1.5,", ",near,", "r0: 'near' where a number belongs"),
        (",1.5,", ",1_5,", "r0: '1_5' where a number belongs"),
        (",0.25,", ",wide,", "angle_increment: 'wide' where a number belongs"),
        (",-1.5,", ",,", "angle_min: '' where a number belongs"),
        (",-1.5,", ",inf,", "angle_min is inf, which is not an angle or a time"),
        (",8,", ",nan,", "range_max is nan, which is not a limit"),
        (",1,2,", ",1,north,", "y: 'north' where a number belongs"),
        ("1700000000.123456789", "noon", "stamp: 'noon' is not a time in seconds"),
        (",inf", "", "11 cells where the header has 12"),
        (",inf", ",inf,1", "13 cells where the header has 12"),
    ],
)
def test_a_bad_row_is_left_out_wherever_it_is(
    tmp_path: Path, good: str, bad: str, complaint: str
) -> None:
    for at in range(3):
        rows = [ROW, ROW]
        rows.insert(at, ROW.replace(good, bad))
        log = open_csv(tmp_path, "\n".join([HEADER, *rows, ""]))
        (note,) = log.notes
        assert note.damage
        assert f"1 of 3 lines are malformed and left out, the first is line {at + 2}" in note.text
        assert complaint in note.text
        assert len(list(log.scans(["scan"]))) == 2
    with pytest.raises(LogError) as caught:
        open_csv(tmp_path, f"{HEADER}\n{ROW.replace(good, bad)}\n")
    assert f"log.csv:2: {complaint}" in str(caught.value)
    assert "\n" not in str(caught.value)


def test_zeros_that_a_crash_left_cost_their_row(tmp_path: Path) -> None:
    log = open_csv(tmp_path, f"{HEADER}\n{ROW}\n".encode() + bytes(99) + f"\n{ROW}\n".encode())
    assert CsvReader().recognises(probe_path(log.path))
    assert len(list(log.scans(["scan"]))) == 2
    assert log.notes[0].damage


def test_a_header_goes_before_a_comment_that_repeats_it(tmp_path: Path) -> None:
    log = open_csv(tmp_path, f"# {HEADER}\n{WHOLE}")
    assert (len(list(log.scans(["scan"]))), log.notes) == (1, [])


def test_empty_cells_between_tabs_are_not_measured(tmp_path: Path) -> None:
    header = "stamp\tangle_min\tangle_increment\tr0\tr1\tr2\n"
    (scan,) = read_text(tmp_path, f"{header}1\t0\t0.1\t\t\t5\n")
    np.testing.assert_array_equal(scan.ranges, [np.nan, np.nan, 5])


def test_a_last_line_cut_anywhere(tmp_path: Path) -> None:
    row = "3,1.5,2.5"
    whole = f"{CONSTANTS}stamp,r0,r1\n1,1.5,2.5\n2,1.5,2.5\n"
    for cut in range(1, len(row) + 1):
        log = open_csv(tmp_path, whole + row[:cut])
        stamps = [scan.stamp_ns // 10**9 for scan in log.scans(["scan"])]
        has_all_cells = row[:cut].count(",") == 2
        assert stamps == ([1, 2, 3] if has_all_cells else [1, 2])
        told, *damage = (note.text for note in log.notes)
        assert told.startswith("line 6, the last, has no line end")
        assert has_all_cells or "1 of 3 lines are malformed" in damage[0]
        assert log.streams[0].count == len(stamps)


@settings(max_examples=30)
@given(
    rows=st.lists(st.lists(st.floats(width=32), min_size=2, max_size=2), min_size=1),
    stamp_ns=st.integers(0, 2**62),
)
def test_what_is_written_is_read(
    tmp_path_factory: pytest.TempPathFactory, rows: list[list[float]], stamp_ns: int
) -> None:
    stamp = f"{stamp_ns // 10**9}.{stamp_ns % 10**9:09}"
    content = "".join(f"{stamp},{row[0]!r},{row[1]!r}\n" for row in rows)
    scans = read_text(tmp_path_factory.mktemp("csv"), f"{CONSTANTS}stamp,r0,r1\n{content}")
    assert [scan.stamp_ns for scan in scans] == [stamp_ns] * len(rows)
    np.testing.assert_array_equal([scan.ranges for scan in scans], np.array(rows, np.float32))


@pytest.mark.parametrize(
    "content",
    [
        *(HEADER, "\ufeff# comment\n\n" + HEADER, "r0,r1,r2", "# angle_min: 0\nstamp,r0\n1,2.5\n"),
        *("angle_min,angle_increment,range_max,r0,r1", '"stamp","angle_min","angle_increment"'),
        "# text\n" + ",".join(f"r{beam}" for beam in range(2000)),
        CONSTANTS + "# " + "long comment " * 400,
    ],
)
def test_recognises_csv_by_content(content: str) -> None:
    data = content.encode()[:4096]
    assert CsvReader().recognises(Probe(Path("any"), data, data))


@pytest.mark.parametrize(
    "content",
    [
        *(b"", b"# a comment only\n", b"name,age,town\nx,1,y\n", b"stamp,name\n"),
        *(b"timestamp,x,y,yaw\n1,2,3,0\n", b"stamp,r0\n1,2.5\n", b"stamp,r0\nangle_min: 1\n"),
        *(b"%time,field.header.seq,field.header.stamp,field.ranges0\n", b"stamp,x,y,yaw\0\0"),
        *(b"The stamp, the x, the y.\n", b"FLASER 180 1.5 1.5\n"),
        *(b'"' + b"a" * 4095, bytes(range(1, 256))),
    ],
)
def test_does_not_claim_what_is_not_its_csv(content: bytes) -> None:
    assert not CsvReader().recognises(Probe(Path("any"), content, content))


def test_what_rostopic_writes_is_read(tmp_path: Path) -> None:
    log = open_csv(tmp_path, ROSTOPIC)
    (scan,) = log.scans(["scan"])

    assert CsvReader().recognises(probe_path(log.path))
    assert (scan.stamp_ns, scan.frame) == (1555061575561518641, "laser")
    assert (scan.angle_min, scan.angle_increment, scan.time_increment) == (-1.5, 3.0, 0.25)
    assert (scan.range_min, scan.range_max, scan.pose) == (0.125, 8.0, None)
    assert scan.ranges.tolist() == [2.5, math.inf]
    assert log.streams[0].count == 1
