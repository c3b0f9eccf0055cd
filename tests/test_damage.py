"""Every sample log cut short, and with flipped bytes: what lies before the damage is read.

`make fuzz` cuts at 200 positions and flips 1,000 bytes in each format; a plain test run does less.
"""

import os
import random
import shutil
import signal
import struct
import zlib
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from types import FrameType

import pytest

from occmap.errors import LogError, OccmapError
from occmap.readers import Role, open_log

SAMPLES = Path(__file__).parents[1] / "sample_logs"
CUTS, FLIPS = (200, 1000) if "OCCMAP_FUZZ" in os.environ else (12, 60)
SEED = 20_240_229
TIME_LIMIT_S = 10.0
SCAN_TOPICS = {"scan", "/scan", "ROBOTLASER1"}

Ends = Callable[[bytes], list[int]]
"""Finds, in a whole file, where each scan ends."""


@dataclass(frozen=True)
class Format:
    """A sample log, where its scans end, and how many of those before damage must be read."""

    source: str
    ends: Ends
    share: float = 0.99
    pack: Callable[[bytes], bytes] = bytes
    shows_its_end: bool = True
    """A text that is cut between two lines looks whole."""

    def prepare(self, folder: Path) -> tuple[Path, Path]:
        """Copy the log: the path to open, and the file in it that is to be damaged."""
        target = folder / Path(self.source).parts[0]
        if (SAMPLES / self.source).parent == SAMPLES:
            target.write_bytes(self.pack((SAMPLES / self.source).read_bytes()))
            return target, target
        shutil.copytree((SAMPLES / self.source).parent, target)
        return target, folder / self.source


def find_rows(data: bytes) -> list[int]:
    """In CSV: behind each line that starts with a digit."""
    return _find_lines(data, lambda line: line[:1].isdigit())


def find_messages(data: bytes) -> list[int]:
    """In CARMEN logs."""
    return _find_lines(data, lambda line: line.startswith(b"ROBOTLASER1"))


def _find_lines(data: bytes, is_scan: Callable[[bytes], bool]) -> list[int]:
    ends, at = [], 0
    for line in data.splitlines(keepends=True):
        at += len(line)
        if is_scan(line) and line.endswith(b"\n"):
            ends.append(at)
    return ends


def find_unzipped_rows(data: bytes) -> list[int]:
    """In gzip: where enough has come in for each row to come out."""
    inflater = zlib.decompressobj(wbits=31)
    text = b""
    ends: list[int] = []
    for at in range(0, len(data), 256):
        text += inflater.decompress(data[at : at + 256])
        ends += [at + 256] * (len(find_rows(text)) - len(ends))
    return ends


def find_ranges(data: bytes) -> list[int]:
    """In binary logs: behind the bytes of each scan's ranges, and those that follow them."""
    scans = open_log(SAMPLES / "drive.csv").scans({"scan"})
    return [data.index(raw) + len(raw) + 8 for raw in (scan.ranges.tobytes() for scan in scans)]


