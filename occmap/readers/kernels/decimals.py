"""Decimal numbers and times in text, parsed as fast as the text can be read.

A number of up to 15 digits is an integer divided by a power of ten. Both are exact in the 53 bits
of a float and their quotient is rounded once, so it is what Python's `float` gives. Every other
word is left to the caller.
"""

import numpy as np

from occmap.arrays import Bool, Float32, Float64, Int64, UInt8, UInt64
from occmap.jit import kernel
from occmap.readers.kernels import ANY, NUMBER, RANGE, SAME, SECONDS

MOST_DIGITS = 15
"""Every integer of this many digits is below 2 to the power of 53."""
MOST_TIME_DIGITS = 19
"""Whole nanoseconds of this many digits fit 64 bits where the first is not 9."""
POWERS: Float64 = np.array([float(10**n) for n in range(MOST_DIGITS + 1)])
_ZERO, _NINE, _DOT, _MINUS, _BLANK, _QUOTE, _END = map(ord, '09.- "\n')

_INF, _NAN = (np.uint64(int.from_bytes(word, "little")) for word in (b"inf", b"nan"))
_THREE_BYTES = np.uint64(0xFFFFFF)

# Eight bytes of text as one number, the first byte lowest.
_DIGIT_BITS = np.uint64(0x1010101010101010)
"""Every digit has this bit; dots, commas, blanks and line ends have not."""
_UPPER, _LOWER = np.uint64(0xF0F0F0F0F0F0F0F0), np.uint64(0x0F0F0F0F0F0F0F0F)
_SIXES = np.uint64(0x0606060606060606)
"""Added to the lower halves of bytes, it sets a digit bit where they are above nine."""
_PAIRS, _FIRST_PAIRS, _LAST_PAIRS = (
    np.uint64(0x000000FF000000FF),
    np.uint64(100 + (1000000 << 32)),
    np.uint64(1 + (10000 << 32)),
)
_NONE, _ONE, _EIGHT, _TEN, _SIXTEEN, _HALF, _BYTE = map(np.uint64, (0, 1, 8, 10, 16, 32, 0xFF))


@kernel
def parse_rows(
    text: UInt8,
    eights: UInt64,
    starts: Int64,
    separator: int,
    kinds: UInt8,
    same: UInt8,
    ranges: Float32,
    values: Float64,
    alike: Bool,
    left: Int64,
) -> int:
    """Parse the words of S lines that hold N each; lines that hold more or fewer are passed over.

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
    same
        Bytes: the words that are the same in every line, each with a separator behind it.
    ranges
        (S, B) filled with the ranges, and with NaN where nothing stands between two commas.
    values
        (N, S) filled likewise with other numbers; the rows of times hold ns, as whole numbers of 64
        bits in place of floats.
    alike
        (S,) filled with whether a line has N words, each parsed or left to the caller.
    left
        (M, 4) filled with row, column, start and end of each word that is left to the caller. A
        line for which there is no more room counts as unlike.

    Returns
    -------
    int
        How many words are left.
    """
    times = values.view(np.int64)
    cols = len(kinds)
    lefts = 0
    # Most ranges are written in the form of those before them, such as 12.34 and a comma, in up to
    # seven bytes. One comparison tells that a word has this usual form, and all its digits are
    # then taken at once: those before the dot, and those behind it, moved up by one place.
    usual, usual_bits, others = _ONE, _NONE, 0  # at first, no word has it
    before_dot, behind_dot, width, power = _NONE, _NONE, _NONE, 1.0
    for row in range(len(starts)):
        # No index is negative, and numba need not look whether it is.
        at, same_at, col, beam = np.uint64(starts[row]), _NONE, 0, 0
        while col < cols:
            while kinds[col] == RANGE and col < cols - 1:
                word = eights[at]
                digits = (word & before_dot) | ((word >> _EIGHT) & behind_dot)
                if word & usual_bits != usual or (digits + _SIXES) & _DIGIT_BITS:
                    break
                digits = digits * _TEN + (digits >> _EIGHT)
                odd_pairs, even_pairs = digits & _PAIRS, (digits >> _SIXTEEN) & _PAIRS
                digits = (odd_pairs * _FIRST_PAIRS + even_pairs * _LAST_PAIRS) >> _HALF
                ranges[row, beam] = np.float64(np.int64(digits)) / power
                at += width
                col += 1
                beam += 1
                others = 0
            while separator == _BLANK and text[at] == _BLANK:
                at += _ONE
            kind, start = kinds[col], at
            if kind == SAME:
                while same[same_at] != separator and same[same_at] == text[at]:
                    same_at += _ONE
                    at += _ONE
                if same[same_at] != separator or text[at] not in (separator, _END):
                    break
                same_at += _ONE
            else:
                if text[at] == _MINUS:
                    at += _ONE
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
                    at += _ONE
                count, is_read, has_quote = int(at - first) - dots, True, False
                if text[at] != separator and text[at] != _END:
                    count = 0
                    while text[at] != separator and text[at] != _END:
                        has_quote |= text[at] == _QUOTE
                        at += _ONE
                if has_quote or (at == start and separator == _BLANK):
                    break  # a quote may hold a separator
                if kind >= NUMBER:
                    size, name = np.int64(at - first), eights[first] & _THREE_BYTES
                    value = np.nan
                    if 0 < count <= MOST_DIGITS:
                        value = number / POWERS[decimals]
                    elif size == 3 and name == _INF:
                        value = np.inf
                    elif size != 3 or name != _NAN:
                        is_read = at == start  # an empty cell
                    value = -value if start < first else value
                    if kind == RANGE:
                        ranges[row, beam] = value
                        beam += 1
                        others += 1
                    else:
                        values[col, row] = value
                    is_short = first == start and 0 < count < 8 - dots and text[at] == separator
                    if others > 1 and is_short:  # a second word in a row: its form is now usual
                        others, whole = 0, count - decimals
                        width, power = np.uint64(count + dots + 1), POWERS[8 - whole]
                        dot_at, end_at = np.uint64(8 * whole), np.uint64(8 * (count + dots))
                        word_bits = (_ONE << end_at) - _ONE
                        before_dot = ((_ONE << dot_at) - _ONE) & _LOWER
                        behind_dot = (word_bits >> _EIGHT) & _LOWER & ~before_dot
                        dot_bits = np.uint64(255 * dots) << dot_at
                        usual_bits = word_bits & _UPPER | dot_bits | _BYTE << end_at
                        usual = eights[start] & usual_bits
                elif kind != ANY:
                    more = 9 - decimals if kind == SECONDS else 0
                    is_plain = start == first and more >= 0 and (kind == SECONDS or dots == 0)
                    room = MOST_TIME_DIGITS - more - (text[first] == _NINE)
                    is_read = is_plain and 0 < count <= room
                    if is_read:
                        for _ in range(more):
                            number *= 10
                        times[col, row] = number
                if not is_read:
                    if lefts == len(left):
                        break
                    left[lefts, 0], left[lefts, 1] = row, col
                    left[lefts, 2], left[lefts, 3] = start, at
                    lefts += 1
            if col < cols - 1:
                if text[at] == _END:
                    break
                at += _ONE
            col += 1
        else:
            while separator == _BLANK and text[at] == _BLANK:
                at += _ONE
            alike[row] = text[at] == _END
    return lefts
