"""What every container of ROS messages gives: channels, and the raw messages of some of them."""

from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol, TypeAlias

from occmap.readers import NoteList


def normalise_type(name: str) -> str:
    """Bring a message type to its ROS 2 form: `tf/tfMessage` becomes `tf/msg/tfMessage`."""
    package, slash, base = name.rpartition("/")
    return f"{package}/msg/{base}" if slash and not package.endswith("/msg") else name


@dataclass(frozen=True, eq=False, slots=True)
class Channel:
    """One publisher's messages on a topic. Compared by identity: two may look alike."""

    topic: str
    type: str
    """As recorded, in ROS 1 or ROS 2 form."""
    encoding: str
    """How messages are written as bytes; occmap reads cdr, ros1, json and protobuf."""
    definition: str = ""
    """The message type and those that it is made of, in the text that ROS writes; empty where the
    log has none, or has it in IDL, which ROS makes of types of its own: these are known anyway."""
    count: int = 0
    """Messages in the log."""
    descriptors: bytes = b""
    """The protobuf FileDescriptorSet of the type, where `encoding` is "protobuf"."""

    @property
    def description(self) -> tuple[str, str, str, str, bytes]:
        """The fields that must be equal where a log describes a channel twice."""
        return self.topic, self.type, self.encoding, self.definition, self.descriptors

    @property
    def kind(self) -> str:
        """The type in its ROS 2 form."""
        return normalise_type(self.type)


RawMessage: TypeAlias = tuple[Channel, int, memoryview]
"""A message as it lies in a log: its channel, when it was recorded (ns), and its bytes."""


class Source(Protocol):
    """A container of ROS messages."""

    path: Path
    notes: NoteList

    @property
    def channels(self) -> Sequence[Channel]:
        """Every channel, also those that no map needs."""

    def messages(self, wanted: Collection[Channel]) -> Iterator[RawMessage]:
        """Give the messages of some channels, in file order."""
