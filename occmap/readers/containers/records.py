"""What is said of the records of MCAP files and ROS 1 bags, and of blocks of them."""

from typing import NamedTuple, TypeAlias

from occmap.readers.containers.inflate import Buffer

NEVER_NS = 2**64 - 1
"""A time later than any: the last of a chunk that states none."""
DESCRIPTION, OTHER = -1, -2
"""Stand in place of a message's channel for a record that describes one, and for any other."""


class Record(NamedTuple):
    """A record of a file whose body is not yet read."""

    opcode: int
    """What kind of record it is"""
    position: int
    """In the file"""
    head: bytes
    """What lies before its body, with the length of the body in it"""
    length: int
    """Bytes of the body; of one that is cut, more than there are"""
    is_sure: bool = False
    """Whether the length cannot be wrong, so that it is the file that is too short"""

    @property
    def start(self) -> int:
        """Where its body begins."""
        return self.position + len(self.head)

    @property
    def end(self) -> int:
        """Where its body ends."""
        return self.start + self.length


class RecordBlock(NamedTuple):
    """Records that lie together: those of a chunk, or one that stands by itself."""

    position: int
    """In the file"""
    records: Buffer
    first_ns: int = 0
    last_ns: int = NEVER_NS
    """Between which times its messages were recorded, as the chunk states"""
    indexed: int = 0
    """How many messages the indexes after the chunk name; 0 where there are none"""


Inner: TypeAlias = tuple[int, int, int, int]
"""A record of a block: a message's channel, when it was recorded (ns), and where in the block the
message begins and the record ends; one that describes a channel is given from its start. A plain
tuple, since a log has tens of thousands."""

Descriptions: TypeAlias = dict[bytes, int]
"""Records that describe channels, each with the position of the chunk where it first lies."""
