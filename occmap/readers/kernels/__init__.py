"""Loops over the text of logs, compiled by numba; what is said here needs no numba."""

ANY, SAME, SECONDS, NANOSECONDS, NUMBER, RANGE = range(6)
"""What a word of a line is: nothing that is asked for, the same in every line, a time in either
unit, a number, or the range of a beam."""
PADDING = b"\n" * 16
"""What must follow the last line: words are looked at up to sixteen bytes at a time."""
