"""A log of ROS messages, whatever container they lie in."""

from collections import Counter
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, Generic, TypeVar

from occmap.errors import DamageError, LogError, refuse_unreadable
from occmap.readers import DEFAULT_OPTIONS, Role, Stream
from occmap.readers.inflate import Buffer
from occmap.readers.options import ReaderOptions
from occmap.readers.ros_decode import FromBytes, make_reader
from occmap.readers.ros_source import Channel, RawMessage, Source, add_note
from occmap.readers.ros_stacks import Stacked, read_scan_run, read_transforms
from occmap.types import PoseBatch, PoseSample, Scan, ScanRun

T = TypeVar("T")

MESSAGE_BYTES = 100
"""What a message that is held takes in memory beside its own bytes."""
STACK_BYTES = 1 << 20
"""Messages of one channel and length are held until they take this much memory."""
MOST_KINDS = 32
"""Channels and lengths for which transforms are held at once; a log that has more is damaged."""
SHORTEST_RUN = 64
"""A run of fewer scans is read one by one, to be stacked with others of their kind."""


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
        self._options = options
        self.notes = source.notes
        self._source = source
        self._is_whole = True
        for channel in source.channels:
            if channel.count and (oddity := channel.oddity):
                found = f"{channel.count} messages on {channel.topic} are of {channel.type!r}"
                add_note(self.notes, f"{found}, {oddity}: they are not used")

    def split(self, size: int) -> Sequence["RosLog"]:
        """Cut the log into parts of about `size` bytes, as `occmap.readers.Splittable` says."""
        parts = [RosLog(part, self._options) for part in self._source.split(size)]
        for part in parts:
            part._is_whole = len(parts) == 1
        return parts

    @property
    def streams(self) -> Sequence[Stream]:
        """Every topic, with the messages of all its publishers."""
        counts: Counter[tuple[str, str, Role]] = Counter()
        for channel in self._source.channels:
            counts[channel.topic, channel.type, channel.role] += channel.count
        return [Stream(topic, kind, n, role) for (topic, kind, role), n in counts.items()]

    def poses(self) -> Iterator[PoseSample]:
        """Every sample of every pose topic, in file order."""
        for samples in self._read(self._make_pose_readers()):
            yield from samples

    def stacked_poses(self) -> Iterator[PoseSample | PoseBatch]:
        """Every sample, as `poses` gives them, but many messages of transforms at once."""
        for reader, stack in self._stack(self._make_pose_readers(), MOST_KINDS):
            yield from _read_stack(reader, stack)

    def scans(self, topics: Collection[str]) -> Iterator[Scan]:
        """The scans of these topics, in file order."""
        return self._read(self._make_scan_readers(topics))

    def stacked_scans(self, topics: Collection[str]) -> Iterator[Scan | ScanRun]:
        """The scans, as from `scans`, but many at once where one laser has many in a row."""
        for reader, run in self._stack(self._make_scan_readers(topics), 1):
            yield from _read_run(reader, run)

    def _make_pose_readers(self) -> dict[Channel, "_ChannelReader[list[PoseSample]]"]:
        return self._make_readers(
            (channel, channel.known.to_poses)
            for channel in self._source.channels
            if channel.known and channel.known.to_poses
        )

    def _make_scan_readers(self, topics: Collection[str]) -> dict[Channel, "_ChannelReader[Scan]"]:
        return self._make_readers(
            (channel, partial(channel.known.to_scan, self._options))
            for channel in self._source.channels
            if channel.topic in topics and channel.known and channel.known.to_scan
        )

    def _make_readers(
        self, wanted: Iterable[tuple[Channel, Callable[[Any, str, int], T]]]
    ) -> dict[Channel, "_ChannelReader[T]"]:
        """Build a reader for each channel; note and leave out what cannot be understood."""
        readers = {}
        for channel, convert in wanted:
            try:
                readers[channel] = _ChannelReader(channel, convert)
            except LogError as error:
                found = error.placed(channel.topic)
                add_note(self.notes, f"{found}: its {channel.count} messages are not used")
        return readers

    def _read(self, readers: Mapping[Channel, "_ChannelReader[T]"]) -> Iterator[T]:
        """Read messages one by one, passing over those that are damaged."""
        for channel, record_ns, data in self._messages(readers):
            yield from readers[channel].read_all([(data, record_ns)])
        self._note_damage(readers)

    def _stack(
        self, readers: Mapping[Channel, "_ChannelReader[T]"], most_kinds: int
    ) -> Iterator[tuple["_ChannelReader[T]", list[Stacked]]]:
        """Gather messages by channel and length, of at most `most_kinds` kinds at a time."""
        stacks: dict[tuple[Channel, int], list[Stacked]] = {}
        for channel, record_ns, data in self._messages(readers):
            key = channel, len(data)
            if key not in stacks and len(stacks) == most_kinds:
                yield from ((readers[kind], stack) for (kind, _), stack in stacks.items())
                stacks.clear()
            stack = stacks.setdefault(key, [])
            # Copied, so that the chunk of the file that it lies in need not be kept.
            stack.append((bytes(data), record_ns))
            if len(stack) * (len(data) + MESSAGE_BYTES) >= STACK_BYTES:
                yield readers[channel], stacks.pop(key)
        yield from ((readers[kind], stack) for (kind, _), stack in stacks.items())
        self._note_damage(readers)

    def _messages(self, readers: Mapping[Channel, "_ChannelReader[T]"]) -> Iterator[RawMessage]:
        """Give raw messages, and count them; a disk that fails is an error with the log's name."""
        if readers:
            with refuse_unreadable(self.path):
                for message in self._source.messages(readers):
                    readers[message[0]].messages += 1
                    yield message

    def _note_damage(self, readers: Mapping[Channel, "_ChannelReader[T]"]) -> None:
        """Say what of the messages was lost or damaged."""
        for channel, reader in readers.items():
            topic, announced = channel.topic, channel.count
            if self._is_whole and reader.messages != announced:
                text = f"{reader.messages} messages are read on {topic}"
                add_note(self.notes, f"{text}, where the log announces {announced}")
            if reader.uses_standard:
                text = f"the definition of {channel.type} on {topic} is damaged"
                add_note(self.notes, f"{text}; the standard one is used")
            if reader.failures:
                text = f"{reader.failures} of {announced} messages on {topic} are damaged"
                add_note(self.notes, f"{text} and not used")


