"""Decimal numbers and times in text, parsed as fast as the text can be read.

A number of up to 15 digits is an integer divided by a power of ten. Both are exact in the 53 bits
of a float and their quotient is rounded once, so it is what Python's `float` gives. Every other
word is left to the caller.
"""

import numpy as np

from occmap.jit import kernel
from occmap.readers.kernels import ANY, NUMBER, SECONDS
from occmap.types import Float64, Int64, UInt8, UInt64

MOST_DIGITS = 15
"""Every integer of this many digits is below 2 to the power of 53."""
MOST_TIME_DIGITS = 19
"""Whole nanoseconds of this many digits fit 64 bits where the first is not 9."""
POWERS: Float64 = np.array([float(10**n) for n in range(MOST_DIGITS + 1)])
_ZERO, _NINE, _DOT, _MINUS, _BLANK, _END = map(ord, "09.- \n")

_INF, _NAN = (np.uint64(int.from_bytes(word, "little")) for word in (b"inf", b"nan"))
_THREE_BYTES = np.uint64(0xFFFFFF)
_ZEROS = np.uint64(0x3030303030303030)
_BEYOND_NINE = np.uint64(0x7676767676767676)
"""Added to digits, it sets the highest bit of every byte that is none."""
_HIGHEST = np.uint64(0x8080808080808080)
_DIGIT_BITS = np.uint64(0x1010101010101010)
"""Every digit has this bit; dots, commas, blanks and line ends have not."""
_PLACES = np.uint64(0x0001020304050607)
"""Times the digit bit of a byte, it has the byte's number in its four highest bits."""
_PAIRS, _FIRST_PAIRS, _LAST_PAIRS = (
    np.uint64(0x000000FF000000FF),
    np.uint64(100 + (1000000 << 32)),
    np.uint64(1 + (10000 << 32)),
)
_ONE, _FOUR, _EIGHT, _TEN, _SIXTEEN, _HALF, _SIXTY = map(np.uint64, (1, 4, 8, 10, 16, 32, 60))


@kernel
def parse_rows(
    text: UInt8,
    eights: UInt64,
    starts: Int64,
    separator: int,
    kinds: UInt8,
    powers: Float64,
    values: Float64,
    times: Int64,
    left: Int64,
) -> int:
    """Parse the words of S lines that hold N each.

    Parameters
    ----------
    text
        (L,) bytes: lines, each with its end, and `PADDING`.
    eights
        (L - 7,) the eight bytes from each byte on, the first one lowest.
    starts
        (S,) where the lines begin that are parsed.
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
    for row in range(rows):
        at = starts[row]
        for col in range(cols):
            while separator == _BLANK and text[at] == _BLANK:
                at += 1
            kind = kinds[col]
            # The usual number, digits with a dot between, up to seven bytes, all at once. No index
            # is negative, and numba need not look whether it is.
            place = np.uint64(at)
            word = eights[place]
            others = ~word & _DIGIT_BITS
            dot = others & (~others + _ONE)
            others &= others - _ONE
            end = others & (~others + _ONE)
            whole, length = (dot * _PLACES) >> _SIXTY, (end * _PLACES) >> _SIXTY
            before, all_before = (dot >> _FOUR) - _ONE, (end >> _FOUR) - _ONE
            word ^= _ZEROS
            word = (word & before) | (((word & all_before) >> _EIGHT) & ~before)
            after = text[place + length]
            if (
                kind == NUMBER
                and length > _ONE
                and text[place + whole] == _DOT
                and (after in (separator, _END))
                and not ((word + _BEYOND_NINE) | word) & _HIGHEST
            ):
                word = word * _TEN + (word >> _EIGHT)
                word = (word & _PAIRS) * _FIRST_PAIRS + ((word >> _SIXTEEN) & _PAIRS) * _LAST_PAIRS
                values[row, col] = np.float64(np.int64(word >> _HALF)) / powers[_EIGHT - whole]
                at += np.int64(length)
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
                    value, name = np.nan, eights[first] & _THREE_BYTES
                    if 0 < count <= MOST_DIGITS:
                        value = number / powers[decimals]
                    elif at - first == 3 and name == _INF:
                        value = np.inf
                    elif at - first != 3 or name != _NAN:
                        is_read = at == start  # an empty cell
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
    return lefts
