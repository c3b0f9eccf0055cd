import itertools
import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

from occmap.errors import LogError
from occmap.inspection import inspect
from occmap.options import BuildOptions
from occmap.posing.trajectory import read_trajectory
from occmap.readers import open_log
from occmap.types import Moments, PoseSample
from occmap.values import suspect_degrees
from tests.csv_logs import write_poses
from tests.samples import write_csv


def read(tmp_path: Path, text: str) -> list[PoseSample]:
    path = tmp_path / "poses.txt"
    path.write_text(text, encoding="utf-8", newline="")
    return read_trajectory(path, [])[0].split()


def test_tum(tmp_path: Path) -> None:
    text = "# stamp x y z qx qy qz qw\n\n1.5 1 2 3 0 0 0.6 0.8\n  2.5\t4 5 6 0 0 0 1\n"
    first, second = read(tmp_path, text)
    assert first.stamp_ns == first.record_ns == 1_500_000_000
    assert first.pose == (1, 2, 3, 0, 0, 0.6, 0.8)
    assert (first.parent, first.child, first.static) == ("map", "", False)
    assert second.pose == (4, 5, 6, 0, 0, 0, 1)


EUROC = "1403636580838555648,4.5,-1.5,0.75,0.8,0,0,0.6"
HALF = math.sqrt(0.5)
TURN = (0, 0, 0.6, 0.8)
FLAT = (1, 2, 0, 0, 0, 0, 1)
NODE = "VERTEX_SE3:QUAT{} 2 4 0 0 0.6 0.8 {}\n"


@pytest.mark.parametrize(
    ("text", "pose"),
    [
        ("Stamp, X, Y, Yaw\n# comment\n3,1,2,1.5707963267948966\n", (1, 2, 0, 0, 0, HALF, HALF)),
        ("y,x,name,z,roll,pitch,yaw,t\n2,1,run,3,3.141592653589793,0,0,3\n", (1, 2, 3, 1, 0, 0, 0)),
        ("#stamp x y z qx qy qz qw id\n3 1 2 4 0 0 0.6 0.8 7\n", (1, 2, 4, *TURN)),
        ("#stamp x y z qw qx qy qz\n# by hand\n3 1 2 4 0.8 0 0 0.6\n", (1, 2, 4, *TURN)),
        ("#time [ns],x,y,z,qx,qy,qz,qw\n3000000000,1,2,4,0,0,0.6,0.8\n", (1, 2, 4, *TURN)),
        ("# stamp,x,y,qx,qy,qz,qw\n3,1,2,0,0,0.6,0.8\n", (1, 2, 0, *TURN)),
        ("stamp,x,y,qx,qy,qz,qw\n3,2,3,0.1,0.2,0.3,0.4\n", (2, 3, 0, 0.1, 0.2, 0.3, 0.4)),
        ("\ufeffstamp,x,y,yaw\r\n3,1,2,0\r\n", FLAT),
        ('"Time [s]","x [m]","y (m)","theta [rad]"\n3,1,2,0\n', FLAT),
        ("timestamp\ttx\tty\ttz\tqx\tqy\tqz\tqw\n3\t1\t2\t4\t0\t0\t0.6\t0.8\n", (1, 2, 4, *TURN)),
        ("t;x;y;z;qx;qy;qz;qw\n3,0;1,0;2;4;0;0;0,6;0,8\n", (1, 2, 4, *TURN)),
        ("t [ns]\tx\ty\tqx\tqy\tqz\tqw\n3000000000\t1,0\t2\t0\t0\t0\t1\n", FLAT),
        (
            "time [ns],p_RS_R_x [m],p_RS_R_y [m],p_RS_R_z [m],q_RS_w [],q_RS_x [],q_RS_y [],"
            "q_RS_z []\n3000000000,1,2,4,0.8,0,0,0.6\n",
            (1, 2, 4, *TURN),
        ),
        ("#sec,nsec,x,y,z,qx,qy,qz,qw\n3,0,1,2,4,0,0,0.6,0.8\n", (1, 2, 4, *TURN)),
        ("Time,header.stamp.secs,header.stamp.nsecs,x,y,yaw\n4,3,0,1,2,0\n", FLAT),
        ("h.stamp.sec,h.stamp.nsec,x,y,yaw,g.stamp.sec,g.stamp.nsec\n3,0,1,2,0,8,9\n", FLAT),
        ("time,nsec,x,y,yaw\n3.0,5,1,2,0\n", FLAT),
        ("# t x y qx qy qz qw a b c d e f\n3 1 2 0 0 0 1 7 7 7 7 7 7\n", FLAT),
        ("3000000000,1,2,0,1,0,0,0,7,7,7,7,7\n", FLAT),  # EuRoC's lines may go on
        ("__time,/odom/pose/position/x,/odom/pose/position/y,yaw\n3,1,2,0\n", FLAT),
        ("3,0,map,1,2,4,0,0,0.6,0.8\n", (1, 2, 4, *TURN)),
        ("3,0,odom,base_link,1.0,2.0,0.0,0.0,0.0,0.0,1.0,0.1,0.0\n", FLAT),
        ("time [ms],x,y,yaw\n3000.0,1,2,0\n", FLAT),
        ("stamp,time,x,y,yaw\n0,3,1,2,0\n", FLAT),
        ("Time,header.stamp.secs,header.stamp.nsecs,x,y,yaw\n3,0,0,1,2,0\n", FLAT),
        ("t_ns,qw,qx,qy,qz,tx_m,ty_m,tz_m\n3000000000,0.8,0,0,0.6,1,2,4\n", (1, 2, 4, *TURN)),
        (f"# id x\nPLATFORM_ID 1\n{NODE.format('_TIME 7 1', '3 0')}EDGE 7 7\n", (1, 2, 4, *TURN)),
    ],
    ids=itertools.count(),
)
def test_csv(tmp_path: Path, text: str, pose: Sequence[float]) -> None:
    (sample,) = read(tmp_path, text)
    assert sample.stamp_ns == 3 * 10**9
    assert sample.pose == pytest.approx(pose)


