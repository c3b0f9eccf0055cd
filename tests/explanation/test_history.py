"""A point in a map: which cell it is in, and what that cell holds."""

import math
from dataclasses import replace
from pathlib import Path

import pytest

from occmap.cells import Evidence
from occmap.errors import UsageError
from occmap.explanation import Explanation, Question, explain
from occmap.grid.tiles import EvidenceKind
from occmap.pipeline import build
from occmap.sensor.models import parse_model
from occmap.store.merging import merge
from occmap.writers.npz import read_evidence
from tests.samples import PLAIN, Planar, write_csv


def observe(folder: Path, poses: list[Planar], model: str = "simple") -> Evidence:
    """Build evidence of scans with one beam of 0.32 m each, in cells of 0.1 m."""
    log = write_csv(folder / "log.csv", poses, [0.32])
    options = replace(PLAIN, resolution=0.1, model=parse_model(model))
    build([log], options, [folder / "m.npz"])
    return read_evidence(folder / "m.npz")


SECOND = 10**9


def look_at(evidence: Evidence, x: float, y: float) -> Explanation:
    return explain(evidence, Question(x, y))


def list_visits(evidence: Evidence, x: float, y: float) -> list[tuple[int, ...]]:
    """Of each build: its number, since when and until when (s), and on how many visits."""
    return [
        (
            each.build,
            each.since_ns // 10**9,
            each.until_ns // 10**9,
            each.hit_visits or 0,
            each.seen_visits,
        )
        for each in look_at(evidence, x, y).builds
    ]


def test_one_beam_clears_three_cells_and_hits_the_fourth(tmp_path: Path) -> None:
    evidence = observe(tmp_path, [(0.05, 0.05, 0.0)])
    seen = [look_at(evidence, x, 0.05) for x in (0.05, 0.15, 0.25, 0.35, 0.45)]
    assert [each.seen.numbers for each in seen] == [(0, 1), (0, 1), (0, 1), (1, 0), (0, 0)]
    assert [each.seen.observations for each in seen] == [1, 1, 1, 1, 0]
    hit = seen[3]
    assert (hit.cell.row, hit.cell.column, hit.seen.kind) == (0, 3, EvidenceKind.COUNTS)
    assert hit.cell.extent == pytest.approx((0.3, 0.0, 0.4, 0.1))


def test_slices_are_told_build_by_build_and_together(tmp_path: Path) -> None:
    """A scan a second; slices of ten seconds are of 10 scans each, and 30 s lie between visits."""
    step, cell = [(0.05, 0.05, 0.0)], (0.35, 0.05)
    once = observe(tmp_path, step)
    long = observe(tmp_path, [*step * 12, *[(0.05, 9.05, 0.0)] * 30, *step])
    both = merge([once, long])
    assert list_visits(once, *cell) == [(0, 0, 10, 1, 1)]
    assert list_visits(both, *cell) == [(0, 0, 10, 1, 1), (1, 0, 50, 2, 2)]
    assert list_visits(both, 0.05, 0.05)[1] == (1, 0, 50, 0, 2)
    assert list_visits(both, 0.35, 9.05) == [(1, 10, 50, 1, 1)]
    assert list_visits(both, 50.0, 9.05) == []
    together = look_at(both, *cell).visits
    assert together
    assert (together.since_ns, together.until_ns) == (0, 50 * SECOND)
    assert (together.hit_visits, together.seen_visits) == (2, 2)
    assert look_at(both, 50.0, 9.05).visits is None


CROSSED, HIT, NOTHING = (0, 1), (1, 0), (0, 0)


@pytest.mark.parametrize(
    ("yaw", "point", "around"),
    [
        (0, (0.3, 0.099), [[NOTHING] * 3, [CROSSED, HIT, NOTHING], [NOTHING] * 3]),
        (math.pi / 2, (0.05, 0.25), [[NOTHING, each, NOTHING] for each in (HIT, CROSSED, CROSSED)]),
        (0, (-1e6, 1e6), [[NOTHING] * 3] * 3),
    ],
)
def test_neighbours_lie_around_the_cell_and_those_above_come_first(
    yaw: float, point: tuple[float, float], around: list[list[tuple[int, int]]], tmp_path: Path
) -> None:
    found = look_at(observe(tmp_path, [(0.05, 0.05, yaw)]), *point).around
    assert [[each.numbers for each in row] for row in found] == around


def test_cells_below_zero_are_in_tiles_below_zero(tmp_path: Path) -> None:
    evidence = observe(tmp_path, [(-6.45, -6.45, math.pi / 2)])
    assert evidence.tiles.tolist() == [[-2, -2], [-1, -2]]  # the beam goes up across row -64
    found = look_at(evidence, -6.45, -6.15)
    assert (found.cell.row, found.cell.column) == (-62, -65)
    assert found.seen.numbers == (1, 0)
    assert look_at(evidence, -6.45, -6.45).seen.misses == 1


def test_log_odds_come_with_observations(tmp_path: Path) -> None:
    pose = (0.05, 0.05, 0.0)
    once = look_at(observe(tmp_path, [pose], "quadratic"), 0.15, 0.05)
    twice = look_at(observe(tmp_path, [pose, pose], "quadratic"), 0.15, 0.05)
    assert once.seen.kind is EvidenceKind.LOG_ODDS
    assert once.seen.numbers[0] < 0
    assert twice.seen.numbers == (2 * once.seen.numbers[0], 2)


@pytest.mark.parametrize("point", [(math.nan, 0), (0, math.inf), (1e30, 0)])
def test_a_point_in_no_map_is_refused(tmp_path: Path, point: tuple[float, float]) -> None:
    with pytest.raises(UsageError, match="is in no map; give x and y in metres"):
        look_at(observe(tmp_path, [(0.05, 0.05, 0.0)]), *point)
