"""Why a cell is what it is: the scans that are named add up to what the evidence holds."""

import json
import math
import shutil
from collections.abc import Sequence
from dataclasses import replace
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from occmap.cells import Evidence
from occmap.choices import read_options
from occmap.clouds import CloudOptions
from occmap.errors import LogError, MapError, PoseError
from occmap.evidence import find_lasting, render
from occmap.evidence.manifest import UNRECORDED, describe_build, list_logs
from occmap.explanation import Explanation, Question, Use, explain, find_uses, recall_options
from occmap.options import BuildOptions, Selection
from occmap.pipeline import build
from occmap.posing import Deskew, PosingOptions, Stamps
from occmap.sensor import NoReturn, ReturnOptions, models
from occmap.sensor.models import CountingModel, QuadraticModel
from occmap.store import Blocks
from occmap.store.merging import merge, subtract
from occmap.store.painting import RenderOptions, render_saved
from occmap.types import BEAM_UPDATES, Update
from occmap.writers import MapMode, WriteOptions
from occmap.writers.npz import read_evidence
from tests.clouds.simulation import HALL, turn, write_leaning, write_tour
from tests.csv_logs import write_poses, write_scans
from tests.every_option import EVERY
from tests.evidence.saving import DRIVE, choose, each_combination, save
from tests.samples import PLAIN, SAMPLE_LOGS, Planar, write_csv

pytestmark = pytest.mark.usefixtures("here")
LOG = Path("log.csv")
TENTH = replace(PLAIN, resolution=0.1)
"""Cells of 0.1 m"""
AHEAD: Planar = (0.05, 0.05, 0.0)
"""From here a beam of 0.32 m crosses cells 0, 1 and 2 and ends in cell 3, at x = 0.37 m"""
END = (0.35, 0.05)
"""In cell 3"""
CROSSED, HIT, NOTHING = (0, 1), (1, 0), (0, 0)


def observe(poses: Sequence[Planar], options: BuildOptions = TENTH, log: Path = LOG) -> Evidence:
    """Evidence of a log of scans a second apart, each with one beam of 0.32 m."""
    return save(log.with_suffix(".npz"), options, write_csv(log, poses, [0.32]))


def ask(evidence: Evidence, point: tuple[float, float], *logs: Path, **more: Any) -> Explanation:
    return explain(Blocks.of(evidence), Question(*point, logs, **more))


def choose_points(evidence: Evidence, amount: int) -> list[tuple[float, float]]:
    """Middles of observed cells: the one with the most of each number, and some at random."""
    size = evidence.manifest.resolution
    grid = render_saved(Blocks.of(evidence), RenderOptions()).grid
    observed = np.argwhere(grid.observed)
    peaks = [np.unravel_index(each(grid.log_odds), grid.shape) for each in (np.argmax, np.argmin)]
    rows = [*peaks, *np.random.default_rng(1).choice(observed, amount)]
    low_x, low_y = grid.origin
    return [(low_x + (col + 0.5) * size, low_y + (row + 0.5) * size) for row, col in rows]


@each_combination
def test_scans_of_the_drive_add_up(update: Update, model: str) -> None:
    evidence = save(Path("m.npz"), choose(update, model))
    for point in choose_points(evidence, 2):
        found = ask(evidence, point, DRIVE)
        assert found.seen.observations
        assert found.explained == found.seen
        assert found.scans_used == 414
        assert found.notes == ()


def test_clouds_of_a_map_that_is_laid_flat_add_up() -> None:
    poses = write_leaning(Path("leaning.tum"), turn(4, -6, 0))
    explain_clouds(HALL, BuildOptions(posing=PosingOptions(poses=str(poses))))


def test_clouds_whose_heights_drift_add_up() -> None:
    explain_clouds(Path("tour"), write_tour(Path("tour"), drift_m=0.4))


def explain_clouds(log: Path, options: BuildOptions) -> None:
    """Explain some cells of a build of clouds by the log: all of each is to add up."""
    evidence = save(Path("m.npz"), options, log)
    for point in choose_points(evidence, 2):
        found = ask(evidence, point, log, poses=options.posing.files)
        assert found.seen.observations
        assert found.explained == found.seen
        assert found.notes == ()


