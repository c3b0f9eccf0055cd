"""What recorded values must be: numbers, times, text and ranges are checked as they come in.

Here is also what the columns of a table are called, and which files are neither logs nor poses.
"""

import re
import shlex
from collections.abc import Iterable, Sequence
from contextlib import suppress
from decimal import Decimal
from numbers import Real
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from occmap.errors import DamageError


def as_float32(values: ArrayLike) -> NDArray[np.float32]:
    """Convert to float32, as ranges are kept; too large a number becomes infinite."""
    with np.errstate(over="ignore"):
        return np.asarray(values).astype(np.float32)


def name_origin(parent: str, topic: str) -> str:
    """Name the frame of scans on a topic that state where in another frame they begin."""
    return f"{parent}:{topic.strip('/')}"


def as_number(value: Any) -> float:
    """Convert a number, which may be infinite or NaN, to a float; raises DamageError."""
    if type(value) is float:
        return value
    if not isinstance(value, Real) or isinstance(value, bool):
        raise DamageError(f"holds {shorten(value)} where a number belongs")
    try:
        return float(value)
    except OverflowError:
        raise DamageError("holds a number that no float can hold") from None


def as_stamp(value: Any) -> int:
    """Convert a time in whole nanoseconds to an int of 64 bits; raises DamageError."""
    if not isinstance(value, (int, np.integer)) or not -(2**63) <= value < 2**63:
        raise DamageError(f"holds {shorten(value)} where a time of 64 bits belongs")
    return int(value)


UNITS = {"s": 9, "ms": 6, "us": 3, "ns": 0}
"""Of time, by the power of ten that makes nanoseconds of them"""
SECONDS, NANOSECONDS = UNITS["s"], UNITS["ns"]
_BY_SIZE = {12: 6, 15: 3, 17: 0, 18: 0}
"""By the power of ten of a whole number that is too large for seconds, which fit 64 bits only up to
10^10: those of its unit in nanoseconds. Such are the times from 2001 to 2286 in milliseconds and in
microseconds, and those in nanoseconds since 1973."""
FAR_APART_NS = 1000 * 10**9
"""Scans and poses that follow one another are not, but those of a clock in ns are, which is taken
for one in ms, if they are more than a millisecond apart."""


def parse_time(text: str, unit: int = SECONDS) -> int:
    """Convert a time, as text, to nanoseconds exactly; a float would round to 0.2 us.

    Of seconds, what can only be whole milliseconds, microseconds or nanoseconds is taken as such.

    Raises
    ------
    ValueError
        The text is not a number, or not whole where it should be nanoseconds, or these do not fit
        64 bits.
    """
    with suppress(ArithmeticError):  # what decimal raises for words and for NaN
        number, scale = Decimal(text), unit
        if unit == SECONDS and number > 10**12 and number % 1 == 0:
            scale = _BY_SIZE.get(number.adjusted(), unit)
        nanoseconds = number.scaleb(scale)
        if abs(nanoseconds) <= 2**63 - 1 and (unit or number % 1 == 0):
            return round(nanoseconds)
    name = "nanoseconds" if unit == NANOSECONDS else "seconds"
    raise ValueError(f"{shorten(text)} is not a time in {name}")


def guess_unit(times: Sequence[str]) -> int:
    """Tell the unit of times that follow one another, where none is stated: seconds or nanoseconds.

    Whole numbers that are too large for seconds are nanoseconds since a computer was started, if
    they are no times since 1970 in any unit, or would lie far apart.
    """
    if not times or not all(each.isdecimal() and len(each) > SECONDS + 1 for each in times):
        return SECONDS
    try:
        steps = np.diff([parse_time(each) for each in times])
    except ValueError:
        return NANOSECONDS
    is_far = len(steps) > 0 and np.median(np.abs(steps)) >= FAR_APART_NS
    return NANOSECONDS if is_far else SECONDS


def parse_number(text: str) -> float:
    """Parse a number; raises ValueError also where Python alone takes it for one, such as 1_000."""
    try:
        if "_" in text or not text.isascii():
            raise ValueError
        return float(text.encode())  # of bytes, since blanks around text may be any of Unicode's
    except ValueError:
        raise ValueError(f"{shorten(text)} where a number belongs") from None


BEYOND_A_TURN = 7.0
JUMP_SHARE = 0.01
"""Headings that are radians stay within a turn, or count on without a jump of half a turn"""
DEGREES = "angles are radians; are these degrees?"
WRAP_DEG = 340.0
"""Headings that are degrees jump by more, up to a turn, from 180 to -180 or from 360 to 0"""


def suspect_degrees(yaw: ArrayLike, seconds: float = 0.0) -> str:
    """Say if headings, one after the other, can hardly be radians; "" if they can.

    It may be known how many seconds they took.
    """
    known = np.asarray(yaw, np.float64)
    known = known[np.isfinite(known)]
    steps = np.abs(np.diff(known))
    if not len(steps) or np.median(np.abs(known)) <= BEYOND_A_TURN:
        return ""
    wraps = (steps > WRAP_DEG) & (steps <= 360)
    jumps = wraps.any() or np.mean(steps > np.pi) > JUMP_SHARE
    is_mad = 1 < seconds < steps.sum() / 6  # no robot turns once a second all the time
    return f"the yaws turn faster than any robot does: {DEGREES}" if jumps or is_mad else ""


