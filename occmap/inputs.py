"""Which recordings a user means by a path: a log, a folder of several, a pattern, or stdin."""

import glob
import os
import shutil
import sys
import tempfile
from collections.abc import Collection, Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import NamedTuple

from occmap.errors import LogError, OccmapError
from occmap.readers import find_reader, open_log
from occmap.readers.options import ReaderOptions
from occmap.readers.probing import probe_path
from occmap.report.words import STDIN_FOLDER, count, join_names
from occmap.steps.opening import choose_topics, take_first

STDIN = Path("-")
RECORDED = (".mcap", ".bag", ".db3")
"""Suffixes that only recordings have; others are taken for such where a recording has them."""


class Inputs(NamedTuple):
    """The recordings that paths stand for."""

    logs: list[Path]
    notes: list[str]
    """Which recordings a folder or a pattern was found to hold"""


def find_inputs(
    paths: Sequence[Path], options: ReaderOptions, others: Sequence[Path] = ()
) -> Inputs:
    """Replace folders and patterns by the recordings in them, in the order of their time.

    What holds no recording stays as it is: opening it says what is wrong.

    Parameters
    ----------
    others
        Files that are not recordings, though a folder may hold them: outputs and trajectories.
    """
    logs: list[Path] = []
    notes: list[str] = []
    known = set(map(os.path.realpath, others))
    for path in paths:
        entries = list_entries(path)
        maybe = [each for each in entries if os.path.realpath(each) not in known]
        kept = list(filter(is_recording, maybe))
        if not kept or is_bag(path, kept):
            logs.append(path)
            continue
        kept.sort(key=lambda each: find_start(each, options))
        logs += kept
        suffixes = {*RECORDED, *(each.suffix for each in kept)}
        lost = [each for each in maybe if each.suffix in suffixes and each not in kept]
        notes.append(describe_found(path, kept, len(entries) - len(kept) - len(lost)))
        notes += (note for each in lost for note in describe_lost(each, options))
    return Inputs(logs, notes)


def list_entries(path: Path) -> list[Path]:
    """List what a folder holds, or what a pattern matches; nothing where a path is a log itself."""
    if path.is_dir():
        with suppress(OSError):
            return sorted(each for each in path.iterdir() if not each.name.startswith("."))
    elif glob.has_magic(str(path)) and not path.exists():
        return sorted(map(Path, glob.glob(str(path), recursive=True)))  # noqa: PTH207  any path
    return []


def is_bag(path: Path, recordings: Collection[Path]) -> bool:
    """Whether a folder is one bag of ROS 2, and not a folder of several recordings."""
    from occmap.readers.containers import bag2  # noqa: PLC0415  late: it brings mcap and apsw

    if not path.is_dir() or (path / bag2.METADATA).exists():
        return path.is_dir()
    files = bag2.list_storage(path)
    with suppress(LogError):
        bag2.refuse_mixed(path, files)
        return set(recordings) <= set(files)
    return False


def is_recording(path: Path) -> bool:
    """Whether any reader recognises a path."""
    with suppress(LogError):
        return find_reader(probe_path(path)) is not None
    return False


def find_start(path: Path, options: ReaderOptions) -> tuple[int, str]:
    """Find when the scans of a recording begin (ns); what cannot be read comes last."""
    start = 2**63
    with suppress(OccmapError):
        log = open_log(path, options)
        first = take_first(log, choose_topics(log, ()))
        start = min((scan.stamp_ns for scan in first), default=start)
    return start, str(path)


def describe_found(path: Path, logs: Sequence[Path], others: int) -> str:
    """Say which recordings a folder holds, and how many other files."""
    names = join_names(log.name for log in logs)
    passed = f"; {count(others, 'other file')} passed over" if others else ""
    order = ", in the order of their time" if len(logs) > 1 else ""
    return f"{path}: {count(len(logs), 'recording')}{order}: {names}{passed}"


def describe_lost(path: Path, options: ReaderOptions) -> Iterator[str]:
    """Say why a file that is named like a recording cannot be one."""
    try:
        open_log(path, options)
    except LogError as error:
        yield f"{path}: passed over, though named like a recording: {error.found}"


@contextmanager
def keep_stdin(paths: Sequence[Path]) -> Iterator[list[Path]]:
    """Save what comes on stdin to a file while the block runs, where a path is `-`.

    Raises
    ------
    LogError
        Nothing comes on stdin, or it is closed.
    """
    if STDIN not in paths:
        yield list(paths)
        return
    if sys.stdin is None:
        raise LogError("is closed", where="stdin", fix="pipe a log into it")
    with tempfile.TemporaryDirectory(prefix=STDIN_FOLDER) as folder:
        saved = Path(folder) / STDIN.name  # pages and evidence call it so
        with saved.open("wb") as file:
            shutil.copyfileobj(sys.stdin.buffer, file)
        if not saved.stat().st_size:
            raise LogError("is empty", where="stdin", fix="pipe a log into it")
        yield [saved if path == STDIN else path for path in paths]