def test_a_cell_is_judged_as_the_map_is() -> None:
    evidence = save(Path("m.npz"), BuildOptions())
    judges: list[models.SensorModel] = [
        models.SimpleModel(0.9, 0.25, 0.3),
        models.CountingModel(0.4, cut=0.2),
        models.SimpleModel(spread=0.0),
    ]
    for model, min_passes in product(judges, (None, 2)):
        grid = render(find_lasting(evidence, min_passes)[1], model, 10**9)
        rng = np.random.default_rng(2)
        for row, col in rng.integers(0, grid.shape, (20, 2)):
            point = grid.origin[0] + (col + 0.5) * 0.05, grid.origin[1] + (row + 0.5) * 0.05
            found = ask(evidence, point, model=model, min_passes=min_passes)
            assert found.probability == grid.probability[row, col]
            assert (found.verdict == "unknown") == (not grid.observed[row, col])
            assert (found.verdict == "occupied") == grid.occupied[row, col]
            assert (found.verdict == "free") == grid.free[row, col]
            if min_passes is None:
                assert found.map_extent == pytest.approx(grid.extent)


def test_one_beam_clears_three_cells_and_hits_the_fourth() -> None:
    evidence = observe([AHEAD])
    found = [ask(evidence, (x, 0.05), LOG) for x in (0.05, 0.15, 0.25, 0.35, 0.45)]
    assert [each.seen.numbers for each in found] == [(0, 1), (0, 1), (0, 1), (1, 0), (0, 0)]
    assert [each.seen.observations for each in found] == [1, 1, 1, 1, 0]
    assert [each.verdict for each in found] == ["free"] * 3 + ["occupied", "unknown"]
    assert [each.probability for each in found] == pytest.approx([0.4] * 3 + [0.7, 0.5])
    assert all([scan.seen for scan in each.scans] == [each.seen] for each in found[:4])
    hit = found[3]
    assert (hit.cell.lattice_row, hit.cell.lattice_column) == (0, 3)
    assert hit.seen.log_odds is None
    assert hit.cell.extent == pytest.approx((0.3, 0.0, 0.4, 0.1))
    (scan,) = hit.scans
    assert (scan.stamp_ns, scan.topic, scan.build) == (0, "scan", 0)
    assert (scan.log, scan.x, scan.y) == ("log.csv", 0.05, 0.05)
    assert scan.distance == pytest.approx(0.3)  # to the middle of the cell, x = 0.35
    assert ask(subtract(evidence, evidence), END).map_extent is None


def test_a_wall_seen_twice_and_then_crossed() -> None:
    poses = [AHEAD, (0.65, 0.05, math.pi), (5, 5, 0.0), (0.25, 0.05, 0.0)]
    found = ask(observe(poses), END, LOG)
    seconds = [each.stamp_ns / 1e9 for each in found.scans]
    assert seconds == [0, 1, 3]  # the scan at 2 s was elsewhere
    assert [each.seen.numbers for each in found.scans] == [(1, 0), (1, 0), (0, 1)]
    assert [each.x for each in found.scans] == [0.05, 0.65, 0.25]
    odds = (0.7 / 0.3) ** 2 * 0.4 / 0.6
    assert found.probability == pytest.approx(odds / (1 + odds))
    assert found.scans_used == 4


@pytest.mark.parametrize(
    ("yaw", "point", "around"),
    [
        (0, (0.3, 0.099), [[NOTHING] * 3, [CROSSED, HIT, NOTHING], [NOTHING] * 3]),
        (math.pi / 2, (0.05, 0.25), [[NOTHING, each, NOTHING] for each in (HIT, CROSSED, CROSSED)]),
        (0, (-1e6, 1e6), [[NOTHING] * 3] * 3),
    ],
)
def test_neighbours_lie_around_the_cell_and_those_above_come_first(
    yaw: float, point: tuple[float, float], around: list[list[tuple[int, int]]]
) -> None:
    found = ask(observe([(0.05, 0.05, yaw)]), point).around
    assert [[each.numbers for each in row] for row in found] == around