class _ChannelReader(Generic[T]):
    """Reads the messages of a channel by the log's own definition of their type.

    Where that is damaged, the standard definition stands in; the first message that can be read
    decides between the two.
    """

    def __init__(self, channel: Channel, convert: Callable[[Any, str, int], T]) -> None:
        self.encoding = channel.encoding
        self.messages = self.failures = 0
        self.uses_standard = False
        standard = replace(channel, definition="")
        self._make_standard = (
            partial(make_reader, standard, convert) if channel.definition else None
        )
        """Builds what stands in, until one of the two could read a message"""
        try:
            self.decode, self.is_plain = make_reader(channel, convert)
        except LogError:
            if self._make_standard is None:
                raise
            self._use(*self._make_standard())

    def _use(self, standard: FromBytes[T], is_plain: bool) -> None:
        self.decode, self.is_plain = standard, is_plain
        self._make_standard, self.uses_standard = None, True

    def read_all(self, messages: Iterable[tuple[Buffer, int]]) -> Iterator[T]:
        """Read messages one by one; those that are damaged are counted and left out."""
        for data, record_ns in messages:
            item = self.read(data, record_ns)
            if item is not None:
                yield item

    def read(self, data: Buffer, record_ns: int) -> T | None:
        """Read a message. One that is damaged is counted, and gives None."""
        view = memoryview(data)
        with suppress(DamageError):
            item = self.decode(view, record_ns)
            self._make_standard = None
            return item
        if self._make_standard is not None:
            standard, is_plain = self._make_standard()
            with suppress(DamageError):
                item = standard(view, record_ns)
                self._use(standard, is_plain)
                return item
        self.failures += 1
        return None


def _read_run(reader: _ChannelReader[Scan], run: list[Stacked]) -> Iterator[Scan | ScanRun]:
    """Read scans all at once; one by one where they are few, or not all alike."""
    if reader.is_plain and len(run) >= SHORTEST_RUN:
        first = reader.read(*run[0])
        if first is not None:
            if scans := read_scan_run(run, reader.encoding, first):
                yield scans
                return
            yield first
        run = run[1:]
    yield from reader.read_all(run)


def _read_stack(
    reader: _ChannelReader[list[PoseSample]], stack: Sequence[Stacked]
) -> Iterator[PoseSample | PoseBatch]:
    """Read transforms all at once; one by one those that are damaged or like no other."""
    if reader.is_plain:
        with suppress(DamageError):
            batches, stack = read_transforms(stack, reader.encoding, reader.decode)
            yield from batches
    for samples in reader.read_all(stack):
        yield from samples
