"""A log of ROS messages, whatever container they lie in."""

import struct
from collections import Counter
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from pathlib import Path
from typing import TypeVar

from rosbags.serde import SerdeError

from occmap.errors import LogError
from occmap.readers import Note, Role, Stream
from occmap.readers.ros_decode import FromBytes, make_pose_reader, make_scan_reader
from occmap.readers.ros_source import Channel, RawMessage, Source, add_note
from occmap.types import PoseSample, Scan

T = TypeVar("T")

# What rosbags' decoders and the converters raise on bytes that are not what the type says.
_DECODE_ERRORS = (
    SerdeError,
    struct.error,
    AssertionError,
    AttributeError,
    ArithmeticError,
    LookupError,
    MemoryError,
    TypeError,
    ValueError,
)


class RosLog:
    """Scans and poses of a container of ROS messages."""

    path: Path
    notes: list[Note]

    def __init__(self, source: Source) -> None:
        self.path = source.path
        self.notes = source.notes
        self._source = source

    @property
    def streams(self) -> Sequence[Stream]:
        """Every topic, with the messages of all its publishers."""
        counts: Counter[tuple[str, str, Role]] = Counter()
        for channel in self._source.channels:
            counts[channel.topic, channel.type, channel.role] += channel.count
        return [Stream(topic, kind, n, role) for (topic, kind, role), n in counts.items()]

    def poses(self) -> Iterator[PoseSample]:
        """Every sample of every pose topic, in file order."""
        wanted = [channel for channel in self._source.channels if channel.role is Role.POSE]
        for samples in self._read(self._make_readers(wanted, make_pose_reader)):
            yield from samples

    def scans(self, topics: Collection[str]) -> Iterator[Scan]:
        """The scans of these topics, in file order."""
        wanted = [
            channel
            for channel in self._source.channels
            if channel.role is Role.SCAN and channel.topic in topics
        ]
        return self._read(self._make_readers(wanted, make_scan_reader))

    def _make_readers(
        self, channels: Collection[Channel], make: Callable[[Channel], FromBytes[T]]
    ) -> Mapping[Channel, FromBytes[T]]:
        """Build the reader of each channel; one that cannot be understood is noted and left out."""
        readers = {}
        for channel in channels:
            try:
                readers[channel] = make(channel)
            except LogError as error:
                add_note(self.notes, f"{error}: its {channel.count} messages are not used")
        return readers

    def _read(self, readers: Mapping[Channel, FromBytes[T]]) -> Iterator[T]:
        """Read messages, passing over those that are damaged."""
        failures: Counter[Channel] = Counter()
        for channel, record_ns, data in self._messages(readers):
            try:
                item = readers[channel](data, record_ns)
            except _DECODE_ERRORS:
                failures[channel] += 1
                continue
            yield item
        for channel, count in failures.items():
            add_note(
                self.notes,
                f"{count} of {channel.count} messages on {channel.topic} are damaged and not used",
            )

    def _messages(self, wanted: Collection[Channel]) -> Iterator[RawMessage]:
        """Give raw messages; a disk that fails is an error with the log's name."""
        if not wanted:
            return
        try:
            yield from self._source.messages(wanted)
        except OSError as error:
            raise LogError(f"cannot be read ({error.strerror})", where=self.path) from None
