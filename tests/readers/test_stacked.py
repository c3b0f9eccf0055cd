"""Scans and poses that are read at once must be those that are read one by one."""

import math
from collections import defaultdict
from collections.abc import Collection, Iterable, Iterator, Sequence
from typing import Any, TypeAlias

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rosbags.typesys.store import Typestore

from occmap.readers import ros_log
from occmap.readers.containers import Channel, RawMessage
from occmap.readers.ros_log import RosLog
from occmap.types import PoseBatch, PoseSample, ScanBatch
from tests.readers import ros
from tests.readers.ros import ROS2, SCAN, TF, Memory, both, make_channel, scan, serialise
from tests.readers.runs import bounded_memory, list_fields

Messages: TypeAlias = list[tuple[Channel, int, bytes]]
Edges = Sequence[tuple[str, str, float]]
Key = tuple[str, str, str, bool]
# Fields behind the header; a driver that measures its own speed changes them from scan to scan.
FIELDS = ("angle_min", "angle_max", "angle_increment", "time_increment", "scan_time", "range_max")
CHANGES = st.sampled_from(["", "", "", "", "", "", "cut", "count", "big-endian", *FIELDS])
SCANS = st.tuples(
    st.integers(0, 1),
    st.integers(0, (2**31 - 1) * 10**9 + 999_999_999),
    st.sampled_from(["laser", "laser", "laser", "front", "/a"]),
    st.lists(st.floats(width=32), min_size=2, max_size=2),
    CHANGES,
)
# Names of one length and of several, so that messages of one length name different frames.
NAMES = st.sampled_from(["map", "odo", "odom", "base_link", "/odom", ""])
EDGES = st.lists(st.tuples(NAMES, NAMES, st.floats(-9, 9)), max_size=3)
DAMAGE = st.sampled_from(["", "", "", "cut", "count", "big-endian"])


def spoil(data: bytes, damage: str, at: int) -> bytes:
    """Damage a message; at a place it has a count."""
    spoilt = bytearray(data)
    if damage == "cut":
        del spoilt[-1:]
    elif damage == "count":
        spoilt[at : at + 4] = b"\xff\xff\xff\x7f"
    elif damage == "big-endian":
        spoilt[1] ^= 1
    return bytes(spoilt)


def write_scan(
    store: Typestore,
    stamp_ns: int,
    frame: str = "laser",
    ranges: Sequence[float] = (1, 2),
    change: str = "",
) -> bytes:
    message = scan(store, stamp_ns, frame, np.array(ranges, np.float32))
    if change in FIELDS:
        setattr(message, change, 0.5)
    data = serialise(message, store)
    return spoil(data, change, len(data) - 4 * 3 - 4 - 4 * len(ranges) - 4)


def write_poses(
    store: Typestore, stamp_ns: int, edges: Edges, damage: str = "", kind: str = TF
) -> bytes:
    edge = edges[0] if edges else ("", "", math.nan)
    message = (
        ros.transforms(store, stamp_ns, edges)
        if kind == TF
        else ros.posed(store, kind, stamp_ns, edge)
    )
    # The count of transforms; of a single pose, that of messages or seconds
    return spoil(serialise(message, store), damage, 4 if store is ROS2 else 0)


def list_scans(changes: Sequence[str], store: Typestore) -> Messages:
    """Scans at 0, 1, 2 ... ns, in each of which a field has another value, or none."""
    channel = make_channel("/scan", SCAN, len(changes), store)
    return [
        (channel, 100 + i, write_scan(store, i, "laser", [i, 0.5], change))
        for i, change in enumerate(changes)
    ]


@both
@given(data=st.data())
@settings(max_examples=80)
def test_scans_of_a_run_are_those_read_one_by_one(store: Typestore, data: st.DataObject) -> None:
    written: list[tuple[Any, ...]] = data.draw(st.lists(SCANS, max_size=12))
    topics = ["/front", "/rear"]
    channels = [make_channel(topic, SCAN, 99, store) for topic in topics]
    messages = [
        (channels[c], 7 * i, write_scan(store, *rest)) for i, (c, *rest) in enumerate(written)
    ]
    alone, stacked = RosLog(Memory(messages)), RosLog(Memory(messages))

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(ros_log, "SHORTEST_RUN", 2)
        scans = list_fields(stacked.scans(topics))
        patch.setattr(ros_log, "STACK_BYTES", 1)
        assert scans == list_fields(alone.scans(topics))

    assert stacked.notes == alone.notes


