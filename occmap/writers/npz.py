"""Evidence files: a NumPy .npz of plain integers, nothing pickled and nothing compressed.

| array | shape, type | holds |
|---|---|---|
| `manifest` | (M,) uint8 | JSON in UTF-8: what this is, what it was made of, and a checksum |
| `tiles` | (T, 2) int64 | row and column of each tile; (r, c) begins at cell (64 r, 64 c) |
| `observed` | (T, 512) uint8 | a bit for each of the 64 x 64 cells, `np.packbits` order |
| `first` | (N,) smallest signed type that fits | hits, or sums of log-odds in units of 1/65536 |
| `second` | (N,) likewise | misses, or observations |
| `layers` | (L, 3) int64 | how much of K, R and C belongs to each of the manifest's builds |
| `slice_tiles` | (K, 2) likewise | a tile that a slice of time observed, as in `tiles` ... |
| `slices` | (K,) likewise | ... and the slice; by tile, then by time |
| `slice_rows` | (K, 16) uint8 | a bit for each row of hit, then of seen cells: is any byte kept? |
| `slice_parts` | (R,) uint8 | for each row that says so, a bit for each of its 8 bytes |
| `slice_changes` | (C,) uint8 | for each byte that is kept, that byte |
| `ground_blocks` | (G, 2) int64 | of clouds only: row and column of each block of 64 x 64 columns |
| `ground_mm` | (G, 4096) int32 | height of the ground of each column; -2^30: none is known |
| `ground_measured` | (G, 512) uint8 | a bit for each column: whether points showed it |

N counts the observed cells, tile by tile, row by row.
A column of the ground is 0.15 m wide: (row, col) begins at (0.15 col, 0.15 row) m.
Cell (row, col) reaches from (col, row) * resolution to (col + 1, row + 1) * resolution in metres.
Slice n lasts from n to n + 1 times `pass_gap_s` (in the manifest). In a slice each tile has a bit
for each of 64 x 64 cells that was hit, none for log-odds, and then for each that was seen. Of the 8
bytes of a row (`np.packbits` order), exclusive or those of the row before, the ones that are not 0
are kept. A visit is a run of slices in which a cell was seen, without a slice between. Without
occmap:

    file = np.load("map.npz")
    seen = np.unpackbits(file["observed"], axis=1).reshape(-1, 64, 64).astype(bool)
    hits = np.zeros(seen.shape, int); hits[seen] = file["first"]
    parts = np.zeros(file["slice_rows"].size * 8, np.uint8)
    parts[np.unpackbits(file["slice_rows"]).astype(bool)] = file["slice_parts"]
    bits = np.zeros(parts.size * 8, np.uint8)
    bits[np.unpackbits(parts).astype(bool)] = file["slice_changes"]
    bits = np.bitwise_xor.accumulate(bits.reshape(-1, 2, 64, 8), axis=2)
    hit, seen_then = np.unpackbits(bits, axis=3).swapaxes(0, 1)  # (K, 64, 64) of each

Equal evidence makes equal bytes on every machine: no time stamps, no compression library.
"""

import hashlib
import json
import struct
import tokenize
import zipfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict
from glob import has_magic
from pathlib import Path
from typing import Any

import numpy as np

from occmap.cells import (
    Evidence,
    Ground,
    Key,
    Manifest,
    Slices,
    Tile,
    stack_tiles,
    sum_tiles,
    view_tiles,
)
from occmap.errors import MapError
from occmap.types import Int64, UInt8
from occmap.writers import Product, WriteOptions, Writer
from occmap.writers.atomic import open_atomic

FORMAT, VERSION = "occmap evidence", 5
SIDE = 64
"""Cells along the side of a tile."""
BATCH = 1024
"""Tiles are packed so many at a time: all at once, evidence would be in memory twice"""
MAGIC = b"PK\x03\x04"
SLICES = ("slice_tiles", "slices", "slice_rows", "slice_parts", "slice_changes")
"""The arrays of `Slices`, in its order"""
ARRAYS = ("tiles", "observed", "first", "second", "layers", *SLICES)
GROUND = ("ground_blocks", "ground_mm", "ground_measured")
"""The arrays of the ground, in evidence of clouds"""
Arrays = dict[str, Any]
DAMAGE = (
    *(zipfile.BadZipFile, struct.error, tokenize.TokenError, EOFError, NotImplementedError),
    *(LookupError, ValueError, TypeError, AttributeError, OverflowError),
    *(RuntimeError, MemoryError, OSError),
)
"""What zipfile, zarr, its codecs, json and NumPy raise on damaged files"""


