"""The loops over beams and cells, compiled by numba: integers in, integers added to a window.

A window is a rectangle of whole tiles. Rows, columns and lattice units that kernels see are
relative to its lower-left corner; what lies outside it is left out, exactly, so that a map may be
traced window by window.

Here is what they count in: kinds of beams, lattice units, and what a model says. It stands beside
the loops, and not with the types, as machine code is kept under a digest of this folder: numba
builds their values in. This module does not load numba.
"""

from typing import NamedTuple

from occmap.types import Int64

SKIP, FREE, HIT = 0, 1, 2
"""`occmap.types.Kind` as plain integers."""

CELL_SHIFT = 8
"""`units >> CELL_SHIFT` is the row or column that a coordinate lies in."""
UNITS_PER_CELL = 1 << CELL_SHIFT
HALF_CELL = UNITS_PER_CELL // 2

AT_A_TIME = 8
"""Short loops run over so many at a time, without a branch at their end; what they write beyond it
is overwritten."""

NO_LENGTH = 1e-300
"""What is divided by where a length is 0."""

TILE_BITS = 6
TILE = 1 << TILE_BITS
"""Cells along the side of a tile."""

PAD = 17
"""Numbers that a row of a window has beyond its cells: one for what changes behind the last, and 16
more, or rows of whole tiles would share their places in the processor's cache."""

MOST_BETWEEN = 3
"""The surface update draws at most this many beams between two neighbours: more change no map."""
ALONE = BETWEEN = 2
"""What a beam weighs in it without its neighbours, and what one that is drawn between two does."""
BEAM_WEIGHT = ALONE + 2 * MOST_BETWEEN
"""The most that a beam weighs: its own 2, and 3 for each of two neighbours on its surface. The
module `projection` says how."""
NEAR_WEIGHT = 4
"""What a cloud weighs in cells near its sensor; in those far away it weighs 1"""

MANY = 4096
"""Cells are visited when so many are listed: loops are long, and the lists fit the cache."""
COUNT_BITS = 31
"""A window is emptied before a cell of it counts 2^31 hits or misses."""


TABLE_STEPS = 2048
"""Steps of a table: a free cell's log-odds is within half a per cent of the formula's where it
matters."""
FIRST_HIT = TABLE_STEPS + 1
NOTHING = 2 * FIRST_HIT
"""Places in `Tables.entries`."""


class Tables(NamedTuple):
    """What a radial model adds to a cell, tabulated for the kernels: no cell costs a logarithm.

    An entry packs both numbers of a cell: the second in the lowest `bits`, the first above them.
    So one addition to a cell counts both.
    """

    depth: float
    """How far about the range a hit reaches (m)"""
    entries: Int64
    """From 0 on over (d / (r - depth))^2, from `FIRST_HIT` on over |d - r| / depth, and a 0 at
    `NOTHING`"""
    plain: float
    """Share of r - depth up to which all cells get the first entry"""
    largest: int
    """The largest number, either way, that an entry adds"""
    bits: int
    """A cell has room for fewer than 2^bits observations"""
