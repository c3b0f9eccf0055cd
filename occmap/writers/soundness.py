"""What evidence must be beyond a checksum that fits, since others may write this format, too."""

import struct
import tokenize
import zipfile
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from itertools import chain
from pathlib import Path
from reprlib import repr as brief
from typing import Any

import numpy as np

from occmap.cells import MOST_OBSERVED, Evidence, Manifest
from occmap.errors import MapError
from occmap.types import Bool, Int64, Update

DAMAGE = (
    *(zipfile.BadZipFile, struct.error, tokenize.TokenError, EOFError, NotImplementedError),
    *(LookupError, ValueError, TypeError, OverflowError, RuntimeError, MemoryError, OSError),
)
"""What zipfile, zarr, its codecs, json and NumPy raise on damaged files"""

COUNTS, LOG_ODDS = "counts", "log_odds"
FARTHEST_TILE = 1 << 38
"""Cells of tiles beyond this have no coordinates that a float could hold."""

BOUNDS = (
    *(("resolution", 1e-12, 1e12), ("pass_gap_s", 1e-12, 1e12)),
    *(("hit_offset", 0, 10), ("align", -360, 360)),
)
"""Numbers of a manifest, each with a range wider than what occmap writes."""
TEXTS = {"kind": (COUNTS, LOG_ODDS), "update": tuple(Update), "profile": str, "model": str}
"""Texts of a manifest, of which some are one of a few"""

SECONDS = (float, int, "inf", "-inf")
SELECTION = {"start_s": SECONDS, "end_s": SECONDS, "stride": int, "topics": list}
BUILD = {
    "occmap": str,
    "inputs": [{"name": str, "sha256": str}],
    "options": {"selection": SELECTION, "posing": {"poses": (str, type(None))}},
    "scans": {"read": int, "used": int, "dropped": {str: int}, "beams": {str: int}},
}
"""What an entry of `Manifest.builds` holds at least: {name: ...}, {str: any number of ...}, [one or
more of ...], (one of ...), types, and texts as they are."""


@contextmanager
def refuse_damage(path: Path) -> Iterator[None]:
    """Say in one line that evidence is not there, or cannot be read; raises MapError."""
    try:
        yield
    except FileNotFoundError:
        raise MapError("no such file", where=path, fix="check the path") from None
    except DAMAGE as error:
        reason = getattr(error, "strerror", None) or "it is cut or altered"
        raise MapError(f"cannot be read: {reason}", where=path, fix="build it again") from None


def refuse_other_version(path: Path, head: dict[str, Any], name: str, version: int) -> None:
    """Refuse evidence that is not in this version of the format `name`; raises MapError.

    Parameters
    ----------
    head
        What the evidence says of itself.
    """
    if head["format"] != name:
        raise MapError(f"holds {head['format']!r}, not evidence of occmap", where=path)
    said = head["version"]
    if said > version:
        found = f"{name} of version {said}, while this occmap reads {version}"
        raise MapError(found, where=path, fix="use a newer occmap")
    if said < version:
        found = f"{name} of an older occmap (version {said}, now {version})"
        fix = f"build it again from its logs, with `outputs={path.name}`"
        raise MapError(found, where=path, fix=fix)


def refuse_faults(path: Path, faults: Iterable[str]) -> None:
    """Refuse what is not as occmap writes it; raises MapError with the first of its faults."""
    for fault in faults:
        raise MapError(f"is not what occmap writes: {fault}", where=path, fix="build it again")


def list_faults(evidence: Evidence) -> Iterator[str]:
    """List what is wrong; what comes first is what the rest relies on."""
    manifest = evidence.manifest
    yield from list_manifest_faults(manifest)
    if not (are_near(evidence.tiles) and are_ascending(evidence.tiles)):
        yield "its tiles are not in ascending order, or too far away"
    if not are_observations(evidence.cells, manifest.kind):
        yield "its cells hold what no observation makes"
    for slices in evidence.slices:
        keys = slices.tiles, slices.numbers
        if not (are_near(slices.tiles) and are_ascending(np.column_stack(keys))):
            yield "its slices of time are not in order"
    told = [map(tuple, slices.tiles.tolist()) for slices in evidence.slices]
    if not set(map(tuple, evidence.tiles.tolist())).issubset(chain(*told)):
        yield "it lacks slices of time of some tiles"


def list_manifest_faults(manifest: Manifest) -> Iterator[str]:
    """List values that occmap does not know what to do with."""
    for name, low, high in BOUNDS:
        value = getattr(manifest, name)
        if not isinstance(value, int | float) or not low <= value <= high:
            yield f"its {name} is {brief(value)}"
    for name, shape in TEXTS.items():
        value = getattr(manifest, name)
        if not fits(value, shape):
            yield f"its {name} is {brief(value)}"
    if bool(manifest.profile) != (manifest.kind == LOG_ODDS):
        yield f"its profile is {manifest.profile!r}, and its kind {manifest.kind}"
    if not all(fits(build, BUILD) for build in (*manifest.builds, *manifest.subtracted)):
        yield "its manifest does not say what it was made of"


def fits(value: Any, shape: Any) -> bool:
    """Whether a value of JSON has a shape, such as BUILD."""
    if isinstance(shape, list):
        return isinstance(value, list) and bool(value) and all(fits(v, shape[0]) for v in value)
    if isinstance(shape, tuple):
        return any(fits(value, each) for each in shape)
    if not isinstance(shape, dict):
        return isinstance(value, shape) if isinstance(shape, type) else value == shape
    if not isinstance(value, dict):
        return False
    if str in shape:
        return all(fits(each, shape[str]) for each in value.values())
    return all(name in value and fits(value[name], inner) for name, inner in shape.items())


def are_near(tiles: Int64) -> bool:
    """Whether these are rows and columns (T, 2) of tiles that a map can hold."""
    if tiles.ndim != 2 or tiles.shape[1] != 2 or tiles.dtype.str != "<i8":
        return False
    return bool((tiles < FARTHEST_TILE).all() and (tiles > -FARTHEST_TILE).all())


def are_ascending(keys: Int64) -> bool:
    """Whether every row (N, M) is above the one before: the first number that differs decides."""
    steps = np.sign(np.diff(keys, axis=0))
    return bool((steps @ (1 << np.arange(keys.shape[1])[::-1]) > 0).all())


def are_observations(cells: Int64, kind: str) -> bool:
    """Whether scans can have made the two numbers of every cell (T, 2, 64, 64)."""
    low, high = int(cells.min(initial=0)), int(cells.max(initial=0))
    if not -MOST_OBSERVED <= low <= high <= MOST_OBSERVED:
        return False
    # The rule, cell by cell, would take longer than all else that is looked at.
    return low >= 0 if kind == COUNTS else not find_unseen(cells, kind).any()


def find_unseen(cells: Int64, kind: str) -> Bool:
    """(T, 64, 64): where two numbers (T, 2, 64, 64) are such as no observation makes."""
    first, second = cells[:, 0], cells[:, 1]
    if kind == COUNTS:
        return np.asarray((first | second) < 0)
    # Log-odds may be negative, but not without an observation.
    return np.asarray((second < 0) | ((second == 0) & (first != 0)))