def find_pages(data: bytes) -> list[int]:
    """In SQLite, which reads whole pages: at the end of the page that a scan lies in."""
    return [-(-end // 4096) * 4096 for end in find_ranges(data)]


def find_mcap_chunks(data: bytes) -> list[int]:
    """In an MCAP file with compressed chunks: at the end of the chunk that a scan lies in."""
    ends: list[int] = []
    at = 8
    while at < len(data) - 8:
        opcode, length = struct.unpack_from("<BQ", data, at)
        at += 9 + length
        if opcode == 7:  # a message index follows its chunk; that of /scan counts its scans
            channel, size = struct.unpack_from("<HI", data, at - length)
            ends += [at] * (size // 16 if channel == 3 else 0)
    return ends


def pack_mcap(data: bytes) -> bytes:
    """Write an MCAP file again with zstd."""
    from io import BytesIO  # noqa: PLC0415

    from mcap.reader import make_reader  # noqa: PLC0415
    from mcap.writer import CompressionType, Writer  # noqa: PLC0415

    out = BytesIO()
    writer = Writer(out, chunk_size=1 << 15, compression=CompressionType.ZSTD)
    writer.start(profile="ros2")
    channels: dict[str, int] = {}
    for schema, channel, message in make_reader(BytesIO(data)).iter_messages():
        if channel.topic not in channels:
            assert schema is not None
            schema_id = writer.register_schema(schema.name, schema.encoding, schema.data)
            channels[channel.topic] = writer.register_channel(channel.topic, "cdr", schema_id)
        writer.add_message(
            channels[channel.topic], message.log_time, message.data, message.publish_time
        )
    writer.finish()  # type: ignore[no-untyped-call]  # the library's gap
    return out.getvalue()


def pack_gzip(data: bytes) -> bytes:
    deflater = zlib.compressobj(wbits=31)
    return deflater.compress(data) + deflater.flush()


FORMATS = {
    "csv": Format("drive.csv", find_rows, share=1.0, shows_its_end=False),
    "csv.gz": Format("drive.csv", find_unzipped_rows, 1.0, pack_gzip),
    "carmen": Format("drive.log", find_messages, share=1.0, shows_its_end=False),
    "bag": Format("drive.bag", find_ranges),
    "mcap": Format("drive.mcap", find_ranges),
    "mcap.zstd": Format("drive.mcap", find_mcap_chunks, pack=pack_mcap),
    "ros2": Format("drive_ros2/drive_ros2.db3", find_pages),
}


@contextmanager
def time_limit(seconds: float) -> Iterator[None]:
    """Raise where a block hangs."""

    def give_up(_signal: int, _frame: FrameType | None) -> None:
        raise TimeoutError(f"still busy after {seconds} s")

    before = signal.signal(signal.SIGALRM, give_up)
    signal.setitimer(signal.ITIMER_REAL, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.signal(signal.SIGALRM, before)


def read_stamps(path: Path) -> tuple[list[int], bool]:
    """Read the stamps of all scans, and whether damage was noted; every pose is read, too."""
    stamps: list[int] = []
    with time_limit(TIME_LIMIT_S):
        try:
            log = open_log(path)
            for _ in log.poses():
                pass
            topics = {stream.topic for stream in log.streams if stream.role is Role.SCAN}
            stamps.extend(scan.stamp_ns for scan in log.scans(topics & SCAN_TOPICS))
        except OccmapError:
            return stamps, True
    return stamps, any(note.damage for note in log.notes)


@pytest.fixture(params=FORMATS)
def form(request: pytest.FixtureRequest) -> Format:
    return FORMATS[request.param]


def check_before(form: Format, found: list[int], before: set[int]) -> None:
    """See that of the scans that lie before the damage enough were found."""
    kept = before.intersection(found)
    assert len(kept) >= form.share * len(before), f"{len(kept)} of {len(before)}"


def test_the_scans_of_a_sound_log_are_where_they_are_looked_for(
    form: Format, tmp_path: Path
) -> None:
    path, file = form.prepare(tmp_path)
    whole, damaged = read_stamps(path)
    ends = form.ends(file.read_bytes())

    assert len(whole) == len(ends) == len(set(whole)) == 414
    assert not damaged


def test_a_log_cut_anywhere(form: Format, tmp_path: Path) -> None:
    path, file = form.prepare(tmp_path)
    data = file.read_bytes()
    whole, _ = read_stamps(path)
    ends = form.ends(data)
    dice = random.Random(SEED)
    for step in range(CUTS):
        cut = int((step + dice.random()) * len(data) / CUTS)
        file.write_bytes(data[:cut])
        found, damaged = read_stamps(path)
        before = {stamp for stamp, end in zip(whole, ends, strict=True) if end <= cut}
        check_before(form, found, before)
        assert damaged or found == whole or not form.shows_its_end, cut


def test_a_log_with_a_flipped_byte_anywhere(form: Format, tmp_path: Path) -> None:
    path, file = form.prepare(tmp_path)
    data = file.read_bytes()
    whole, _ = read_stamps(path)
    ends = form.ends(data)
    dice = random.Random(SEED)
    for step in range(FLIPS):
        at = int((step + dice.random()) * len(data) / FLIPS)
        flipped = bytearray(data)
        flipped[at] ^= dice.randrange(1, 256)
        file.write_bytes(flipped)
        found, _ = read_stamps(path)
        check_before(form, found, {s for s, end in zip(whole, ends, strict=True) if end <= at})


def test_a_word_in_the_first_row_is_an_error_and_later_damage(tmp_path: Path) -> None:
    rows = (SAMPLES / "drive.csv").read_text().splitlines()
    path = tmp_path / "log.csv"

    path.write_text("\n".join([*rows[:5], rows[5] + "x", *rows[6:], ""]))
    with pytest.raises(LogError, match=r"log\.csv:6: column r270 is '.*x' where a number belongs"):
        list(open_log(path).scans({"scan"}))

    path.write_text("\n".join([*rows[:100], rows[100] + "x", *rows[101:], ""]))
    log = open_log(path)
    assert len(list(log.scans({"scan"}))) == 413
    (note,) = log.notes
    assert note.damage
    assert note.text.startswith("1 of 414 lines are malformed and left out, the first is line 101")
    assert log.streams[0].count == 413
