"""Readers: one file per log format, found through entry points and chosen by content.

A reader is a class with a `name`, a one-line `description`, a `recognises(probe)` and an
`open(path)` that returns a `Log`. Nothing here imports rosbags or mcap: a reader is loaded on use.
"""

import gzip
import zlib
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import Protocol

from occmap.errors import LogError
from occmap.plugins import load_plugins
from occmap.types import PoseSample, Scan

PROBE_BYTES = 4096


class Role(StrEnum):
    """What a stream of messages can be used for."""

    SCAN = "scan"
    POSE = "pose"
    OTHER = "other"


@dataclass(frozen=True)
class Stream:
    """One topic of a log (or one kind of line): its name, message type and size."""

    topic: str
    type: str
    count: int
    role: Role


@dataclass(frozen=True)
class Probe:
    """What a reader may look at to say whether a path is its own."""

    path: Path
    raw: bytes
    """The first bytes of the file; empty for a directory."""
    content: bytes
    """The same after gzip, where the file is gzip."""


@dataclass(frozen=True)
class Note:
    """Something about a log that its user should know: lines passed over, a limit found, damage."""

    text: str
    """One sentence, without the path."""
    damage: bool = False
    """True: something that the log should hold is lost; `text` says how much and where."""


class Log(Protocol):
    """An opened log. Both iterators may be called more than once and start at the beginning."""

    path: Path
    notes: list[Note]
    """Grows while reading; a note appears once, however often the log is read."""

    @property
    def streams(self) -> Sequence[Stream]:
        """Every stream, also those that no map needs."""

    def poses(self) -> Iterator[PoseSample]:
        """Every pose source of the log, in file order."""

    def scans(self, topics: Collection[str]) -> Iterator[Scan]:
        """The scans of these topics, in file order, one at a time."""


class Reader(Protocol):
    """A log format."""

    name: str
    description: str

    def recognises(self, probe: Probe) -> bool:
        """Whether the path is of this format, by content rather than by name."""

    def open(self, path: Path) -> Log:
        """Open a log.

        Raises
        ------
        LogError
            The file is of this format and cannot be read.
        """


def probe_path(path: Path) -> Probe:
    """Read the first bytes of a file, and what gzip makes of them.

    Raises
    ------
    LogError
        The path does not exist or cannot be read.
    """
    if path.is_dir():
        return Probe(path, b"", b"")
    try:
        with path.open("rb") as file:
            raw = file.read(PROBE_BYTES)
    except FileNotFoundError:
        raise LogError("no such file or directory", where=path, fix="check the path") from None
    except OSError as error:
        raise LogError(f"cannot be read ({error.strerror})", where=path) from None
    return Probe(path, raw, _peek_gzip(path) if raw.startswith(b"\x1f\x8b") else raw)


def _peek_gzip(path: Path) -> bytes:
    """Decompress the start of a gzip file: as much as there is, where it is damaged."""
    content = b""
    try:
        with gzip.open(path) as file:
            while len(content) < PROBE_BYTES and (byte := file.read1(PROBE_BYTES)):
                content += byte
    except (OSError, EOFError, zlib.error):
        pass
    return content


def load_readers() -> list[Reader]:
    """Load every installed reader that imports."""
    loaded, _ = load_plugins("occmap.readers")
    return [reader_class() for reader_class in loaded.values()]


def open_log(path: Path) -> Log:
    """Open a log with the first reader that recognises its content.

    Raises
    ------
    LogError
        The path cannot be read, or no reader knows what it is.
    """
    probe = probe_path(path)
    readers = load_readers()
    for reader in readers:
        if reader.recognises(probe):
            return reader.open(path)
    names = ", ".join(reader.name for reader in readers)
    raise LogError(
        _describe_unknown(probe), where=path, fix=f"occmap reads {names}: see `occmap readers`"
    )


def _describe_unknown(probe: Probe) -> str:
    """Say what a file that no reader knows looks like."""
    if probe.path.is_dir():
        names = sorted(entry.name for entry in probe.path.iterdir())
        listing = ", ".join(names[:5]) or "nothing"
        return f"a directory that is no recording: it holds {listing}"
    if not probe.raw:
        return "the file is empty"
    if probe.content.isascii():
        first_line = probe.content.decode("ascii").splitlines()[0][:60]
        return f"a text file of no known log format: it starts with {first_line!r}"
    return f"not a known log format: it starts with the bytes {probe.raw[:8].hex(' ')}"