@pytest.mark.parametrize("since_boot", [10**10, 960 * 10**9, 1234567890123, 40000 * 10**9])
def test_nanoseconds_since_the_start_of_a_computer(tmp_path: Path, since_boot: int) -> None:
    """Whole milliseconds of 13 digits would lie hours apart."""
    stamps = [since_boot, since_boot + 10**8 + 1]
    samples = read(tmp_path, "".join(f"{stamp} 1 2 4 0 0 0.6 0.8\n" for stamp in stamps))
    assert [sample.stamp_ns for sample in samples] == stamps
    rows = "".join(f"{stamp},1\n" for stamp in stamps)
    (tmp_path / "log.csv").write_text(f"# angle_min: 0\n# angle_increment: 1\nstamp,r0\n{rows}")
    scans = open_log(tmp_path / "log.csv").scans(["scan"])
    assert [scan.stamp_ns for scan in scans] == stamps


@pytest.mark.parametrize("place", ["pose.pose.position", "pose.position", "transform.translation"])
def test_what_rostopic_writes_of_poses(tmp_path: Path, place: str) -> None:
    """The stamp of the header counts, in nanoseconds, and no speed is taken for a place."""
    turn = place.replace("position", "orientation").replace("translation", "rotation")
    names = [f"{place}.{axis}" for axis in "xyz"] + [f"{turn}.{axis}" for axis in "xyzw"]
    header = ",field.".join(["%time", "header.stamp", "header.frame_id", *names, "twist.linear.x"])
    (sample,) = read(tmp_path, f"{header}\n9000000000,3000000001,map,1,2,4,0,0,0.6,0.8,5\n")
    assert (sample.stamp_ns, sample.pose) == (3_000_000_001, (1, 2, 4, *TURN))


def test_a_lost_tracker_writes_nan(tmp_path: Path) -> None:
    tum, csv = "1 nan nan nan nan nan nan nan\n", "stamp,x,y,yaw\n1,2,3,inf\n"
    assert math.isnan(read(tmp_path, tum)[0].pose.qw)
    assert math.isnan(read(tmp_path, csv)[0].pose.qw)


@pytest.mark.parametrize(
    ("yaws", "is_told"),
    [
        ([170, 176, -178, -172, 180], True),
        ([0, 90, 180, 270, 0, 90], True),
        ([*range(90, 180), *range(-180, 180)], True),  # a turn in small steps
        ([*range(90, 360), *range(360)], True),
        ([*range(200, 330), 0, *range(330, 400)], False),  # one is lost
        ([3.0, 3.1, -3.1, -3.0, 3.1], False),
        ([20.0, 22.5, 25.0, 27.5], False),  # turns that are counted
        ([0.0, 5.0, 0.0, 6.2], False),
        ([math.nan, math.inf], False),
        ([], False),
    ],
)
def test_degrees_are_told_from_radians(yaws: list[float], is_told: bool) -> None:
    assert bool(suspect_degrees(yaws)) == is_told


