"""Why a cell is what it is: the scans that are named add up to what the evidence holds."""

import math
from dataclasses import replace
from itertools import product
from pathlib import Path

import numpy as np
import pytest

from occmap.cells import Evidence
from occmap.errors import MapError, UsageError
from occmap.evidence import keep_lasting, render, to_grid
from occmap.explanation import Explanation, Question, explain
from occmap.explanation.history import add_up
from occmap.options import BuildOptions, Selection
from occmap.pipeline import build
from occmap.posing import Deskew, PosingOptions
from occmap.sensor.models import (
    CountingModel,
    QuadraticModel,
    SensorModel,
    SimpleModel,
    parse_model,
)
from occmap.store.merging import merge, subtract
from occmap.store.publishing import RenderOptions, render_kept
from occmap.types import BEAM_UPDATES, Update
from occmap.writers import MapMode, WriteOptions
from occmap.writers.npz import read_evidence
from tests.samples import PLAIN, REAL_LOGS, SAMPLE_LOGS, Planar, write_csv

DRIVE = SAMPLE_LOGS / "drive.csv"
each_combination = pytest.mark.parametrize(
    ("update", "model"), list(product(BEAM_UPDATES, ["simple", "quadratic", "counting"]))
)
TENTH = replace(PLAIN, resolution=0.1)
"""Cells of 0.1 m"""


def save(folder: Path, log: Path, options: BuildOptions = TENTH, name: str = "m") -> Evidence:
    build([log], options, [folder / f"{name}.npz"])
    return read_evidence(folder / f"{name}.npz")


def choose_points(evidence: Evidence, amount: int) -> list[tuple[float, float]]:
    """Middles of observed cells: the one with the most of each number, and some at random."""
    size = evidence.manifest.resolution
    grid = render_kept(evidence, RenderOptions()).map
    rng = np.random.default_rng(1)
    observed = np.argwhere(grid.observed)
    peaks = [
        np.unravel_index(int(each), grid.shape)
        for each in (grid.log_odds.argmax(), grid.log_odds.argmin())
    ]
    rows = [*peaks, *observed[rng.integers(0, len(observed), amount)]]
    low_x, low_y = grid.origin
    return [(low_x + (col + 0.5) * size, low_y + (row + 0.5) * size) for row, col in rows]


@each_combination
def test_scans_of_the_drive_add_up(tmp_path: Path, update: Update, model: str) -> None:
    options = BuildOptions(update=update, model=parse_model(model), jobs=1)
    evidence = save(tmp_path, DRIVE, options)
    for x, y in choose_points(evidence, 4):
        found = explain(evidence, Question(x, y, (DRIVE,)))
        assert found.seen.observations
        assert add_up(found.scans) == found.seen.numbers
        assert found.scans_used == 414
        assert found.notes == ()


def test_a_cell_is_judged_as_the_map_is(tmp_path: Path) -> None:
    evidence = save(tmp_path, DRIVE, BuildOptions())
    models: list[SensorModel] = [
        SimpleModel(0.9, 0.25, 0.3),
        CountingModel(0.4, cut=0.2),
        SimpleModel(spread=0.0),
    ]
    for model, min_passes in product(models, (None, 2)):
        lasting = keep_lasting(to_grid(evidence), evidence.slices, min_passes)
        grid = render(lasting, model, 10**9)
        rng = np.random.default_rng(2)
        for row, col in rng.integers(0, grid.shape, (20, 2)):
            x, y = (
                edge + (at + 0.5) * 0.05 for edge, at in zip(grid.origin, (col, row), strict=True)
            )
            found = explain(evidence, Question(x, y, model=model, min_passes=min_passes))
            assert found.probability == grid.probability[row, col]
            assert (found.verdict == "unknown") == (not grid.observed[row, col])
            assert (found.verdict == "occupied") == grid.occupied[row, col]
            assert (found.verdict == "free") == grid.free[row, col]
            if min_passes is None:
                assert found.map_extent == pytest.approx(grid.extent)


@pytest.mark.skipif(not REAL_LOGS.is_dir(), reason=f"no real logs in {REAL_LOGS}")
def test_scans_of_a_real_log_add_up(tmp_path: Path) -> None:
    log = REAL_LOGS / "carmen" / "freiburg-079-corrected.log.gz"
    evidence = save(tmp_path, log, BuildOptions(jobs=2))
    point = choose_points(evidence, 0)[0]
    found = explain(evidence, Question(*point, (log,)))
    assert add_up(found.scans) == found.seen.numbers
    assert found.seen.numbers[0] > 20