def as_text(value: Any) -> str:
    """Check that text can be written as UTF-8; raises DamageError."""
    if not isinstance(value, str):
        raise DamageError(f"holds {shorten(value)} where text belongs")
    try:
        if not value.isascii():
            value.encode()
    except UnicodeEncodeError:
        raise DamageError("holds text that is not Unicode") from None
    return value


def as_ranges(values: ArrayLike) -> NDArray[np.float32]:
    """Copy one row of numbers as float32, (B,), what is masked as NaN; raises DamageError."""
    try:
        array = np.asarray(values)
        # Most are plain arrays, for which numpy.ma need not be loaded.
        if array is not values and isinstance(values, np.ma.MaskedArray):
            array = np.where(np.ma.getmaskarray(values), np.nan, array)
    except (ValueError, TypeError, OverflowError):  # rows that differ in length, and the like
        raise DamageError("holds ranges that are not numbers in one row") from None
    if array.ndim != 1 or array.dtype.kind not in "fiu":
        raise DamageError(f"holds {array.ndim}-dimensional ranges of {array.dtype}")
    return array.copy() if array.dtype == np.float32 else as_float32(array)


def shorten(value: object) -> str:
    """Quote a value in at most 40 characters; a huge number is only called one."""
    if isinstance(value, int) and abs(value) >= 2**63:
        return "a number beyond 64 bits"
    text = repr(value) if isinstance(value, str | int | float | None) else type(value).__name__
    return text if len(text) <= 40 else f"{text[:37]}..."


STAMPS = {
    f"{name}{suffix}": unit
    for suffix, unit in {"": SECONDS, **{f"_{name}": unit for name, unit in UNITS.items()}}.items()
    for name in ("stamp", "timestamp", "time", "t", "__time")
} | {"field.header.stamp": NANOSECONDS, "%time": NANOSECONDS}
"""What programs call the column of times, and in which unit it is; the first of these counts"""
COLUMN_NAMES = {
    "stamp": tuple(STAMPS),
    "yaw": ("theta", "heading", "field.theta"),
    "frame": ("field.header.frame_id", "header.frame_id"),
}
"""What other programs call a column; those of `rostopic echo -p` begin with `field.`"""
RECEIPTS = ("time", "%time")
"""The times of receipt, as bagpy and `rostopic echo -p` call them, beside the stamps of headers"""
SAMPLED_ROWS = 100
"""By so many rows it is told what the times of a table are"""
_TIME = re.compile(r"^(?:.*\bstamp[./])?(n?)(?:ano)?(sec)s?$")
"""What ROS calls the two columns of a time: whole seconds, and nanoseconds to be added"""
_TIME_UNIT = re.compile(r"\s*[\[(]([mun]s)[\])]$")
_UNIT = re.compile(r"\s*[\[(](?:s|m|rad)?[\])]$")
"""A unit behind the name of a column, where it is one of time, or the one that is expected"""


def find_separator(row: str) -> str | None:
    """Tell what stands between the cells of a row; None for any white space."""
    separator = max(",;\t", key=row.count)
    return separator if separator in row else None


def split_header(text: str, separator: str | None) -> tuple[list[str], int]:
    """Split a header row into the names of its columns, as occmap has them where it knows them.

    Also give the unit of the time, which is `stamp`. Of a time in two columns `stamp` is the
    seconds, and `stamp_nsec` the rest.
    """
    cells = [cell.strip(' \t"').lower() for cell in text.split(separator)]
    names = [_UNIT.sub("", _TIME_UNIT.sub(r"_\1", cell)) for cell in cells]
    halves = [_TIME.sub(r"\1\2", name) for name in names]
    if {"sec", "nsec"}.issubset(halves) and "stamp" not in names:
        names[halves.index("sec")], names[halves.index("nsec")] = "stamp", "stamp_nsec"
    unit = next((unit for name, unit in STAMPS.items() if name in names), SECONDS)
    for name, others in COLUMN_NAMES.items():
        found = next((other for other in others if other in names), "")
        if found and name not in names:
            names[names.index(found)] = name
    return [name.removeprefix("field.") for name in names], unit


def _are_times(texts: Sequence[str]) -> bool:
    """Whether all are times, and not all the same one."""
    with suppress(ValueError):
        return len({parse_time(each) for each in texts}) >= min(len(texts), 2)
    return False


