"""A log of ROS messages, whatever container they lie in."""

from collections import Counter
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import partial
from itertools import groupby, islice
from pathlib import Path
from typing import Generic, TypeVar

from occmap.errors import DamageError, LogError
from occmap.readers import DEFAULT_OPTIONS, Note, Role, Stream
from occmap.readers.options import ReaderOptions
from occmap.readers.ros_decode import (
    FromBytes,
    is_laid_out_plainly,
    make_pose_reader,
    make_scan_reader,
)
from occmap.readers.ros_source import Channel, RawMessage, Source, SplittableSource, add_note
from occmap.readers.ros_stacks import Stacked, read_scan_run, read_transforms
from occmap.types import PoseBatch, PoseSample, Scan, ScanRun

T = TypeVar("T")


class RosReader:
    """What readers of ROS messages share; each says how its container is opened."""

    open_source: Callable[[Path], Source]

    def open(self, path: Path) -> "RosLog":
        """Open a log.

        Raises
        ------
        LogError
            Nothing in it can be read.
        """
        return self.open_tuned(path, DEFAULT_OPTIONS)

    def open_tuned(self, path: Path, options: ReaderOptions) -> "RosLog":
        """Open a log; echoes and clouds become scans as the user chose. Raises what `open` does."""
        return RosLog(self.open_source(path), options)


MESSAGE_BYTES = 100
"""What a message that is held takes in memory beside its own bytes."""
STACK_BYTES = 1 << 19
"""Transforms of one channel and length are held until they take this much memory."""
MOST_STACKS = 64
"""Channels and lengths for which transforms are held at most; more of them are damage."""
RUN_BYTES = 1 << 20
"""Scans of one channel and length that follow one another are held up to this much memory."""
SHORTEST_RUN = 64
"""A run of fewer scans is read one by one, to be stacked with others of their kind."""


