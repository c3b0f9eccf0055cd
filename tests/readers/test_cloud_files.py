"""Folders of clouds: what each format holds, what is damaged, and which poses are theirs."""

import struct
from collections.abc import Callable
from contextlib import suppress
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from occmap.errors import DamageError, LogError, MapError
from occmap.inspection import inspect
from occmap.options import BuildOptions
from occmap.pipeline import build
from occmap.posing import DropReason, PosingOptions
from occmap.posing.trajectory import read_trajectory
from occmap.readers import ReaderOptions, Role, cloud_folder, open_log
from occmap.readers.cloud_folder import SPACING_NS, CloudFolder, read_bin, read_cloud, read_pcd
from occmap.scans.logs import find_inputs
from occmap.types import Cloud, Float32, Moments, Pose, PoseSample

POINTS = [(1.0, -2.0, 0.5), (3.25, 4.0, -1.5), (0.0, 0.0, 0.0)]
XYZ = struct.pack("<9f", *(number for point in POINTS for number in point))
SECOND = 1_000_000_000


def pcd(
    form: str, data: bytes, fields: str = "x y z", points: int = 3, kinds: str = "F F F"
) -> bytes:
    size = " ".join("4" if kind in "FU" else "2" for kind in kinds.split())
    head = f"# .PCD v0.7\nVERSION 0.7\nFIELDS {fields}\nSIZE {size}\nTYPE {kinds}\n"
    return f"{head}WIDTH {points}\nHEIGHT 1\nPOINTS {points}\nDATA {form}\n".encode() + data


def ply(form: str, properties: list[str], data: bytes, count: int = 3) -> bytes:
    lines = ["ply", f"format {form} 1.0", "comment by hand", f"element vertex {count}"]
    lines += [f"property {each}" for each in properties]
    lines += ["element face 0", "property list uchar int vertex_indices", "end_header", ""]
    return "\n".join(lines).encode() + data


def npy(array: Any) -> bytes:
    file = BytesIO()
    np.save(file, array)
    return file.getvalue()


def stored(data: bytes) -> bytes:
    """As LZF that copies nothing, behind both of its sizes."""
    runs = [data[at : at + 32] for at in range(0, len(data), 32)]
    packed = b"".join(bytes([len(run) - 1]) + run for run in runs)
    return struct.pack("<II", len(packed), len(data)) + packed


def by_field(data: bytes) -> bytes:
    return np.frombuffer(data, "<f4").reshape(-1, 3).T.tobytes()


def read(folder: Path) -> list[Cloud]:
    log = open_log(folder)
    assert [(s.topic, s.role) for s in log.streams] == [("clouds", Role.CLOUD)]
    return list(log.clouds({"clouds"}))


def read_damaged(folder: Path) -> tuple[list[int], list[str]]:
    """How many points each cloud has that can be used, and what is said of damage."""
    log = CloudFolder(folder)
    sizes = [len(cloud.points) for cloud in log.clouds({"clouds"})]
    return sizes, [note.text for note in log.notes if note.damage]


FLOATS = ["float x", "float y", "float z"]
SWAPPED = np.frombuffer(XYZ, "<f4").byteswap().tobytes()
TEXT = b"1 -2 0.5\n3.25 4 -1.5\n0 0 0\n"


@pytest.mark.parametrize(
    ("read", "data"),
    [
        (read_pcd, pcd("ascii", TEXT)),
        (read_pcd, pcd("binary", XYZ)),
        (read_pcd, pcd("binary_compressed", stored(by_field(XYZ)))),
        (cloud_folder.read_ply, ply("ascii", FLOATS, TEXT.replace(b"\n", b"\r\n"))),
        (cloud_folder.read_ply, ply("binary_little_endian", FLOATS, XYZ)),
        (cloud_folder.read_ply, ply("binary_big_endian", FLOATS, SWAPPED)),
        (read_bin, b"".join(XYZ[at : at + 12] + b"\0\0\0\0" for at in (0, 12, 24))),
    ],
    ids=["pcd", "pcd binary", "pcd compressed", "ply", "ply little", "ply big", "bin"],
)  # fmt: skip
def test_each_format_holds_the_same_points(
    read: Callable[[bytes], cloud_folder.Points], data: bytes
) -> None:
    found = read(data)

    assert list(zip(*(found.columns[name].tolist() for name in "xyz"), strict=True)) == POINTS
    assert found.announced == 3


