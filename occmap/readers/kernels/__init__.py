"""Loops over the text of logs, compiled by numba; what is said here needs no numba."""

NUMBER, SECONDS, NANOSECONDS, ANY = range(4)
"""What a word of a line is: a number, a time in either unit, or nothing that is asked for."""
PADDING = b"\n" * 8
"""What must follow the last line: words are looked at eight bytes at a time."""
