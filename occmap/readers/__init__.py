"""Readers: one file per log format, found through entry points and chosen by content.

A reader is a class with a `name`, a one-line `description`, a `recognises(probe)` and an
`open(path)` that returns a `Log`. Nothing here imports rosbags or mcap: a reader is loaded on use.
"""

import shlex
from collections.abc import Collection, Iterable, Iterator, Sequence
from contextlib import suppress
from copy import copy
from dataclasses import dataclass
from difflib import get_close_matches
from enum import StrEnum
from glob import has_magic
from pathlib import Path
from typing import Any, NamedTuple, Protocol, TypeVar, runtime_checkable

from occmap.errors import LogError
from occmap.plugins import list_plugins, load_plugin
from occmap.readers.gunzip import GUNZIP_ERRORS, MAGIC, gunzip
from occmap.readers.options import ReaderOptions
from occmap.types import PoseBatch, PoseSample, Scan, ScanRun

Whole = TypeVar("Whole")

PROBE_BYTES = 4096
SIMILAR = 0.85
"""How alike (0 to 1) a file must be named that is suggested for one that is not there."""
_MAP = "a map, not a log: `occmap diff` compares maps"
OTHER_FILES = {
    b"PK\x03\x04": ("an archive; if it is evidence (.npz), `occmap render` reads it", ""),
    b"P5": (_MAP, ""),
    b"image:": (_MAP, ""),
    b"\x89PNG": ("a picture, not a log: `occmap diff` compares maps", ""),
    b"version https://git-lfs": ("a Git LFS pointer, not the file", "fetch it: git lfs pull"),
    b"\x28\xb5\x2f\xfd": ("a file that zstd compressed", "decompress it first: unzstd PATH"),
}
"""What a file is, by how it begins, and what mends it; "": to give a log that occmap reads."""


class Role(StrEnum):
    """What a stream of messages can be used for."""

    SCAN = "scan"
    CLOUD = "cloud"
    """Points that can be flattened into scans: used where a log has no scans, or on request."""
    POSE = "pose"
    OTHER = "other"


@dataclass(frozen=True)
class Stream:
    """One topic of a log (or one kind of line): its name, message type and size."""

    topic: str
    """Name of the topic, or of the kind of line"""
    type: str
    """Message type"""
    count: int
    """Messages"""
    role: Role
    """What the topic can be used for"""


@dataclass(frozen=True)
class Probe:
    """What a reader may look at to say whether a path is its own."""

    path: Path
    raw: bytes
    """The first bytes of the file; empty for a directory."""
    content: bytes
    """The first bytes of the content, unpacked where the file is gzip."""


@dataclass(frozen=True)
class Note:
    """Something about a log that its user should know: lines passed over, a limit found, damage."""

    text: str
    """One sentence, without the path."""
    damage: bool = False
    """True: the log is not as its recorder meant it; `text` says where, and what is lost."""


class NoteList(list[Note]):
    """Notes, each once however often the log is read; a damaged log may give very many."""

    def __init__(self, notes: Iterable[Note] = ()) -> None:
        super().__init__(notes)
        self._known = set(self)

    def append(self, note: Note) -> None:
        """Add a note unless it is there."""
        if note not in self._known:
            super().append(note)
            self._known.add(note)


class Span(NamedTuple):
    """The bytes of a log that a part of it has: from the start on, and before the end."""

    start: int
    end: int


def make_part(whole: Whole, **fields: Any) -> Whole:
    """Copy a log, or a source of one, with some other fields and a list of notes of its own."""
    part = copy(whole)
    vars(part).update(fields, notes=NoteList(vars(whole)["notes"]))
    return part


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


@runtime_checkable
class StackingPoses(Protocol):
    """A log that can give poses many at once, where one by one takes long."""

    def stacked_poses(self) -> Iterator[PoseSample | PoseBatch]:
        """What `poses` gives, in any order.

        Samples of one frame in another stay in file order where their messages are of one length.
        """


@runtime_checkable
class StackingScans(Protocol):
    """A log that can give scans many at once."""

    def stacked_scans(self, topics: Collection[str]) -> Iterator[Scan | ScanRun]:
        """What `scans` gives, in the same order."""


@runtime_checkable
class Splittable(Protocol):
    """A log whose scans can be read in parts, each by another process."""

    def split(self, size: int) -> Sequence[Log]:
        """Cut the log into parts of about `size` bytes, in file order; each can be pickled.

        A part gives its own scans and, where these are damaged, notes. A log that cannot be cut is
        one part; where even that cannot be pickled, there is none.
        """


def split_log(log: Log, size: int) -> Sequence[Log]:
    """Cut a log into parts of about `size` bytes; none where its reader cannot."""
    return log.split(size) if isinstance(log, Splittable) else ()


def read_poses(log: Log) -> Iterator[PoseSample | PoseBatch]:
    """Every pose source of a log, in the way that is quickest for it."""
    return log.stacked_poses() if isinstance(log, StackingPoses) else log.poses()