def test_fields_of_other_types_and_counts_lie_between() -> None:
    row = struct.Struct("<2H f h 2H f f")
    data = b"".join(row.pack(7, 7, x, 9, 7, 7, y, z) for x, y, z in POINTS)
    head = "FIELDS _ x ring _ y z\nSIZE 2 4 2 2 4 4\nTYPE U F I U F F\nCOUNT 2 1 1 2 1 1\n"
    found = read_pcd(f"{head}POINTS 3\nDATA binary\n".encode() + data)

    assert found.columns["y"].tolist() == [-2, 4, 0]
    assert found.columns["ring"].tolist() == [9, 9, 9]


def test_lzf_copies_what_it_has_just_written() -> None:
    packed = np.array([1, *b"ab", 2 << 5, 1, 7 << 5, 3, 0], np.uint8)
    out = np.empty(2 + 4 + 12, np.uint8)

    assert cloud_folder.inflate_lzf(packed, len(packed), out) == len(out)
    assert out.tobytes() == b"ababab" + b"b" * 12


@pytest.mark.parametrize("kind", ["<f8", "<i2", ">f4"])
def test_arrays_of_any_number(tmp_path: Path, kind: str) -> None:
    np.save(tmp_path / "1.npy", np.array([(1, 2, 3, 99), (4, 5, 6, 99)], kind))
    fields = [(name, kind) for name in ("intensity", "x", "y", "z")]
    np.save(tmp_path / "2.npy", np.array([(99, 1, 2, 3), (99, 4, 5, 6)], fields))

    for cloud in read(tmp_path):
        assert cloud.points.tolist() == [[1, 2, 3], [4, 5, 6]]
        assert cloud.points.dtype == np.float32


@pytest.mark.parametrize(
    ("name", "data", "found"),
    [
        ("a.pcd", b"", "ends within its header"),
        ("a.pcd", pcd("binary", XYZ, fields="x y i"), "no field z"),
        ("a.pcd", pcd("zipped", XYZ), "'zipped'"),
        ("a.pcd", pcd("binary", XYZ, points=-1), "-1 points"),
        ("a.pcd", pcd("binary", XYZ, kinds="F F"), "not a .pcd"),
        ("a.pcd", pcd("ascii", b"1 2 x\n"), "not a .pcd"),
        ("a.pcd", pcd("binary_compressed", stored(by_field(XYZ))[:-5]), "33 of 38 bytes"),
        ("a.pcd", pcd("binary_compressed", struct.pack("<II", 3, 36) + b"\xff\xff\xff"), "damaged"),
        ("a.ply", b"ply\nformat ascii 1.0\n", "ends within its header"),
        ("a.ply", ply("binary_little_endian", ["list uchar float x"], XYZ), "lists"),
        ("a.ply", ply("ascii", ["float x"], TEXT), "no field y"),
        ("a.bin", b"0123456789", "10 bytes"),
        ("a.bin", np.full(32, 20_000, "<u2").tobytes(), "no points of x, y, z and reflectance"),
        ("a.npy", b"\x93NUMPY", "not a .npy"),
        ("a.npy", npy(np.ones((3, 65))), "3 x 65 of float64"),
    ],
)
def test_a_file_that_is_no_cloud_is_left_out_and_named(
    tmp_path: Path, name: str, data: bytes, found: str
) -> None:
    (tmp_path / name).write_bytes(data)
    (tmp_path / "b.pcd").write_bytes(pcd("binary", XYZ))

    sizes, (note,) = read_damaged(tmp_path)

    assert sizes == [3]
    assert name in note
    assert found in note


def test_what_cannot_be_opened_or_is_impossibly_large_is_left_out_and_named(tmp_path: Path) -> None:
    np.save(tmp_path / "1.npy", np.ones((5, 3), np.float32))
    (tmp_path / "2.npy").mkdir()
    made = (tmp_path / "1.npy").read_bytes()
    stated, huge = b"(5, 3), }", b"(99999999999, 3), }"
    grown = made.replace(stated + b" " * (len(huge) - len(stated)), huge)
    assert grown != made
    (tmp_path / "3.npy").write_bytes(grown)

    sizes, notes = read_damaged(tmp_path)

    assert sizes == [5]
    (note,) = notes
    assert note.startswith("2.npy ")
    assert note.endswith("; it is left out; also left out: 3.npy")


def test_of_a_file_that_is_cut_short_the_points_that_are_there_are_used(tmp_path: Path) -> None:
    (tmp_path / "1.pcd").write_bytes(pcd("binary", XYZ[:-1]))
    (tmp_path / "2.pcd").write_bytes(pcd("ascii", TEXT[:-4]))
    (tmp_path / "3.ply").write_bytes(ply("binary_little_endian", FLOATS, XYZ[:12]))

    sizes, notes = read_damaged(tmp_path)

    assert sizes == [2, 2, 1]
    (note,) = notes
    assert note.startswith("1.pcd is cut short: 2 of 3 points")
    assert note.endswith("; also cut short: 2.pcd, 3.ply")


