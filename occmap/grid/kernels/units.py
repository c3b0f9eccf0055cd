"""What the loops count in: kinds of beams, and lattice units.

They stand beside the loops, and not with the types, as machine code is kept under a digest of this
folder: numba builds their values in.
"""

SKIP, HIT = 0, 2
"""`occmap.types.Kind` as plain integers."""

CELL_SHIFT = 8
"""`units >> CELL_SHIFT` is the row or column that a coordinate lies in."""
UNITS_PER_CELL = 1 << CELL_SHIFT
HALF_CELL = UNITS_PER_CELL // 2
