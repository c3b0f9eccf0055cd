"""Clouds of points in messages: Livox's, Foxglove's, depth images, and what is none of them."""

import base64
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rosbags.typesys import get_types_from_msg
from rosbags.typesys.store import Typestore

from occmap.errors import LogError
from occmap.options import BuildOptions
from occmap.posing import PosingOptions
from occmap.readers import Role, open_log, read_recorded
from occmap.readers.cloud_messages import convert_cloud, find_offsets
from occmap.readers.depth import clean, clean_cloud
from occmap.scans.logs import choose_topics
from occmap.scans.mounts import open_drive
from occmap.scans.tally import Tally
from occmap.types import Cloud, Float64, Pose
from tests.readers.clouds import cloud, image, info, listed, livox, packed
from tests.readers.foxglove_logs import Message, place, stamp, write_json
from tests.readers.ros import ROS1, ROS2, SECOND, Written, both, drive, write_bag1, write_mcap

DEPTH, INFO = "/camera/depth/image_rect_raw", "/camera/depth/camera_info"


def read(path: Path) -> tuple[list[Cloud], list[str]]:
    log = open_log(path)
    clouds = list(log.clouds({s.topic for s in log.streams if s.role is Role.CLOUD}))
    return clouds, [note.text for note in log.notes]


def record(
    tmp_path: Path, *messages: tuple[str, Any], store: Typestore = ROS2
) -> tuple[list[Cloud], list[str]]:
    """Record messages on topics, and read the clouds and notes."""
    log = [Written(topic, 2 * SECOND, message) for topic, message in messages]
    return read(write_mcap(tmp_path / "log.mcap", log, store))


def decode(message: Any) -> list[list[float]]:
    seen = clean_cloud(convert_cloud(message, "/cloud", 7))
    points: list[list[float]] = seen.points.tolist()
    return points


@both
@pytest.mark.parametrize("form", ["<f4", ">f4", "<f8", ">f8", "<i2"])
def test_points_in_any_form(store: Typestore, form: str) -> None:
    points = [(3.0, 1.0, 0.0), (2.0, 5.0, -1.0), (0.0, 0.0, 0.0)]

    found = convert_cloud(cloud(store, points, form), "/cloud", 7)

    assert found.points.dtype == np.float32
    assert found.points.tolist() == [list(point) for point in points]
    assert (found.frame, found.stamp_ns, found.topic) == ("lidar", SECOND, "/cloud")
    assert found.offset_ns is None


def test_points_that_are_none_stay_as_their_driver_wrote_them() -> None:
    nothing = [(0.0, 0.0, 0.0), (math.nan, 1.0, 0.0), (math.inf, 1.0, 0.0)]

    np.testing.assert_array_equal(decode(cloud(ROS2, nothing)), nothing)
    assert decode(cloud(ROS2, [])) == []
    assert decode(cloud(ROS2, [(1e300, 0.0, 0.0)], "<f8")) == [[math.inf, 0.0, 0.0]]


def test_rows_of_a_cloud_may_be_padded_and_a_single_one_need_not_say_its_length() -> None:
    message = cloud(ROS2, [(2.0, 0.5, 0.0), (9.0, 9.0, 9.0), (-3.0, 0.5, 0.0), (9.0, 9.0, 9.0)])
    message.height, message.width, message.row_step = 2, 1, 2 * message.point_step
    assert decode(message) == [[2.0, 0.5, 0.0], [-3.0, 0.5, 0.0]]
    message.height, message.row_step = 1, 0
    assert decode(message) == [[2.0, 0.5, 0.0]]


def test_clouds_are_used_where_there_are_no_scans_or_on_request(tmp_path: Path) -> None:
    points = [Written("/points", SECOND, cloud(ROS2, [(2.0, 0.1, 0.0)]))]
    alone = open_log(write_mcap(tmp_path / "alone.mcap", points))
    beside = open_log(write_mcap(tmp_path / "beside.mcap", drive(ROS2) + points))

    assert [stream.role for stream in alone.streams] == [Role.CLOUD]
    assert choose_topics(alone, ()) == ["/points"]
    assert choose_topics(beside, ()) == ["/scan"]
    assert choose_topics(beside, ["/points"]) == ["/points"]
    assert len(list(read_recorded(beside, ["/points"]))) == 1
    with pytest.raises(LogError, match="it has scans on /scan, /points"):
        choose_topics(beside, ["/other"])


