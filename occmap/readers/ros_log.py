"""A log of ROS messages: from the container, by way of decoding and conversion, to scans and poses.

The way of a message:

1. A source (`mcap`, `bag1`, `sqlite`) gives its channel, record time and bytes.
2. The channel's `_ChannelReader` decodes the bytes (`messages`) and converts what comes out
   (`message_types`).
3. Scans of one laser, and poses of one source, are laid out alike. So most are not read one by
   one, but gathered by channel and length and read many at once.
"""

from collections import Counter, defaultdict
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import partial
from operator import itemgetter
from pathlib import Path
from typing import Any, TypeAlias, TypeVar, cast

import numpy as np

from occmap.errors import DamageError, LogError, refuse_unreadable
from occmap.readers import DEFAULT_OPTIONS, Echo, Fix, Log, ReaderOptions, Role, Stream
from occmap.readers.cloud_messages import Camera, is_depth, read_camera, tell_clouds
from occmap.readers.containers import Buffer, Channel, Source
from occmap.readers.fields import get_frame
from occmap.readers.message_types import PACKETS, TYPES, UNUSED, MessageType, find_type
from occmap.readers.messages import make_parser
from occmap.types import Cloud, PoseBatch, PoseSample, Scan, ScanBatch

T = TypeVar("T")

CAMERA_INFO = "sensor_msgs/msg/CameraInfo"
read_frame = partial(get_frame, path="header.frame_id")
STACK_BYTES = 1 << 20
"""Messages are gathered until they are so long, and read together."""
MESSAGE_BYTES = 100
"""What a message that is held takes in memory beside its own bytes."""
SHORTEST_RUN = 64
"""Fewer scans are given one by one, to be stacked with others of their kind."""
_Held: TypeAlias = tuple[int, int, Buffer]
"""The number of a message in its log, when it was recorded (ns), and its bytes"""


class RosReader:
    """What readers of ROS messages share; each says how its container is opened."""

    open_source: Callable[[Path], Source]

    def open_tuned(self, path: Path, options: ReaderOptions = DEFAULT_OPTIONS) -> "RosLog":
        """Open a log; echoes and clouds become scans as the user chose.

        Raises
        ------
        LogError
            Nothing in it can be read.
        """
        return RosLog(self.open_source(path), options)

    open = open_tuned


