"""Readers: one file for each log format, found through entry points and chosen by content.

A reader is a class with a `name`, a one-line `description`, a `recognises(probe)` and an
`open(path)` that returns a `Log`. `text_log` lists the way of a line and `ros_log` that of a
message, from the file to a scan or a pose. Nothing here imports rosbags or mcap: a reader is loaded
on use.

A probe holds the first bytes of a path, by which readers know it.
"""

import shlex
import zlib
from collections.abc import Collection, Iterator, MutableSequence, Sequence
from contextlib import suppress
from dataclasses import dataclass
from difflib import get_close_matches
from enum import StrEnum
from glob import has_magic
from pathlib import Path
from typing import NamedTuple, Protocol, cast, runtime_checkable

from occmap.choices import option
from occmap.errors import DamageError, LogError, name_log
from occmap.plugins import list_plugins, load_plugin, load_plugins
from occmap.report import Note as Note
from occmap.report import NoteList as NoteList
from occmap.types import Cloud, Moments, PoseBatch, PoseSample, Recorded, Scan, ScanRun
from occmap.values import ZSTD_MAGIC as ZSTD_MAGIC
from occmap.values import find_separator, name_other, shorten, split_header

GZIP_MAGIC = b"\x1f\x8b"

_GZIP_BITS = 31
"""zlib's code for gzip with its header and checksum."""
PROBE_BYTES = 4096
SIMILAR = 0.85
"""How alike (0 to 1) a file must be named that is suggested for one that is not there."""


@dataclass(frozen=True)
class Probe:
    """What a reader may look at to say whether a path is its own."""

    path: Path
    raw: bytes
    """The first bytes of the file; empty for a directory."""
    content: bytes
    """The first bytes of the content, unpacked where the file is gzip."""

    @property
    def lines(self) -> list[str]:
        """The first lines; the probe may end within the last.

        Where a zero byte follows, as in what is no text, or as a crash leaves it, a line ends.
        """
        text, zero, _ = self.content.partition(b"\0")
        text = text[: text.rfind(b"\n") + 1] if zero else text
        return text.decode("utf-8-sig", "replace").splitlines()


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
            raise LogError("no file and no folder", where=path, fix="pipe it: | occmap build -")
        with path.open("rb") as file:
            raw = file.read(PROBE_BYTES)
    except FileNotFoundError:
        raise _miss(path) from None
    except OSError as error:
        raise LogError(f"cannot be read ({error.strerror})", where=path) from None
    content = raw
    if raw.startswith(GZIP_MAGIC):
        content = b""
        with suppress(zlib.error):
            content = zlib.decompressobj(_GZIP_BITS).decompress(raw, PROBE_BYTES)
    return Probe(path, raw, content)


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


def explain_unknown(probe: Probe, otherwise: str) -> LogError:
    """Say what a path that no reader knows is, and what mends it; `otherwise` says what is read."""
    raw, content, fix = probe.raw, probe.content, ""
    if probe.path.is_dir():
        found = _describe_folder(probe.path)
    elif not raw:
        found = "the file is empty"
    elif not content:
        found = "a gzip file with nothing in it that can be read"
    elif (other := name_other(probe.path, content))[0]:
        found, fix = other
    elif content.isascii():
        first_line = content.decode("ascii").splitlines()[0][:60]
        found = f"a text file of no known log format: it starts with {first_line!r}"
        names, _ = split_header(first_line, find_separator(first_line))
        fix = "if it holds poses alone, give it with `poses`" * {"x", "y"}.issubset(names)
    elif content is not raw:
        found = "a file that gzip compressed"
        fix = f"decompress it first: gunzip {shlex.quote(str(probe.path))}"
    else:
        found = f"not a known log format: it starts with the bytes {raw[:8].hex(' ')}"
    return LogError(found, where=probe.path, fix=fix or otherwise)


def _describe_folder(folder: Path) -> str:
    """Say what a folder that is not a recording holds."""
    try:
        names = sorted(entry.name for entry in folder.iterdir())
    except OSError as error:
        return f"a folder that cannot be read ({error.strerror})"
    return f"a folder that is not a recording: it holds {', '.join(names[:5]) or 'nothing'}"


class Echo(StrEnum):
    """Which return of a beam to take where a laser states several."""

    FIRST = "first"
    """The nearest thing: glass, rain, leaves."""
    LAST = "last"
    """What stands behind it."""


