"""Evidence files: plain NumPy, the same bytes every time, and refused when not as written."""

import json
import zipfile
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from occmap.cells import Evidence, Manifest, Slices
from occmap.errors import MapError
from occmap.grid.tiles import pack_bits
from occmap.types import Int64
from occmap.writers import npz
from occmap.writers.npz import SIDE, SLICES, add_array, narrow, read_evidence, write_evidence
from tests.grid.scans import are_equal, assert_same_slices

SELECTION = {"topics": [], "start_s": "-inf", "end_s": 2.5, "stride": 1}
BUILD = {
    "occmap": "0.1.0",
    "inputs": [{"name": "log.csv", "bytes": 3, "sha256": "ab"}],
    "options": {"model": "simple", "selection": SELECTION, "posing": {"poses": None}},
    "scans": {"read": 2, "used": 1, "dropped": {"no beams": 1}, "beams": {"hit": 3}},
}
MANIFEST = Manifest(0.05, "beam", "counts", "", 10.0, 0.0, "simple:prior=0.5", (BUILD, BUILD))


def evidence_of(cells: dict[tuple[int, int], tuple[int, int]]) -> Evidence:
    """Two tiles, at (-1, 0) and (2, 3), with these numbers at (row, col) of the first."""
    values = np.zeros((2, 2, SIDE, SIDE), np.int64)
    values[1, :, 63, 63] = 1, 0
    for (row, col), pair in cells.items():
        values[0, :, row, col] = pair
    tiles = dict(zip([(-1, 0), (2, 3)], values, strict=True))
    return Evidence(MANIFEST, tiles, (mark(values), NO_SLICES))


def mark(values: Int64) -> Slices:
    """The first tile was observed in slice -7, and all of it again in 300; the second in 5."""
    bits = np.packbits(values != 0, axis=-1)
    bits[:, 1] |= bits[:, 0]
    tiles = np.array([[-1, 0], [-1, 0], [2, 3]])
    return pack_bits(tiles, np.array([-7, 300, 5]), np.stack([bits[0], bits[0] | 255, bits[1]]))


NO_SLICES = Slices.join([])


SMALL = evidence_of({(0, 0): (3, 5), (0, 1): (0, 200), (7, 9): (1, 0)})


def write(path: Path, evidence: Evidence = SMALL) -> Path:
    write_evidence(path, evidence)
    return path


def test_what_is_read_is_what_was_written(tmp_path: Path) -> None:
    path = write(tmp_path / "m.npz")
    back = read_evidence(path)
    assert back.manifest == MANIFEST
    assert are_equal(back.tiles, SMALL.tiles)
    assert_equal_slices(back, SMALL)
    assert back.where == str(path)


def assert_equal_slices(one: Evidence, other: Evidence) -> None:
    for mine, its in zip(one.slices, other.slices, strict=True):
        assert_same_slices(mine, its)


def test_slices_of_any_number_of_builds(tmp_path: Path) -> None:
    (some, _) = SMALL.slices
    for slices in ((some,), (NO_SLICES, some), (NO_SLICES, some, NO_SLICES, some)):
        manifest = replace(MANIFEST, builds=(BUILD,) * len(slices))
        evidence = replace(SMALL, manifest=manifest, slices=slices)
        assert_equal_slices(read_evidence(write(tmp_path / "m.npz", evidence)), evidence)
    nothing = replace(SMALL, manifest=replace(MANIFEST, builds=()), tiles={}, slices=())
    assert read_evidence(write(tmp_path / "m.npz", nothing)).slices == ()


def test_numpy_alone_reads_it(tmp_path: Path) -> None:
    with np.load(write(tmp_path / "m.npz"), allow_pickle=False) as file:
        assert json.loads(bytes(file["manifest"]))["resolution"] == 0.05
        seen = np.unpackbits(file["observed"], axis=1).reshape(-1, 64, 64).astype(bool)
        assert file["first"].tolist() == [3, 0, 1, 1]
        assert (file["first"].dtype, file["second"].dtype) == (np.int8, np.int16)
        assert file["slices"].tolist() == [-7, 300, 5]
        assert (file["slices"].dtype, file["slice_tiles"].dtype) == (np.int16, np.int8)
        parts = np.zeros(file["slice_rows"].size * 8, np.uint8)
        parts[np.unpackbits(file["slice_rows"]).astype(bool)] = file["slice_parts"]
        bits = np.zeros(parts.size * 8, np.uint8)
        bits[np.unpackbits(parts).astype(bool)] = file["slice_changes"]
        bits = np.bitwise_xor.accumulate(bits.reshape(-1, 2, 64, 8), axis=2)
        hit, seen_then = np.unpackbits(bits, axis=3).swapaxes(0, 1)
        small = SMALL.slices[0]
        assert file["layers"].tolist() == [[3, len(small.parts), len(small.changes)], [0, 0, 0]]
    assert np.argwhere(seen).tolist() == [[0, 0, 0], [0, 0, 1], [0, 7, 9], [1, 63, 63]]
    assert np.argwhere(seen_then[[0, 2]]).tolist() == np.argwhere(seen).tolist()
    assert np.argwhere(hit[[0, 2]]).tolist() == [[0, 0, 0], [0, 7, 9], [1, 63, 63]]
    assert hit[1].all()
    assert seen_then[1].all()


