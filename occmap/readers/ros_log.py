"""A log of ROS messages: from the container, by way of decoding and conversion, to scans and poses.

The way of a message:

1. A source (`mcap`, `bag1`, `sqlite`) gives its channel, record time and bytes.
2. The channel's `_ChannelReader` decodes the bytes (`messages`) and converts what comes out
   (`message_types`).
3. Scans of one laser, and transforms, are laid out alike. So most are not read one by one, but
   gathered by channel and length (`_stack`) and read many at once (`stacks`).
"""

from collections import Counter
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, Generic, TypeAlias, TypeVar

from occmap.errors import DamageError, LogError, refuse_unreadable
from occmap.readers import DEFAULT_OPTIONS, ReaderOptions, Role, Stream
from occmap.readers.cloud_messages import is_depth, read_camera, tell_clouds
from occmap.readers.containers import Buffer, Channel, RawMessage, Source
from occmap.readers.message_types import (
    PACKETS,
    TYPES,
    MessageType,
    Parse,
    ToCloud,
    ToDepth,
    ToScan,
    find_type,
)
from occmap.readers.messages import Stacked, make_reader, read_scan_run, read_transforms
from occmap.types import Cloud, PoseBatch, PoseSample, Scan, ScanRun

T = TypeVar("T")
Many = TypeVar("Many")
Convert: TypeAlias = Callable[[Any, str, int], list[T]]
"""From a decoded message, its topic and its record time in ns."""

MESSAGE_BYTES = 100
"""What a message that is held takes in memory beside its own bytes."""
STACK_BYTES = 1 << 20
"""Messages of one channel and length are held until they take this much memory."""
MOST_KINDS = 32
"""Channels and lengths for which transforms are held at once; a log that has more is damaged."""


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


class RosLog:
    """Scans and poses of a container of ROS messages."""

    def __init__(self, source: Source, options: ReaderOptions = DEFAULT_OPTIONS) -> None:
        self.path = source.path
        self.notes = source.notes
        self._options = options
        self._source = source
        self._types = {channel: find_type(channel) for channel in source.channels}
        for channel, kind in self._types.items():
            if channel.count and kind is None and channel.kind in TYPES:
                found = f"{channel.count} messages on {channel.topic} are {channel.type}"
                self.notes.add_damage(f"{found} in {channel.encoding!r}: they are not used")
            if channel.count and (node := PACKETS.get(channel.kind)):
                found = f"{channel.count} messages on {channel.topic} are packets of a lidar"
                self.notes.add(f"{found}: record the clouds that {node} makes of them")
            if kind and kind.to_depth:
                self._types[channel] = self._find_camera(channel, kind.to_depth)

    @property
    def streams(self) -> Sequence[Stream]:
        """Every topic, with the messages of all its publishers."""
        counts: Counter[tuple[str, str, Role]] = Counter()
        for channel, kind in self._types.items():
            counts[channel.topic, channel.type, kind.role if kind else Role.OTHER] += channel.count
        return [Stream(topic, kind, n, role) for (topic, kind, role), n in counts.items()]

    def poses(self) -> Iterator[PoseSample]:
        """Every sample of every pose topic, in file order."""
        return self._read(self._make_pose_readers())

    def stacked_poses(self) -> Iterator[PoseSample | PoseBatch]:
        """Every sample, as `poses` gives them, but many messages of transforms at once."""
        return self._read_stacked(self._make_pose_readers(), read_transforms, MOST_KINDS)

    def scans(self, topics: Collection[str]) -> Iterator[Scan]:
        """The scans of these topics, in file order."""
        return self._read(self._make_scan_readers(topics))

    def stacked_scans(self, topics: Collection[str]) -> Iterator[Scan | ScanRun]:
        """The scans, as from `scans`, but many at once where one laser has many in a row."""
        return self._read_stacked(self._make_scan_readers(topics), read_scan_run, 1)

    def _find_camera(self, channel: Channel, to_depth: ToDepth) -> MessageType | None:
        """Find how images become clouds; None where they are not depths, or of no known camera."""
        if not channel.count or not self._take_first(channel, is_depth):
            return None
        place = channel.topic.removesuffix("/compressedDepth").rpartition("/")[0]
        name = f"{place}/camera_info"
        infos = (each for each in self._source.channels if each.topic == name)
        cameras = (self._take_first(each, read_camera) for each in infos)
        camera = next((each for each in cameras if each), None)
        if camera is None:
            found = f"{channel.count} depth images on {channel.topic} are not used"
            self.notes.add(f"{found}: no CameraInfo comes on {name}; record it with them")
            return None
        return MessageType(Role.CLOUD, to_cloud=partial(to_depth, camera))

    def _take_first(self, channel: Channel, read: Callable[[Any], T]) -> T | None:
        """Read the first message of a channel that can be read."""
        with suppress(LogError), refuse_unreadable(self.path):
            reader = _ChannelReader(channel, lambda message, *_: [read(message)])
            for _, record_ns, data in self._source.messages({channel}):
                found: Sequence[T] = reader.read(data, record_ns)
                if found:
                    return found[0]
        return None

    def clouds(self, topics: Collection[str]) -> Iterator[Cloud]:
        """The clouds of points of these topics, in file order."""

        def make_convert(to_cloud: ToCloud) -> Convert[Cloud]:
            return lambda *message: [to_cloud(*message)]

        readers = self._make_readers(
            (channel, make_convert(kind.to_cloud))
            for channel, kind in self._types.items()
            if kind and kind.to_cloud and channel.topic in topics
        )
        return tell_clouds(self._read(readers), self.path, self.notes)

    def _make_pose_readers(self) -> "_Readers[PoseSample]":
        return self._make_readers(
            (channel, kind.to_poses)
            for channel, kind in self._types.items()
            if kind and kind.to_poses
        )

    def _make_scan_readers(self, topics: Collection[str]) -> "_Readers[Scan]":
        def make_convert(to_scan: ToScan) -> Convert[Scan]:
            return lambda *message: [to_scan(self._options, *message)]

        return self._make_readers(
            (channel, make_convert(kind.to_scan))
            for channel, kind in self._types.items()
            if kind and kind.to_scan and channel.topic in topics
        )

    def _make_readers(self, wanted: Iterable[tuple[Channel, Convert[T]]]) -> "_Readers[T]":
        """Build a reader for each channel; note and leave out what cannot be understood."""
        readers = {}
        for channel, convert in wanted:
            try:
                kind = self._types[channel]
                readers[channel] = _ChannelReader(channel, convert, kind and kind.parse)
            except LogError as error:
                found = error.placed(channel.topic)
                self.notes.add_damage(f"{found}: its {channel.count} messages are not used")
        return readers

    def _read(self, readers: "_Readers[T]") -> Iterator[T]:
        """Read messages one by one, passing over those that are damaged."""
        for channel, record_ns, data in self._messages(readers):
            yield from readers[channel].read(data, record_ns)
        self._note_damage(readers)

    def _read_stacked(
        self,
        readers: "_Readers[T]",
        read_alike: Callable[..., tuple[Sequence[Many], Sequence[Stacked]]],
        most_kinds: int,
    ) -> Iterator[T | Many]:
        """Read messages of one channel and length together, of `most_kinds` kinds at a time.

        `read_alike` gives what it read, and the messages that it leaves to be read one by one.
        """
        for channel, stack in self._stack(readers, most_kinds):
            yield from _read_stack(readers[channel], stack, read_alike)
        self._note_damage(readers)

    def _stack(
        self, readers: "_Readers[T]", most_kinds: int
    ) -> Iterator[tuple[Channel, Sequence[Stacked]]]:
        """Gather messages by channel and length."""
        stacks: dict[tuple[Channel, int], list[Stacked]] = {}
        for channel, record_ns, data in self._messages(readers):
            kind = channel, len(data)
            if kind not in stacks and len(stacks) == most_kinds:
                yield from ((of, stack) for (of, _), stack in stacks.items())
                stacks.clear()
            stack = stacks.setdefault(kind, [])
            # Copied, so that the chunk of the file that it lies in need not be kept.
            stack.append((bytes(data), record_ns))
            if len(stack) * (len(data) + MESSAGE_BYTES) >= STACK_BYTES:
                yield channel, stacks.pop(kind)
        yield from ((of, stack) for (of, _), stack in stacks.items())

    def _messages(self, readers: "_Readers[T]") -> Iterator[RawMessage]:
        """Give raw messages, and count them; a disk that fails is an error with the log's name."""
        if readers:
            with refuse_unreadable(self.path):
                for message in self._source.messages(readers):
                    readers[message[0]].messages += 1
                    yield message

    def _note_damage(self, readers: "_Readers[T]") -> None:
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
                self.notes.add_damage(f"{text} and not used")