@both
@pytest.mark.parametrize("package", ["livox_ros_driver", "livox_ros_driver2"])
@pytest.mark.parametrize("frame", ["livox", "livox_frame", ""])
def test_livox_points_have_their_times(
    store: Typestore, package: str, frame: str, tmp_path: Path
) -> None:
    message = livox(store, package, frame)
    (cloud,), notes = record(tmp_path, ("/livox/lidar", message), store=store)

    assert cloud.points.tolist() == [[1, 2, 3], [-4, 5.5, 0.25]]
    assert cloud.offset_ns is not None
    assert cloud.offset_ns.tolist() == [0, 50_000_000]
    assert (cloud.stamp_ns, cloud.frame, cloud.record_ns) == (SECOND, frame, 2 * SECOND)
    assert notes == ["/livox/lidar: its points have the time offset_time, in ns after the stamp"]


@both
def test_an_old_cloud_lists_its_points_and_their_times(store: Typestore, tmp_path: Path) -> None:
    (cloud,), _ = record(tmp_path, ("/cloud", listed(store)), store=store)
    assert cloud.points.tolist() == [[1, 2, 3], [-4, 5.5, 0.25]]
    assert cloud.offset_ns is not None
    assert cloud.offset_ns.tolist() == [0, 62_500_000]


def test_livox_points_that_are_not_all_there_are_damaged(tmp_path: Path) -> None:
    message = Written("/livox", SECOND, livox(ROS1, "livox_ros_driver", "livox"))
    path = write_bag1(tmp_path / "l.bag", [message])
    data = path.read_bytes()
    count = (2).to_bytes(4, "little")
    at = data.rindex(count, 0, data.index(np.array([1, 2, 3], "<f4").tobytes()))
    path.write_bytes(data[:at] + (3).to_bytes(4, "little") + data[at + 4 :])

    clouds, notes = read(path)

    assert clouds == []
    assert any("1 of 1 messages on /livox are damaged" in note for note in notes)


@pytest.mark.parametrize(
    "change",
    [
        {"point_step": 3},
        {"width": 1000},
        {"fields": []},
        # Points that lie over one another
        {"row_step": 0, "height": 2**31, "width": 2},
        {"row_step": 0, "height": 2},
        {"point_step": 0, "width": 2**32 - 1},
        {"height": 2**32 - 1, "width": 2**32 - 1},
        {"point_step": 2**32 - 1},
    ],
)
def test_a_cloud_that_lies_is_counted_as_damaged(tmp_path: Path, change: dict[str, Any]) -> None:
    message = cloud(ROS2, [(2.0, 0.1, 0.0), (2.0, 0.2, 0.0)])
    for name, value in change.items():
        setattr(message, name, value)

    clouds, notes = record(tmp_path, ("/points", message))

    assert clouds == []
    assert "1 of 1 messages on /points are damaged" in notes[0]


NOW, TENTH = 1_700_000_000_000_000_000, 100_000_000


