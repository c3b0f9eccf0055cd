"""How evidence files keep numbers: as narrow as they can be; slices of all builds end to end."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from occmap.arrays import Int64
from occmap.cells import Slices

WIDTHS = ("<i1", "<i2", "<i4", "<i8")
SLICE_ARRAYS = (
    *("layers", "slice_tiles", "slices"),
    *("slice_rows", "slice_parts", "slice_changes"),
)

Arrays = dict[str, Any]


def narrow(values: Int64) -> Any:
    """Convert integers to the smallest signed type that holds them all."""
    low, high = int(values.min(initial=0)), int(values.max(initial=0))
    widths = (each for each in WIDTHS if np.iinfo(each).min <= low <= high <= np.iinfo(each).max)
    return values.astype(next(widths))


def pack_slices(layers: Sequence[Slices]) -> Arrays:
    """Lay the arrays of each build end to end."""
    sizes = [(len(each.numbers), len(each.parts), len(each.changes)) for each in layers]
    layout = np.array(sizes, "<i8").reshape(-1, 3)
    whole = Slices.join(layers)
    columns = (layout, narrow(whole.tiles), narrow(whole.numbers))
    bits = (whole.rows, whole.parts, whole.changes)
    return dict(zip(SLICE_ARRAYS, (*columns, *bits), strict=True))


def unpack_slices(arrays: Arrays) -> tuple[Slices, ...]:
    """Cut the slices of each build out again.

    Raises
    ------
    LookupError, ValueError
        The arrays do not fit each other.
    """
    tiles, parts, changes = np.cumsum(arrays["layers"], axis=0).T  # where each layer ends
    columns = (
        np.split(arrays["slice_tiles"].astype(np.int64), tiles),
        np.split(arrays["slices"].astype(np.int64), tiles),
        np.split(arrays["slice_rows"], tiles),
        np.split(arrays["slice_parts"], parts),
        np.split(arrays["slice_changes"], changes),
    )
    *layers, rest = (Slices(*layer) for layer in zip(*columns, strict=True))
    if not all(map(is_whole, (*layers, rest))) or len(rest.tiles):
        raise ValueError("layers")
    return tuple(layers)


def is_whole(slices: Slices) -> bool:
    """Whether there are as many numbers, parts and changes as tiles, rows and parts ask for."""
    size, bits = len(slices.tiles), (slices.rows, slices.parts, slices.changes)
    return (
        {each.dtype for each in bits} == {np.dtype(np.uint8)}
        and slices.numbers.shape == (size,)
        and slices.rows.shape == (size, 16)
        and slices.parts.shape == (np.bitwise_count(slices.rows).sum(dtype=np.int64),)
        and slices.changes.shape == (np.bitwise_count(slices.parts).sum(dtype=np.int64),)
    )