class _ChannelReader(Generic[T]):
    """Reads the messages of a channel by the log's own definition of their type.

    Where that is damaged, the standard definition stands in; the first message that can be read
    decides between the two.
    """

    def __init__(self, channel: Channel, convert: Convert[T], parse: Parse | None = None) -> None:
        self.encoding = channel.encoding
        self.messages = self.failures = 0
        self.uses_standard = False
        self._is_settled = not channel.definition
        self._make_standard = partial(make_reader, replace(channel, definition=""), convert, parse)
        try:
            self.decode, self.is_plain = make_reader(channel, convert, parse)
        except LogError:
            if self._is_settled:
                raise
            self.decode, self.is_plain = self._make_standard()
            self._is_settled = self.uses_standard = True

    def read(self, data: Buffer, record_ns: int) -> Sequence[T]:
        """Read what a message holds. One that is damaged is counted, and gives nothing."""
        view = memoryview(data)
        with suppress(DamageError):
            items = self.decode(view, record_ns)
            self._is_settled = True
            return items
        if not self._is_settled:
            standard, is_plain = self._make_standard()
            with suppress(DamageError):
                items = standard(view, record_ns)
                self.decode, self.is_plain = standard, is_plain
                self._is_settled = self.uses_standard = True
                return items
        self.failures += 1
        return ()


_Readers: TypeAlias = Mapping[Channel, _ChannelReader[T]]


def _read_stack(
    reader: _ChannelReader[T],
    stack: Sequence[Stacked],
    read_alike: Callable[..., tuple[Sequence[Many], Sequence[Stacked]]],
) -> Iterator[T | Many]:
    """Read messages of one length together; one by one those that are damaged or not alike."""
    if reader.is_plain:
        with suppress(DamageError):  # of the first; one by one it is counted
            together, stack = read_alike(stack, reader.encoding, reader.decode)
            yield from together
    for data, record_ns in stack:
        yield from reader.read(data, record_ns)
