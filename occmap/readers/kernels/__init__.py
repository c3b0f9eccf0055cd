"""Loops over the text of logs, compiled by numba; what is said here needs no numba."""

NUMBER, SECONDS, NANOSECONDS, ANY = range(4)
"""What a word of a line is: a number, a time in either unit, or nothing that is asked for."""