@pytest.mark.parametrize(("seconds", "is_told"), [(0, False), (50, True), (100, False)])
def test_degrees_without_a_wrap_are_told_by_their_speed(seconds: float, is_told: bool) -> None:
    yaws = [*range(-98, 98, 2), *range(98, -98, -2)]
    assert bool(suspect_degrees(yaws, seconds)) == is_told


@pytest.mark.parametrize("unit", [1.0, 180 / math.pi])
def test_headings_in_degrees_are_told_of_files_and_of_logs(unit: float, tmp_path: Path) -> None:
    poses = [(0.1 * i, 0.0, unit * math.remainder(2.5 + i / 8, math.tau)) for i in range(40)]
    notes: list[str] = []
    (read_trajectory(write_poses(tmp_path / "p.csv", range(40), poses), notes))
    log = open_log(write_csv(tmp_path / "log.csv", poses, [1.0]))
    for told in (notes, log.notes):
        assert any("are these degrees?" in note for note in told) == (unit > 1)
    assert bool(inspect([log.path], BuildOptions()).command) == (unit == 1)


def test_quaternions_in_another_order_are_told_and_taken(tmp_path: Path) -> None:
    halves = [(math.cos(yaw / 2), math.sin(yaw / 2)) for yaw in (0.0, 0.4, 0.8, 1.2)]
    path, notes = tmp_path / "poses.txt", list[str]()
    first = [f"{at} 0 0 0 {w} 0 0 {z}\n" for at, (w, z) in enumerate(halves)]
    last = [f"{at} 0 0 0 0 0 {z} {w}\n" for at, (w, z) in enumerate(halves)]
    header = "timestamp tx ty tz qw qx qy qz\n"
    of_euroc = "".join(last).replace(" ", ",")  # which has w first
    for text in ("".join(last), header + "".join(first), "".join(first), of_euroc):
        path.write_text(text)
        turns = read_trajectory(path, notes)[0].pose[:, 3:]
        assert turns == pytest.approx(np.array([(0, 0, z, w) for w, z in halves]))
    assert [note.split()[-1] for note in notes] == ["first", "last"]


def test_of_a_camera_poses_of_any_format_are_in_a_robots_axes(tmp_path: Path) -> None:
    """ORB-SLAM3 and RTAB-Map write them in TUM: ahead, then by 1.2 radians to the left."""
    left = f"0 {-math.sin(0.6)} 0 {math.cos(0.6)}"
    samples = read(tmp_path, f"1 0 0 0 0 0 0 1\n2 0 0 9 0 0 0 1\n3 -2 -1 9 {left}\n")
    assert samples[1].pose == pytest.approx((9, 0, 0, 0, 0, 0, 1))
    assert samples[2].pose == pytest.approx((9, 2, 1, 0, 0, math.sin(0.6), math.cos(0.6)))


@pytest.mark.parametrize(
    ("text", "line", "found"),
    [
        ("1 2 3\n", 1, "3 values where 8 belong"),
        ("# TUM\n1 0 0 0 0 0 0 1\n2 0 0 0 0 0 0 1 7\n", 3, "9 values where 8 belong"),
        ("1 0 0 0 0 0 here 1\n", 1, "'here' where a number belongs"),
        ("1e10 0 0 0 0 0 0 1\n", 1, "is not a time in seconds"),
        ("1.5,1,2,0\n", 1, "no header says what the columns are"),
        ("stamp,x,y,yaw [deg]\n1,2,3,0\n", 1, "has no column yaw, but 'yaw [deg]': units are"),
        ("time;x;y;theta(deg)\n1;2;3;0\n", 1, "has no column yaw, but 'theta(deg)': units are"),
        ("stamp,x,yaw\n1,2,3\n", 1, "has no column y"),
        ("stamp,x,y\n1,2,3\n", 1, "has no column yaw"),
        ("stamp,x,y,qw\n1,2,3,1\n", 1, "has no column qx, qy, qz"),
        ("stamp,x,y,yaw,x\n1,2,3,0,4\n", 1, "names a column twice"),
        ("stamp,x,y,yaw\n1,2,3,0\n\n2,,3,0\n", 4, "'' where a number belongs"),
        ("stamp,x,y,yaw\n1,2,3\n", 2, "3 values where 4 belong"),
        ("9" * 100_000, 1, "1 values where 8 belong"),
        ("# IMAGE_ID, QW, QX\n1 1 0 0 0 1 2 3 1 a.png\n", 2, "poses of COLMAP, which have no sc"),
        ("12,1,2,3\n", 1, "no header says what the columns are"),
        (f"{EUROC}\n1.5,1,2,3,1,0,0,0\n", 2, "'1.5' is not a time in nanoseconds"),
        ("99999999999999999999,1,2,3,1,0,0,0\n", 1, "is not a time in nanoseconds"),
        (NODE.format("_TIME 7 1", "1e10 0"), 1, "is not a time in seconds"),
    ],
)
def test_a_bad_line_is_named(tmp_path: Path, text: str, line: int, found: str) -> None:
    with pytest.raises(LogError) as caught:
        read(tmp_path, text)
    message = str(caught.value)
    assert message.startswith(f"{tmp_path / 'poses.txt'}:{line}: ")
    assert ("VERTEX" in message) == text.startswith("VERTEX")
    assert found in message
    assert "\n" not in message
    assert len(message) < 400 + len(str(tmp_path))


