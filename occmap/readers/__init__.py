"""Readers: one file for each log format, found through entry points and chosen by content.

A reader is a class with a `name`, a one-line `description`, a `recognises(probe)` and an
`open(path)` that returns a `Log`. `text_log` has what logs of lines share (`carmen`, `csv`), and
`decimals` parses their numbers. `ros_log` says how a message becomes a scan, a pose or a cloud: one
of `mcap`, `bag1` (both walk over `records`) and `sqlite` finds it, `messages` decodes it, and
`message_types` and `cloud_messages` convert what `fields` finds in it. Nothing here imports rosbags
or mcap: a reader is loaded on use.

A probe holds the first bytes of a path, by which readers know it.
"""

import re
import zlib
from collections.abc import Collection, Iterable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from difflib import get_close_matches
from enum import StrEnum
from glob import has_magic
from pathlib import Path
from typing import Any, NamedTuple, Protocol, cast

from occmap import values
from occmap.choices import option
from occmap.errors import DamageError, LogError, name_log, refuse_unreadable
from occmap.plugins import OWN, list_plugins, load_plugin, load_plugins
from occmap.report import Note as Note
from occmap.report import NoteList as NoteList
from occmap.types import Cloud, Moments, PoseBatch, PoseSample, Recorded, Scan, ScanBatch

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
    with refuse_unreadable(path):
        if path.is_dir():
            return Probe(path, b"", b"")
        if not path.exists():
            raise _miss(path)
        if not path.is_file():
            raise LogError("no file and no folder", where=path, fix="pipe it: | occmap build -")
        with path.open("rb") as file:
            raw = file.read(PROBE_BYTES)
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
    if scheme := re.match(r"(\w{2,}):/", str(path)):
        fix = "leave out file://" if scheme[1] == "file" else "download it, and give that file"
        return LogError("an address, where a file or a folder belongs", where=path, fix=fix)
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
        with refuse_unreadable(probe.path):
            names = sorted(entry.name for entry in probe.path.iterdir())
        found = f"a folder that is not a recording: it holds {', '.join(names[:5]) or 'nothing'}"
    elif not raw:
        found = "the file is empty"
    elif not content:
        found = "a gzip file with nothing in it that can be read"
    elif (other := values.name_other(probe.path, content))[0]:
        found, fix = other
    elif content.isascii() and not values.NO_TEXT.search(content[: values.BINARY_WITHIN]):
        first_line = content.decode("ascii").splitlines()[0][:60]
        found = f"a text file of no known log format: it starts with {first_line!r}"
        names, _ = values.split_header(first_line, values.find_separator(first_line))
        fix = "if it holds poses alone, give it with `poses`" * {"x", "y"}.issubset(names)
        if values.ECHOED.match(first_line):
            fix = "if `ros2 topic echo` wrote it: record a bag, or give poses by `poses`"
    elif content is not raw:
        found, fix = values.name_other(probe.path, raw)
    else:
        found = f"not a known log format: it starts with the bytes {raw[:8].hex(' ')}"
    return LogError(found, where=probe.path, fix=fix or otherwise)


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


class Fix(NamedTuple):
    """Where satellites say that a receiver is."""

    stamp_ns: int
    frame: str
    latitude: float
    """Like the longitude in degrees (WGS 84)"""
    longitude: float


class Log:
    """An opened log. What it gives may be asked for again, and then begins at the start once more.

    A format says what `stacked_poses` and `stacked_scans` give (or `poses` and `scans`), or
    `clouds`; by default it is nothing. A plugin's log need not be one of these: it stands behind a
    `PluginLog`.
    """

    path: Path
    notes: NoteList
    """Grows while reading; a note appears once, however often the log is read."""
    streams: Sequence[Stream]
    """Every stream, also those that no map needs"""
    moments: Moments | None = None
    """Of a log of scans alone, whose order at least is known before they are read"""

    def stacked_poses(self) -> Iterator[PoseSample | PoseBatch]:
        """Every pose source of the log, many samples at once where one by one takes long.

        Samples of one frame in another stay in file order where their messages are of one length.
        """
        return iter(()) if type(self).poses is Log.poses else self.poses()

    def stacked_scans(self, topics: Collection[str]) -> Iterator[Scan | ScanBatch]:
        """The scans of some topics, in file order, many at once where one by one takes long."""
        return iter(()) if type(self).scans is Log.scans else self.scans(topics)

    def clouds(self, _topics: Collection[str]) -> Iterator[Cloud]:
        """The clouds of points of some topics, in file order."""
        return iter(())

    def fixes(self) -> Iterator[Fix]:
        """Every fix of satellites, in file order."""
        return iter(())

    def poses(self) -> Iterator[PoseSample]:
        """What `stacked_poses` gives, one at a time."""
        for each in self.stacked_poses():
            yield from each.split() if isinstance(each, PoseBatch) else (each,)

    def scans(self, topics: Collection[str]) -> Iterator[Scan]:
        """What `stacked_scans` gives, one at a time."""
        for each in self.stacked_scans(topics):
            yield from each.split() if isinstance(each, ScanBatch) else (each,)