class NpzWriter(Writer):
    """What was observed, to be rendered, merged and resumed."""

    description = "evidence, not yet a map: to render, merge and resume"
    needs_evidence = in_parts = True

    def write_product(self, path: Path, product: Product, _: WriteOptions) -> None:
        """Write the evidence."""
        write_evidence(path, product.evidence())


def write_evidence(path: Path, evidence: Evidence) -> None:
    """Write evidence.

    Raises
    ------
    OutputError
        It cannot be written; then nothing is left behind.
    """
    arrays = pack_evidence(evidence)
    head = {"format": FORMAT, "version": VERSION, **asdict(evidence.manifest)}
    head["evidence"] = evidence.manifest.identify(sum_tiles(evidence.tiles))
    head["checksum"] = compute_checksum(head, arrays)
    text = json.dumps(head, sort_keys=True, indent=1, allow_nan=False)
    arrays = {"manifest": np.frombuffer(text.encode(), np.uint8), **arrays}
    with open_atomic(path) as (file,), zipfile.ZipFile(file, "w") as archive:
        for member, array in arrays.items():
            add_array(archive, member, array)


def add_array(archive: zipfile.ZipFile, name: str, array: Any) -> None:
    """Store an array as `np.savez` does, but without a word about this machine."""
    member = zipfile.ZipInfo(f"{name}.npy")  # of the year 1980
    member.create_system = 3
    with archive.open(member, "w", force_zip64=True) as file:
        np.lib.format.write_array(file, array, version=(1, 0), allow_pickle=False)


def pack_evidence(evidence: Evidence) -> Arrays:
    """Keep the observed cells only, each number as narrow as all of its kind allow."""
    keys = sorted(evidence.tiles)
    batches = [keys[start : start + BATCH] for start in range(0, len(keys), BATCH)] or [[]]
    packed = [pack_tiles({key: evidence.tiles[key] for key in batch}) for batch in batches]
    tiles, observed, first, second = map(np.concatenate, zip(*packed, strict=True))
    return {
        "tiles": tiles.astype("<i8"),
        "observed": observed,
        "first": narrow(first),
        "second": narrow(second),
        **pack_slices(evidence.slices),
        **pack_ground(evidence.ground),
    }


def pack_tiles(tiles: Mapping[Key, Tile]) -> tuple[Int64, UInt8, Any, Any]:
    """Places of tiles, bits of the cells that were observed, and their two numbers."""
    places, cells = stack_tiles(tiles)
    seen = (cells != 0).any(axis=1)
    bits = np.packbits(seen.reshape(len(seen), SIDE * SIDE), axis=1)
    return places, bits, narrow(cells[:, 0][seen]), narrow(cells[:, 1][seen])


def compute_checksum(head: dict[str, Any], arrays: Arrays) -> str:
    """SHA-256 over all that a file says of itself, but the checksum, and over arrays, in order."""
    said = {name: value for name, value in head.items() if name != "checksum"}
    digest = hashlib.sha256(json.dumps(said, sort_keys=True).encode())
    for name, array in arrays.items():
        digest.update(f"{name} {array.dtype.str} {array.shape}".encode())
        digest.update(np.ascontiguousarray(array).data)
    return digest.hexdigest()


def read_evidence(path: Path) -> Evidence:
    """Read an evidence file.

    Raises
    ------
    MapError
        It is missing, no evidence file, of another format, or not as it was written.
    """
    with refuse_damage(path), path.open("rb") as file:
        if file.read(len(MAGIC)) != MAGIC:
            fix = "build one with `outputs=map.npz`"
            raise MapError("is not an evidence file", where=path, fix=fix)
        file.seek(0)
        with np.load(file, allow_pickle=False) as archive:
            if "manifest" not in archive:
                raise MapError("is an .npz, but not evidence of occmap", where=path)
            refuse_compressed(archive.zip)
            head = json.loads(archive["manifest"].tobytes())
            refuse_other_version(path, head, FORMAT, VERSION)
            names = ARRAYS + GROUND * (GROUND[0] in archive)
            arrays = {name: archive[name] for name in names}
        return unpack_evidence(path, head, arrays)


@contextmanager
def refuse_damage(path: Path) -> Iterator[None]:
    """Say in one line that evidence is not there, or cannot be read; raises MapError."""
    try:
        yield
    except FileNotFoundError:
        fix = "leave out its quotes" if has_magic(str(path)) else "check the path"
        raise MapError("no such file", where=path, fix=fix) from None
    except DAMAGE as error:
        # A new build does not mend what keeps the system from reading it.
        system = getattr(error, "strerror", "")
        reason, fix = (system, "") if system else ("it is cut or altered", "build it again")
        raise MapError(f"cannot be read: {reason}", where=path, fix=fix) from None


