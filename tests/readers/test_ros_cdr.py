"""The short way of reading must give what rosbags' decoder and the converters give."""

import struct

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from occmap.readers.messages import convert_laser_scan, convert_transforms
from occmap.readers.ros_cdr import (
    STANDARD_DEFINITIONS,
    is_standard,
    read_laser_scan,
    read_transforms,
)
from tests.readers.ros import ROS1, ROS2, SCAN, TF, scan, transforms

FRAMES = st.text(st.characters(exclude_characters="\0", codec="utf-8"), max_size=9)
STAMPS = st.integers(0, (2**31 - 1) * 10**9 + 999_999_999)


@given(FRAMES, STAMPS, st.lists(st.floats(width=32), max_size=9))
@settings(max_examples=60)
def test_scans_are_read_as_the_general_decoder_reads_them(
    frame: str, stamp_ns: int, ranges: list[float]
) -> None:
    message = scan(ROS2, stamp_ns, frame, np.array(ranges, dtype=np.float32))
    data = ROS2.serialize_cdr(message, SCAN)

    short = read_laser_scan(memoryview(data), "/scan", 7)
    full = convert_laser_scan(ROS2.deserialize_cdr(data, SCAN), "/scan", 7)

    assert short.ranges.tobytes() == full.ranges.tobytes()
    assert short._replace(ranges=full.ranges) == full


@given(st.lists(st.tuples(FRAMES, FRAMES, st.floats(allow_nan=False)), max_size=4), STAMPS)
@settings(max_examples=60)
def test_transforms_are_read_as_the_general_decoder_reads_them(
    edges: list[tuple[str, str, float]], stamp_ns: int
) -> None:
    data = ROS2.serialize_cdr(transforms(ROS2, stamp_ns, edges), TF)

    full = convert_transforms(ROS2.deserialize_cdr(data, TF), "/tf_static", 7)

    assert read_transforms(memoryview(data), "/tf_static", 7) == full
    assert len(full) == len(edges)


def test_a_cut_message_is_refused_at_every_length() -> None:
    data = memoryview(ROS2.serialize_cdr(scan(ROS2, 1), SCAN))
    for length in range(len(data)):
        with pytest.raises((ValueError, struct.error, IndexError)):
            read_laser_scan(data[:length], "/scan", 0)


def test_a_scan_that_announces_two_billion_beams_is_refused_without_allocating() -> None:
    data = bytearray(ROS2.serialize_cdr(scan(ROS2, 1, "laser"), SCAN))
    beams = 4 + 20 + 28  # behind the encapsulation, the header with its frame, seven floats
    assert struct.unpack_from("<I", data, beams) == (5,)
    struct.pack_into("<I", data, beams, 2**31)

    with pytest.raises((ValueError, struct.error)):
        read_laser_scan(memoryview(data), "/scan", 0)


def test_only_the_standard_layout_is_standard() -> None:
    assert all(is_standard(name, ROS2.fielddefs) for name in STANDARD_DEFINITIONS)
    # ROS 1 headers hold a sequence number.
    assert not is_standard(SCAN, ROS1.fielddefs)
    assert not is_standard(SCAN, {SCAN: ROS2.fielddefs[SCAN]})
    assert not is_standard("nav_msgs/msg/Odometry", ROS2.fielddefs)
