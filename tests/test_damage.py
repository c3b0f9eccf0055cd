"""Every sample log cut short, and with flipped bytes: what lies before the damage is read.

`make fuzz` cuts at 200 positions and flips 1,000 bytes in each format; a plain test run does less.
"""

import os
import random
import shutil
import struct
import tempfile
import zlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from io import BytesIO
from pathlib import Path

import pytest
from mcap.writer import CompressionType
from rosbags import rosbag1

from occmap.errors import OccmapError
from occmap.readers import Role, open_log
from tests.fuzz.__main__ import alarm
from tests.fuzz.mutate import IN_PLACE, change_byte, put_zeros
from tests.samples import SAMPLE_LOGS, copy_mcap

MUCH = float(os.environ.get("OCCMAP_FUZZ", "0"))
"""How much more than a plain test run `make fuzz` does, which is 1"""
CUTS, FLIPS = max(8, round(200 * MUCH)), max(16, round(1000 * MUCH))
SEED = 20_240_229
TIME_LIMIT_S = 10

Zone = tuple[int, int]
"""Where in a file damage may concern a scan: from one offset up to another."""
FindZones = Callable[[bytes], list[Zone]]


@dataclass(frozen=True)
class Format:
    """A sample log, where its scans lie, and how many of those before damage must be read."""

    source: str
    zones: FindZones
    share: float = 0.99
    pack: Callable[[bytes], bytes] = bytes
    is_container: bool = True
    """A text that is cut between two lines looks whole, and no text counts its scans."""
    shared: FindZones = lambda _: []
    """Where damage concerns many scans, which a note says"""

    def prepare(self, folder: Path) -> tuple[Path, Path]:
        """Copy the log: the path to open, and the file in it that is to be damaged."""
        target = folder / Path(self.source).parts[0]
        if (SAMPLE_LOGS / self.source).parent == SAMPLE_LOGS:
            target.write_bytes(self.pack((SAMPLE_LOGS / self.source).read_bytes()))
            return target, target
        shutil.copytree((SAMPLE_LOGS / self.source).parent, target)
        return target, folder / self.source


def find_rows(data: bytes) -> list[Zone]:
    """In CSV: the lines that start with a digit."""
    return _find_lines(data, lambda line: line[:1].isdigit())


def find_messages(data: bytes) -> list[Zone]:
    """In CARMEN logs."""
    return _find_lines(data, lambda line: line.startswith(b"ROBOTLASER1"))


def _find_lines(data: bytes, is_scan: Callable[[bytes], bool]) -> list[Zone]:
    zones, at = [], 0
    for line in data.splitlines(keepends=True):
        at += len(line)
        if is_scan(line) and line.endswith(b"\n"):
            zones.append((at - len(line), at))
    return zones


def find_unzipped_rows(data: bytes) -> list[Zone]:
    """In gzip: up to where each row is out, with the 4096 bytes behind it that are at risk."""
    inflater = zlib.decompressobj(wbits=31)
    text = b""
    zones: list[Zone] = []
    for at in range(0, len(data), 256):
        text += inflater.decompress(data[at : at + 256])
        zones += [(0, at + 256)] * (len(find_rows(text[:-4096])) - len(zones))
    return zones + [(0, len(data))] * (len(find_rows(text)) - len(zones))


def find_ranges(data: bytes) -> list[Zone]:
    """In binary logs: the bytes of each scan's ranges, with the heads before and what follows."""
    scans = open_log(SAMPLE_LOGS / "drive.csv").scans({"scan"})
    places = [(data.index(raw), len(raw)) for raw in (scan.ranges.tobytes() for scan in scans)]
    return [(at - 200, at + length + 8) for at, length in places]


