"""Folders of ROS 2 bags, and any single file of a bag.

A folder has storage files (SQLite or MCAP, each perhaps zstd) and metadata.yaml, which a recorder
that died has not written: it is also read without.
"""

import re
import shutil
import tempfile
import weakref
from collections import Counter
from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

from ruamel.yaml import YAML
from ruamel.yaml.error import YAMLError

from occmap.errors import LogError, refuse_unreadable
from occmap.readers import NoteList, Probe, probe_path
from occmap.readers.bag1 import Bag1Source
from occmap.readers.containers import Channel, RawMessage, Source, inflate_message, unzip_file
from occmap.readers.mcap import McapSource
from occmap.readers.ros_log import RosReader
from occmap.readers.sqlite import SqliteSource
from occmap.types import Paths
from occmap.values import ZSTD_MAGIC

METADATA = "metadata.yaml"
_MOST_METADATA = 1 << 20
"""Characters of metadata.yaml that are read: a hundred times what recorders write."""
_BAD_METADATA = YAMLError, LookupError, TypeError, AttributeError, ValueError, RecursionError
"""What is raised where it is not as recorders write it"""
_STORAGE_NAME = re.compile(r".*\.(db3|mcap)(\.zstd)?")


def list_storage(folder: Path) -> list[Path]:
    """List the storage files of a folder, those of a split recording by their numbers."""
    named = (path for path in folder.iterdir() if _STORAGE_NAME.fullmatch(path.name))
    paths = (path for path in named if path.is_file())  # a pipe would be waited for
    return sorted(paths, key=lambda path: ([int(n) for n in re.findall(r"\d+", path.name)], path))


def refuse_mixed(folder: Path, files: Paths) -> None:
    """Refuse to read several recordings as one, where no metadata says what belongs together.

    Raises
    ------
    LogError
        The files are not those of one split recording, NAME_0.db3, NAME_1.db3 and so on.
    """
    names = [file.name.removesuffix(".zstd") for file in files]
    recordings = {re.sub(r"(_\d+)?(\.\w+)$", r"\2", name) for name in names}
    if len(recordings) > 1 or len(set(names)) < len(names):
        found = f"holds more than one recording and no {METADATA}"
        listed = ", ".join(file.name for file in files)
        fix = f"give one of them, such as {files[0]}"
        raise LogError(f"{found}: {listed}", where=folder, fix=fix)