def settle_times(
    names: Sequence[str], unit: int, rows: Iterable[Sequence[str]]
) -> tuple[list[str], int, str]:
    """Settle by some rows of a table which of its columns is `stamp`, and in which unit.

    Where the stamps of headers were never set, the times of receipt count, and a note says so.
    """
    sample = [dict(zip(names, map(str.strip, row), strict=False)) for row in rows]
    stamps = [row.get("stamp", "") for row in sample]
    is_zero = all(stamp and not stamp.strip("0.") for stamp in stamps)
    is_set = not is_zero or any(row.get("stamp_nsec", "").strip("0") for row in sample)
    receipt = next((name for name in RECEIPTS if name in names), "")
    if sample and not is_set and _are_times([row.get(receipt, "") for row in sample]):
        renamed = {"stamp": "", "stamp_nsec": "", receipt: "stamp"}
        note = "the stamps of headers are all zero: the times of receipt count"
        return [renamed.get(name, name) for name in names], STAMPS[receipt], note
    return list(names), guess_unit(stamps) if unit == SECONDS else unit, ""


FRAME_NAME = r"(?!(?:nan|inf)\b)[^\W\d][^,]*"
ECHOED = re.compile(rf"\d+,\d{{1,9}},(?:{FRAME_NAME})?,({FRAME_NAME},)?")
"""How a line begins that `ros2 topic echo` writes as CSV: a time, a frame, perhaps another frame"""


def tell_missing(names: Sequence[str], columns: Iterable[str]) -> str:
    """Say which columns are missing, and which of them is there in a unit that is not expected."""
    called = "|".join(re.escape(it) for name in names for it in (name, *COLUMN_NAMES.get(name, ())))
    odd = next((column for column in columns if re.match(rf"(?:{called})\s*[\[(]", column)), "")
    found = f"no column {', '.join(names)}"
    return f"{found}, but {odd!r}: units are s, m and rad" if odd else found


NO_TEXT = re.compile(rb"[\0-\x08\x0e-\x1f]")
BINARY_WITHIN = 64
"""A log or a picture has a byte of no text within these first bytes; a text may have some later,
where a crash cut it."""
ZSTD_MAGIC = b"\x28\xb5\x2f\xfd"
PACKERS = {
    "zstd": (ZSTD_MAGIC, "unzstd"),
    "gzip": (b"\x1f\x8b", "gunzip"),
    "lz4": (b"\x04\x22\x4d\x18", "unlz4"),
    "bzip2": (b"BZh", "bunzip2"),
    "xz": (b"\xfd7zXZ", "unxz"),
    "7z": (b"7z\xbc\xaf", "7z x"),
}
"""How files begin that a program compressed, and what undoes that"""
OTHER_FILES = {
    **{
        re.escape(magic): (f"a file that {name} compressed", f"decompress it first: {command} PATH")
        for name, (magic, command) in PACKERS.items()
    },
    b"PK\x03\x04": (
        "an archive; if it is evidence (.npz), `occmap render` reads it",
        "else unpack it: unzip PATH",
    ),
    rb"(?s:.{257})ustar": ("an archive", "unpack it: tar -xf PATH"),
    rb"\xd4\xc3\xb2\xa1|\n\r\r\n": ("packets", "record what the lidar's ROS driver makes of them"),
    rb"ARROW1|PAR1": ("a table of Arrow", "make it CSV: pandas reads it, and has `to_csv`"),
    rb"\x93NUMPY": ("an array of NumPy", "SLAM that writes one writes its poses as text, too"),
    b"P5|image:": ("a map, not a log: `occmap diff` compares maps", ""),
    b"\x89PNG": ("a picture, not a log: `occmap diff` compares maps", ""),
    b"version https://git-lfs": ("a Git LFS pointer, not the file", "fetch it: git lfs pull"),
    rb"\xff\xfe[\t-~]\0|\xfe\xff\0[\t-~]": (
        "text in UTF-16",
        "make it UTF-8 first: iconv -f UTF-16 -t UTF-8 PATH > NEW.csv",
    ),
    re.escape(b"\xdb\x01\xf5\x5b\x7b\x1f\x1d\x7b"): (
        "a pbstream of Cartographer",
        "take its poses out: cartographer_dev_pbstream_trajectories_to_rosbag -input PATH -output "
        "poses.bag",
    ),
    rb"#ROS(RECORD|BAG) V[01]": (
        "a bag of a format before 2.0",
        "convert it with ROS 1's `rosbag fix PATH NEW.bag`",
    ),
    b"\0": (
        "a file that begins with zeros, as a power cut leaves one",
        "take the log from where it was copied from",
    ),
    rb"ply\r?\n|# \.PCD|VERSION \.7": (
        "a single cloud of points",
        "a map needs the clouds of single scans, in a folder, and their poses: `poses=FILE`; of "
        "LIO-SAM, record /lio_sam/mapping/odometry: it writes poses as such a cloud",
    ),
}
"""By a pattern of how a file begins: what it is, and how to make of it what is read; "" where that
is never"""


def name_other(path: object, content: bytes) -> tuple[str, str]:
    """Say what a file is that occmap cannot read, by how it begins, and what mends it.

    Both are "" where it is not known.
    """
    begins = (start for start in OTHER_FILES if re.match(start, content))
    found, fix = OTHER_FILES.get(next(begins, b""), ("", ""))
    return found, fix.replace("PATH", shlex.quote(str(path)))
