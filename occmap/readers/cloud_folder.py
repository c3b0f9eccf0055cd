"""Reads folders of clouds, a file for each, as KISS-ICP, glim and KITTI leave them behind.

Their times stand in their names, or else only their order is known: then the poses of a trajectory
are those of the files, one by one.

The files are PCD, PLY, KITTI's .bin and NumPy's .npy:
https://pointclouds.org/documentation/tutorials/pcd_file_format.html,
http://paulbourke.net/dataformats/ply/. Every `read_` function takes the bytes of a file.
"""

import re
from collections.abc import Callable, Collection, Iterable, Iterator
from contextlib import suppress
from glob import glob
from io import BytesIO
from itertools import chain
from pathlib import Path
from typing import Any, NamedTuple, TypeAlias

import numpy as np

from occmap.errors import DamageError, LogError, refuse_unreadable
from occmap.jit import kernel
from occmap.readers import Log, NoteList, Probe, Role, Stream
from occmap.readers.cloud_messages import Columns, make_cloud, tell_clouds
from occmap.readers.decimals import NUMBER, parse_words
from occmap.report import count, join_names
from occmap.types import Cloud, Moments, Paths, UInt8
from occmap.values import guess_unit, parse_time, shorten


class Points(NamedTuple):
    """The fields of the points of a file."""

    columns: Columns
    announced: int
    """How many points it announces: more than N where it is cut short"""


Read: TypeAlias = Callable[[bytes], Points]

_LZF_SHORT, _LZF_LONGEST = 32, 34
"""Bytes that stand for themselves come in runs of at most so many; what is above is a copy. Behind
the packed bytes lie so many zeros, so that the last head need not be looked at before it is read.
"""
_PCD_KINDS = {"F": "f", "I": "i", "U": "u"}
_PLY_KINDS = {
    "char": "i1", "uchar": "u1", "short": "i2", "ushort": "u2", "int": "i4", "uint": "u4",
    "float": "f4", "double": "f8", "int8": "i1", "uint8": "u1", "int16": "i2", "uint16": "u2",
    "int32": "i4", "uint32": "u4", "float32": "f4", "float64": "f8",
}  # fmt: skip
_PLY_ORDERS = {"ascii": "<", "binary_little_endian": "<", "binary_big_endian": ">"}
MOST_VALUES = 64
"""Of a point, in an array without names: one with more is turned the other way round."""
_ERRORS = ArithmeticError, LookupError, ValueError, TypeError, OSError, SyntaxError, MemoryError
"""What is raised of bytes that are not as their format has them"""
BEYOND_EARTH_M = 1e8
"""Where most points lie in a .bin of whole numbers, as NCLT has them"""
MOST_BYTES = 1 << 31
"""What a file may unpack to; a cloud of a hundred million points has less."""


def read_cloud(path: Path) -> Points:
    """Read the points of a file, by its suffix.

    Raises
    ------
    OSError
        It cannot be read.
    DamageError
        It is not what its suffix says.
    """
    data, suffix = path.read_bytes(), path.suffix.lower()
    is_nuscenes = path.name.lower().endswith(".pcd.bin")  # whose points have their ring, too
    try:
        return read_bin(data, 5) if is_nuscenes else READERS[suffix](data)
    except _ERRORS as error:
        raise DamageError(f"is not a {suffix} that can be read ({shorten(str(error))})") from None


def read_pcd(data: bytes) -> Points:
    """Read a PCD: ascii, binary or binary_compressed."""
    lines, at = _read_header(data, "DATA")
    header = {word.upper(): values for word, *values in lines}
    names, points = header["FIELDS"], _read_count(header["POINTS"][0])
    counts = map(int, header.get("COUNT", ["1"] * len(names)))
    sizes = zip(header["TYPE"], header["SIZE"], strict=True)
    kinds = [f"<{_PCD_KINDS[kind]}{size}" for kind, size in sizes]
    layout = _make_layout(zip(names, kinds, counts, strict=True))
    form = header["DATA"][0]
    if form == "ascii":
        return _parse_text(data, at, layout, points)
    if form == "binary":
        return _view(data, at, layout, points)
    if form != "binary_compressed":
        raise DamageError(f"is written as {shorten(form)}, which no PCD is")
    fields = _unpack_lzf(data[at:], layout.itemsize * points)
    columns, at = {}, 0
    for name in layout.names or ():  # one field of all points behind the other
        kind, each = layout[name].base, layout[name].shape[0]
        columns[name] = np.frombuffer(fields, kind, points * each, at)[::each]
        at += layout[name].itemsize * points
    return Points(columns, points)