def list_visits(evidence: Evidence, x: float, y: float) -> list[tuple[int, ...]]:
    """Of each build: its number, since when and until when (s), and on how many visits."""
    found = ask(evidence, (x, y)).builds
    spans = [(each.build, each.since_ns // 10**9, each.until_ns // 10**9) for each in found]
    visits = [(each.hit_visits or 0, each.seen_visits) for each in found]
    return [span + visit for span, visit in zip(spans, visits, strict=True)]


def test_slices_are_told_build_by_build_and_together() -> None:
    """A scan a second; slices of ten seconds are of 10 scans each, and 30 s lie between visits."""
    once = observe([AHEAD])
    long = observe([*[AHEAD] * 12, *[(0.05, 9.05, 0.0)] * 30, AHEAD])
    both = merge([once, long])
    assert list_visits(once, *END) == [(0, 0, 10, 1, 1)]
    assert list_visits(both, *END) == [(0, 0, 10, 1, 1), (1, 0, 50, 2, 2)]
    assert list_visits(both, 0.05, 0.05)[1] == (1, 0, 50, 0, 2)
    assert list_visits(both, 0.35, 9.05) == [(1, 10, 50, 1, 1)]
    assert list_visits(both, 50.0, 9.05) == []
    together = ask(both, END).visits
    assert together
    assert (together.since_ns, together.until_ns) == (0, 50 * 10**9)
    assert (together.hit_visits, together.seen_visits) == (2, 2)
    assert ask(both, (50.0, 9.05)).visits is None


def test_scans_come_by_time_whatever_the_order_of_the_file() -> None:
    log = write_csv(LOG, [AHEAD] * 3, [0.32])
    lines = log.read_text().splitlines()
    log.write_text("\n".join([*lines[:-3], lines[-1], lines[-3], lines[-2], ""]))
    found = ask(save(Path("m.npz"), TENTH, log), END, log)
    assert [each.stamp_ns / 1e9 for each in found.scans] == [0, 1, 2]


def test_only_the_scans_that_a_build_used_are_named() -> None:
    early, third = (
        observe([AHEAD] * 10, replace(TENTH, selection=selection))
        for selection in (Selection(end_s=2.5), Selection(start_s=4, stride=3))
    )
    found = ask(merge([early, third]), END, LOG)
    used = [(each.build, each.stamp_ns / 1e9) for each in found.scans]
    assert used == [(0, 0), (0, 1), (0, 2), (1, 4), (1, 7)]
    assert (found.scans_used, found.notes) == (3 + 2, ())


def test_what_the_logs_at_hand_do_not_explain_is_said() -> None:
    a, b = Path("a.csv"), Path("b.csv")
    both = merge([observe([AHEAD], log=a), observe([(0.15, 0.05, 0.0)], log=b)])
    (note,) = ask(both, END, a).notes
    assert "explain 1 hit and 0 misses of 1 hit and 1 miss" in note
    assert "b.csv" in note
    for logs in ((a, b), ()):
        assert ask(both, END, *logs).notes == ()
    assert ask(both, (0.05, 0.05), a).notes == ()  # all of that cell is in a.csv


def test_what_was_subtracted_is_said() -> None:
    part = observe([AHEAD] * 4, replace(TENTH, selection=Selection(end_s=0.5)))
    rest = subtract(observe([AHEAD] * 4), part)
    bounds, note = ask(rest, END, LOG).notes
    assert "upper bounds" in bounds
    assert "explain 4 hits and 0 misses of 3 hits and 0 misses" in note
    assert "subtracted" in note


@pytest.mark.parametrize("model", ["simple", "quadratic"])
@pytest.mark.parametrize("update", BEAM_UPDATES)
def test_deskewed_scans_add_up(update: Update, model: str) -> None:
    shape = {"angle_min": -0.4, "angle_increment": 0.1, "time_increment": 0.1}
    log = write_scans(Path("turning.csv"), [0, 0.8], np.ones((2, 8)), **shape)
    path = write_poses(Path("path.csv"), [0, 1, 2], [(0, 0, 0), (0.5, 0.1, 1), (1, 0.5, 2)])
    posing = PosingOptions(poses=str(path), deskew=Deskew.ON)
    options = replace(TENTH, update=update, model=models.parse_model(model), posing=posing)
    evidence = save(Path("m.npz"), options, log)
    for point in choose_points(evidence, 8):
        found = ask(evidence, point, log, poses=(path,))
        assert found.explained == found.seen


def test_thresholds_decide_what_a_cell_is() -> None:
    evidence = observe([AHEAD])
    for thresholds, verdict in (
        ((0.69, 0.1), "occupied"),
        ((0.71, 0.1), "undecided"),
        ((0.71, None), "undecided"),  # the hit's 0.7 is not below the model's 0.5 either
        ((0.8, 0.71), "free"),
    ):
        writing = WriteOptions(MapMode.TRINARY, *thresholds)
        assert ask(evidence, END, writing=writing).verdict == verdict


def test_the_numbers_of_a_radial_model_are_log_odds_and_observations() -> None:
    for scans in (1, 2):
        options = replace(TENTH, model=models.QuadraticModel(p_min=0.2))
        found = ask(observe([AHEAD] * scans, options), (0.05, 0.05))
        seen = found.to_json()["seen"]
        # p = 0.2 near the sensor, and log-odds are kept to 1/65536.
        assert seen.pop("log_odds") == pytest.approx(scans * math.log(0.2 / 0.8), abs=1e-4)
        assert seen == {"hits": None, "misses": None, "observations": scans}


SELECTED = BuildOptions(selection=Selection(end_s=0.5), jobs=1)


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Work in a folder with three logs, of which the third states no poses, and a trajectory."""
    monkeypatch.chdir(tmp_path)
    for name, reach in (("a", 0.3), ("b", 0.4)):
        write_csv(tmp_path / f"{name}.csv", [(0.0, 0.0, 0.0)], [reach])
    head = "# angle_min: 0\n# angle_increment: 0\nstamp,r0,r1\n"
    Path("bare.csv").write_text(head + "0.5,0.3,0.3\n")
    Path("path.txt").write_text("0 0 0 0 0 0 0 1\n1 0.1 0 0 0 0 0 1\n")
    return tmp_path


def keep(*logs: str, options: BuildOptions = SELECTED, into: str = "m.npz") -> Evidence:
    build([Path(log) for log in logs], options, [Path(into)])
    return read_evidence(Path(into))


def name_uses(uses: Sequence[Use]) -> list[tuple[str, int]]:
    return [(str(use.log), use.build) for use in uses]


def find(evidence: Evidence, *logs: str, poses: Sequence[str] = ()) -> list[Use]:
    return find_uses(evidence, [Path(log) for log in logs], [Path(path) for path in poses])


def test_a_log_is_found_with_the_options_of_its_build() -> None:
    (use,) = find(keep("a.csv", "b.csv"), "b.csv")
    assert (use.log, use.build) == (Path("b.csv"), 0)
    assert use.options == replace(SELECTED, jobs=use.options.jobs)


def test_every_build_that_used_a_log_is_found_with_its_own_options() -> None:
    later = BuildOptions(selection=Selection(start_s=-1.0))
    evidence = merge([keep("b.csv"), keep("a.csv", "b.csv"), keep("b.csv", options=later)])
    uses = find(evidence, "b.csv", "a.csv")
    assert name_uses(uses) == [("b.csv", 0), ("b.csv", 1), ("b.csv", 2), ("a.csv", 1)]
    assert [use.options.selection.start_s for use in uses[:3]] == [-float("inf")] * 2 + [-1.0]


def test_copies_of_a_log_are_one() -> None:
    shutil.copy("a.csv", "copy.csv")
    assert name_uses(find(keep("a.csv"), "./a.csv", "a.csv", "copy.csv")) == [("copy.csv", 0)]


def test_a_folder_is_known_by_its_files(tmp_path: Path) -> None:
    shutil.copytree(SAMPLE_LOGS / "drive_ros2", tmp_path / "drive")
    evidence = keep("drive", "a.csv")
    assert list_logs(evidence.manifest.builds[0]) == ["drive", "a.csv"]
    shutil.move("drive", "elsewhere")
    assert name_uses(find(evidence, "elsewhere")) == [("elsewhere", 0)]
    Path("elsewhere", "more.txt").write_text("?")
    with pytest.raises(LogError, match=r"elsewhere: m.npz was not made of it"):
        find(evidence, "elsewhere")


def build_followed() -> Evidence:
    return keep("bare.csv", options=BuildOptions(posing=PosingOptions(poses="path.txt")))


def test_a_trajectory_is_found_by_its_hash() -> None:
    evidence = build_followed()
    shutil.move("path.txt", "moved.txt")
    (use,) = find(evidence, "bare.csv", poses=["moved.txt"])
    assert use.options.posing.poses == "moved.txt"
    assert list_logs(evidence.manifest.builds[0]) == ["bare.csv"]


def test_each_build_gets_its_own_trajectory() -> None:
    first = build_followed()
    Path("second.txt").write_text("0 1 0 0 0 0 0 1\n1 1 0 0 0 0 0 1\n")
    posing = PosingOptions(poses="second.txt")
    second = keep("bare.csv", options=BuildOptions(posing=posing), into="n.npz")
    uses = find(merge([first, second]), "bare.csv", poses=["second.txt", "path.txt"])
    assert [use.options.posing.poses for use in uses] == ["path.txt", "second.txt"]


@pytest.mark.parametrize(
    ("log", "poses", "found"),
    [
        ("bare.csv", [], "bare.csv: its poses came from path.txt"),
        ("bare.csv", ["a.csv"], "SHA-256 of a.csv is another); add `poses=path"),
        ("bare.csv", ["path.txt", "a.csv"], "a.csv: is not a trajectory"),
        ("a.csv", ["path.txt"], "path.txt: is not a trajectory"),
    ],
)
def test_one_trajectory_too_few_or_many_is_refused(log: str, poses: list[str], found: str) -> None:
    evidence = merge([build_followed(), keep("a.csv", into="n.npz")])
    with pytest.raises(PoseError) as caught:
        find(evidence, log, poses=poses)
    assert found in str(caught.value)


def test_what_is_no_log_of_the_evidence_is_refused_with_what_it_was_made_of() -> None:
    with pytest.raises(LogError, match=r"b.csv: m.npz was not made of it, .* a.csv: .*`logs`"):
        find(keep("a.csv"), "b.csv")
    with pytest.raises(LogError, match=r"path.txt: m.npz was not made of it, .* bare.csv"):
        find(build_followed(), "path.txt")


LEFT = {"extent", "margin", "edits", "georeference", *UNRECORDED}
UNUSUAL = read_options(
    BuildOptions, {name: it for _, name, it, _ in EVERY if name not in LEFT} | {"end_s": 6}, ""
)
"""Nothing in it is as usual, but for what evidence does not depend on."""


def write_down(options: BuildOptions) -> dict[str, Any]:
    """What a manifest says of a build with these options, by way of JSON as in a file."""
    text = json.dumps(describe_build([], options, {}), allow_nan=False)
    chosen: dict[str, Any] = json.loads(text)["options"]
    return chosen


@pytest.mark.parametrize(
    "options",
    [
        BuildOptions(),
        UNUSUAL,
        replace(UNUSUAL, model=QuadraticModel(0.07, 0.3, 0.4), min_passes=None),
        replace(
            UNUSUAL, model=CountingModel(1 / 3, ceiling=0.9), resolution=0.1 + 0.2, jump=math.inf
        ),
        replace(UNUSUAL, returns=ReturnOptions(), posing=PosingOptions(max_pose_gap_s=math.inf)),
    ],
    ids=lambda options: options.model.name,
)
def test_options_come_back(options: BuildOptions) -> None:
    assert recall_options(write_down(options), "m.npz") == options


def test_every_choice_comes_back() -> None:
    for update, stamps, deskew, no_return in product(Update, Stamps, Deskew, NoReturn):
        posing = PosingOptions(stamps=stamps, deskew=deskew, height_drift={})
        returns = ReturnOptions(no_return=no_return)
        clouds = CloudOptions(own_points={})
        options = BuildOptions(update=update, posing=posing, returns=returns, clouds=clouds)
        again = recall_options(write_down(options), "m.npz")
        assert again == options
        assert isinstance(again.posing.stamps, Stamps)


def test_threads_and_resuming_are_forgotten() -> None:
    options = replace(UNUSUAL, jobs=7, resume=Path("old.npz"))
    assert recall_options(write_down(options), "m.npz") == UNUSUAL


def test_a_trajectory_file_is_a_name() -> None:
    options = BuildOptions(posing=PosingOptions(poses="./path.txt"))
    assert recall_options(write_down(options), "m.npz").posing.poses == "path.txt"


def test_an_option_that_was_not_there_yet_has_its_default() -> None:
    plain = write_down(UNUSUAL)
    del plain["jump"]
    assert recall_options(plain, "m.npz") == replace(UNUSUAL, jump=BuildOptions().jump)


@pytest.mark.parametrize(
    ("name", "value", "found"),
    [
        ("smoothing", 3, "no option is called 'smoothing'"),
        ("resolution", "wide", "`resolution` is 'wide'"),
        ("resolution", None, "`resolution` is None"),
        ("update", "circle", "circle"),
        ("model", "clever:p=1", "no model is called"),
        ("model", None, "`model` is None"),
        ("posing", 5, "no option is called 'posing'"),
        ("posing", {"sensor_pose": [1, 2]}, "missing 5"),
        ("selection", {"stride": 0}, "`stride=0`"),
        ("selection", {"topics": 4}, "`topics` is 4"),
    ],
)
def test_what_cannot_be_an_option_is_refused(name: str, value: Any, found: str) -> None:
    plain = {**write_down(BuildOptions()), name: value}
    with pytest.raises(MapError) as caught:
        recall_options(plain, "m.npz")
    assert str(caught.value).startswith("m.npz: the options of a build in it cannot be read (")
    assert found in str(caught.value)