@pytest.mark.parametrize(
    ("times", "expected", "told"),
    [
        (np.array([0, TENTH // 2, TENTH], "u4"), [0, TENTH // 2, TENTH], "in ns after the stamp"),
        (np.array([0, 50_000, 100_000], "u4"), [0, TENTH // 2, TENTH], "in us after the stamp"),
        (np.array([0, 50, 100], "f4"), [0, TENTH // 2, TENTH], "in ms after the stamp"),
        (np.array([-0.125, -0.0625, 0.0], "f4"), [-TENTH * 5 // 4, -TENTH * 5 // 8, 0], "in s aft"),
        (NOW / 1e9 + np.array([0.0, 0.5, 0.75]), [0, 5 * TENTH, TENTH * 15 // 2], "in s of a clo"),
        (NOW + np.array([0.0, 512.0, TENTH]), [0, 512, TENTH], "in ns of a clock"),
        (NOW + np.array([0, 512, TENTH], "u8"), [0, 512, TENTH], "in ns of a clock"),
        (1.5e9 + np.array([0.0, 0.5, 0.75]), [0, 5 * TENTH, TENTH * 15 // 2], "other than the s"),
        (np.array([0.0, 0.1, 1.5], "f4"), None, "more than a second"),  # no sweep takes so long
        (np.array([math.nan] * 3, "f4"), None, ""),
        (np.zeros(3, "u4"), None, ""),
    ],
)
def test_times_of_points_in_any_unit(times: Any, expected: list[int] | None, told: str) -> None:
    found, text = find_offsets(times, np.ones((3, 3), np.float32), NOW)

    assert (found if found is None else found.tolist()) == expected
    assert told in text
    assert bool(told) == bool(text)


def test_points_without_a_return_tell_no_time() -> None:
    points = np.array([[1.0, 2.0, 0.0], [0.0, 0.0, 0.0], [3.0, 1.0, 0.0]], np.float32)

    found, _ = find_offsets(np.array([0, 2**32 - 1, TENTH], "u4"), points, SECOND)

    assert found is not None
    assert found.tolist() == [0, 0, TENTH]


FIELDS = [{"name": name, "offset": 4 * at, "type": 7} for at, name in enumerate("xyz")]
OWN = {"position": {"x": 0, "y": 0, "z": 0}, "orientation": {"x": 0, "y": 0, "z": 0, "w": 0}}


@pytest.mark.parametrize("at", [OWN, place(1.0, 0.5)], ids=["own", "posed"])
def test_a_cloud_of_foxglove(at: dict[str, Any], tmp_path: Path) -> None:
    data = np.array([(1, 2, 3, 9), (4, 5, 6, 9)], "<f4").tobytes()
    message = {
        "timestamp": stamp(0), "frame_id": "lidar", "pose": at, "point_stride": 16,
        "fields": FIELDS, "data": base64.b64encode(data).decode(),
    }  # fmt: skip
    path = write_json(tmp_path / "f.mcap", [Message("/p", "foxglove.PointCloud", 0, message)])

    (cloud,), _ = read(path)

    assert cloud.points.tolist() == [[1, 2, 3], [4, 5, 6]]
    poses = list(open_log(path).poses())
    assert [(p.parent, p.child, p.pose) for p in poses] == (
        [] if cloud.frame == "lidar" else [("lidar", "lidar:p", Pose.planar(1.0, 2.0, 0.5))]
    )
    assert cloud.frame == ("lidar" if at is OWN else "lidar:p")


MILLIMETRES = np.array([[0, 2000, 0], [0, 0, 4000]])
# (column - 1) / 2 * z and (row - 0.5) / 4 * z, by the camera of `info`
DEPTHS = image(ROS2, MILLIMETRES.astype("<u2"), "16UC1")
SEEN = [[0.0, -0.25, 2.0], [2.0, 0.5, 4.0]]


@both
@pytest.mark.parametrize(
    ("topic", "make"),
    [
        (DEPTH, lambda store: image(store, MILLIMETRES.astype("<u2"), "16UC1")),
        (DEPTH, lambda store: image(store, MILLIMETRES.astype(">u2"), "16UC1")),
        (DEPTH, lambda store: image(
            store, np.where(MILLIMETRES > 0, MILLIMETRES / 1000, np.nan).astype("<f4"), "32FC1")),
        (f"{DEPTH}/compressedDepth", lambda store: packed(
            store, MILLIMETRES, "16UC1; compressedDepth png", (0, 0))),
        # 100 / (60 - 10) = 2 m and 100 / (35 - 10) = 4 m
        (f"{DEPTH}/compressedDepth", lambda store: packed(
            store, np.array([[0, 60, 0], [0, 0, 35]]), "32FC1; compressedDepth", (100, 10))),
    ],
    ids=["16UC1", "big-endian", "32FC1", "png", "png of floats"],
)  # fmt: skip
def test_a_depth_image_is_a_point_for_each_pixel(
    store: Typestore, topic: str, make: Any, tmp_path: Path
) -> None:
    log = (INFO, info(store)), (topic, make(store))
    (cloud,), notes = record(tmp_path, *log, store=store)

    np.testing.assert_allclose(cloud.points, SEEN, rtol=1e-6)
    assert (cloud.frame, cloud.topic, cloud.offset_ns) == ("optical", topic, None)
    assert notes == []


WALL = 1 / np.linspace(0.5, 0.1, 13)


@pytest.mark.parametrize(
    ("depths", "flying"),
    [
        ([1.0, 1.0, 2.0, 4.0, 4.0], [2]),
        ([4.0, 4.0, 2.5, 2.0, 1.0, 1.0], [2, 3]),  # an edge that blurs two
        ([1.0, 2.0, 0.0, 4.0], [1]),
        ([4.0, 2.0, 4.0], []),  # a pole
        ([4.0, 4.0, 3.0, 2.0, 3.0, 0.0, 4.0, 4.0], [2, 4]),  # another, which blurs
        ([1.0, 1.0, 4.0, 4.0], []),
        ([1.0, 1.09, 4.0], []),
        ([5.0, 5.14, 6.0], []),
        (WALL, []),  # at any slant
        ([*WALL[:7], *[40.0] * 6], [5, 6]),  # but what ends it so far away
        ([0.0, 2.0, 4.0], []),
        ([1.0, 2.0, np.nan], []),
        ([1.0, 2.0, np.inf], []),
        ([1.0], []),
        ([], []),
    ],
)
def test_a_pixel_between_a_near_and_a_far_thing_is_of_neither(
    depths: list[float], flying: list[int]
) -> None:
    row = np.array([depths], np.float32)
    for found in clean(row, 200.0), clean(row[:, ::-1], 200.0)[:, ::-1], clean(row.T, 200.0).T:
        is_seen = (row > 0) & np.isfinite(row)
        assert np.flatnonzero(is_seen & np.isnan(found)).tolist() == flying
    assert (clean(row, 2.0) > 0).sum() == is_seen.sum()  # as wide pixels may be three things


def average_slowly(inverse: Float64, alike: float, axis: int) -> Float64:
    even = inverse.copy()
    for row, col in np.ndindex(*inverse.shape):
        line, at = (inverse[row], col) if axis else (inverse[:, col], row)
        inside = [apart for apart in (2, 4, 6, 8) if apart <= at < len(line) - apart]
        pairs = [line[[at - apart, at + apart]] for apart in inside]
        alikes = [pair for pair in pairs if np.abs(pair - line[at]).sum() < alike]
        even[row, col] = np.mean([line[at], *np.ravel(alikes)])
    return even


def test_noise_is_averaged_along_a_surface_however_it_leans_and_not_over_its_edge() -> None:
    row, col = np.indices((44, 60))
    exact = 0.5 + 0.003 * row + 0.001 * col + 0.1 * ((row > 20) & (col > 30))
    noise = np.random.default_rng(4).normal(size=exact.shape)

    still, seen = (1 / (exact + 0.0002 * noise)).astype(np.float32), exact + 0.004 * noise
    found = 1 / clean((1 / seen).astype(np.float32), 200.0)

    bends = [seen[:, at - 4] + seen[:, at + 4] - 2 * seen[:, at] for at in range(4, 56)]
    alike = 5 * 1.4826 * np.median(np.abs(bends)) / math.sqrt(6)
    expected = average_slowly(average_slowly(seen, alike, 1), alike, 0)
    assert np.isclose(found, expected, rtol=1e-5).mean() > 0.99  # rounding decides on some pairs
    assert np.std((found - exact)[8:20, 8:30]) < 0.4 * 0.004  # and not beside the image's border
    np.testing.assert_array_equal(clean(still, 200.0), still)
    slats = np.where(col % 8 < 4, 1.0, 5.0).astype(np.float32)
    np.testing.assert_allclose(clean(slats, 200.0), slats, rtol=1e-6)


def test_points_of_a_camera_in_any_order_are_its_pixels(tmp_path: Path) -> None:
    depth = np.where(np.arange(40) < 20, 1.0, 4.0) * np.ones((30, 1))
    depth[5:25, 20], depth[::3, ::7] = 2.0, np.nan
    row, col = np.indices(depth.shape)
    x, y = (col - 19.5) / 50 * depth, (row - 14.5) / 50 * depth
    points = np.stack([x, y, depth], axis=-1).reshape(-1, 3)
    order = np.random.default_rng(1).permutation(len(points))

    for seen in points, points[order], points[order][~np.isnan(points[order, 2])]:
        found = np.array(decode(cloud(ROS2, seen.tolist())))
        known = seen[np.isfinite(found).all(axis=1)]
        assert 2.0 in seen[:, 2]
        assert sorted(set(known[:, 2])) == [1.0, 4.0]
        assert len(known) == np.isfinite(depth).sum() - (depth == 2.0).sum()
    for others in points[:, [2, 0, 1]], points * (1, 1, -1), points[:200]:
        np.testing.assert_array_equal(decode(cloud(ROS2, others.tolist())), others.astype("f4"))

    (tmp_path / "clouds").mkdir()
    np.save(tmp_path / "clouds" / "1600000000.5.npy", points)
    way = tmp_path / "way.tum"
    way.write_text("".join(f"160000000{time} 0 0 0 0 0 0 1\n" for time in ("0.4", "0.6")))
    options = BuildOptions(posing=PosingOptions(poses=str(way)))
    (posed,) = open_drive(open_log(tmp_path / "clouds"), options).read(Tally())
    (seen,) = posed.batch.clouds or ()
    assert {*np.unique(seen.points[np.isfinite(seen.points[:, 2]), 2])} == {1.0, 4.0}


def test_a_camera_of_the_same_frame_on_any_topic_will_do(tmp_path: Path) -> None:
    (cloud,), (note,) = record(tmp_path, ("/rgb/camera_info", info(ROS2)), (DEPTH, DEPTHS))
    assert len(cloud.points) == 2
    assert "/rgb/camera_info" in note

    other = info(ROS2)
    other.header.frame_id = "elsewhere"
    clouds, (note,) = record(tmp_path, ("/rgb/camera_info", other), (DEPTH, DEPTHS))
    assert clouds == []
    assert DEPTH in note
    assert INFO in note


def test_an_image_of_zeros_has_no_points(tmp_path: Path) -> None:
    black = (INFO, info(ROS2)), (DEPTH, image(ROS2, np.zeros((2, 3), "<u2"), "16UC1"))

    with pytest.raises(LogError, match=f"{DEPTH} holds a point"):
        record(tmp_path, *black)
    (first, second), (note,) = record(tmp_path, *black, (DEPTH, DEPTHS))
    assert (len(first.points), len(second.points)) == (0, 2)
    assert DEPTH in note


def test_an_image_of_another_size_than_its_camera_is_damaged(tmp_path: Path) -> None:
    clouds, (note,) = record(tmp_path, (INFO, info(ROS2, width=4)), (DEPTH, DEPTHS))

    assert clouds == []
    assert "1 of 1 messages" in note


def test_images_of_colours_are_no_clouds(tmp_path: Path) -> None:
    colours = image(ROS2, np.zeros((2, 9), np.uint8), "rgb8")

    assert record(tmp_path, ("/c/camera_info", info(ROS2)), ("/c/image", colours)) == ([], [])


@pytest.mark.parametrize("kind", ["velodyne_msgs/msg/VelodyneScan", "ouster_ros/msg/PacketMsg"])
def test_packets_are_named_with_the_node_that_makes_them_clouds(kind: str, tmp_path: Path) -> None:
    ROS2.register(get_types_from_msg("uint8[] buf", kind))
    packet = ROS2.types[kind](np.zeros(9, np.uint8))
    clouds, (note,) = record(tmp_path, ("/packets", packet))

    assert clouds == []
    assert "/packets" in note
    assert kind[:6] in note