def refuse_other_version(path: Path, head: dict[str, Any], name: str, version: int) -> None:
    """Refuse evidence that is not in this version of the format `name`; raises MapError.

    Parameters
    ----------
    head
        What the evidence says of itself.
    """
    if head["format"] != name:
        raise MapError(f"holds {head['format']!r}, not evidence of occmap", where=path)
    if head["version"] != version:
        is_newer = head["version"] > version
        again = f"build it again from its logs, with `outputs={path.name}`"
        raise MapError(
            f"is {name} of version {head['version']}, while this occmap reads {version}",
            where=path,
            fix="use a newer occmap" if is_newer else again,
        )


def refuse_compressed(archive: zipfile.ZipFile) -> None:
    """Raise ValueError if an archive unpacks to more than the file is large: occmap packs none."""
    if any(each.file_size != each.compress_size for each in archive.infolist()):
        raise ValueError(archive.filename)


def unpack_evidence(path: Path, head: dict[str, Any], arrays: Arrays) -> Evidence:
    """Make evidence of what a file holds, if that is what was written.

    Raises
    ------
    MapError
        The checksum does not fit, or what it is of is no evidence.
    """
    if head["checksum"] != compute_checksum(head, arrays):
        found = "the checksum does not fit: the file was altered"
        raise MapError(found, where=path, fix="build it again")
    seen = np.unpackbits(arrays["observed"], axis=1).reshape(-1, SIDE, SIDE).astype(np.bool_)
    width = max(arrays["first"].dtype.itemsize, arrays["second"].dtype.itemsize, 4)
    cells = np.zeros((len(arrays["tiles"]), 2, SIDE, SIDE), f"<i{width}")
    cells[:, 0][seen] = arrays["first"]
    cells[:, 1][seen] = arrays["second"]
    slices, ground = unpack_slices(arrays), unpack_ground(arrays)
    manifest = Manifest.from_json(head)
    return Evidence(manifest, view_tiles(arrays["tiles"], cells), slices, str(path), ground=ground)


def pack_ground(ground: Ground | None) -> Arrays:
    """Lay out the arrays of the ground, where there is one."""
    if ground is None:
        return {}
    measured = np.packbits(ground.measured, axis=1)
    arrays = ground.blocks.astype("<i8"), ground.height_mm.astype("<i4"), measured
    return dict(zip(GROUND, arrays, strict=True))


def unpack_ground(arrays: Arrays) -> Ground | None:
    """Read the ground, where there is one."""
    if GROUND[0] not in arrays:
        return None
    blocks, height, bits = (arrays[name] for name in GROUND)
    measured = np.unpackbits(bits, axis=1).astype(np.bool_)
    return Ground(blocks.astype(np.int64), height.astype(np.int32), measured)


def narrow(values: Int64) -> Any:
    """Convert integers to the smallest signed type that holds them all."""
    low, high = int(values.min(initial=0)), int(values.max(initial=0))
    width = np.min_scalar_type(min(low, -1 - high))  # of a number below 0, so it is signed
    return values.astype(width.newbyteorder("<"), copy=False)


def pack_slices(layers: Sequence[Slices]) -> Arrays:
    """Lay the arrays of each build end to end."""
    sizes = [(len(each.numbers), len(each.parts), len(each.changes)) for each in layers]
    whole = Slices.join(layers)
    keys, bits = (whole.tiles, whole.numbers), (whole.rows, whole.parts, whole.changes)
    arrays = dict(zip(SLICES, (*map(narrow, keys), *bits), strict=True))
    return {"layers": np.array(sizes, "<i8").reshape(-1, 3), **arrays}


def unpack_slices(arrays: Arrays) -> tuple[Slices, ...]:
    """Cut the slices of each build out again.

    Raises
    ------
    LookupError, ValueError
        The arrays do not fit each other.
    """
    tiles, parts, changes = np.cumsum(arrays["layers"], axis=0).T  # where each layer ends
    ends = tiles, tiles, tiles, parts, changes
    columns = [np.split(arrays[name], end) for name, end in zip(SLICES, ends, strict=True)]
    layers = [
        Slices(of_tiles.astype(np.int64), numbers.astype(np.int64), *bits)
        for of_tiles, numbers, *bits in zip(*columns, strict=True)
    ]
    return tuple(layers[:-1])  # what is behind the last layer is empty
