"""Scans that are read at once must be those that are read one by one."""

from collections.abc import Sequence

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from occmap.readers import ros_log
from occmap.readers.containers import Channel
from occmap.readers.ros_log import RosLog
from occmap.types import Scan, ScanRun
from tests.readers.ros import ROS1, ROS2, SCAN, Memory, scan
from tests.readers.runs import flatten, list_fields

ENCODINGS: Sequence[str] = ("cdr", "ros1")
# Fields behind the header; a driver that measures its own speed changes them from scan to scan.
FIELDS = ("angle_min", "angle_max", "angle_increment", "time_increment", "scan_time", "range_max")
CHANGES = st.sampled_from(["", "", "", "", "", "", "cut", "beams", "big-endian", *FIELDS])
RANGES = st.lists(st.floats(width=32), min_size=2, max_size=2)
MESSAGES = st.tuples(
    st.integers(0, 1),
    st.sampled_from(["laser", "laser", "laser", "front", "/a"]),
    st.integers(0, (2**31 - 1) * 10**9 + 999_999_999),
    RANGES,
    CHANGES,
)


def write(
    encoding: str, frame: str, stamp_ns: int, ranges: Sequence[float], change: str = ""
) -> bytes:
    store = ROS1 if encoding == "ros1" else ROS2
    message = scan(store, stamp_ns, frame, np.array(ranges, np.float32))
    if change in FIELDS:
        setattr(message, change, 0.5)
    serialise = store.serialize_ros1 if encoding == "ros1" else store.serialize_cdr
    data = bytearray(serialise(message, SCAN))
    if change == "cut":
        data[-1:] = b""
    elif change == "beams":
        at = len(data) - 4 * 3 - 4 - 4 * len(ranges) - 4
        data[at : at + 4] = b"\xff\xff\xff\x7f"
    elif change == "big-endian":
        data[1] ^= 1
    return bytes(data)


def make_channel(encoding: str, topic: str = "/scan", count: int = 99) -> Channel:
    store = ROS1 if encoding == "ros1" else ROS2
    return Channel(topic, SCAN, encoding, store.generate_msgdef(SCAN)[0], count)


@pytest.mark.parametrize("encoding", ENCODINGS)
@given(st.data())
@settings(max_examples=150)
def test_scans_of_a_run_are_those_read_one_by_one(encoding: str, data: st.DataObject) -> None:
    written = data.draw(st.lists(MESSAGES, max_size=12))
    channels = [make_channel(encoding, topic) for topic in ("/front", "/rear")]
    messages = [
        (channels[channel], 7 * i, write(encoding, frame, stamp_ns, ranges, change))
        for i, (channel, frame, stamp_ns, ranges, change) in enumerate(written)
    ]
    alone, stacked = RosLog(Memory(messages)), RosLog(Memory(messages))
    topics = ["/front", "/rear"]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(ros_log, "SHORTEST_RUN", 2)
        scans = flatten(stacked.stacked_scans(topics))

    assert list_fields(scans) == list_fields(alone.scans(topics))
    assert stacked.notes == alone.notes


@pytest.mark.parametrize("encoding", ENCODINGS)
@pytest.mark.parametrize("changing", ["stamp", "angle_max", "scan_time"])
def test_what_nobody_uses_may_differ_within_a_run(
    encoding: str, changing: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    channel = make_channel(encoding)
    changes = [changing if changing in FIELDS and i % 2 else "" for i in range(10)]
    messages = [
        (channel, 100 + i, write(encoding, "laser", i, [i, 0.5], changes[i])) for i in range(10)
    ]
    monkeypatch.setattr(ros_log, "STACK_BYTES", 3 * len(messages[0][2]))
    monkeypatch.setattr(ros_log, "SHORTEST_RUN", 5)

    items = list(RosLog(Memory(messages)).stacked_scans(["/scan"]))

    runs = [item for item in items if isinstance(item, ScanRun)]
    assert [len(run.stamp_ns) for run in runs] == [5, 5]
    assert len(items) == 2
    assert runs[1].stamp_ns.tolist() == [5, 6, 7, 8, 9]
    assert runs[1].record_ns.tolist() == [105, 106, 107, 108, 109]
    assert runs[1].ranges.tolist() == [[k, 0.5] for k in range(5, 10)]


@pytest.mark.parametrize("encoding", ENCODINGS)
def test_each_scan_of_a_run_has_its_own_time_between_beams(
    encoding: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    channel = make_channel(encoding)
    changes = ["", "time_increment", ""]
    messages = [(channel, i, write(encoding, "laser", i, [1, 2], changes[i])) for i in range(3)]
    monkeypatch.setattr(ros_log, "SHORTEST_RUN", 3)

    (run,) = RosLog(Memory(messages)).stacked_scans(["/scan"])

    assert isinstance(run, ScanRun)
    before, changed, after = run.time_increment.tolist()
    assert changed == 0.5
    assert before == after != 0.5


@pytest.mark.parametrize("encoding", ENCODINGS)
@pytest.mark.parametrize("change", ["angle_min", "angle_increment", "range_max"])
def test_scans_of_another_geometry_are_no_run(
    encoding: str, change: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    channel = make_channel(encoding)
    messages = [
        (channel, i, write(encoding, "laser", i, [1, 2], change if i == 7 else ""))
        for i in range(9)
    ]
    monkeypatch.setattr(ros_log, "SHORTEST_RUN", 2)

    items = list(RosLog(Memory(messages)).stacked_scans(["/scan"]))

    assert [type(item) for item in items] == [Scan] * 9


def test_messages_of_an_own_definition_are_read_by_it(monkeypatch: pytest.MonkeyPatch) -> None:
    definition = ROS2.generate_msgdef(SCAN)[0].replace("float32 scan_time", "float32 scan_times")
    channel = Channel("/scan", SCAN, "cdr", definition, 9)
    messages = [(channel, i, write("cdr", "laser", i, [1, 2])) for i in range(9)]
    monkeypatch.setattr(ros_log, "SHORTEST_RUN", 2)

    log = RosLog(Memory(messages))
    (run,) = log.stacked_scans(["/scan"])

    assert isinstance(run, ScanRun)
    assert list_fields(run.split()) == list_fields(log.scans(["/scan"]))
