"""Whether parts of a map fit each other: by hand on a few cells, and on drives that were moved."""

from pathlib import Path

import pytest

import occmap
from occmap.evidence import Fit, list_misfit, measure_fit
from occmap.grid.tiles import EvidenceKind, TileGrid
from occmap.sensor.models import CountingModel, QuadraticModel
from tests.evidence.saving import DRIVE, MIDDLE_S
from tests.grid.scans import make_grid
from tests.samples import DRIVES
from tests.tuning.simulated import write_parts

RULE = CountingModel(spread=0.0)
ELSEWHERE = (3.0, 1.0, 0.4)


def lay(*cells: tuple[int, int], kind: EvidenceKind = EvidenceKind.COUNTS) -> TileGrid:
    """Cells beside each other, with these hits and misses."""
    return make_grid({(0, col): pair for col, pair in enumerate(cells)}, 0.05, kind)


def test_the_share_of_each_part_counts_as_much_as_the_other() -> None:
    """A cell is occupied from one hit for two misses on; the last one only one part saw."""
    one = lay((400, 0), (0, 8000), (7000, 0))
    other = lay((300, 3), (300, 3))
    # Alone all hits agree. Together those in the second cell do not: half of the other's.
    assert measure_fit(one, other.tiles, RULE) == Fit(1.0, (1 + 0.5) / 2)
    (note,) = list_misfit(one, other.tiles, RULE, "it")
    assert note.startswith("does not fit it: in cells that both saw, 100% of the hits lie")
    assert "and 75% together" in note


def test_parts_that_fit_are_no_news() -> None:
    one = lay((400, 0), (0, 8000))
    assert measure_fit(one, one.tiles, RULE) == Fit(1.0, 1.0)
    assert not list(list_misfit(one, one.tiles, RULE, "it"))


def test_little_is_not_judged() -> None:
    one = lay((199, 1))
    assert measure_fit(one, one.tiles, RULE) is None
    assert measure_fit(one, {}, RULE) is None


def test_sums_of_log_odds_know_no_hits() -> None:
    one = lay((400, 400), kind=EvidenceKind.LOG_ODDS)
    assert measure_fit(one, one.tiles, QuadraticModel()) is None


def keep_misfits(grid: occmap.Map) -> list[str]:
    return [note for note in grid.report.notes if "does not fit" in note]


@pytest.fixture(scope="module")
def parts(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two halves of a drive, and the drive where it would be were the map's frame elsewhere."""
    folder = tmp_path_factory.mktemp("parts")
    occmap.build_map(DRIVE, end_s=MIDDLE_S, outputs=folder / "a.npz")
    occmap.build_map(DRIVE, start_s=MIDDLE_S, outputs=folder / "b.npz")
    occmap.build_map(DRIVE, transform=ELSEWHERE, outputs=folder / "moved.npz")
    return folder


def test_merged_evidence_that_does_not_fit_is_named(parts: Path) -> None:
    assert not keep_misfits(occmap.merge(parts / "a.npz", parts / "b.npz"))
    (note,) = keep_misfits(occmap.merge(parts / "a.npz", parts / "b.npz", parts / "moved.npz"))
    assert note.startswith(f"{parts / 'moved.npz'}: does not fit the evidence before it")


def test_a_build_does_not_fit_what_it_is_added_to(parts: Path) -> None:
    past = parts / "a.npz"
    assert not keep_misfits(occmap.build_map(DRIVE, start_s=MIDDLE_S, resume=past))
    (note,) = keep_misfits(occmap.build_map(DRIVE, transform=ELSEWHERE, resume=past))
    assert note.startswith(f"{past}: does not fit the logs that are added to it")


def test_a_log_that_does_not_fit_those_before_it_is_named(tmp_path: Path) -> None:
    """The second log has a frame of its own, turned by a right angle."""
    assert not keep_misfits(occmap.build_map(*DRIVES[:2]))
    (moved,) = write_parts(tmp_path, [0.0], scans=414)
    (note,) = keep_misfits(occmap.build_map(DRIVE, moved))
    assert note.startswith(f"{moved}: does not fit the logs before it")