def test_writing_twice_gives_the_same_bytes(tmp_path: Path) -> None:
    first, second = write(tmp_path / "a.npz"), write(tmp_path / "b.npz")
    assert first.read_bytes() == second.read_bytes()
    with zipfile.ZipFile(first) as archive:
        assert {each.date_time[0] for each in archive.infolist()} == {1980}


@pytest.mark.parametrize(
    ("values", "width"),
    [([], 1), ([127, -128], 1), ([128], 2), ([-(2**15) - 1], 4), ([2**31], 8), ([-(2**63)], 8)],
)
def test_numbers_are_as_narrow_as_they_can_be(values: list[int], width: int) -> None:
    narrowed = narrow(np.array(values, np.int64))
    assert (narrowed.dtype.itemsize, narrowed.tolist()) == (width, values)


def test_sums_beyond_32_bits_survive(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    large = evidence_of({(1, 1): (2**40, 2**33)})
    monkeypatch.setattr(npz, "BATCH", 1)  # numbers of the other tile are narrow
    assert are_equal(read_evidence(write(tmp_path / "m.npz", large)).tiles, large.tiles)


def damage(path: Path, content: bytes) -> str:
    """Return the one line that reading such a file ends with."""
    path.write_bytes(content)
    with pytest.raises(MapError) as caught:
        read_evidence(path)
    line = str(caught.value)
    assert line.startswith(f"{path}: ")
    return line


def test_a_cut_file_is_refused(tmp_path: Path) -> None:
    path = write(tmp_path / "m.npz")
    whole = path.read_bytes()
    for length in range(0, len(whole), 17):
        damage(path, whole[:length])


def test_an_altered_file_is_refused_or_says_the_same(tmp_path: Path) -> None:
    path = write(tmp_path / "m.npz")
    whole = path.read_bytes()
    refused = 0
    positions = range(0, len(whole), 7)
    for position in positions:
        path.write_bytes(whole[:position] + bytes([whole[position] ^ 0x41]) + whole[position + 1 :])
        try:
            back = read_evidence(path)
        except MapError:
            refused += 1
        else:  # a date in the zip's directory, say
            assert are_equal(back.tiles, SMALL.tiles)
            assert back.manifest == MANIFEST
            assert_equal_slices(back, SMALL)
    assert refused > 0.8 * len(positions)


def rewrite(path: Path, **changed: Any) -> bytes:
    """The file with other arrays, stored as a program that means well might."""
    with np.load(path) as file:
        arrays = {name: file[name] for name in file.files} | changed
    with zipfile.ZipFile(path, "w") as archive:
        for name, array in arrays.items():
            add_array(archive, name, array)
    return path.read_bytes()


def to_bytes(text: str) -> Any:
    return np.frombuffer(text.encode(), np.uint8)


@pytest.mark.parametrize("name", ["first", "layers", "manifest", *SLICES])
def test_what_was_altered_on_purpose_is_refused(tmp_path: Path, name: str) -> None:
    path = write(tmp_path / "m.npz")
    with np.load(path) as file:
        array = file[name]
    if name == "manifest":
        array = to_bytes(bytes(array).decode().replace("0.05", "0.06"))
    else:
        array.flat[0] ^= 1
    altered = "the checksum does not fit: the file was altered; build it again"
    assert altered in damage(path, rewrite(path, **{name: array}))


@pytest.mark.parametrize(
    ("manifest", "found"),
    [
        ("", "it is cut or altered"),
        ("[]", "it is cut or altered"),
        ("{}", "it is cut or altered"),
        ('{"format": "occmap evidence", "version": 5}', "it is cut or altered"),
        ('{"format": "occmap evidence", "version": 6}', "version 6, while this occmap reads 5"),
        ('{"format": "occmap evidence", "version": 4}', "build it again from its logs, with `outp"),
        ('{"format": "else", "version": 1}', "holds 'else', not evidence of occmap"),
        ('{"format": "else"}', "holds 'else', not evidence of occmap"),
    ],
)
def test_other_manifests_are_refused(tmp_path: Path, manifest: str, found: str) -> None:
    path = write(tmp_path / "m.npz")
    assert found in damage(path, rewrite(path, manifest=to_bytes(manifest)))


def test_other_files_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "m.npz"
    with pytest.raises(MapError, match=r"m.npz: no such file"):
        read_evidence(path)
    assert "is not an evidence file" in damage(path, b"P5 1 1 255 x")
    np.savez(path, a=np.zeros(3))
    assert "is an .npz, but not evidence of occmap" in damage(path, path.read_bytes())
    np.savez(path, manifest=np.array([{}], dtype=object))
    assert "it is cut or altered" in damage(path, path.read_bytes())
    np.savez_compressed(path, manifest=to_bytes("{}"))
    assert "it is cut or altered" in damage(path, path.read_bytes())
    with pytest.raises(MapError, match="Is a directory"):
        read_evidence(tmp_path)