def find_pages(data: bytes) -> list[Zone]:
    """In SQLite, which reads whole pages: the pages that a scan lies on."""
    return [(start // 4096 * 4096, -(-end // 4096) * 4096) for start, end in find_ranges(data)]


def find_shared_pages(data: bytes) -> list[Zone]:
    """In SQLite: the page of topics, and the inner page of the tree of messages."""
    starts = range(0, len(data), 4096)
    topics = data.index(b"/scansensor_msgs/msg/LaserScan") // 4096 * 4096
    return [(at, at + 4096) for at in starts if at == topics or data[at] == 5]


def list_mcap_records(data: bytes) -> Iterator[tuple[int, int, int]]:
    """Where each record of an MCAP file begins, its code, and where it ends."""
    end = 8
    while end < len(data) - 8:
        at, (opcode, length) = end, struct.unpack_from("<BQ", data, end)
        end += 9 + length
        yield at, opcode, end


def find_chunk_heads(data: bytes) -> list[Zone]:
    """In an MCAP file: what says of a chunk how long it is and how it is compressed."""
    return [(at, at + 9 + 40) for at, opcode, _ in list_mcap_records(data) if opcode == 6]


def find_mcap_chunks(data: bytes) -> list[Zone]:
    """In an MCAP file with compressed chunks: the chunk that a scan lies in, with its indexes."""
    zones: list[Zone] = []
    start = 8
    for at, opcode, end in list_mcap_records(data):
        start = at if opcode == 6 else start
        if opcode == 7:  # a message index follows its chunk; that of /scan counts its scans
            channel, size = struct.unpack_from("<HI", data, at + 9)
            zones += [(start, end)] * (size // 16 if channel == 3 else 0)
    return zones


def find_bag_chunks(data: bytes) -> list[Zone]:
    """The same in a ROS 1 bag."""
    zones: list[Zone] = []
    start = end = 13
    while end < len(data):
        (length,) = struct.unpack_from("<I", data, end)
        header = data[end + 4 : end + 4 + length]
        start = end if b"op=\x05" in header else start
        end += 8 + length + struct.unpack_from("<I", data, end + 4 + length)[0]
        if b"op=\x04" in header and b"conn=" + struct.pack("<I", 2) in header:
            (count,) = struct.unpack_from("<I", header, header.index(b"count=") + 6)
            zones += [(start, end)] * count
    return zones


def pack_bag(data: bytes, compression: str) -> bytes:
    """Write a ROS 1 bag again in small compressed chunks."""
    with tempfile.TemporaryDirectory() as folder:
        source, target = Path(folder, "source.bag"), Path(folder, "target.bag")
        source.write_bytes(data)
        writer = rosbag1.Writer(target)
        writer.set_compression(rosbag1.Writer.CompressionFormat[compression])
        writer.chunk_threshold = 1 << 15
        with rosbag1.Reader(source) as reader, writer:
            connections = {
                each.id: writer.add_connection(
                    each.topic, each.msgtype, msgdef=each.msgdef.data, md5sum=each.digest
                )
                for each in reader.connections
            }
            for each, record_ns, message in reader.messages():
                writer.write(connections[each.id], record_ns, message)
        return target.read_bytes()


def pack_mcap(data: bytes) -> bytes:
    """Write an MCAP file again with zstd."""
    out = BytesIO()
    copy_mcap(BytesIO(data), out, chunk_size=1 << 15, compression=CompressionType.ZSTD)
    return out.getvalue()


def pack_gzip(data: bytes) -> bytes:
    deflater = zlib.compressobj(wbits=31)
    return deflater.compress(data) + deflater.flush()


FORMATS = {
    "csv": Format("drive.csv", find_rows, share=1.0, is_container=False),
    "csv.gz": Format("drive.csv", find_unzipped_rows, 1.0, pack_gzip, is_container=False),
    "carmen": Format("drive.log", find_messages, share=1.0, is_container=False),
    "bag": Format("drive.bag", find_ranges),
    "bag.bz2": Format("drive.bag", find_bag_chunks, pack=partial(pack_bag, compression="BZ2")),
    "bag.lz4": Format("drive.bag", find_bag_chunks, pack=partial(pack_bag, compression="LZ4")),
    "mcap": Format("drive.mcap", find_ranges, shared=find_chunk_heads),
    "mcap.zstd": Format("drive.mcap", find_mcap_chunks, pack=pack_mcap),
    "ros2": Format("drive_ros2/drive_ros2.db3", find_pages, shared=find_shared_pages),
}


Scans = dict[tuple[int, int], bytes]
"""Ranges by the two times of a scan: one of them may be damaged to that of another scan."""


def read_scans(path: Path) -> tuple[Scans, str]:
    """Read all scans, and what was said of damage; every pose is read, too."""
    scans: Scans = {}
    with alarm(TIME_LIMIT_S):
        try:
            log = open_log(path)
            for _ in log.poses():
                pass
            topics = {stream.topic for stream in log.streams if stream.role is Role.SCAN}
            count = 0
            for scan in log.scans(topics):
                scans[scan.stamp_ns, scan.record_ns] = scan.ranges.tobytes()
                count += 1
        except OccmapError as error:
            return scans, str(error)
    notes = "; ".join(note.text for note in log.notes if note.damage)
    assert count == len(scans) or notes, "a scan that is there twice went untold"
    return scans, notes


@pytest.fixture(params=FORMATS)
def form(request: pytest.FixtureRequest) -> Format:
    return FORMATS[request.param]


def check_before(form: Format, found: Scans, before: set[tuple[int, int]]) -> None:
    """See that of the scans that lie before the damage enough were found."""
    kept = before.intersection(found)
    assert len(kept) >= form.share * len(before), f"{len(kept)} of {len(before)}"


def test_the_scans_of_a_sound_log_are_where_they_are_looked_for(
    form: Format, tmp_path: Path
) -> None:
    path, file = form.prepare(tmp_path)
    whole, damage = read_scans(path)

    assert len(whole) == len(form.zones(file.read_bytes())) == 414
    assert not damage


def test_a_log_cut_anywhere(form: Format, tmp_path: Path) -> None:
    path, file = form.prepare(tmp_path)
    data = file.read_bytes()
    whole, _ = read_scans(path)
    zones = form.zones(data)
    dice = random.Random(SEED)
    for step in range(CUTS):
        cut = int((step + dice.random()) * len(data) / CUTS)
        file.write_bytes(data[:cut])
        found, damage = read_scans(path)
        before = {times for times, (_, end) in zip(whole, zones, strict=True) if end <= cut}
        check_before(form, found, before)
        assert damage or found == whole or not form.is_container, cut


def test_no_damage_anywhere_takes_what_lies_before_it_or_in_a_container_beside_it(
    form: Format, tmp_path: Path
) -> None:
    """A container also says what is lost."""
    path, file = form.prepare(tmp_path)
    data = file.read_bytes()
    whole, _ = read_scans(path)
    zones = dict(zip(whole, form.zones(data), strict=True))
    dice = random.Random(SEED)
    for step in range(FLIPS):
        at = int((step + dice.random()) * len(data) / FLIPS)
        damaged = bytearray(data)
        damage = dice.choice(IN_PLACE) if form.is_container else change_byte
        last = damage(damaged, at, dice)
        first = at // 512 * 512 if damage is put_zeros else at
        file.write_bytes(damaged)
        found, told = read_scans(path)

        where = f"{damage.__name__} at {at}: {told}"
        check_before(form, found, {times for times, (_, end) in zones.items() if end <= first})
        if not form.is_container:
            continue
        assert told or len(found) == len(whole), where
        if any(start < last and first < end for start, end in form.shared(data)):
            continue
        beside = {times for times, (start, end) in zones.items() if end <= first or last <= start}
        lost = {times for times in beside if found.get(times) != whole[times]}
        assert not lost or refuses(path), f"{len(lost)} lost by {where}"


def refuses(path: Path) -> bool:
    """Whether a log cannot be opened at all."""
    try:
        open_log(path)
    except OccmapError:
        return True
    return False
