"""One message with a value of a wrong type: it is damaged and noted, and the log goes on."""

import json
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from occmap.readers import message_types, open_log
from occmap.readers.cloud_messages import convert_cloud
from occmap.readers.containers import Channel
from occmap.readers.fields import get_row
from occmap.readers.ros_log import RosLog
from tests.readers.clouds import cloud
from tests.readers.foxglove_logs import SECOND, Message, scan, write_json
from tests.readers.ros import ROS2, SCAN, TF, Memory, serialise, transforms
from tests.readers.ros import scan as ros_scan

SCANS = [scan(index) for index in range(3)]


def spoil(message: Message, path: str, value: Any) -> Message:
    """Put a value in a place such as pose.position.x; it is taken away where it is `...`."""
    fields = json.loads(json.dumps(message.fields))
    *above, last = path.split(".")
    place = fields
    for name in above:
        place = place[int(name)] if isinstance(place, list) else place[name]
    if value is ...:
        del place[last]
    else:
        place[last] = value
    return message._replace(fields=fields)


NOT_A_NUMBER: list[Any] = [None, "1.5", True, [1.0], {}, 10**400, ...]
NOT_TEXT: list[Any] = [None, 7, ["laser"], "\ud800", ...]
NO_MESSAGE: list[Any] = [None, 7, [], ...]
NO_RANGES: list[Any] = [None, 7, {}, "none", [[1, 2], [3, 4]], [[1], [2, 3]], [10**400], ...]
NOT_A_TIME: list[Any] = [None, 2**62, -(2**62), 2**64, 1.5, "7", ...]


@pytest.mark.parametrize(
    ("path", "value"),
    [
        *[("start_angle", value) for value in NOT_A_NUMBER],
        *[("pose.position.x", value) for value in NOT_A_NUMBER],
        *[("frame_id", value) for value in NOT_TEXT],
        *[("timestamp.sec", value) for value in NOT_A_TIME],
        *[("pose", value) for value in NO_MESSAGE],
        *[("ranges", value) for value in NO_RANGES],
    ],
)
def test_a_value_of_a_wrong_type_damages_its_scan(path: str, value: Any, tmp_path: Path) -> None:
    log = open_log(
        write_json(tmp_path / "l.mcap", [SCANS[0], spoil(SCANS[1], path, value), SCANS[2]])
    )

    assert [one.stamp_ns // SECOND for one in log.scans({"/scan"})] == [100, 102]
    assert list(log.poses()) == []
    (note,) = log.notes
    assert note.text.startswith("1 of 3 messages on /scan are damaged and not used: the first ")


def test_json_nested_without_end_is_damaged() -> None:
    channel = Channel("/scan", "foxglove.LaserScan", "json", count=2)
    deep = b'{"ranges": ' + b"[" * 200_000
    good = json.dumps(SCANS[0].fields).encode()
    log = RosLog(Memory([(channel, 1, deep), (channel, 2, good)]))

    assert [one.record_ns for one in log.scans({"/scan"})] == [2]
    assert "1 of 2 messages on /scan are damaged" in log.notes[0].text


def test_a_nan_that_a_flipped_bit_makes_of_infinity_is_read_without_a_warning() -> None:
    signalling = np.array([0x7F800001], np.uint32).view(np.float32)
    message = cloud(ROS2, [(2.0, 0.1, 0.0)])
    x = signalling.view(np.uint8)
    message.data = np.concatenate([message.data[:2], x, message.data[6:]])

    assert np.isnan(get_row({"x": signalling}, "x")).all()
    assert np.isnan(convert_cloud(message, "/p", 7).points[0, 0])


@pytest.mark.parametrize(
    ("kind", "read"), [(SCAN, lambda log: log.scans({"/it"})), (TF, lambda log: log.poses())]
)
def test_a_fault_of_a_converter_is_no_damage_of_the_log(
    kind: str, read: Callable[[RosLog], Iterator[Any]], monkeypatch: pytest.MonkeyPatch
) -> None:
    def convert(*given: Any) -> Any:
        return given[0].anlge_min

    known = message_types.TYPES[kind]
    faulty = known._replace(converts={known.role: convert})
    monkeypatch.setitem(message_types.TYPES, kind, faulty)
    message = ros_scan(ROS2, 5) if kind == SCAN else transforms(ROS2, 5, [("a", "b", 1.0)])
    channel = Channel("/it", kind, "cdr", count=1)
    log = RosLog(Memory([(channel, 7, serialise(message))]))

    with pytest.raises(AttributeError, match="anlge_min"):
        list(read(log))
    assert log.notes == []