class Bag2Source:
    """The channels and raw messages of a ROS 2 bag folder."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.notes = NoteList()
        self._scratch: Path | None = None
        with refuse_unreadable(path):
            names, announced = self._read_metadata()
            self._parts = self._open_parts(self._find_files(names))
        self._gather_notes()
        held = Counter[tuple[str, str]]()
        for channel in self.channels:
            held[channel.topic, channel.type] += channel.count
        for (topic, kind), count in announced.items():
            if (found := held[topic, kind]) != count:
                text = f"{METADATA} announces {count} messages of {kind} on {topic}"
                self.notes.add_damage(f"{text}, the files {found}")

    @property
    def channels(self) -> Sequence[Channel]:
        """Every channel of every storage file."""
        return [channel for part in self._parts for channel in part.channels]

    def messages(self, wanted: Collection[Channel]) -> Iterator[RawMessage]:
        """Give the messages of some channels, one storage file after the other."""
        for part in self._parts:
            if inner := [channel for channel in part.channels if channel in wanted]:
                for channel, at, data in part.messages(inner):
                    yield channel, at, inflate_message(data)
            self._gather_notes()

    def _find_files(self, names: Sequence[str]) -> list[Path]:
        """Find the storage files that the metadata names, or those that are there."""
        present = list_storage(self.path)
        there = [self.path / name for name in names if (self.path / name).is_file()]
        if len(there) < len(names):
            missing = ", ".join(name for name in names if self.path / name not in there)
            text = f"{METADATA} names files that are missing: {missing}"
            if not present:
                raise LogError(text, where=self.path, fix="copy them into this folder, too")
            self.notes.add_damage(text)
        if not there:
            refuse_mixed(self.path, present)
            return present
        # A player unpacks a .zstd beside it.
        known = {name.removesuffix(".zstd") for name in names}
        others = [each.name for each in present if each.name.removesuffix(".zstd") not in known]
        if others:
            text = f"{METADATA} does not name {', '.join(others)}: not read"
            self.notes.add_damage(f"{text}; move {METADATA} away to read all files")
        return there

    def _open_parts(self, files: Paths) -> list[Source]:
        """Open storage files; one that cannot be read is noted, unless there is no other."""
        parts: list[Source] = []
        for file in files:
            try:
                is_zipped = probe_path(file).raw.startswith(ZSTD_MAGIC)
                parts.append(open_file(self._unzip(file) if is_zipped else file))
            except LogError as error:
                if len(files) == 1:
                    raise
                self.notes.add_damage(f"{file.name} is not used: {error.found}")
        if not parts:
            raise LogError("no storage file in it can be read", where=self.path)
        return parts

    def _unzip(self, file: Path) -> Path:
        """Decompress a storage file into a folder that goes away with this object."""
        if self._scratch is None:
            self._scratch = Path(tempfile.mkdtemp(prefix="occmap-"))
            weakref.finalize(self, shutil.rmtree, self._scratch, ignore_errors=True)
        target = self._scratch / file.stem
        if problem := unzip_file(file, target):
            self.notes.add_damage(f"{file.name} {problem}")
        return target

    def _read_metadata(self) -> tuple[Sequence[str], Mapping[tuple[str, str], int]]:
        """Read what only metadata.yaml says: the files, and messages by topic and type.

        Where it is absent or damaged, the files speak for themselves. Every value is taken as
        text, so nothing in it can unfold.
        """
        path = self.path / METADATA
        if not path.is_file():
            return (), {}
        with path.open("rb") as file:
            content = file.read(_MOST_METADATA)
        try:
            document: Any = YAML(typ="base", pure=True).load(content.decode())
            information = document["rosbag2_bagfile_information"]
            # Old recorders wrote the folder's name before the file's.
            files = [Path(name).name for name in information["relative_file_paths"]]
            counts = Counter[tuple[str, str]]()
            for topic in information.get("topics_with_message_count") or ():
                described = topic["topic_metadata"]
                counts[described["name"], described["type"]] += int(topic["message_count"])
        except _BAD_METADATA:
            self.notes.add_damage(f"{METADATA} is damaged and not used")
            return (), {}
        return files, counts

    def _gather_notes(self) -> None:
        """Take over what the storage files had to say."""
        for part in self._parts:
            for note in part.notes:
                self.notes.add_damage(f"{part.path.name}: {note.text}")


def open_file(path: Path) -> Source:
    """Open a file by its content rather than by its name."""
    start = probe_path(path).raw
    for source in (McapSource, SqliteSource, Bag1Source):
        if start.startswith(source.magic):
            return source(path)
    raise LogError("neither SQLite nor MCAP" if start else "the file is empty", where=path)


class RosbagReader(RosReader):
    """Reads ROS 1 bags, and ROS 2 bags with SQLite or MCAP storage."""

    name = "rosbag"
    description = "ROS 1 .bag (none, bz2, lz4); ROS 2 folder or .db3 (SQLite, MCAP, zstd)"

    def recognises(self, probe: Probe) -> bool:
        """Say whether a file starts as bags do, or a folder holds storage files."""
        if probe.path.is_dir():
            with suppress(PermissionError):
                return (probe.path / METADATA).exists() or bool(list_storage(probe.path))
            return False
        return probe.raw.startswith((Bag1Source.magic, SqliteSource.magic))

    def open_source(self, path: Path) -> Source:
        """Open a folder or a file."""
        return Bag2Source(path) if path.is_dir() else open_file(path)