@pytest.mark.parametrize("line", ["12,5,1,2,{},0,0,0.6,0.8\n", "12 1 2 3 0.{} 0.2 0.3 0\n"])
def test_columns_that_hold_no_quaternion_are_refused(tmp_path: Path, line: str) -> None:
    with pytest.raises(LogError, match="no quaternion stands behind"):
        read(tmp_path, line.format(1) + line.format(3))


@pytest.mark.parametrize("end", [",", "\n"])
def test_transforms_are_those_of_one_body(tmp_path: Path, end: str) -> None:
    first, row = "3,0,a,b,1,2,0,0,0,0,1", "4,0,a,{},1,2,0,0,0,0,1\n"
    assert len(read(tmp_path, f"{first}{end}{row.format('b')}")) == 2
    with pytest.raises(LogError, match="between several frames"):
        read(tmp_path, f"{first}{end}{row.format('c')}")


def test_quaternions_of_another_length_are_rotations(tmp_path: Path) -> None:
    (sample, _) = read(tmp_path, "3 1 2 4 0 0 1.2 1.6\n4 1 2 4 0 0 1.6 1.2\n")
    length = math.hypot(*sample.pose[3:])
    assert [each / length for each in sample.pose[3:]] == pytest.approx(TURN)


@pytest.mark.parametrize(
    ("content", "found"),
    [
        (b"#ROSBAG V2.0\nE\0\0\0\x10\0\0\0", "not text, so not a trajectory"),
        (b"\x1b\x8c$FQ\x0fJ{h", "not text, so not a trajectory"),
        (b"\xdb\x01\xf5[{\x1f\x1d{\x8a", "pbstream.*trajectories_to_rosbag -input .*drive.bin"),
        ("stamp,x,y,yaw\n1,2,3,0\n".encode("utf-16"), "UTF-16.*iconv"),
        (b"PARAMS_SE3OFFSET 0 0 0 0 0 0 0 1\n", "pose graph, whose poses have no times"),
        (b"VERTEX_SE3:QUAT 0 1 2 4 0 0 0.6 0.8\n", "poses without times"),
        (b"\x93NUMPY\x01\0", "an array of NumPy.*its poses as text"),
        (b"\x1f\x8b\x08\0", "decompress it first: gunzip"),
        *((text, "holds no poses") for text in (b"", b"# nothing\n", b"stamp,x,y,yaw\n")),
    ],
)
def test_what_is_no_trajectory_is_named(tmp_path: Path, content: bytes, found: str) -> None:
    path = tmp_path / "drive.bin"
    path.write_bytes(content)
    with pytest.raises(LogError, match=found):
        read_trajectory(path, [])


@pytest.mark.parametrize(
    "text",
    [
        f"{EUROC}\n",
        f"#timestamp [ns], p_RS_R_x [m], p_RS_R_y [m]\n{EUROC}\n",
        f"{EUROC},0.1,0.2,0.3,-0.002,0.02,0.07,-0.1,0.1,0.1\r\n",
    ],
)
def test_euroc(tmp_path: Path, text: str) -> None:
    (sample,) = read(tmp_path, text)
    assert sample.stamp_ns == 1403636580838555648
    assert sample.pose == (4.5, -1.5, 0.75, 0, 0, 0.6, 0.8)


LEVEL = "1 0 0 {} 0 1 0 {} 0 0 1 {}"


def read_kitti(tmp_path: Path, poses: list[str], times: str | None) -> list[PoseSample]:
    if times is not None:
        (tmp_path / "times.txt").write_text(times)
    return read(tmp_path, "\n".join(poses) + "\n")


