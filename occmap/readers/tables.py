"""Lines of text as values: those that are alike are parsed together, by a kernel."""

from collections.abc import Sequence
from functools import lru_cache
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from occmap.readers.text import PADDING, Block
from occmap.types import Float32, Float64, Int64, UInt8
from occmap.values import as_float32, parse_nanoseconds, parse_seconds, shorten

if TYPE_CHECKING:
    from occmap.readers.decimals import Filled

ANY, SAME, SECONDS, NANOSECONDS, NUMBER, RANGE = range(6)
"""What a word of a line is: nothing that is asked for, the same in every line, a time in either
unit, a number, or the range of a beam."""
NUMBER_CHARACTERS = b"+-.0123456789Ee naif"
"""What programs write numbers with; of others, such as 1_0, Python and NumPy think differently."""


class Pattern(NamedTuple):
    """What lines that are parsed together have in common."""

    words: Sequence[bytes]
    """The words of one of them, N"""
    separator: bytes
    """What stands between two words: one comma, or any number of blanks"""
    kinds: UInt8
    """(N,) what each word is, ANY, SAME or another"""


class Table(NamedTuple):
    """The values of S lines of N words that share a pattern."""

    rows: Int64
    """(S,) which lines of the block they are"""
    ranges: Float32
    """(S, B) in the order in which they stand; NaN where nothing stands between two commas"""
    values: Float64
    """(N, S) other numbers, likewise, by word"""
    times: Int64
    """(N, S) ns, by word; only the rows of times mean anything, as in `values` only the others"""


def parse_table(block: Block, rows: Int64, pattern: Pattern) -> Table:
    """Parse those of some lines, by their indices (S,), that are of a pattern."""
    from occmap.readers import decimals  # noqa: PLC0415  late: it brings numba

    words, separator, kinds = pattern
    same = b"".join(words[at] + separator for at in np.flatnonzero(kinds == SAME).tolist())
    rows = rows[: len(block.text) // len(kinds)]  # no more lines can have so many words
    values = np.empty((len(kinds), len(rows)))
    filled = decimals.Filled(
        ranges=np.empty((len(rows), np.count_nonzero(kinds == RANGE)), np.float32),
        values=values,
        times=values.view(np.int64),
        alike=np.zeros(len(rows), np.bool_),
        # With more words than this for the caller, lines are parsed as quickly one by one.
        left=np.empty((values.size // 8 + 64, 4), np.int64),
    )
    lines = decimals.Lines(
        text=np.frombuffer(block.text, np.uint8),
        eights=block.eights,
        starts=block.starts[rows],
        separator=ord(separator),
        kinds=kinds,
        same=np.frombuffer(same + PADDING, np.uint8),
    )
    left = decimals.parse_rows(lines, filled)
    _parse_left(block.text, kinds, filled, left)
    alike, ranges = filled.alike, filled.ranges
    if not alike.all():
        rows, ranges, values = rows[alike], ranges[alike], values[:, alike]
    return Table(rows, ranges, values, values.view(np.int64))


def _parse_left(text: bytearray, kinds: UInt8, filled: "Filled", left: int) -> None:
    """Parse the words that the kernel left, so many; a line with a malformed one is not alike."""
    beams = np.cumsum(kinds == RANGE) - 1
    for row, col, start, end in filled.left[:left].tolist():
        word, kind = bytes(text[start:end]), kinds[col]
        try:
            if kind == RANGE:
                filled.ranges[row, beams[col]] = as_float32(_parse_number(word))
            elif kind == NUMBER:
                filled.values[col, row] = _parse_number(word)
            else:
                parse = parse_seconds if kind == SECONDS else parse_nanoseconds
                filled.times[col, row] = parse(word.decode("utf-8", "replace"))
        except ValueError:
            filled.alike[row] = False


@lru_cache(maxsize=64)
def _parse_number(word: bytes) -> float:
    """Parse a number that the kernel leaves; cached, as many logs repeat a few in every line."""
    if word.translate(None, NUMBER_CHARACTERS):
        raise ValueError(f"{shorten(word.decode(errors='replace'))} where a number belongs")
    return float(word.strip() or "nan")
