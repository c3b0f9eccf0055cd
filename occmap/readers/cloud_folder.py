"""Reads folders of clouds, a file for each, as KISS-ICP, glim and KITTI leave them behind.

Their times stand in their names, or else only their order is known: then the poses of a trajectory
are those of the files, one by one.
"""

import re
from collections.abc import Collection, Iterator, Sequence
from pathlib import Path

import numpy as np

from occmap.errors import DamageError, refuse_unreadable
from occmap.readers import NoteList, Role, Stream
from occmap.readers.cloud_files import READERS, read_cloud
from occmap.readers.cloud_messages import make_cloud
from occmap.readers.probing import Probe
from occmap.types import Cloud, Moments, PoseSample, Scan
from occmap.values import as_stamp

TOPIC, FRAME = "clouds", "lidar"
SPACING_NS = 1_500_000_000
"""Between clouds whose times are not known: where one of them has no pose, the gap is longer than
any that poses are interpolated over by default."""
_SECONDS = re.compile(r"(?<!\d)(\d{9,10})[._](\d{1,9})$")
_WHOLE = re.compile(r"(?<!\d)(\d{13}|\d{16}|\d{19})$")
"""How names end that state a time: in s, or as a whole number of ms, us or ns"""
_DIGITS = re.compile(r"(\d+)")


class CloudFolderReader:
    """Folders of clouds."""

    name = "clouds"
    description = "a folder of clouds, a file each (.pcd, .ply, KITTI .bin, .npy); poses apart"

    def recognises(self, probe: Probe) -> bool:
        """Whether a folder holds clouds, and nothing of a bag."""
        return probe.path.is_dir() and bool(list_clouds(probe.path))

    def open(self, path: Path) -> "CloudFolder":
        """Open a folder; its files are read when their clouds are asked for."""
        return CloudFolder(path)


class CloudFolder:
    """An opened folder; its clouds are the stream `clouds`."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.notes = NoteList()
        self._files = list_clouds(path)
        times = [read_time(each) for each in self._files]
        known = [time for time in times if time is not None]
        is_timed = len(known) == len(times) and len(set(known)) == len(times)
        if is_timed:
            self._files = [self._files[at] for at in np.argsort(known, kind="stable").tolist()]
        counted = range(0, SPACING_NS * len(times), SPACING_NS)
        self.moments = Moments(sorted(known) if is_timed else list(counted), is_timed)
        order = "by the times in their names" if is_timed else "in the order of their names"
        self.notes.add(f"{len(times):,} clouds are taken {order}")

    @property
    def streams(self) -> Sequence[Stream]:
        """The one stream of clouds."""
        kinds = ", ".join(sorted({each.suffix.lower() for each in self._files}))
        return [Stream(TOPIC, kinds, len(self._files), Role.CLOUD)]

    def poses(self) -> Iterator[PoseSample]:
        """Give none: they are in a file of their own."""
        return iter(())

    def scans(self, _topics: Collection[str]) -> Iterator[Scan]:
        """Give none: it holds clouds."""
        return iter(())

    def clouds(self, topics: Collection[str]) -> Iterator[Cloud]:
        """The clouds, in the order of their times; what cannot be read is noted and left out."""
        for file, stamp_ns in zip(self._files, self.moments.stamp_ns, strict=True):
            if TOPIC not in topics:
                return
            try:
                with refuse_unreadable(file):
                    points = read_cloud(file)
                cloud = make_cloud(points.columns, FRAME, stamp_ns, TOPIC, stamp_ns)
            except DamageError as error:
                self.notes.add_damage(f"{file.name} {error}; it is left out")
                continue
            there = len(cloud.points)
            if there < points.announced:
                found = f"{file.name} is cut short: {there:,} of {points.announced:,} points"
                self.notes.add_damage(f"{found} are there and used")
            yield cloud


def list_clouds(folder: Path) -> list[Path]:
    """List the files of clouds in a folder, in the order of their names: 10 stands behind 9."""
    files = (each for each in folder.iterdir() if not each.name.startswith("."))
    return sorted((each for each in files if each.suffix.lower() in READERS), key=_make_key)


def _make_key(path: Path) -> list[tuple[int, str]]:
    parts = _DIGITS.split(path.name)
    return [(int(part) if part.isdecimal() else -1, part) for part in parts]


def read_time(path: Path) -> int | None:
    """Read the time that stands in a file's name, in ns; None where none does."""
    stem = path.stem.removesuffix(".pcd")  # nuScenes calls them .pcd.bin
    if found := _SECONDS.search(stem):
        seconds, rest = found.groups()
        return int(seconds) * 1_000_000_000 + int(rest.ljust(9, "0"))
    if found := _WHOLE.search(stem):
        return as_stamp(int(found[1].ljust(19, "0")))
    return None