class RosLog(Log):
    """Scans and poses of a container of ROS messages."""

    def __init__(self, source: Source, options: ReaderOptions = DEFAULT_OPTIONS) -> None:
        self.path, self.notes = source.path, source.notes
        self._source = source
        self._types: dict[Channel, MessageType] = {}
        for channel in source.channels:
            kind, name = find_type(channel), f"{channel.count} messages on {channel.topic}"
            if channel.count and kind is UNUSED and channel.kind in TYPES:
                found = f"{name} are {channel.type} in {channel.encoding!r}"
                self.notes.add_damage(f"{found}: they are not used")
            if channel.count and (node := PACKETS.get(channel.kind)):
                found = f"{name} are packets of a lidar"
                self.notes.add(f"{found}: record the clouds that {node} makes of them")
            if kind.needs:
                needed = options.echo if kind.needs is Echo else self._find_camera(channel)
                kind = kind.bind(needed) if needed else UNUSED
            self._types[channel] = kind

        counts: Counter[tuple[str, str, Role]] = Counter()
        for channel, kind in self._types.items():
            counts[channel.topic, channel.type, kind.role] += channel.count
        self.streams = [Stream(topic, kind, n, role) for (topic, kind, role), n in counts.items()]

    def stacked_poses(self) -> Iterator[PoseSample | PoseBatch]:
        """Every sample of every pose topic, many at once where messages are laid out alike."""
        return self._read(Role.POSE)

    def stacked_scans(self, topics: Collection[str]) -> Iterator[Scan | ScanBatch]:
        """The scans of these topics, many at once where one laser has many in a row."""
        return self._read(Role.SCAN, topics)

    def clouds(self, topics: Collection[str]) -> Iterator[Cloud]:
        """The clouds of points of these topics, in file order."""
        return tell_clouds(self._read(Role.CLOUD, topics), self.path, self.notes)

    def fixes(self) -> Iterator[Fix]:
        """The fixes of satellites, in file order."""
        return self._read(Role.OTHER)

    def _find_camera(self, channel: Channel) -> Camera | None:
        """Find the camera of images; None where they are not depths, or of no known camera."""
        if not channel.count or not self._take_first(channel, is_depth):
            return None
        place = channel.topic.removesuffix("/compressedDepth").rpartition("/")[0]
        name, frame = f"{place}/camera_info", self._take_first(channel, read_frame)
        infos = [each for each in self._source.channels if each.kind == CAMERA_INFO]
        for each in sorted(infos, key=lambda each: each.topic != name):
            is_same = bool(frame) and self._take_first(each, read_frame) == frame
            if (each.topic == name or is_same) and (camera := self._take_first(each, read_camera)):
                if each.topic != name:
                    self.notes.add(f"{channel.topic}: its camera is that of {each.topic}, by frame")
                return camera
        found = f"{channel.count} depth images on {channel.topic} are not used"
        missing = f"no CameraInfo comes on {name}, or anywhere with the frame {frame!r}"
        self.notes.add(f"{found}: {missing}; record it with them")
        return None

    def _take_first(self, channel: Channel, read: Callable[[Any], T]) -> T | None:
        """Read the first message of a channel that can be read."""
        with suppress(LogError), refuse_unreadable(self.path):
            reader = _ChannelReader(channel, UNUSED, lambda message, *_: read(message))
            for _, record_ns, data in self._source.messages({channel}):
                for found in reader.read(data, record_ns):
                    return cast(T, found)
        return None

    def _make_readers(self, role: Role, topics: Collection[str] | None) -> "_Readers":
        """Build a reader for each channel that has values of a role, on some topics or on all.

        What cannot be understood is noted and left out.
        """
        readers = {}
        for channel, kind in self._types.items():
            convert = kind.converts.get(role)
            if convert is None or (topics is not None and channel.topic not in topics):
                continue
            try:
                readers[channel] = _ChannelReader(channel, kind, convert)
            except LogError as error:
                found = error.placed(channel.topic)
                self.notes.add_damage(f"{found}: its {channel.count} messages are not used")
        return readers

    def _read(self, role: Role, topics: Collection[str] | None = None) -> Iterator[Any]:
        """Read the messages of a role, on some topics or on all; those laid out alike together.

        All but poses stay in file order, so that runs of scans of several lasers are split.
        """
        readers = self._make_readers(role, topics)
        for groups in self._gather(readers):
            found: list[tuple[int, Any]] = []
            for (channel, _), held in groups.items():
                reader = readers[channel]
                reader.messages += len(held)
                is_run = len(groups) == 1 and len(held) >= SHORTEST_RUN
                together, left = reader.read_together(held)
                for each in together:
                    parts = each.split() if isinstance(each, ScanBatch) and not is_run else [each]
                    found += zip((number for number, _, _ in held), parts, strict=False)
                for number, record_ns, data in left:
                    found += ((number, each) for each in reader.read(data, record_ns))
            yield from (each for _, each in sorted(found, key=itemgetter(0)))
        self._note_damage(readers)

    def _gather(self, readers: "_Readers") -> Iterator[Mapping[tuple[Channel, int], list[_Held]]]:
        """Gather messages by channel and length.

        Where none is read together with others, as clouds are not, each comes alone.
        """
        groups, size = defaultdict[tuple[Channel, int], list[_Held]](list), 0
        most = STACK_BYTES if any(each.read_many for each in readers.values()) else 0
        with refuse_unreadable(self.path):  # a disk that fails is an error with the log's name
            messages = self._source.messages(readers) if readers else ()
            for number, (channel, record_ns, data) in enumerate(messages):
                groups[channel, len(data)].append((number, record_ns, data))
                size += len(data) + MESSAGE_BYTES
                if size >= most:
                    yield groups
                    groups, size = defaultdict(list), 0
        yield groups

    def _note_damage(self, readers: "_Readers") -> None:
        """Say what of the messages was lost or damaged."""
        for channel, reader in readers.items():
            topic, announced = channel.topic, channel.count
            if reader.messages != announced:
                text = f"{reader.messages} messages are read on {topic}"
                self.notes.add_damage(f"{text}, where the log announces {announced}")
            if reader.uses_standard:
                text = f"the definition of {channel.type} on {topic} is damaged"
                self.notes.add_damage(f"{text}; the standard one is used")
            if reader.failures:
                text = f"{reader.failures} of {announced} messages on {topic} are damaged"
                self.notes.add_damage(f"{text} and not used: the first {reader.first_fault}")


class _ChannelReader:
    """Reads the messages of a channel by the log's own definition of their type.

    Where that cannot be understood, the standard definition stands in.
    """

    def __init__(self, channel: Channel, kind: MessageType, convert: Callable[..., Any]) -> None:
        self.messages = self.failures = 0
        self.uses_standard = False
        self.first_fault = ""
        self._channel, self._convert = channel, convert
        make = kind.parser or make_parser
        try:
            self._parser = make(channel)
        except LogError:
            if not channel.definition:
                raise
            self._parser = make(replace(channel, definition=""))
            self.uses_standard = True
        many, locate = kind.many, self._parser.locate
        self.read_many = partial(many, locate, self.decode) if many and locate else None
        """Reads messages of one length together, where that can be done"""

    def decode(self, data: Buffer, record_ns: int) -> list[Any]:
        """Decode and convert a message; raises DamageError."""
        try:
            message = self._parser.parse(memoryview(data))
        except self._parser.errors as error:
            found = f"is not a {self._channel.kind} ({type(error).__name__})"
            raise DamageError(found) from error
        made = self._convert(message, self._channel.topic, record_ns)
        return made if isinstance(made, list) else [made]

    def read(self, data: Buffer, record_ns: int) -> Sequence[Any]:
        """Read what a message holds. One that is damaged is counted, and gives nothing."""
        try:
            return self.decode(data, record_ns)
        except DamageError as error:
            self.failures += 1
            self.first_fault = self.first_fault or str(error)
        return ()

    def read_together(self, held: Sequence[_Held]) -> tuple[Sequence[Any], Sequence[_Held]]:
        """Read messages of one length; give what was read, and those to be read one by one.

        These are damaged or not alike, or there is only one.
        """
        if self.read_many and len(held) > 1:
            _, record_ns, texts = zip(*held, strict=True)
            rows = np.frombuffer(b"".join(texts), np.uint8).reshape(len(held), -1)
            with suppress(DamageError):  # of the first; one by one it is counted
                read, left = self.read_many(rows, np.array(record_ns))
                return read, [held[at] for at in np.flatnonzero(left).tolist()]
        return (), held


_Readers: TypeAlias = Mapping[Channel, _ChannelReader]