@pytest.mark.parametrize(
    ("line", "place", "turn", "told"),
    [
        # A quarter turn to the left, 4 m ahead and 5 m to the left
        ("0 -1 0 4 1 0 0 5 0 0 1 0", (4, 5, 0), HALF, "5 m along y and 0 m along z, {} robot (x "),
        # A camera that looks to the right by a quarter turn about its y, which is down; it went
        # 9 m along its z, 2 m along its x, and lies 1 m higher: against its y.
        ("0 0 1 2 0 1 0 -1 -1 0 0 9", (9, -2, 1), -HALF, "1 m along y and 9 m along z, {} camera "),
    ],
    ids=["robot", "camera"],
)
def test_kitti_of_a_robot_and_of_a_camera_is_in_a_robots_axes_which_is_told(
    tmp_path: Path, line: str, place: Sequence[float], turn: float, told: str
) -> None:
    path, notes = tmp_path / "poses.txt", list[str]()
    path.write_text(f"{LEVEL.format(0, 0, 0)} 0 0 0 1\n{line} 0 0 0 1\n")
    (tmp_path / "times.txt").write_text("0.0\n1.036e-01\n")
    poses, _ = read_trajectory(path, notes)
    first, second = poses.split()
    (note,) = notes
    assert note.startswith(f"{path}: its poses go {told.format('so they are taken as those of a')}")
    assert (first.stamp_ns, second.stamp_ns) == (0, 103_600_000)
    assert first.pose == pytest.approx((0, 0, 0, 0, 0, 0, 1))
    sign = math.copysign(1, second.pose.qw)
    assert second.pose[:3] == pytest.approx(place)
    assert [sign * part for part in second.pose[3:]] == pytest.approx([0, 0, turn, HALF])


ROWS = "0 0 1\n1 0 0 {}\n0 1 0 2\n0 0 1 0\n0 0 0 1\n"  # Open3D has a matrix in four lines
FIXED = f"FIX 9 11\n{NODE.format(' 10 6', '')}VERTEX_PLANE 12 0 0 1 0\n{NODE.format(' 11 0', '')}"


@pytest.mark.parametrize("text", [ROWS.format(4) + ROWS.format(6), FIXED + NODE.format(" 9 4", "")])
def test_poses_without_times_are_those_of_clouds(tmp_path: Path, text: str) -> None:
    """Of a graph by the numbers of its vertices; one that is fixed behind the first is no pose."""
    path, moments = tmp_path / "poses.log", Moments([7, 8], is_timed=False)
    path.write_text(text)
    poses, _ = read_trajectory(path, [], moments)
    assert poses.pose[:, :2].tolist() == [[4, 2], [6, 2]]


def test_a_matrix_may_have_its_time_in_front(tmp_path: Path) -> None:
    line = f"1700000000000000007,{LEVEL.format(4, 5, 0).replace(' ', ',')}"
    (sample,) = read(tmp_path, line)
    assert (sample.stamp_ns, sample.pose) == (1_700_000_000_000_000_007, (4, 5, 0, 0, 0, 0, 1))


@pytest.mark.parametrize(
    ("times", "found"),
    [
        (None, "poses without times; put times.txt beside it, or write TUM"),
        ("1\n", "it holds 2 poses, and times.txt 1 time"),
        ("1\nnoon\n", "times.txt:2: 'noon' is not a time in seconds"),
        (f"1\n{'x' * 50}\n", "x... is not a time in seconds; a time in seconds stands"),
    ],
)
def test_kitti_wants_a_time_for_each_pose(tmp_path: Path, times: str | None, found: str) -> None:
    with pytest.raises(LogError, match=found):
        read_kitti(tmp_path, [LEVEL.format(0, 0, 0), LEVEL.format(1, 0, 0)], times)


def test_a_line_that_is_no_matrix_is_named(tmp_path: Path) -> None:
    for line in ("1 2 3", "1 0 0 x 0 1 0 0 0 0 1 0"):
        with pytest.raises(LogError, match=r"poses\.txt:2: "):
            read_kitti(tmp_path, [LEVEL.format(0, 0, 0), line], "1\n2\n")


def test_a_kitti_pose_that_is_not_finite_is_none_and_spoils_no_other(tmp_path: Path) -> None:
    lost = "inf 0 0 1 0 1 0 0 0 0 1 0", "1 0 0 nan 0 1 0 0 0 0 1 0"
    lines = [LEVEL.format(0, 0, 0), *lost, LEVEL.format(4, 0, 0)]
    poses = [sample.pose for sample in read_kitti(tmp_path, lines, "1\n2\n3\n4\n")]
    assert [all(map(math.isfinite, pose)) for pose in poses] == [True, False, False, True]
    assert poses[3] == pytest.approx((4, 0, 0, 0, 0, 0, 1))