def ask(folder: Path, poses: list[Planar], point: tuple[float, float]) -> Explanation:
    """Ask who saw a point; each scan has one beam of 0.32 m, straight ahead."""
    log = write_csv(folder / "log.csv", poses, [0.32])
    return explain(save(folder, log), Question(*point, (log,)))


def test_one_beam(tmp_path: Path) -> None:
    pose = (0.05, 0.05, 0.0)  # across cells 0, 1 and 2 to x = 0.37
    found = ask(tmp_path, [pose], (0.37, 0.05))
    (scan,) = found.scans
    assert (scan.stamp_ns, scan.topic, scan.build, scan.seen.numbers) == (0, "scan", 0, (1, 0))
    assert (scan.log, scan.x, scan.y) == (str(tmp_path / "log.csv"), 0.05, 0.05)
    assert scan.distance == pytest.approx(0.3)  # to the middle of the cell, x = 0.35
    assert found.verdict == "occupied"
    assert found.probability == pytest.approx(0.7)
    on_the_way = ask(tmp_path, [pose], (0.15, 0.05))
    assert [each.seen.numbers for each in on_the_way.scans] == [(0, 1)]
    assert on_the_way.verdict == "free"
    assert on_the_way.probability == pytest.approx(0.4)


def test_a_wall_seen_twice_and_then_crossed(tmp_path: Path) -> None:
    poses = [(0.05, 0.05, 0.0), (0.65, 0.05, math.pi), (5, 5, 0.0), (0.25, 0.05, 0.0)]
    found = ask(tmp_path, poses, (0.35, 0.05))
    seconds = [each.stamp_ns / 1e9 for each in found.scans]
    assert seconds == [0, 1, 3]  # the scan at 2 s was elsewhere
    assert [each.seen.numbers for each in found.scans] == [(1, 0), (1, 0), (0, 1)]
    assert [each.x for each in found.scans] == [0.05, 0.65, 0.25]
    odds = (0.7 / 0.3) ** 2 * 0.4 / 0.6
    assert found.probability == pytest.approx(odds / (1 + odds))
    assert found.scans_used == 4


def test_a_cell_that_nothing_observed(tmp_path: Path) -> None:
    found = ask(tmp_path, [(0.05, 0.05, 0.0), (0.05, 0.25, 0.0)], (0.15, 0.15))
    assert (found.verdict, found.probability, found.scans) == ("unknown", 0.5, ())
    assert found.map_extent == pytest.approx((0, 0, 0.4, 0.3))
    assert found.notes == ()


def test_scans_come_by_time_whatever_the_order_of_the_file(tmp_path: Path) -> None:
    log = write_csv(tmp_path / "log.csv", [(0.05, 0.05, 0.0)] * 3, [0.32])
    lines = log.read_text().splitlines()
    log.write_text("\n".join([*lines[:-3], lines[-1], lines[-3], lines[-2], ""]))
    found = explain(save(tmp_path, log), Question(0.35, 0.05, (log,)))
    assert [each.stamp_ns / 1e9 for each in found.scans] == [0, 1, 2]


def test_only_the_scans_that_a_build_used_are_named(tmp_path: Path) -> None:
    log = write_csv(tmp_path / "log.csv", [(0.05, 0.05, 0.0)] * 10, [0.32])
    early = save(tmp_path, log, replace(TENTH, selection=Selection(end_s=2.5)), "early")
    third = save(tmp_path, log, replace(TENTH, selection=Selection(start_s=4, stride=3)), "third")
    found = explain(merge([early, third]), Question(0.35, 0.05, (log,)))
    assert [(each.build, each.stamp_ns / 1e9) for each in found.scans] == [
        *((0, 0), (0, 1), (0, 2)),
        *((1, 4), (1, 7)),
    ]
    assert found.scans_used == 3 + 2
    assert found.notes == ()


def test_what_the_logs_at_hand_do_not_explain_is_said(tmp_path: Path) -> None:
    a, b = (
        write_csv(tmp_path / f"{n}.csv", [(x, 0.05, 0.0)], [0.32])
        for n, x in (("a", 0.05), ("b", 0.15))
    )
    both = merge([save(tmp_path, a, name="a"), save(tmp_path, b, name="b")])
    found = explain(both, Question(0.35, 0.05, (a,)))
    assert found.notes == (
        "these logs explain 1 hit and 0 misses of 1 hit and 1 miss; the rest is in b.csv",
    )
    assert explain(both, Question(0.35, 0.05, (a, b))).notes == ()
    assert explain(both, Question(0.35, 0.05)).notes == ()
    assert explain(both, Question(0.05, 0.05, (a,))).notes == ()  # all of that cell is in a.csv


