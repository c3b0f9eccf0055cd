"""CARMEN logs with a byte gone, or cut: what is lost or may be is said, and all else stays."""

import random
from collections.abc import Callable
from pathlib import Path

import pytest

from occmap.options import BuildOptions
from occmap.pipeline import build
from occmap.readers.carmen import CarmenReader

SCANS = 40
MEASURED = [f"{2 + beam / 8:.2f}" for beam in range(150)]
NOTHING = ["81.83"] * 30
LOG = "".join(
    f"FLASER 180 {' '.join(MEASURED + NOTHING)} {t}.25 2 0 {t}.25 2 0 {t}.5 host {t}.5\n"
    for t in range(SCANS)
)


def delete(index: int) -> str:
    return LOG[:index] + LOG[index + 1 :]


def find_dots() -> list[int]:
    """Where a range of a scan in the middle has its dot: without it, it reads 8183 m, or 1750 m."""
    start = LOG.index("FLASER", len(LOG) // 2)
    return [at for at in range(start, LOG.index("\n", start)) if LOG[at] == "."]


def any_of(indices: Callable[[], list[int]], count: int) -> list[int]:
    return random.Random(1).sample(indices(), count)


@pytest.mark.parametrize(
    "index", any_of(find_dots, 15) + any_of(lambda: list(range(LOG.index("\n") + 1, len(LOG))), 25)
)
def test_a_deleted_byte_leaves_the_no_return_value_known(tmp_path: Path, index: int) -> None:
    path = tmp_path / "hand.log"
    path.write_text(delete(index))
    report = build([path], BuildOptions()).report
    assert report.scans.used >= SCANS - 2
    assert report.beams.no_return >= len(NOTHING) * report.scans.used - 1


@pytest.mark.parametrize(
    ("line", "is_whole"),
    [
        ("SYNC a 4 host 4", True),
        ("PARAM robot_width 0.5 host 4", True),
        ("SYNC a 4 ho", False),
        ("PARAM robot_wid", False),
        ("# a comm", False),
        ("VERTEX2 7 1.5", False),
    ],
)
def test_a_cut_in_a_line_that_is_no_scan_is_told(tmp_path: Path, line: str, is_whole: bool) -> None:
    path = tmp_path / "hand.log"
    path.write_text(LOG + line)
    damage = [note.text for note in CarmenReader().open(path).notes if note.damage]
    told = [f"the file ends in the middle of line {SCANS + 1}; this line is lost"]
    assert damage == ([] if is_whole else told)
