"""How counts, names, boxes, times and a log on stdin are written for people."""

import re
from collections.abc import Iterable, Mapping, Sequence
from datetime import UTC, datetime
from typing import TypeAlias

MOST_NAMES = 6
"""How many names a list shows: people do not read longer ones"""
DATES_S = range(631_152_000, 4_102_444_800)
"""Stamps from 1990 to 2100 are dates; others count from some start"""
STDIN_FOLDER = "occmap-stdin-"
"""How the temporary folder is called in which a log from stdin is kept while a command runs"""

Row: TypeAlias = tuple[str, str]
"""A label, "" where it is that of the row before, and a text"""


def count(number: float, noun: str) -> str:
    """Write how many there are: 1 beam, 2,000 beams, 2.875 misses."""
    ending = "" if number == 1 else "es" if noun.endswith("s") else "s"
    return f"{number:,.15g} {noun}{ending}"


def join_names(names: Iterable[str], most: int = MOST_NAMES) -> str:
    """Write names as a list; of many only the first, and how many more there are."""
    names = tuple(names)
    more = f" and {len(names) - most:,} more" if len(names) > most else ""
    return (", ".join(names[:most]) or "none") + more


def write_counts(counts: Mapping[str, int]) -> str:
    """List how many there are of each kind; zeros are left out."""
    return ", ".join(f"{number:,} {name}" for name, number in counts.items() if number)


def write_unused(scans: int, reasons: Mapping[str, int]) -> str:
    """Say why none of so many scans is used."""
    return f"none of {scans:,} scans can be used: {write_counts(reasons)}"


def write_metres(places: Iterable[float]) -> list[str]:
    """Write coordinates (m), with the digits that those of a globe need (UTM)."""
    return [f"{place:.10g}" for place in places]


def write_box(box: Sequence[float]) -> str:
    """Write the edges of a box, given as lowest x and y, highest x and y (m)."""
    low_x, low_y, high_x, high_y = write_metres(box)
    return f"x {low_x} to {high_x} m, y {low_y} to {high_y} m"


def write_duration(seconds: float) -> str:
    """Write a duration in seconds, from an hour on also in hours; it may be negative."""
    if seconds < 100:
        return f"{seconds:.3g} s"
    hours, minutes = divmod(round(seconds / 60), 60)
    return f"{seconds:,.0f} s" + (f" ({hours:,} h {minutes} min)" if seconds >= 3600 else "")


def write_time(stamp_ns: int) -> str:
    """Write a stamp in seconds as in the log, and as a date where it is one."""
    return f"{stamp_ns / 1e9:.3f} s{_date(stamp_ns)}"


def write_span(start_ns: int, end_ns: int) -> str:
    """Write two stamps in seconds as in the log, and the first as a date where it is one."""
    return f"{start_ns / 1e9:.3f} to {end_ns / 1e9:.3f} s{_date(start_ns)}"


def _date(stamp_ns: int) -> str:
    if stamp_ns // 1_000_000_000 not in DATES_S:
        return ""
    date = datetime.fromtimestamp(stamp_ns // 1_000_000_000, UTC)
    return f" ({date:%Y-%m-%d %H:%M:%S} UTC)"


def name_stdin(text: str) -> str:
    """Call a log that came on stdin `-` in a text that names the file in which it is kept."""
    if STDIN_FOLDER not in text:
        return text
    from tempfile import gettempdir  # noqa: PLC0415  late: few texts need it

    return re.sub(rf"{re.escape(gettempdir())}[/\\]{STDIN_FOLDER}\w+[/\\]-", "-", text)