def test_what_was_subtracted_is_said(tmp_path: Path) -> None:
    log = write_csv(tmp_path / "log.csv", [(0.05, 0.05, 0.0)] * 4, [0.32])
    part = save(tmp_path, log, replace(TENTH, selection=Selection(end_s=0.5)), "part")
    rest = subtract(save(tmp_path, log), part)
    found = explain(rest, Question(0.35, 0.05, (log,)))
    bounds, note = found.notes
    assert bounds.endswith("so numbers of visits are upper bounds")
    explained = "the scans explain 4 hits and 0 misses of 3 hits and 0 misses"
    assert note == f"{explained}; other evidence was subtracted"


@pytest.mark.parametrize("model", ["simple", "quadratic"])
@pytest.mark.parametrize("update", BEAM_UPDATES)
def test_deskewed_scans_add_up(tmp_path: Path, update: Update, model: str) -> None:
    log = tmp_path / "turning.csv"
    ranges = ",".join(["1.0"] * 8)
    log.write_text(
        "# angle_min: -0.4\n# angle_increment: 0.1\n# time_increment: 0.1\nstamp,"
        + ",".join(f"r{beam}" for beam in range(8))
        + f"\n0,{ranges}\n0.8,{ranges}\n"
    )
    path = tmp_path / "path.csv"
    path.write_text("stamp,x,y,yaw\n0,0,0,0\n1,0.5,0.1,1\n2,1,0.5,2\n")
    posing = PosingOptions(poses=str(path), deskew=Deskew.ON)
    options = replace(TENTH, update=update, model=parse_model(model), posing=posing)
    evidence = save(tmp_path, log, options)
    for x, y in choose_points(evidence, 8):
        found = explain(evidence, Question(x, y, (log,), (path,)))
        assert add_up(found.scans) == found.seen.numbers


def test_evidence_that_holds_nothing_has_no_extent(tmp_path: Path) -> None:
    log = write_csv(tmp_path / "log.csv", [(0.05, 0.05, 0.0)], [0.32])
    evidence = save(tmp_path, log)
    assert explain(subtract(evidence, evidence), Question(0.35, 0.05)).map_extent is None


def test_thresholds_decide_what_a_cell_is(tmp_path: Path) -> None:
    log = write_csv(tmp_path / "log.csv", [(0.05, 0.05, 0.0)], [0.32])
    evidence = save(tmp_path, log)
    for thresholds, verdict in (
        ((0.69, 0.1), "occupied"),
        ((0.71, 0.1), "undecided"),
        ((0.71, None), "undecided"),  # the hit's 0.7 is not below the model's 0.5 either
        ((0.8, 0.71), "free"),
    ):
        writing = WriteOptions(MapMode.TRINARY, *thresholds)
        assert explain(evidence, Question(0.35, 0.05, writing=writing)).verdict == verdict


def test_json_says_it_all(tmp_path: Path) -> None:
    found = ask(tmp_path, [(0.05, 0.05, 0.0)], (0.35, 0.05)).to_json()
    assert found["cell"] == {"row": 0, "column": 3, "extent": pytest.approx([0.3, 0, 0.4, 0.1])}
    assert found["class"] == "occupied"
    hit, miss, nothing = (
        {"hits": hits, "misses": misses, "log_odds": None, "observations": hits + misses}
        for hits, misses in ((1, 0), (0, 1), (0, 0))
    )
    assert found["seen"] == hit
    assert found["around"] == [[nothing] * 3, [miss, hit, nothing], [nothing] * 3]
    (scan,) = found["scans"]
    assert (scan["stamp_ns"], scan["topic"], scan["seen"]) == (0, "scan", hit)


def test_the_numbers_of_a_radial_model_are_log_odds(tmp_path: Path) -> None:
    log = write_csv(tmp_path / "log.csv", [(0.05, 0.05, 0.0)], [0.32])
    evidence = save(tmp_path, log, replace(TENTH, model=QuadraticModel(p_min=0.2)))
    seen = explain(evidence, Question(0.05, 0.05)).to_json()["seen"]
    # p = 0.2 near the sensor, and log-odds are kept to 1/65536.
    assert seen.pop("log_odds") == pytest.approx(math.log(0.2 / 0.8), abs=1e-5)
    assert seen == {"hits": None, "misses": None, "observations": 1}


def test_the_wrong_model_is_refused(tmp_path: Path) -> None:
    log = write_csv(tmp_path / "log.csv", [(0.05, 0.05, 0.0)], [0.32])
    evidence = save(tmp_path, log)
    with pytest.raises(MapError, match="which quadratic cannot read"):
        explain(evidence, Question(0, 0, model=QuadraticModel()))
    with pytest.raises(UsageError, match="`poses` goes with a log"):
        explain(evidence, Question(0, 0, poses=(log,)))
