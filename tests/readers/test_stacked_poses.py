"""Poses that are read at once must be those that are read one by one."""

import math
import tracemalloc
from collections import defaultdict
from collections.abc import Collection, Iterable, Iterator, Sequence

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from occmap.readers import containers, ros_log
from occmap.readers.containers import Channel, Messages
from occmap.readers.ros_log import RosLog
from occmap.types import PoseBatch, PoseSample
from tests.readers.ros import POSED, ROS1, ROS2, TF, Memory, posed, transforms

Edges = Sequence[tuple[str, str, float]]
Key = tuple[str, str, str, bool]
# Names of one length and of several, so that messages of one length name different frames.
NAMES = st.sampled_from(["map", "odo", "odom", "base_link", "/odom", ""])
EDGES = st.lists(st.tuples(NAMES, NAMES, st.floats(-9, 9)), max_size=3)
DAMAGE = st.sampled_from(["", "", "", "cut", "count", "big-endian"])


def write(
    edges: Edges, stamp_ns: int, damage: str = "", encoding: str = "cdr", kind: str = TF
) -> bytes:
    store = ROS1 if encoding == "ros1" else ROS2
    message = (
        transforms(store, stamp_ns, edges)
        if kind == TF
        else posed(store, kind, stamp_ns, edges[0] if edges else ("", "", math.nan))
    )
    serialise = store.serialize_ros1 if store is ROS1 else store.serialize_cdr
    data = bytearray(serialise(message, kind))
    if damage == "cut":
        del data[-1:]
    elif damage == "count":  # of transforms; of a single pose, the count of messages or seconds
        at = 4 if encoding == "cdr" else 0
        data[at : at + 4] = b"\xff\xff\xff\x7f"
    elif damage == "big-endian":
        data[1] ^= 1
    return bytes(data)


def make_channel(topic: str, count: int, encoding: str = "cdr", kind: str = TF) -> Channel:
    definition = (ROS1 if encoding == "ros1" else ROS2).generate_msgdef(kind)[0]
    return Channel(topic, kind, encoding, definition, count)


def by_key(items: Iterable[PoseSample | PoseBatch]) -> dict[Key, list[PoseSample]]:
    """Single samples by what they are of, in their order."""
    samples: dict[Key, list[PoseSample]] = defaultdict(list)
    for item in items:
        samples[item.topic, item.parent, item.child, item.static] += split(item)
    return {
        key: sorted(each, key=lambda sample: sample.record_ns)
        for key, each in sorted(samples.items())
    }


def split(item: PoseSample | PoseBatch) -> list[PoseSample]:
    return [item] if isinstance(item, PoseSample) else item.split()


@pytest.mark.parametrize("kind", [TF, *POSED])
@pytest.mark.parametrize("encoding", ["cdr", "ros1"])
@given(data=st.data())
@settings(max_examples=100)
def test_stacked_poses_are_those_read_one_by_one(
    encoding: str, kind: str, data: st.DataObject
) -> None:
    written = data.draw(st.lists(st.tuples(EDGES, st.integers(0, 1), DAMAGE), max_size=12))
    channels = [make_channel(topic, 9, encoding, kind) for topic in ("/tf", "/tf_static")]
    messages = [
        (channels[c], 7 * i, write(edges, 10**9 * i + 5, damage, encoding, kind))
        for i, (edges, c, damage) in enumerate(written)
    ]
    alone, stacked = RosLog(Memory(messages)), RosLog(Memory(messages))

    # As text, in which every bit of a number shows and nan is like nan.
    assert repr(by_key(stacked.stacked_poses())) == repr(by_key(alone.poses()))
    assert stacked.notes == alone.notes


@pytest.mark.parametrize("kind", [TF, *POSED])
@pytest.mark.parametrize("encoding", ["cdr", "ros1"])
def test_messages_laid_out_alike_are_read_at_a_stroke(
    encoding: str, kind: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    channel = make_channel("/tf", 100, encoding, kind)
    messages = [
        (channel, i, write([("odom", "base", float(i))], i, "", encoding, kind)) for i in range(100)
    ]
    monkeypatch.setattr(ros_log, "STACK_BYTES", 20 * len(messages[0][2]))

    items = list(RosLog(Memory(messages)).stacked_poses())

    batches = [item for item in items if isinstance(item, PoseBatch)]
    assert [len(batch.stamp_ns) for batch in batches] == [34, 33, 33]
    assert len(items) == 3
    assert np.concatenate([batch.pose[:, 0] for batch in batches]).tolist() == list(range(100))


def test_a_log_whose_messages_all_differ_in_length_holds_only_some_of_them(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    channel = make_channel("/tf", 30)
    messages = [
        (channel, i, write([("odom", "base", float(k)) for k in range(i)], i)) for i in range(30)
    ]
    monkeypatch.setattr(containers, "BLOCK_BYTES", 1)
    monkeypatch.setattr(ros_log, "STACK_BYTES", 5 * len(messages[-1][2]))
    taken = []

    class Watched(Memory):
        def messages(self, wanted: Collection[Channel]) -> Iterator[Messages]:
            for some in super().messages(wanted):
                taken.append(len(some.key))
                yield some

    items = RosLog(Watched(messages)).stacked_poses()
    first = next(items)
    assert sum(taken) < 30

    counts = [len(item.pose) if isinstance(item, PoseBatch) else 1 for item in [first, *items]]
    assert sum(counts) == sum(range(30))


def test_a_message_of_very_many_transforms_is_held_once() -> None:
    edges = [("base", f"laser{n}", 0.25) for n in range(2000)]
    data = write(edges, 5)
    log = RosLog(Memory([(make_channel("/tf_static", 1), 5, data)]))

    tracemalloc.start()
    poses = list(log.stacked_poses())
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()

    assert len(poses) == 2000
    assert peak < 100 * len(data)


@pytest.mark.parametrize("encoding", ["cdr", "ros1"])
def test_a_message_without_a_byte_is_damaged(encoding: str) -> None:
    channel = make_channel("/tf", 3, encoding)
    whole = write([("odom", "base", 1.0)], 5, encoding=encoding)
    log = RosLog(Memory([(channel, 1, b""), (channel, 2, whole), (channel, 3, b"")]))

    samples = by_key(log.stacked_poses())["/tf", "odom", "base", False]

    assert [sample.record_ns for sample in samples] == [2]
    (note,) = log.notes
    assert note.text.startswith("2 of 3 messages on /tf are damaged and not used: the first is not")