class RosLog:
    """Scans and poses of a container of ROS messages."""

    path: Path
    notes: list[Note]

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
        if not isinstance(self._source, SplittableSource):
            return ()
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
        readers = self._make_pose_readers()
        stacks: dict[tuple[Channel, int], list[Stacked]] = {}
        for channel, record_ns, data in self._messages(readers):
            key = channel, len(data)
            if not (readers[channel].plain and (key in stacks or len(stacks) < MOST_STACKS)):
                yield from readers[channel].read(data, record_ns) or ()
                continue
            stack = stacks.setdefault(key, [])
            stack.append((bytes(data), record_ns))
            if len(stack) * (len(data) + MESSAGE_BYTES) >= STACK_BYTES:
                yield from _read_stack(stacks.pop(key), channel, readers[channel])
        for (channel, _), stack in stacks.items():
            yield from _read_stack(stack, channel, readers[channel])
        self._note_damage(readers)

    def scans(self, topics: Collection[str]) -> Iterator[Scan]:
        """The scans of these topics, in file order."""
        return self._read(self._make_scan_readers(topics))

    def stacked_scans(self, topics: Collection[str]) -> Iterator[Scan | ScanRun]:
        """The scans, as `scans` gives them, but many at once where one laser follows on itself."""
        readers = self._make_scan_readers(topics)
        for (channel, length), messages in groupby(self._messages(readers), _find_kind):
            reader = readers[channel]
            if not reader.plain:
                yield from reader.read_all((data, record_ns) for _, record_ns, data in messages)
                continue
            # Copied, so that the chunks of the file that they lie in need not be kept.
            copies = ((bytes(data), record_ns) for _, record_ns, data in messages)
            while run := list(islice(copies, 1 + RUN_BYTES // (length + MESSAGE_BYTES))):
                yield from _read_run(run, channel, reader)
        self._note_damage(readers)

    def _make_pose_readers(self) -> Mapping[Channel, "_ChannelReader[list[PoseSample]]"]:
        wanted = [channel for channel in self._source.channels if channel.has_poses]
        return self._make_readers(wanted, make_pose_reader)

    def _make_scan_readers(
        self, topics: Collection[str]
    ) -> Mapping[Channel, "_ChannelReader[Scan]"]:
        wanted = [
            channel
            for channel in self._source.channels
            if channel.role in {Role.SCAN, Role.CLOUD} and channel.topic in topics
        ]
        make = partial(make_scan_reader, options=self._options)
        return self._make_readers(wanted, make)

    def _make_readers(
        self, channels: Collection[Channel], make: Callable[[Channel], FromBytes[T]]
    ) -> Mapping[Channel, "_ChannelReader[T]"]:
        """Build a reader for each channel; note and leave out what cannot be understood."""
        readers = {}
        for channel in channels:
            try:
                readers[channel] = _ChannelReader(channel, make)
            except LogError as error:
                add_note(self.notes, f"{error}: its {channel.count} messages are not used")
        return readers

    def _read(self, readers: Mapping[Channel, "_ChannelReader[T]"]) -> Iterator[T]:
        """Read messages, passing over those that are damaged."""
        for channel, record_ns, data in self._messages(readers):
            item = readers[channel].read(data, record_ns)
            if item is not None:
                yield item
        self._note_damage(readers)

    def _note_damage(self, readers: Mapping[Channel, "_ChannelReader[T]"]) -> None:
        for reader in readers.values():
            for text in reader.list_damage():
                add_note(self.notes, text)

    def _messages(self, wanted: Collection[Channel]) -> Iterator[RawMessage]:
        """Give raw messages, and note where they are not as many as the log announces.

        A disk that fails is an error with the log's name.
        """
        if not wanted:
            return
        counts = dict.fromkeys(wanted, 0)
        try:
            for message in self._source.messages(wanted):
                counts[message[0]] += 1
                yield message
        except OSError as error:
            raise LogError(f"cannot be read ({error.strerror})", where=self.path) from None
        for channel, count in counts.items():
            if self._is_whole and count != channel.count:
                add_note(
                    self.notes,
                    f"{count} messages are read on {channel.topic},"
                    f" where the log announces {channel.count}",
                )


class _ChannelReader(Generic[T]):
    """Reads the messages of a channel by the log's own definition of their type.

    Where that is damaged, the standard definition stands in; the first message that can be read
    decides between the two.
    """

    def __init__(self, channel: Channel, make: Callable[[Channel], FromBytes[T]]) -> None:
        self._channel = channel
        self.plain = is_laid_out_plainly(channel)
        self._make = make
        self._failures = 0
        self._decided = not channel.definition
        self._uses_standard = False
        try:
            self.decode = make(channel)
        except LogError:
            if self._decided or (standard := self._make_standard()) is None:
                raise
            self.decode, self._decided, self._uses_standard = standard, True, True

    def read_all(self, messages: Iterable[tuple[memoryview, int]]) -> Iterator[T]:
        """Read messages one by one, passing over those that are damaged."""
        items = (self.read(data, record_ns) for data, record_ns in messages)
        return (item for item in items if item is not None)

    def read(self, data: memoryview, record_ns: int) -> T | None:
        """Read a message. One that is damaged is counted, and gives None."""
        try:
            item: T | None = self.decode(data, record_ns)
        except DamageError:
            item = None if self._decided else self._read_by_standard(data, record_ns)
            self._failures += item is None
            return item
        self._decided = True
        return item

    def _read_by_standard(self, data: memoryview, record_ns: int) -> T | None:
        """Try the standard definition on a message that the log's own definition does not fit."""
        standard = self._make_standard()
        if standard is None:
            return None
        try:
            item = standard(data, record_ns)
        except DamageError:
            return None
        self.decode, self._decided, self._uses_standard = standard, True, True
        return item

    def _make_standard(self) -> FromBytes[T] | None:
        with suppress(LogError):
            return self._make(replace(self._channel, definition="", syntax=""))
        return None

    def list_damage(self) -> Iterator[str]:
        """Say in a sentence each what was damaged so far."""
        topic, count = self._channel.topic, self._channel.count
        if self._uses_standard:
            kind = self._channel.type
            yield f"the definition of {kind} on {topic} is damaged; the standard one is used"
        if self._failures:
            yield f"{self._failures} of {count} messages on {topic} are damaged and not used"


def _find_kind(message: RawMessage) -> tuple[Channel, int]:
    """Find what messages that are read at once have in common: channel and length."""
    return message[0], len(message[2])


def _read_run(
    run: list[Stacked], channel: Channel, reader: _ChannelReader[Scan]
) -> Iterator[Scan | ScanRun]:
    """Read scans all at once; one by one where they are few, or not all alike."""
    messages = [(memoryview(data), record_ns) for data, record_ns in run]
    first = reader.read(*messages[0])
    if first is not None:
        if len(run) >= SHORTEST_RUN and (scans := read_scan_run(run, channel.encoding, first)):
            yield scans
            return
        yield first
    yield from reader.read_all(messages[1:])


def _read_stack(
    stack: list[Stacked], channel: Channel, reader: _ChannelReader[list[PoseSample]]
) -> Iterator[PoseSample | PoseBatch]:
    """Read transforms all at once; one by one those that are damaged or like no other."""
    try:
        batches, others = read_transforms(stack, channel.encoding, reader.decode)
    except DamageError:
        batches, others = [], stack
    yield from batches
    for data, record_ns in others:
        yield from reader.read(memoryview(data), record_ns) or ()
