"""What a path is: its first bytes, by which readers know it, or a sentence where none does.

Gzip is read so that everything before damage comes out, to the last byte that is certain.
"""

import shlex
import zlib
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from difflib import get_close_matches
from glob import has_magic
from pathlib import Path
from typing import BinaryIO

from occmap.errors import LogError

GZIP_MAGIC = b"\x1f\x8b"
GUNZIP_ERRORS = (zlib.error, EOFError)

_GZIP_BITS = 31
"""zlib's code for gzip with its header and checksum."""
_STEP = 1 << 17
_MOST_AT_ONCE = 1 << 18
"""Bytes that are unpacked at once: a bomb comes out a piece at a time."""
PROBE_BYTES = 4096
SIMILAR = 0.85
"""How alike (0 to 1) a file must be named that is suggested for one that is not there."""
ZSTD_MAGIC = b"\x28\xb5\x2f\xfd"
_MAP = "a map, not a log: `occmap diff` compares maps"
OTHER_FILES = {
    b"PK\x03\x04": ("an archive; if it is evidence (.npz), `occmap render` reads it", ""),
    b"P5": (_MAP, ""),
    b"image:": (_MAP, ""),
    b"\x89PNG": ("a picture, not a log: `occmap diff` compares maps", ""),
    b"version https://git-lfs": ("a Git LFS pointer, not the file", "fetch it: git lfs pull"),
    ZSTD_MAGIC: ("a file that zstd compressed", "decompress it first: unzstd PATH"),
}
"""By how a file begins: what it is, and how to make a log of it; "" where it never becomes one."""


@dataclass(frozen=True)
class Probe:
    """What a reader may look at to say whether a path is its own."""

    path: Path
    raw: bytes
    """The first bytes of the file; empty for a directory."""
    content: bytes
    """The first bytes of the content, unpacked where the file is gzip."""

    @property
    def lines(self) -> list[str]:
        """The first lines, if it may be text; the probe may end within the last."""
        is_text = b"\0" not in self.content
        return self.content.decode("utf-8-sig", "replace").splitlines() if is_text else []


def probe_path(path: Path) -> Probe:
    """Read the first bytes of a file, and what gzip makes of them.

    Raises
    ------
    LogError
        The path does not exist or cannot be read.
    """
    try:
        if path.is_dir():
            return Probe(path, b"", b"")
        if path.exists() and not path.is_file():
            raise LogError("neither a file nor a folder", where=path, fix="save it to a file first")
        with path.open("rb") as file:
            raw = file.read(PROBE_BYTES)
    except FileNotFoundError:
        raise _miss(path) from None
    except OSError as error:
        raise LogError(f"cannot be read ({error.strerror})", where=path) from None
    return Probe(path, raw, _peek_gzip(path) if raw.startswith(GZIP_MAGIC) else raw)


def _miss(path: Path) -> LogError:
    """Say that there is no such file, and which one may be meant."""
    if path.is_symlink():
        found = f"a link to {path.readlink()}, which is not there"
        return LogError(found, where=path, fix="mend the link, or give the log itself")
    if has_magic(str(path)):
        return LogError("no file matches", where=path, fix="check the pattern and its folder")
    there = []
    with suppress(OSError):
        there = [each.name for each in path.parent.iterdir()]
    close = get_close_matches(path.name, there, n=1, cutoff=SIMILAR)
    fix = f"did you mean {path.parent / close[0]}?" if close else "check the path"
    return LogError("no such file or directory", where=path, fix=fix)


def _peek_gzip(path: Path) -> bytes:
    """Decompress the start of a gzip file: as much as there is, where it is damaged."""
    content = b""
    with suppress(OSError, *GUNZIP_ERRORS), path.open("rb") as file:
        for piece in gunzip(file):
            content += piece
            if len(content) >= PROBE_BYTES:
                break
    return content[:PROBE_BYTES]


def explain_unknown(probe: Probe, otherwise: str) -> LogError:
    """Say what a path that no reader knows is, and what mends it; `otherwise` says what is read."""
    raw, content, fix = probe.raw, probe.content, ""
    if probe.path.is_dir():
        found = _describe_folder(probe.path)
    elif not raw:
        found = "the file is empty"
    elif not any(raw):
        found = f"the first {len(raw):,} bytes are zero, as a power cut leaves a file"
        fix = "take the log from where it was copied from"
    elif not content:
        found = "a gzip file with nothing in it that can be read"
    elif begins := [start for start in OTHER_FILES if content.startswith(start)]:
        found, fix = OTHER_FILES[begins[0]]
    elif content.isascii():
        first_line = content.decode("ascii").splitlines()[0][:60]
        found = f"a text file of no known log format: it starts with {first_line!r}"
    elif content is not raw:
        found, fix = "a file that gzip compressed", "decompress it first: gunzip PATH"
    else:
        found = f"not a known log format: it starts with the bytes {raw[:8].hex(' ')}"
    fix = fix.replace("PATH", shlex.quote(str(probe.path)))
    return LogError(found, where=probe.path, fix=fix or otherwise)


def _describe_folder(folder: Path) -> str:
    """Say what a folder that is not a recording holds."""
    try:
        names = sorted(entry.name for entry in folder.iterdir())
    except OSError as error:
        return f"a folder that cannot be read ({error.strerror})"
    return f"a folder that is not a recording: it holds {', '.join(names[:5]) or 'nothing'}"


def gunzip(file: BinaryIO) -> Iterator[bytes]:
    """Decompress a file piece by piece.

    Where the data is corrupt, all before comes out first; the gzip module loses up to a block.

    Raises
    ------
    zlib.error, EOFError
        The data is corrupt, or the file ends within it.
    """
    inflater = zlib.decompressobj(_GZIP_BITS)
    data = b""
    while data := data or file.read(_STEP):
        if inflater.eof:
            data = data.lstrip(b"\0")  # padding, or one more member
            inflater = zlib.decompressobj(_GZIP_BITS) if data else inflater
            continue
        before = inflater.copy()
        try:
            piece = inflater.decompress(data, _MOST_AT_ONCE)
        except zlib.error:
            yield _salvage(before, data)
            raise
        yield piece
        data = inflater.unconsumed_tail or inflater.unused_data
    while not inflater.eof:
        piece = inflater.decompress(b"", _MOST_AT_ONCE)
        if not piece:
            raise EOFError("the file ends within the gzip data")
        yield piece


def _salvage(inflater: "zlib._Decompress", data: bytes) -> bytes:
    """Decompress byte by byte up to the first that is wrong."""
    pieces: list[bytes] = []
    with suppress(zlib.error):
        pieces.extend(inflater.decompress(data[at : at + 1]) for at in range(len(data)))
    return b"".join(pieces)