def _unpack_lzf(data: bytes, size: int) -> UInt8:
    packed_size, stated = np.frombuffer(data[:8].ljust(8, b"\0"), "<u4").tolist()
    if len(data) - 8 < packed_size or stated != size or not 0 <= size < MOST_BYTES:
        found = f"holds {max(len(data) - 8, 0)} of {packed_size} bytes of compressed points"
        raise DamageError(f"is cut short or damaged: it {found}")
    packed = np.zeros(packed_size + _LZF_LONGEST, np.uint8)
    packed[:packed_size] = np.frombuffer(data, np.uint8, packed_size, 8)
    out = np.empty(size, np.uint8)
    if inflate_lzf(packed, packed_size, out) != size:
        raise DamageError("holds compressed points that are damaged")
    return out


@kernel
def inflate_lzf(packed: UInt8, packed_size: int, out: UInt8) -> int:
    """Unpack LZF into an array of the size that it should have; say how many bytes come.

    PCL compresses clouds with it: http://oldhome.schmorp.de/marc/liblzf.html. A head stands before
    bytes that are copied from behind it, or from what is already unpacked.
    """
    at, end = 0, 0
    while at < packed_size:
        head = int(packed[at])
        at += 1
        source, start, size = packed, at, head + 1
        if head < _LZF_SHORT:
            at += size
        else:
            size = (head >> 5) + 2
            if size == 9:
                size += int(packed[at])
                at += 1
            source, start = out, end - ((head & 31) << 8) - int(packed[at]) - 1
            at += 1
        if start < 0 or at > packed_size or end + size > len(out):
            return end
        for each in range(size):  # one by one, since they may be those that were just written
            out[end + each] = source[start + each]
        end += size
    return end


def read_ply(data: bytes) -> Points:
    """Read the vertices of a PLY, ascii or binary; they are the first of its elements."""
    elements: list[tuple[list[str], list[list[str]]]] = []
    form = ""
    lines, at = _read_header(data, "END_HEADER")
    for word, *values in lines:
        if word == "format":
            form = values[0]
        elif word == "element":
            elements.append((values, []))
        elif word == "property":
            elements[-1][1].append(values)
    (name, count), properties = elements[0]
    if name != "vertex" or any(len(each) != 2 for each in properties):
        raise ValueError("vertices hold lists or are not first")
    order, points = _PLY_ORDERS[form], _read_count(count)
    layout = _make_layout((name, order + _PLY_KINDS[kind], 1) for kind, name in properties)
    return (_parse_text if form == "ascii" else _view)(data, at, layout, points)


def _read_count(text: str) -> int:
    if not text.isdecimal():
        raise ValueError(f"{text} points")
    return int(text)


