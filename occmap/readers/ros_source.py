"""What every container of ROS messages gives: channels, and the raw messages of some of them."""

from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass
from operator import ne
from pathlib import Path
from typing import Protocol, TypeAlias

from occmap.readers import Note, Role
from occmap.readers.messages import TYPES, normalise_type
from occmap.readers.shapes import MessageType

SCAN_ROLES = frozenset({Role.SCAN, Role.CLOUD})
_MOST_LETTERS = 2
"""The name of a type may differ in this many letters from the one that is meant."""


@dataclass(frozen=True, eq=False, slots=True)
class Channel:
    """One publisher's messages on a topic. Compared by identity: two may look alike."""

    topic: str
    type: str
    """As recorded, in ROS 1 or ROS 2 form."""
    encoding: str
    """How messages are written as bytes; occmap reads cdr, ros1, json and protobuf."""
    definition: str = ""
    """The text of the message type and those it is made of, where the log holds it as ROS writes
    it; one in IDL is made by ROS of its own types, and these are read by what ROS has."""
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

    @property
    def known(self) -> MessageType | None:
        """How its messages are read, if at all: ROS and Foxglove each write in two ways."""
        encodings = {"cdr", "ros1"} if "/" in self.type else {"json", "protobuf"}
        return TYPES.get(self.kind) if self.encoding in encodings else None

    @property
    def role(self) -> Role:
        """What the messages can be used for."""
        return self.known.role if self.known else Role.OTHER

    @property
    def oddity(self) -> str:
        """What suggests that messages that are not used were meant to be; "" if nothing does.

        Damage to the name of a type, or of an encoding, leaves a file that is sound otherwise.
        """
        if self.known:
            return ""
        if self.kind in TYPES:
            return "which are written in a way that occmap does not know"
        if not (self.type.isascii() and self.type.isprintable()):
            return "which is not the name of a type"
        for known in TYPES:
            for name in (known, known.replace("/msg/", "/")):  # as ROS 2 and ROS 1 write it
                if len(name) == len(self.type) and sum(map(ne, name, self.type)) <= _MOST_LETTERS:
                    return f"which may be meant to be {name}"
        return ""


RawMessage: TypeAlias = tuple[Channel, int, memoryview]
"""A message as it lies in a log: its channel, when it was recorded (ns), and its bytes."""


class Source(Protocol):
    """A container of ROS messages."""

    path: Path
    notes: list[Note]

    @property
    def channels(self) -> Sequence[Channel]:
        """Every channel, also those that no map needs."""

    def messages(self, wanted: Collection[Channel]) -> Iterator[RawMessage]:
        """Give the messages of some channels, in file order."""

    def split(self, size: int) -> Sequence["Source"]:
        """Cut it into parts of about `size` bytes, as `occmap.readers.Splittable` says."""


def add_note(notes: list[Note], text: str) -> None:
    """Note damage."""
    notes.append(Note(text, damage=True))
