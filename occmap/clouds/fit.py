"""Grounds of evidence that is combined: one for both, or a refusal."""

import numpy as np

from occmap.cells import Ground
from occmap.errors import MapError
from occmap.types import Int64

UNEVEN_MM = 50
"""Columns whose ground differs by more were not traced alike."""
UNEVEN_SHARE = 0.05
"""Noise of poses makes some such columns; more than this share of them is a different ground."""


def join_grounds(ground: Ground | None, other: Ground | None, where: str) -> Ground | None:
    """Extend a ground by another one where it has none.

    Parameters
    ----------
    where
        The file of the other one.

    Raises
    ------
    MapError
        They differ where both were measured.
    """
    if ground is None or other is None:
        return ground or other
    blocks = np.unique(np.concatenate([ground.blocks, other.blocks]), axis=0)
    mine, its = spread(ground, blocks), spread(other, blocks)
    both = mine.measured & its.measured
    uneven = np.abs(mine.height_mm - its.height_mm)[both] > UNEVEN_MM
    if uneven.sum() > UNEVEN_SHARE * len(uneven):
        raise MapError(
            f"lies over other ground: {uneven.mean():.0%} of what both measured differs by more "
            f"than {UNEVEN_MM / 1000:g} m",
            where=where,
            fix="build it over the ground of the other one: `ground=first.npz`",
        )
    known = mine.measured | ((mine.height_mm > its.height_mm) & ~its.measured)
    height = np.where(known, mine.height_mm, its.height_mm)
    return Ground(blocks, height, mine.measured | its.measured)


def spread(ground: Ground, blocks: Int64) -> Ground:
    """Put a ground in its place among more blocks (B, 2), which are in ascending order."""
    shape = len(blocks), ground.height_mm.shape[1]
    height, measured = np.full(shape, -(1 << 30), np.int32), np.zeros(shape, np.bool_)
    places = {tuple(block): at for at, block in enumerate(blocks.tolist())}
    at = [places[tuple(block)] for block in ground.blocks.tolist()]
    height[at], measured[at] = ground.height_mm, ground.measured
    return Ground(blocks, height, measured)