def read_bin(data: bytes, values: int = 4) -> Points:
    """Read KITTI's x, y, z and reflectance, each a float of 32 bits.

    Boreas has six values a point, and RobotCar all x before all y. By a wrong layout places, many
    below zero, stand where the reflectance belongs.
    """
    numbers = np.frombuffer(data, "<f4", len(data) // 4)
    sizes = [size for size in (values, 5, 6) if len(data) % (4 * size) == 0]
    fitting = [numbers.reshape(-1, size) for size in sizes]
    fitting += [numbers.reshape(size, -1).T for size in sizes if size == values]
    likely = [rows for rows in fitting if not (rows[:, 3] < 0).any()]
    if not likely and len(data) % (4 * values):
        raise DamageError(f"has {len(data):,} bytes, where a point takes {4 * values}")
    rows = (likely or fitting)[0]
    apart = np.abs(rows[:, :3])  # infinite where nothing came back
    if np.count_nonzero((apart > BEYOND_EARTH_M) & (apart < np.inf)) > len(rows):
        raise DamageError("holds no points of x, y, z and reflectance as floats of 32 bits")
    return Points(dict(zip("xyz", rows.T, strict=False)), len(rows))


def read_npy(data: bytes) -> Points:
    """Read an array of NumPy: rows of x, y, z and perhaps more, or fields of these names."""
    array = np.load(BytesIO(data), allow_pickle=False)
    if array.dtype.names:
        names, rows = array.dtype.names, array.ravel()
        return Points({name: rows[name] for name in names if rows[name].ndim == 1}, len(rows))
    if array.ndim != 2 or not 3 <= array.shape[1] <= MOST_VALUES or array.dtype.kind not in "fiu":
        shape = " x ".join(map(str, array.shape))
        raise DamageError(f"holds {shape} of {array.dtype}, where rows of x, y, z belong")
    return Points(dict(zip("xyz", array.T, strict=False)), len(array))


def _read_header(data: bytes, last: str) -> tuple[list[list[str]], int]:
    """Read the words of each line up to one with a keyword, and find where the next one begins."""
    lines, at = [[""]], 0
    while lines[-1][0].upper() != last:
        end = data.find(b"\n", at, at + 4096)
        if end < 0:
            raise DamageError(f"ends within its header, at byte {min(at, len(data))}")
        lines.append(data[at:end].decode("ascii", "replace").split() or [""])
        at = end + 1
    return lines, at


def _make_layout(fields: Iterable[tuple[str, str, int]]) -> np.dtype[Any]:
    """Make the layout of one point; names that repeat, as those of padding, get a number."""
    parts: dict[str, tuple[str, tuple[int]]] = {}
    for number, (name, kind, many) in enumerate(fields):
        parts[f"{name}#{number}" if name in parts else name] = kind, (many,)
    return np.dtype([(name, *part) for name, part in parts.items()])


def _view(data: bytes, at: int, layout: np.dtype[Any], points: int) -> Points:
    """See bytes as points: as many as are there."""
    there = min(points, max(len(data) - at, 0) // max(layout.itemsize, 1))
    rows = np.frombuffer(data, layout, there, at)
    return Points({name: rows[name][:, 0] for name in layout.names or ()}, points)


def _parse_text(data: bytes, at: int, layout: np.dtype[Any], points: int) -> Points:
    """Parse a line of numbers for each point: as many as are whole."""
    names = layout.names or ()
    *places, many = np.cumsum([0, *(layout[name].shape[0] for name in names)]).tolist()
    if not many:
        raise ValueError("its points have no fields")
    text = data[at:] + b"\n"
    starts = np.flatnonzero(np.frombuffer(b"\n" + text[:-1], np.uint8) == ord("\n"))[:points]
    words, faults = parse_words(text, starts, b" ", np.full(many, NUMBER), [""] * many)
    rows = words.numbers.T
    if faults or len(rows) < len(starts):  # one by one, up to where a line is cut
        lines = [line.split() for line in text.split(b"\n", points)[:points]]
        whole = next((n for n, each in enumerate(lines) if len(each) != many), len(lines))
        rows = np.array(lines[:whole], np.float64).reshape(whole, many)
    return Points({name: rows[:, at] for name, at in zip(names, places, strict=True)}, points)


READERS: dict[str, Read] = {".pcd": read_pcd, ".ply": read_ply, ".bin": read_bin, ".npy": read_npy}


TOPIC, FRAME = "clouds", "lidar"
SPACING_NS = 1_500_000_000
"""Between clouds whose times are not known: where one of them has no pose, the gap is longer than
any that poses are interpolated over by default."""
_TIME = re.compile(r"(?<!\d)(?:(\d{9,10})[._](\d{1,9})|(\d{13}|\d{16}|\d{19}))$")
"""How names end that state a time: in s, or as a whole number of ms, us or ns"""
_DIGITS = re.compile(r"(\d+)")


class CloudFolder(Log):
    """An opened folder; its clouds are the stream `clouds`."""

    moments: Moments

    def __init__(self, path: Path) -> None:
        self.path, self.notes = path, NoteList()
        self._files = list_clouds(path)
        clouds = len(self._files)
        times = read_times(self._files)
        is_timed = len(set(times)) == clouds
        if is_timed:
            self._files = [self._files[at] for at in np.argsort(times, kind="stable").tolist()]
        counted = range(0, SPACING_NS * clouds, SPACING_NS)
        self.moments = Moments(sorted(times) if is_timed else list(counted), is_timed)
        order = "by the times in their names" if is_timed else "in the order of their names"
        self.notes.add(f"{count(clouds, 'cloud')}, taken {order}")
        kinds = ", ".join(sorted({each.suffix.lower() for each in self._files}))
        self.streams = [Stream(TOPIC, kinds, len(self._files), Role.CLOUD)]

    def clouds(self, topics: Collection[str]) -> Iterator[Cloud]:
        """The clouds, in the order of their times; what cannot be read is noted and left out.

        Raises
        ------
        LogError
            None holds a point.
        """
        return tell_clouds(self._read() if TOPIC in topics else (), self.path, self.notes)

    def _read(self) -> Iterator[Cloud]:
        lost, cut = dict[str, str](), dict[str, str]()
        for file, stamp_ns in zip(self._files, self.moments.stamp_ns, strict=True):
            name = str(file.relative_to(self.path))
            try:
                with refuse_unreadable(file):
                    points = read_cloud(file)
                cloud = make_cloud(points.columns, (stamp_ns, FRAME), TOPIC, stamp_ns)
            except LogError as error:
                lost[name] = f"{error.found}; it is left out"
                continue
            there = len(cloud.points)
            if there < points.announced:
                found = f"is cut short: {there:,} of {points.announced:,} points"
                cut[name] = f"{found} are there and used"
            yield cloud
        if len(lost) == len(self._files):
            found = f"none of {count(len(lost), 'cloud')} can be read"
            fix = f"mend them: {' '.join(next(iter(lost.items())))}"
            raise LogError(found, where=self.path, fix=fix)
        for kind, each in (("left out", lost), ("cut short", cut)):
            if each:
                first, *others = each
                also = f"; also {kind}: {join_names(others)}" if others else ""
                self.notes.add_damage(f"{first} {each[first]}{also}")


class CloudFolderReader:
    """Folders of clouds."""

    name = "clouds"
    description = "a folder of clouds, a file each (.pcd, .ply, KITTI .bin, .npy); poses apart"
    open = CloudFolder

    def recognises(self, probe: Probe) -> bool:
        """Whether a folder holds clouds, and is no bag of ROS 2 beside which somebody put some."""
        if not probe.path.is_dir() or not list_clouds(probe.path):
            return False
        from occmap.readers.rosbag import METADATA, list_storage  # noqa: PLC0415  late: brings apsw

        return not ((probe.path / METADATA).exists() and list_storage(probe.path))


def list_clouds(folder: Path) -> list[Path]:
    """List the files of clouds in a folder, in the order of their names: 10 stands behind 9.

    If it has none, they are in the folders in it that hold one each, as hdl_graph_slam dumps them.
    """
    if not (files := _list_files(folder)):
        inner = list(filter(None, map(_list_files, folder.glob("*/"))))
        files = list(chain(*inner)) if len(inner) > 1 == max(map(len, inner)) else []
    return sorted(files, key=_make_key)


def _list_files(folder: Path) -> list[Path]:
    """List the clouds right in a folder; none where it may not be read."""
    names = glob("*", root_dir=folder)  # noqa: PTH207  of 100,000 files half the time
    return [folder / name for name in names if name[name.rfind(".") :].lower() in READERS]


def _make_key(path: Path) -> list[tuple[int, str]]:
    return [(int(part) if part.isdecimal() else -1, part) for part in _DIGITS.split(str(path))]


def read_times(paths: Paths) -> list[int]:
    """Read the times that stand in the names of files, in ns; none where some name has none."""
    stems = [path.stem.removesuffix(".pcd") for path in paths]  # nuScenes calls them .pcd.bin
    found = [each for each in map(_TIME.search, stems) if each]
    if len(found) < len(paths):
        return []
    times = [f"{each[1]}.{each[2]}" if each[1] else each[3] for each in found]
    unit = guess_unit(times)
    with suppress(ValueError):  # beyond 64 bits
        return [parse_time(each, unit) for each in times]
    return []