@both
@pytest.mark.parametrize("changing", ["", "angle_max", "scan_time"])
def test_what_nobody_uses_may_differ_within_a_run(
    store: Typestore, changing: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    messages = list_scans(["", changing] * 5, store)
    monkeypatch.setattr(ros_log, "STACK_BYTES", 5 * (len(messages[0][2]) + ros_log.MESSAGE_BYTES))
    monkeypatch.setattr(ros_log, "SHORTEST_RUN", 5)

    first, run = RosLog(Memory(messages)).stacked_scans(["/scan"])

    assert isinstance(first, ScanBatch)
    assert isinstance(run, ScanBatch)
    assert run.stamp_ns.tolist() == [5, 6, 7, 8, 9]
    assert run.record_ns.tolist() == [105, 106, 107, 108, 109]
    assert run.ranges.tolist() == [[k, 0.5] for k in range(5, 10)]


def test_messages_of_an_own_definition_are_read_by_it(monkeypatch: pytest.MonkeyPatch) -> None:
    definition = ROS2.generate_msgdef(SCAN)[0].replace("float32 scan_time", "float32 scan_times")
    channel = Channel("/scan", SCAN, "cdr", definition, 9)
    monkeypatch.setattr(ros_log, "SHORTEST_RUN", 2)

    log = RosLog(Memory([(channel, i, write_scan(ROS2, i)) for i in range(9)]))
    (run,) = log.stacked_scans(["/scan"])

    assert isinstance(run, ScanBatch)
    monkeypatch.setattr(ros_log, "STACK_BYTES", 1)
    assert list_fields(run.split()) == list_fields(log.scans(["/scan"]))


def by_key(items: Iterable[PoseSample | PoseBatch]) -> dict[Key, list[PoseSample]]:
    """Single samples by what they are of, in their order."""
    samples: dict[Key, list[PoseSample]] = defaultdict(list)
    for item in items:
        split = [item] if isinstance(item, PoseSample) else item.split()
        samples[item.topic, item.parent, item.child, item.static] += split
    return {
        key: sorted(each, key=lambda sample: sample.record_ns)
        for key, each in sorted(samples.items())
    }


@both
@pytest.mark.parametrize("kind", [TF, *ros.POSED])
@given(data=st.data())
@settings(max_examples=50)
def test_stacked_poses_are_those_read_one_by_one(
    store: Typestore, kind: str, data: st.DataObject
) -> None:
    written = data.draw(st.lists(st.tuples(EDGES, st.integers(0, 1), DAMAGE), max_size=12))
    channels = [make_channel(topic, kind, 9, store) for topic in ("/tf", "/tf_static")]
    messages = [
        (channels[c], 7 * i, write_poses(store, 10**9 * i + 5, edges, damage, kind))
        for i, (edges, c, damage) in enumerate(written)
    ]
    alone, stacked = RosLog(Memory(messages)), RosLog(Memory(messages))

    # As text, in which every bit of a number shows and nan is like nan.
    together = repr(by_key(stacked.stacked_poses()))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(ros_log, "STACK_BYTES", 1)
        assert together == repr(by_key(alone.stacked_poses()))
    assert stacked.notes == alone.notes


@both
@pytest.mark.parametrize("kind", [TF, *ros.POSED])
def test_messages_laid_out_alike_are_read_at_a_stroke(
    store: Typestore, kind: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    channel = make_channel("/tf", kind, 100, store)
    messages = [
        (channel, i, write_poses(store, i, [("odom", "base", float(i))], kind=kind))
        for i in range(100)
    ]
    monkeypatch.setattr(ros_log, "STACK_BYTES", 34 * (len(messages[0][2]) + ros_log.MESSAGE_BYTES))

    items = list(RosLog(Memory(messages)).stacked_poses())

    batches = [item for item in items if isinstance(item, PoseBatch)]
    assert len(batches) == len(items)
    assert [len(batch.stamp_ns) for batch in batches] == [34, 34, 32]
    assert np.concatenate([batch.pose[:, 0] for batch in batches]).tolist() == list(range(100))


def test_a_log_whose_messages_all_differ_in_length_holds_only_some_of_them(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    channel = make_channel("/tf", TF, 30)
    edges = [("odom", "base", float(k)) for k in range(30)]
    messages = [(channel, i, write_poses(ROS2, i, edges[:i])) for i in range(30)]
    monkeypatch.setattr(ros_log, "STACK_BYTES", 5 * len(messages[-1][2]))
    taken = []

    class Watched(Memory):
        def messages(self, wanted: Collection[Channel]) -> Iterator[RawMessage]:
            for message in super().messages(wanted):
                taken.append(message)
                yield message

    items = RosLog(Watched(messages)).stacked_poses()
    first = next(items)
    assert len(taken) < 30

    counts = [len(item.pose) if isinstance(item, PoseBatch) else 1 for item in [first, *items]]
    assert sum(counts) == sum(range(30))


def test_a_message_of_very_many_transforms_is_held_once() -> None:
    edges = [("base", f"laser{n}", 0.25) for n in range(2000)]
    data = write_poses(ROS2, 5, edges)
    log = RosLog(Memory([(make_channel("/tf_static", TF, 1), 5, data)]))

    with bounded_memory(100 * len(data)):
        assert len(list(log.stacked_poses())) == 2000


@both
def test_a_message_without_a_byte_is_damaged(store: Typestore) -> None:
    channel = make_channel("/tf", TF, 3, store)
    whole = write_poses(store, 5, [("odom", "base", 1.0)])
    log = RosLog(Memory([(channel, 1, b""), (channel, 2, whole), (channel, 3, b"")]))

    (samples,) = by_key(log.stacked_poses()).values()

    assert [sample.record_ns for sample in samples] == [2]
    (note,) = log.notes
    assert note.text.startswith("2 of 3 messages on /tf are damaged and not used: the first is not")