def read_scans(log: Log, topics: Collection[str]) -> Iterator[Scan | ScanRun]:
    """The scans of some topics of a log, in the way that is quickest for it.

    A scan that names no topic is of the first: a reader of a format with one stream need not say.
    """
    if isinstance(log, StackingScans):
        return log.stacked_scans(topics)
    name = next(iter(topics), "")
    return (scan if scan.topic else scan._replace(topic=name) for scan in log.scans(topics))


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


@runtime_checkable
class TunableReader(Protocol):
    """A reader whose logs depend on what the user chose; `open` takes the defaults."""

    def open_tuned(self, path: Path, options: ReaderOptions) -> Log:
        """Open a log; raises what `open` does."""


DEFAULT_OPTIONS = ReaderOptions()


def probe_path(path: Path) -> Probe:
    """Read the first bytes of a file, and what gzip makes of them.

    Raises
    ------
    LogError
        The path does not exist or cannot be read.
    """
    try:
        if path.is_dir():
            return Probe(path, b"", b"")
        if path.exists() and not path.is_file():
            raise LogError("neither a file nor a folder", where=path, fix="save it to a file first")
        with path.open("rb") as file:
            raw = file.read(PROBE_BYTES)
    except FileNotFoundError:
        raise _miss(path) from None
    except OSError as error:
        raise LogError(f"cannot be read ({error.strerror})", where=path) from None
    return Probe(path, raw, _peek_gzip(path) if raw.startswith(MAGIC) else raw)


def _miss(path: Path) -> LogError:
    """Say that there is no such file, and which one may be meant."""
    if path.is_symlink():
        found = f"a link to {path.readlink()}, which is not there"
        return LogError(found, where=path, fix="mend the link, or give the log itself")
    if has_magic(str(path)):
        return LogError("no file matches", where=path, fix="check the pattern and its folder")
    there = []
    with suppress(OSError):
        there = [each.name for each in path.parent.iterdir()]
    close = get_close_matches(path.name, there, n=1, cutoff=SIMILAR)
    fix = f"did you mean {path.parent / close[0]}?" if close else "check the path"
    return LogError("no such file or directory", where=path, fix=fix)


def _peek_gzip(path: Path) -> bytes:
    """Decompress the start of a gzip file: as much as there is, where it is damaged."""
    content = b""
    with suppress(OSError, *GUNZIP_ERRORS), path.open("rb") as file:
        for piece in gunzip(file):
            content += piece
            if len(content) >= PROBE_BYTES:
                break
    return content[:PROBE_BYTES]


def load_readers() -> Iterator[tuple[str, Reader | None]]:
    """Load the readers one by one, as the later ones take longest; None: it cannot be loaded."""
    for entry in list_plugins("occmap.readers"):
        reader_class = load_plugin("occmap.readers", entry.name)
        yield entry.name, reader_class and reader_class()


def open_log(path: Path, options: ReaderOptions = DEFAULT_OPTIONS) -> Log:
    """Open a log with the first reader that recognises its content.

    Raises
    ------
    LogError
        The path cannot be read, or no reader knows what it is.
    """
    probe = probe_path(path)
    whole: list[str] = []
    broken: list[str] = []
    for name, reader in load_readers():
        (broken if reader is None else whole).append(name)
        if reader is not None and reader.recognises(probe):
            if isinstance(reader, TunableReader):
                return reader.open_tuned(path, options)
            return reader.open(path)
    lacking = f" ({', '.join(broken)} cannot be loaded)" if broken else ""
    raise _explain_unknown(probe, f"occmap reads {', '.join(whole)}{lacking}: see `occmap readers`")


def _explain_unknown(probe: Probe, otherwise: str) -> LogError:
    """Say what a path that no reader knows is, and what mends it; `otherwise` says what is read."""
    raw, content, fix = probe.raw, probe.content, ""
    if probe.path.is_dir():
        found = _describe_folder(probe.path)
    elif not raw:
        found = "the file is empty"
    elif not any(raw):
        found = f"the first {len(raw):,} bytes are zero, as a power cut leaves a file"
        fix = "take the log from where it was copied from"
    elif not content:
        found = "a gzip file with nothing in it that can be read"
    elif begins := [start for start in OTHER_FILES if content.startswith(start)]:
        found, fix = OTHER_FILES[begins[0]]
    elif content.isascii():
        first_line = content.decode("ascii").splitlines()[0][:60]
        found = f"a text file of no known log format: it starts with {first_line!r}"
    elif content is not raw:
        found, fix = "a file that gzip compressed", "decompress it first: gunzip PATH"
    else:
        found = f"not a known log format: it starts with the bytes {raw[:8].hex(' ')}"
    fix = fix.replace("PATH", shlex.quote(str(probe.path)))
    return LogError(found, where=probe.path, fix=fix or otherwise)


def _describe_folder(folder: Path) -> str:
    """Say what a folder that is not a recording holds."""
    try:
        names = sorted(entry.name for entry in folder.iterdir())
    except OSError as error:
        return f"a folder that cannot be read ({error.strerror})"
    return f"a folder that is not a recording: it holds {', '.join(names[:5]) or 'nothing'}"
