"""How evidence files keep numbers: as narrow as they can be; stamps as places in a table."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from occmap.types import Int64, Times

WIDTHS = ("<i1", "<i2", "<i4", "<i8")
TIME_ARRAYS = (
    *("layers", "time_tiles", "time_observed", "stamps"),
    *("first_seen", "last_seen", "hit_visits", "seen_visits"),
)

Arrays = dict[str, Any]


def narrow(values: Int64) -> Any:
    """Convert integers to the smallest signed type that holds them all."""
    low, high = int(values.min(initial=0)), int(values.max(initial=0))
    for width in WIDTHS:
        limits = np.iinfo(width)
        if limits.min <= low and high <= limits.max:
            break
    return values.astype(width)


def pack_times(layers: Sequence[Times]) -> Arrays:
    """Lay the layers' arrays end to end; a few thousand stamps serve a million cells."""
    first, last = join([each.first_ns for each in layers]), join([each.last_ns for each in layers])
    stamps = np.unique(np.concatenate([first, last]))
    sizes = [(len(each.tiles), len(each.first_ns)) for each in layers]
    tiles = [np.zeros((0, 2), np.int64), *(each.tiles for each in layers)]
    observed = [np.zeros((0, 512), np.uint8), *(each.observed for each in layers)]
    return {
        "layers": np.array(sizes, "<i8").reshape(-1, 2),
        "time_tiles": np.concatenate(tiles).astype("<i8"),
        "time_observed": np.concatenate(observed),
        "stamps": stamps.astype("<i8"),
        "first_seen": narrow(np.searchsorted(stamps, first)),
        "last_seen": narrow(np.searchsorted(stamps, last)),
        "hit_visits": narrow(join([each.hit_visits for each in layers])),
        "seen_visits": narrow(join([each.seen_visits for each in layers])),
    }


def join(parts: Sequence[Any]) -> Int64:
    """Lay arrays of integers, if any, end to end."""
    return np.concatenate([np.zeros(0, np.int64), *parts])


def unpack_times(arrays: Arrays) -> tuple[Times, ...]:
    """Cut the layers out again.

    Raises
    ------
    LookupError, ValueError
        The arrays do not fit each other.
    """
    if min(arrays[name].min(initial=0) for name in ("first_seen", "last_seen")) < 0:
        raise ValueError("stamps")
    tiles, cells = (np.cumsum(sizes) for sizes in arrays["layers"].T)  # where each layer ends
    columns = (
        np.split(arrays["time_tiles"], tiles),
        np.split(arrays["time_observed"], tiles),
        np.split(arrays["stamps"][arrays["first_seen"]], cells),
        np.split(arrays["stamps"][arrays["last_seen"]], cells),
        np.split(arrays["hit_visits"].astype(np.int32), cells),
        np.split(arrays["seen_visits"].astype(np.int32), cells),
    )
    layers = tuple(Times(*layer) for layer in zip(*columns, strict=True))
    for each in layers:
        if not len(each.tiles) == len(each.observed) or not is_whole(each):
            raise ValueError("layers")
    return layers[:-1]  # nothing lies behind the last


def is_whole(times: Times) -> bool:
    """Whether every cell that was observed has its four numbers."""
    cells = int(np.bitwise_count(times.observed).sum(dtype=np.int64))
    return {cells} == {
        *(len(times.first_ns), len(times.last_ns)),
        *(len(times.hit_visits), len(times.seen_visits)),
    }