@dataclass(frozen=True, slots=True)
class ReaderOptions:
    """What a user may choose: how messages that are not plain scans become scans."""

    echo: Echo = option(Echo.FIRST, "MultiEchoLaserScan: the echo of a beam that counts.")


DEFAULT_OPTIONS = ReaderOptions()


class Role(StrEnum):
    """What a stream of messages can be used for."""

    SCAN = "scan"
    CLOUD = "cloud"
    """Clouds of points: used where a log has no scans, or on request."""
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


class Log(Protocol):
    """An opened log. Both iterators may be called more than once and start at the beginning."""

    path: Path

    @property
    def notes(self) -> MutableSequence[Note]:
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
class Counting(Protocol):
    """A log of scans alone, whose order at least is known before they are read."""

    moments: Moments


@runtime_checkable
class HoldingClouds(Protocol):
    """A log that may hold clouds of points, on topics of their own."""

    def clouds(self, topics: Collection[str]) -> Iterator[Cloud]:
        """The clouds of these topics, in file order, one at a time."""


class Fix(NamedTuple):
    """Where satellites say that a receiver is."""

    stamp_ns: int
    frame: str
    latitude: float
    """Like the longitude in degrees (WGS 84)"""
    longitude: float


@runtime_checkable
class HoldingFixes(Protocol):
    """A log that may hold fixes of satellites."""

    def fixes(self) -> Iterator[Fix]:
        """All of them, in file order."""


def read_poses(log: Log) -> Iterator[PoseSample | PoseBatch]:
    """Every pose source of a log, in the way that is quickest for it."""
    with name_log(log.path):
        yield from log.stacked_poses() if isinstance(log, StackingPoses) else log.poses()


def read_recorded(log: Log, topics: Collection[str]) -> Iterator[Recorded]:
    """The scans of some topics of a log, or the clouds, in the way that is quickest for it."""
    has_clouds = any(each.topic in topics and each.role is Role.CLOUD for each in log.streams)
    if has_clouds and isinstance(log, HoldingClouds):
        return log.clouds(topics)
    return read_scans(log, topics)


def read_scans(log: Log, topics: Collection[str]) -> Iterator[Scan | ScanRun]:
    """The scans of some topics of a log, in the way that is quickest for it."""
    if isinstance(log, StackingScans):
        return log.stacked_scans(topics)
    return read_singly(log, topics)


def read_singly(log: Log, topics: Collection[str]) -> Iterator[Scan]:
    """The scans of some topics of a log, one at a time.

    A scan that names no topic is of the first: a reader of a format with one stream need not say.

    Raises
    ------
    DamageError
        A plugin gives what is no scan.
    """
    name = next(iter(topics), "")
    with name_log(log.path):
        for scan in log.scans(topics):
            if not isinstance(scan, Scan):
                raise DamageError(f"its reader gives {shorten(scan)} where a Scan belongs")
            yield scan if scan.topic else scan._replace(topic=name)


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


def find_reader(probe: Probe) -> Reader | None:
    """Find the reader that recognises a path; they are loaded one by one, the quick ones first."""
    for entry in list_plugins("occmap.readers"):
        reader_class = load_plugin("occmap.readers", entry.name)
        if reader_class and (reader := reader_class()).recognises(probe):
            return cast(Reader, reader)
    return None


def open_log(path: Path, options: ReaderOptions = DEFAULT_OPTIONS) -> Log:
    """Open a log with the first reader that recognises its content.

    Raises
    ------
    LogError
        The path cannot be read, or no reader knows what it is.
    """
    probe = probe_path(path)
    reader = find_reader(probe)
    if reader is None:
        loaded, broken = load_plugins("occmap.readers")
        lost = f" ({', '.join(each.name for each in broken)} cannot be loaded)" if broken else ""
        raise explain_unknown(
            probe, f"occmap reads {', '.join(loaded)}{lost}: see `occmap readers`"
        )
    if isinstance(reader, TunableReader):
        return reader.open_tuned(path, options)
    log = reader.open(path)
    needed = "path", "notes", "streams", "poses", "scans"
    if lacks := [name for name in needed if not hasattr(log, name)]:
        found = f"the reader {reader.name} gives {shorten(log)}, which has no {lacks[0]}"
        raise LogError(found, where=path, fix="a reader's `open` returns a `Log`: mend the plugin")
    return log