def test_folders_that_hold_a_cloud_each_are_one_recording(tmp_path: Path) -> None:
    for number in (10, 9, 100):
        (tmp_path / f"{number}").mkdir()
        np.save(tmp_path / f"{number}/cloud.npy", np.full((1, 3), number, np.float32))
    assert [cloud.points[0, 0] for cloud in read(tmp_path)] == [9, 10, 100]
    assert find_inputs([tmp_path], ReaderOptions())[0] == [tmp_path]
    (tmp_path / "drive.csv").write_text("stamp,angle_min,angle_increment,r0\n1,0,1,2\n")
    assert tmp_path / "drive.csv" in find_inputs([tmp_path], ReaderOptions())[0]


def test_files_are_taken_in_the_order_of_the_numbers_in_their_names(tmp_path: Path) -> None:
    for number in (10, 9, 100):
        np.save(tmp_path / f"scan_{number}.npy", np.full((1, 3), number, np.float32))

    clouds = read(tmp_path)

    assert [cloud.points[0, 0] for cloud in clouds] == [9, 10, 100]
    assert [cloud.stamp_ns for cloud in clouds] == [0, SPACING_NS, 2 * SPACING_NS]


@pytest.mark.parametrize(
    ("name", "stamp_ns"),
    [
        ("1700000000.25.pcd", 1_700_000_000 * SECOND + SECOND // 4),
        ("cloud_1700000000_000000007.ply", 1_700_000_000 * SECOND + 7),
        ("1700000000000000007.bin", 1_700_000_000 * SECOND + 7),
        ("n015__LIDAR_TOP__1533151603547590.pcd.bin", 1_533_151_603_547_590_000),
    ],
)
def test_times_in_names(name: str, stamp_ns: int) -> None:
    assert cloud_folder.read_times([Path(name)]) == [stamp_ns]
    assert not cloud_folder.read_times([Path(name), Path("000123.bin")])
    since_boot = [1234567890123, 1234667890123]  # ns
    assert cloud_folder.read_times([Path(f"{it}.pcd") for it in since_boot]) == since_boot


def test_files_of_nuscenes_have_five_floats_a_point(tmp_path: Path) -> None:
    rows = np.array([[1, 2, 3, 9, 0]] * 4, "<f4")  # 80 bytes, which are five points of KITTI, too
    (tmp_path / "1533151603547590.pcd.bin").write_bytes(rows.tobytes())
    (cloud,) = read(tmp_path)
    assert cloud.points.tolist() == [[1, 2, 3]] * 4


@pytest.mark.parametrize("layout", ["4", "5", "6", "4 columns"])
def test_of_a_bin_no_reflectance_is_below_zero(tmp_path: Path, layout: str) -> None:
    """Boreas writes six values a point, and RobotCar all x, then all y."""
    rows = np.array([[1, -2, 3, 9, 7, 0], [-4, -5, -6, 9, 7, 0]] * 30, "<f4")[:, : int(layout[0])]
    (tmp_path / "1.bin").write_bytes((rows.T if "columns" in layout else rows).tobytes())
    (cloud,) = read(tmp_path)
    assert cloud.points.tolist() == [[1, -2, 3], [-4, -5, -6]] * 30


def test_points_have_the_times_that_a_file_gives_them(tmp_path: Path) -> None:
    rows = np.array(
        [(1, 2, 3, 0.0), (4, 5, 6, 0.05)], [(n, "<f4") for n in ("x", "y", "z", "time")]
    )
    np.save(tmp_path / "1700000000.0.npy", rows)
    (cloud,) = read(tmp_path)

    assert cloud.offset_ns is not None
    assert cloud.offset_ns.tolist() == [0, 50_000_001]  # as 32 bits hold it
    assert cloud.times == "time, in s after the stamp"


COUNTED = Moments([0, SPACING_NS, 2 * SPACING_NS], is_timed=False)
TUM = "".join(f"{7 + k} {k} 0 0 0 0 0 1\n" for k in range(3))
KITTI = "".join(f"1 0 0 {k} 0 1 0 0 0 0 1 0\n" for k in range(3))
CSV = "stamp,x,y,yaw\n" + "".join(f"{7 + k},{k},0,0\n" for k in range(3))


each_text = pytest.mark.parametrize("text", [TUM, KITTI, CSV], ids=["tum", "kitti", "csv"])


def read_poses(folder: Path, text: str, moments: Moments = COUNTED) -> list[PoseSample]:
    (folder / "poses.txt").write_text(text)
    return read_trajectory(folder / "poses.txt", [], moments)[0].split()


@each_text
def test_poses_are_for_the_files_one_by_one(tmp_path: Path, text: str) -> None:
    samples = read_poses(tmp_path, text)

    assert [sample.stamp_ns for sample in samples] == COUNTED.stamp_ns
    assert [sample.pose.x for sample in samples] == [0, 1, 2]


def test_poses_keep_their_times_where_those_of_the_clouds_are_known(tmp_path: Path) -> None:
    timed = Moments([5, 6], is_timed=True)
    stamps = [sample.stamp_ns for sample in read_poses(tmp_path, TUM, timed)]
    assert stamps == [7 * SECOND, 8 * SECOND, 9 * SECOND]

    with pytest.raises(LogError, match="3 poses, and the log 2 clouds"):
        read_poses(tmp_path, KITTI, timed)


def test_a_pose_that_is_not_finite_is_kept_for_its_cloud(tmp_path: Path) -> None:
    samples = read_poses(tmp_path, KITTI.replace("1 0 0 1", "1 0 0 nan"))

    assert samples[0].pose == Pose(0, 0, 0, 0, 0, 0, 1)
    assert np.isnan(samples[1].pose.x)


def test_bytes_that_are_flipped_never_crash(tmp_path: Path) -> None:
    rng = np.random.default_rng(3)
    sound = [
        ("a.pcd", pcd("ascii", TEXT)),
        ("b.pcd", pcd("binary_compressed", stored(by_field(XYZ)))),
        ("a.ply", ply("binary_little_endian", FLOATS, XYZ)),
        ("b.ply", ply("ascii", FLOATS, TEXT)),
    ]
    for name, data in sound:
        for _ in range(500):
            spoilt = bytearray(data)
            spoilt[rng.integers(len(data))] ^= 1 << int(rng.integers(8))
            (tmp_path / name).write_bytes(spoilt[: rng.integers(len(data)) + 1])
            with suppress(DamageError):
                read_cloud(tmp_path / name)


def make_room(at: float) -> Float32:
    """The floor 0.5 m below, and a wall at x = 3 m, as seen from `at` along x."""
    noise = np.random.default_rng(round(10 * at))
    floor = [
        (x, y, noise.normal(-0.5, 0.01))
        for x in np.arange(-2, 2.9, 0.05)
        for y in np.arange(-2, 2, 0.05)
    ]
    wall = [(3.0, y, z) for y in np.arange(-2, 2, 0.05) for z in np.arange(-0.5, 1, 0.1)]
    points: Float32 = np.array(floor + wall, np.float32) - np.array([at, 0, 0], np.float32)
    return points


def test_a_folder_makes_the_map_and_a_cloud_without_a_pose_is_left_out(tmp_path: Path) -> None:
    (tmp_path / "clouds").mkdir()
    for k in range(8):
        np.save(tmp_path / "clouds" / f"{k}.npy", make_room(0.1 * k))
    lines = [f"1 0 0 {0.1 * k:.1f} 0 1 0 0 0 0 1 0\n" for k in range(8)]
    lines[3] = lines[3].replace("0.3", "nan")
    (tmp_path / "poses.txt").write_text("".join(lines))
    options = BuildOptions(posing=PosingOptions(poses=str(tmp_path / "poses.txt")))

    built = build([tmp_path / "clouds"], options)

    assert built.report.scans.used == 7
    assert built.report.scans.dropped == {str(DropReason.GAP): 1}
    _, columns = np.nonzero(built.map.occupied)
    assert len(columns) > 50
    x = built.map.origin[0] + (columns + 0.5) * built.map.resolution
    assert abs(x - 3.0).max() < 0.11


def test_clouds_without_poses_are_told_by_check_and_refused_by_a_build(tmp_path: Path) -> None:
    np.save(tmp_path / "1700000000.0.npy", make_room(0.0))
    found = inspect([tmp_path], BuildOptions())
    assert [topic.scans for topic in found.topics] == [1]
    assert "the scans have no poses" in found.problems[0]

    (tmp_path / "poses.txt").write_text(TUM)  # of other times
    options = BuildOptions(posing=PosingOptions(poses=str(tmp_path / "poses.txt")))
    assert "1 after the last pose" in inspect([tmp_path], options).problems[0]
    with pytest.raises(MapError, match="no cloud that is asked for has points and a pose"):
        build([tmp_path], options)


def test_a_folder_of_which_no_file_can_be_read_is_refused(tmp_path: Path) -> None:
    (tmp_path / "1.bin").write_bytes(b"0123456789")

    with pytest.raises(LogError, match=r"1\.bin has 10 bytes"):
        list(CloudFolder(tmp_path).clouds({"clouds"}))