class PluginLog(Log):
    """The log of a plugin: what it gives is checked.

    Whatever else a `Log` has it may have, too.
    """

    def __init__(self, log: Any) -> None:
        self._log = log
        self.moments = getattr(log, "moments", None)

    def __getattr__(self, name: str) -> Any:
        """Get its path, its streams, and the notes that it has now."""
        return getattr(self._log, name)

    def stacked_poses(self) -> Iterator[PoseSample | PoseBatch]:
        """Every pose source, many samples at once if the plugin can."""
        return self._take("poses", (PoseSample, PoseBatch))

    def stacked_scans(self, topics: Collection[str]) -> Iterator[Scan | ScanBatch]:
        """The scans, many at once if the plugin can.

        One that names no topic is of the first: a plugin for one stream need not say.
        """
        name = next(iter(topics), "")
        for each in self._take("scans", (Scan, ScanBatch), topics):
            is_named = isinstance(each, ScanBatch) or each.topic
            yield each if is_named else each._replace(topic=name)

    def clouds(self, topics: Collection[str]) -> Iterator[Cloud]:
        """The clouds, if it has any."""
        return self._take("clouds", (Cloud,), topics)

    def fixes(self) -> Iterator[Fix]:
        """The fixes, if it has any."""
        return self._take("fixes", (Fix,))

    def _take(self, what: str, kinds: tuple[type, ...], *topics: Collection[str]) -> Iterator[Any]:
        """Give what a plugin does; raises DamageError where that is of another kind."""
        one_by_one = getattr(self._log, what, lambda *_: ())
        with name_log(self.path):
            given = getattr(self._log, f"stacked_{what}", one_by_one)(*topics)
            name = kinds[0].__name__
            if not isinstance(given, Iterable):
                found = f"its reader gives {values.shorten(given)}"
                raise DamageError(f"{found} where some {name} belongs")
            for each in given:
                if not isinstance(each, kinds):
                    found = f"its reader gives {values.shorten(each)}"
                    raise DamageError(f"{found} where a {name} belongs")
                yield each


def read_recorded(log: Log, topics: Collection[str]) -> Iterator[Recorded]:
    """The scans of some topics of a log, or the clouds, in the way that is quickest for it."""
    has_clouds = any(each.topic in topics and each.role is Role.CLOUD for each in log.streams)
    return log.clouds(topics) if has_clouds else log.stacked_scans(topics)


class Reader(Protocol):
    """A log format.

    One whose logs depend on what the user chose has `open_tuned`, which takes `ReaderOptions`, too.
    """

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
    if (reader := find_reader(probe)) is None:
        loaded, broken = load_plugins("occmap.readers")
        lost = f" ({', '.join(each.name for each in broken)} cannot be loaded)" if broken else ""
        formats = f"occmap reads {', '.join(loaded)}{lost}: see `occmap readers`"
        raise explain_unknown(probe, formats)
    log = reader.open_tuned(path, options) if hasattr(reader, "open_tuned") else reader.open(path)
    if isinstance(log, Log) and type(log).__module__.startswith(OWN):
        return log
    needed = "path", "notes", "streams", "poses", "scans"
    if lacks := [name for name in needed if not hasattr(log, name)]:
        found = f"the reader {reader.name} gives {values.shorten(log)}, which has no {lacks[0]}"
        raise LogError(found, where=path, fix="a reader's `open` returns a `Log`: mend the plugin")
    return PluginLog(log)
