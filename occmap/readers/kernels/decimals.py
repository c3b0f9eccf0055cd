"""Decimal numbers and times in text, parsed as fast as the text can be read.

A number of up to 15 digits is an integer divided by a power of ten. Both are exact in the 53 bits
of a float and their quotient is rounded once, so it is what Python's `float` gives. Every other
word is left to the caller.
"""

import numpy as np

from occmap.jit import kernel
from occmap.readers.kernels import ANY, NUMBER, SECONDS
from occmap.types import Float64, Int64, UInt8, UInt64

PADDING = b"\n" * 8
"""What must follow the last line: words are looked at eight bytes at a time."""
MOST_DIGITS = 15
"""Every integer of this many digits is below 2 to the power of 53."""
MOST_TIME_DIGITS = 19
"""Whole nanoseconds of this many digits fit 64 bits where the first is not 9."""
POWERS: Float64 = np.array([float(10**n) for n in range(MOST_DIGITS + 1)])
_ZERO, _NINE, _DOT, _MINUS, _BLANK, _END = 48, 57, 46, 45, 32, 10
_I, _N, _F = 105, 110, 102

_ZEROS = np.uint64(0x3030303030303030)
_BEYOND_NINE = np.uint64(0x7676767676767676)
"""Added to digits, it sets the highest bit of every byte that is none."""
_HIGHEST = np.uint64(0x8080808080808080)
_PLACES = np.uint64(0x0001020304050607)
_PAIRS, _FOURS, _EIGHTS = (
    np.uint64(0x00FF00FF00FF00FF),
    np.uint64(0x0000FFFF0000FFFF),
    np.uint64(0x00000000FFFFFFFF),
)
_BY_10, _BY_100, _BY_10000 = np.uint64(10), np.uint64(100), np.uint64(10000)
_ONE, _SEVEN, _BYTE, _TWO_BYTES, _FOUR_BYTES, _SEVEN_BYTES = map(np.uint64, (1, 7, 8, 16, 32, 56))


@kernel
def parse_rows(
    text: UInt8,
    eights: UInt64,
    separator: int,
    kinds: UInt8,
    powers: Float64,
    values: Float64,
    times: Int64,
    left: Int64,
) -> int:
    """Parse the words of lines that hold as many each.

    Parameters
    ----------
    text
        (L,) bytes: S lines, each with its end, and `PADDING`.
    eights
        (L - 7,) the eight bytes from each byte on, the first one lowest.
    separator
        What stands between two words: one comma, or any number of blanks.
    kinds
        (N,) what each word of a line is.
    powers
        `POWERS`.
    values
        (S, N) filled with the numbers, and with NaN where nothing stands between two commas.
    times
        (S, N) filled with the times (ns); it may be the same memory, since no word is both.
    left
        (M, 4) filled with row, column, start and end of each word that is left to the caller.

    Returns
    -------
    int
        How many words are left; -1 where a line has more or fewer words than N, or where more words
        are left than there is room for.
    """
    rows, cols = values.shape
    lefts = 0
    at: int | np.int64 = 0
    for row in range(rows):
        for col in range(cols):
            while separator == _BLANK and text[at] == _BLANK:
                at += 1
            kind = kinds[col]
            # The usual number, digits with a dot between, up to seven bytes, all at once.
            eight = eights[at] ^ _ZEROS
            others = ((eight + _BEYOND_NINE) | eight) & _HIGHEST
            dot = (others & (~others + _ONE)) >> _SEVEN
            others &= others - _ONE
            end = (others & (~others + _ONE)) >> _SEVEN
            digits = np.int64((dot * _PLACES) >> _SEVEN_BYTES)
            length = np.int64((end * _PLACES) >> _SEVEN_BYTES)
            after = text[at + length]
            is_usual = length > 1 and text[at + digits] == _DOT and after in (separator, _END)
            if kind == NUMBER and is_usual:
                before = dot - _ONE
                eight = (eight & before) | (((eight & (end - _ONE)) >> _BYTE) & ~before)
                eight = (eight * _BY_10 + (eight >> _BYTE)) & _PAIRS
                eight = (eight * _BY_100 + (eight >> _TWO_BYTES)) & _FOURS
                eight = (eight * _BY_10000 + (eight >> _FOUR_BYTES)) & _EIGHTS
                values[row, col] = np.float64(eight) / powers[8 - digits]
                at += length
            else:
                start = at
                if text[at] == _MINUS:
                    at += 1
                first, number, dots, decimals = at, np.int64(0), 0, 0
                while True:
                    if _ZERO <= text[at] <= _NINE:
                        number *= 10
                        number += text[at] - _ZERO
                        decimals += dots
                    elif text[at] == _DOT and dots == 0:
                        dots = 1
                    else:
                        break
                    at += 1
                count, is_read = at - first - dots, True
                if text[at] != separator and text[at] != _END:
                    count = 0
                    while text[at] != separator and text[at] != _END:
                        at += 1
                if at == start and separator == _BLANK:
                    return -1
                if kind == NUMBER:
                    value = np.nan
                    if 0 < count <= MOST_DIGITS:
                        value = number / powers[decimals]
                    elif at - first == 3 and text[first] == _I and text[at - 1] == _F:
                        is_read = text[at - 2] == _N
                        value = np.inf
                    else:
                        is_read = at == start
                    values[row, col] = -value if start < first else value
                elif kind != ANY:
                    more = 9 - decimals if kind == SECONDS else 0
                    is_plain = start == first and more >= 0 and (kind == SECONDS or dots == 0)
                    room = MOST_TIME_DIGITS - more - (text[first] == _NINE)
                    is_read = is_plain and 0 < count <= room
                    if is_read:
                        for _ in range(more):
                            number *= 10
                        times[row, col] = number
                if not is_read:
                    if lefts == len(left):
                        return -1
                    left[lefts, 0], left[lefts, 1] = row, col
                    left[lefts, 2], left[lefts, 3] = start, at
                    lefts += 1
            if col < cols - 1:
                if text[at] == _END:
                    return -1
                at += 1
        while separator == _BLANK and text[at] == _BLANK:
            at += 1
        if text[at] != _END:
            return -1
        at += 1
    return lefts
