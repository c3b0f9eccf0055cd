"""What a notebook calls: flat options, a map that can be saved, the commands as functions."""

import base64
import inspect
import io
import json
import math
import pickle
import re
import shutil
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

import occmap
from occmap.choices import list_options, read_options
from occmap.cli.console import spell
from occmap.errors import OccmapError, OutputError, UsageError
from occmap.options import BuildOptions
from occmap.sensor import ReturnOptions
from occmap.sensor.models import CountingModel, QuadraticModel
from occmap.store.painting import RenderOptions
from occmap.types import Pose, PoseSample, Update
from tests.cli.runner import ask
from tests.every_option import EVERY
from tests.samples import DRIVES, ROOT, write_csv

DRIVE = DRIVES[-1]
BY_HAND: dict[str, Any] = {
    "update": "beam",
    "model": "simple:p_hit=0.9,p_miss=0.2,spread=0",
    "resolution": 0.1,
    "hit_offset": 0,
}


@pytest.fixture
def log(tmp_path: Path) -> Path:
    """Two scans from the middle of a cell of 0.1 m"""
    return write_csv(tmp_path / "log.csv", [(0.05, 0.05, 0.0)] * 2, [0.3])


def flatten(value: Any) -> Any:
    """Numbers and text of nested tuples, in one list."""
    if isinstance(value, tuple):
        return [each for part in value for each in flatten(part)]
    return [value]


@pytest.mark.parametrize(("group", "name", "given", "value"), EVERY, ids=[it[1] for it in EVERY])
def test_an_option_is_given_by_name_as_a_plain_value(
    group: str, name: str, given: Any, value: Any
) -> None:
    made, usual = read_options(BuildOptions, {name: given}, "build_map"), BuildOptions()
    for each in BuildOptions.__dataclass_fields__.keys() - {group, name}:
        assert getattr(made, each) == getattr(usual, each)
    holder = getattr(made, group) if group else made
    found = getattr(holder, name)
    for one, other in zip(flatten(found), flatten(value), strict=True):  # angles are rounded
        assert one == (pytest.approx(other) if isinstance(other, float) else other)
        assert type(one) is type(other)
    if group:
        others = replace(holder, **{name: getattr(getattr(usual, group), name)})
        assert others == getattr(usual, group)


def test_every_option_can_be_given() -> None:
    assert sorted(name for _, name, *_ in EVERY) == sorted(list_options(BuildOptions))
    more = {"overview", "since", "until"}
    assert list_options(RenderOptions).keys() <= {*list_options(BuildOptions), *more}


def test_values_of_the_classes_are_taken_as_they_are() -> None:
    mount, transform = Pose.planar(1, 2, 3), PoseSample(0, "a", "b", Pose.planar(0, 0, 0), True)
    given = {"model": QuadraticModel(), "update": Update.POLYGON}
    placed = {"sensor_pose": mount, "static_transforms": [transform]}
    made = read_options(BuildOptions, given | placed, "build_map")
    assert (made.model, made.update) == (QuadraticModel(), Update.POLYGON)
    assert (made.posing.sensor_pose, made.posing.static_transforms) == (mount, (transform,))


@pytest.mark.parametrize(
    ("name", "one"),
    [("ignore_sectors", (2.5, -2.5)), ("static_transforms", ("a", "b", 0.1, 0, 0.2, 0, 0, 0))],
)
def test_a_tuple_of_numbers_is_one_of_several_values(name: str, one: tuple[Any, ...]) -> None:
    alone, listed = (read_options(BuildOptions, {name: it}, "build_map") for it in (one, [one]))
    assert alone == listed != BuildOptions()


def test_none_is_the_default_but_where_it_is_a_value() -> None:
    nothing = dict.fromkeys(list_options(BuildOptions).keys() - {"align", "max_pose_gap_s"})
    assert read_options(BuildOptions, nothing, "build_map") == BuildOptions()
    endless = read_options(BuildOptions, {"max_pose_gap_s": None}, "build_map")
    assert endless.posing.max_pose_gap_s is None


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"maxrange": 6}, "build_map has no option 'maxrange'; did you mean 'max_range'?"),
        ({"static_tf": ()}, "no option 'static_tf'; did you mean 'static_transforms'?"),
        ({"returns": ReturnOptions()}, "build_map has no option 'returns'"),
        ({"no_return": "cler"}, '`no_return` is \'cler\'; give "clear" or "ignore"'),
        ({"max_range": True}, "`max_range` is True; give a number"),
        ({"align": True}, "give a number, or auto, so that walls run along the axes"),
        ({"max_pose_gap_s": "two"}, "give a number, or inf, to interpolate across any gap"),
        ({"jobs": 2.5}, "`jobs` is 2.5; give a whole number"),
        ({"model": 0.5}, "give text such as"),
        ({"topics": 5}, "`topics` is 5; give a list, each item text"),
        ({"footprint": (0, 1)}, "give x_min,y_min,x_max,y_max in metres"),
        ({"transform": (0, 0, 0, 3, 0)}, "`transform=(0, 0, 0, 3, 0)`: 5 values where 3 or 4 "),
        ({"sensor_pose": (math.nan, 0, 0)}, "`sensor_pose=(nan, 0, 0)`: nan is not a number"),
        ({"height_drift": {"a.csv": 3}}, "`height_drift` is {'a.csv': 3}; give \"off\""),
        ({"ignore_sectors": [2.5, -2.5]}, "give a list, each item from,to in radians"),
    ],
)
def test_what_is_no_option_is_refused_in_words(options: dict[str, Any], message: str) -> None:
    with pytest.raises(UsageError) as caught:
        occmap.build_map("there is no such log", **options)
    assert message in str(caught.value)


@pytest.mark.parametrize("call", [occmap.check, occmap.compare, occmap.tune])
@pytest.mark.parametrize("name", ["update", "model", "min_passes", "resume", "mode", "shade"])
def test_an_option_that_would_do_nothing_is_refused(call: Any, name: str) -> None:
    with pytest.raises(UsageError, match=f"has no option '{name}'; build_map takes it"):
        call(DRIVE, **{name: None})


@pytest.mark.parametrize("call", [occmap.build_map, occmap.check, occmap.compare, occmap.merge])
def test_paths_are_given_one_by_one_or_as_a_list(call: Any) -> None:
    name = getattr(call, "__name__", "")
    asked = "paths" if call is occmap.merge else "logs"
    given: Any
    for given in ((), ([],)):
        with pytest.raises(UsageError, match=rf"no file is given; see help\(occmap.{name}\)"):
            call(*given)
    with pytest.raises(UsageError, match=rf"`{asked}` is b'a.bag'; give a list, each item a path"):
        call(b"a.bag")
    for given in (("a.bag", 3), (["a.bag", 3],)):
        with pytest.raises(UsageError, match=rf"`{asked}` is 3; give a list, each item a path"):
            call(*given)


@pytest.mark.parametrize(
    ("call", "name", "value"),
    [
        *((occmap.build_map, "outputs", value) for value in (3, None, ["a\0.pgm"])),
        *((occmap.build_map, name, np.zeros(3)) for name in ("update", "mode", "echo")),
        (occmap.build_map, "max_range", 10**400),
        (occmap.build_map, "topics", np.array(1)),
        (occmap.build_map, "poses", "a\0"),
        (occmap.build_map, "map_frame", b"map"),
        (occmap.compare, "updates", "beem"),
        *((occmap.compare, "models", value) for value in (3, [None])),
        (occmap.compare, "picture", 3),
        (occmap.merge, "subtract", 3),
        (partial(occmap.merge, "a.npz"), "fit", "yes"),
        (partial(occmap.diff, "a.pgm"), "picture", b"c.png"),
    ],
)
def test_a_value_of_a_wrong_type_is_named(call: Any, name: str, value: Any) -> None:
    with pytest.raises(UsageError, match=rf"^`{name}` is .*; "):
        call(DRIVE, **{name: value})


@pytest.mark.parametrize("name", ["build_map", "check", "compare", "tune", "score"])
def test_what_a_folder_holds_is_noted(name: str, tmp_path: Path, halves: Path) -> None:
    (tmp_path / "drive.csv").symlink_to(DRIVE)
    (tmp_path / "broken.bag").write_text("no bag")
    given = {"logs": tmp_path} if name == "score" else {}
    path = halves / "whole.pgm" if given else tmp_path
    found = getattr(occmap, name)(path, stride=4, **given)
    first, second, *_ = getattr(found, "report", found).notes + getattr(found, "warnings", ())
    assert first == f"{tmp_path}: 1 recording: drive.csv"
    assert second.startswith(f"{tmp_path / 'broken.bag'}: passed over, though named like a rec")


LONG = "x" * 300


@pytest.mark.parametrize(
    "call",
    [
        *(partial(call, LONG) for call in (occmap.build_map, occmap.check, occmap.read_log)),
        partial(occmap.build_map, DRIVE, poses=LONG),
        partial(occmap.build_map, DRIVE, resume=f"{LONG}.npz"),
        partial(occmap.merge, f"{LONG}.zarr"),
        partial(occmap.diff, f"{LONG}.pgm", DRIVE),
        partial(occmap.explain, f"{LONG}.npz", 1, 1),
        partial(occmap.score, f"{LONG}.pgm", logs=DRIVE),
    ],
)
def test_a_path_that_is_too_long_is_an_error_in_one_line(call: Any) -> None:
    with pytest.raises(OccmapError, match=f"{LONG}.*: .*File name too long"):
        call()


@pytest.mark.parametrize("path", [3, b"a", "a\0", "\ud800"])
def test_what_is_no_path_is_refused(path: Any) -> None:
    with pytest.raises(UsageError, match=r"`logs` is .*; give .*a path"):
        occmap.check(path)
    with pytest.raises(UsageError, match=r"^`path` is .*; give a path"):
        occmap.read_log(path)
    with pytest.raises(UsageError, match=r"^`before` is .*; give a path"):
        occmap.diff(path, "a.pgm")


def test_the_docstring_lists_every_option_with_its_default_and_unit() -> None:
    text = inspect.getdoc(occmap.build_map) or ""
    shown = {
        name: (default, takes)
        for name, default, takes in re.findall(r"^    (\w+) = (.+?) \((.+)", text, re.MULTILINE)
    }
    assert shown.keys() == list_options(BuildOptions).keys()
    assert shown["max_range"][0] == "inf"
    assert shown["max_range"][1].startswith("m): Use beams only up to here; ")
    assert shown["stamps"][0] == '"header"'
    assert shown["stamps"][1].startswith('"header" or "record"): ')
    assert shown["footprint"][1].startswith("x_min,y_min,x_max,y_max in metres, such as")
    assert all(unit.startswith("s): ") for name, (_, unit) in shown.items() if name[-2:] == "_s")


def test_the_model_suits_the_update_where_none_is_given(log: Path) -> None:
    polygon = occmap.build_map(DRIVE, update="polygon", model=None, stride=50)
    for cut, made in ((0.4, polygon), (0.32, occmap.build_map(log))):
        share = 0.8 * cut * 1.02 * cut / (cut + 0.02)
        assert made.decision.occupied_above == pytest.approx(share)


def test_a_map_knows_its_cells_hits_and_misses(log: Path) -> None:
    grid = occmap.build_map(log, **BY_HAND)
    assert isinstance(grid, occmap.OccupancyMap)
    assert (grid.resolution, grid.origin, grid.shape) == (0.1, (0.0, 0.0), (1, 4))
    # Two scans: each misses three cells and hits the fourth.
    assert grid.hits.tolist() == [[0, 0, 0, 2]]
    assert grid.misses.tolist() == [[2, 2, 2, 0]]
    part = grid.take(slice(None), slice(2, 4))
    assert (part.hits.tolist(), part.misses.tolist()) == ([[0, 2]], [[2, 0]])
    # Odds of 1/4 and of 9, twice: 1/16 and 81.
    np.testing.assert_allclose(grid.probability, [[1 / 17, 1 / 17, 1 / 17, 81 / 82]], rtol=1e-5)
    np.testing.assert_allclose(grid.log_odds, [[-math.log(16)] * 3 + [math.log(81)]], rtol=1e-5)
    assert grid.occupied.tolist() == [[False, False, False, True]]
    assert grid.free.tolist() == [[True, True, True, False]]
    assert grid.agreement == 1.0
    assert repr(grid) == (
        "<Map of 4 x 1 cells of 0.1 m: 25.0% occupied, 75.0% free, 0.0% unknown; 2 of 2 scans used>"
    )


def test_hits_are_as_observed_whatever_the_visits(log: Path) -> None:
    grid = occmap.build_map(log, **BY_HAND, min_passes=2)
    assert grid.hits.sum() == 0  # one visit: the cell that was hit is not in the map any more
    assert grid.misses.tolist() == [[2, 2, 2]]


def test_a_model_that_sums_log_odds_keeps_no_hits(log: Path) -> None:
    grid = occmap.build_map(log, model="quadratic")
    assert grid.agreement is None
    for name in ("hits", "misses"):
        with pytest.raises(UsageError, match="the model quadratic sums up log-odds: it keeps no"):
            getattr(grid, name)


def test_a_map_is_saved_as_a_build_writes_it(tmp_path: Path) -> None:
    (tmp_path / "built").mkdir()
    (tmp_path / "saved").mkdir()
    names = ["map.pgm", "map.png", "map.npz"]
    grid = occmap.build_map(DRIVE, stride=8, outputs=[tmp_path / "built" / name for name in names])
    written = [path for name in names for path in grid.save(tmp_path / "saved" / name)]
    assert [each.name for each in written] == ["map.pgm", "map.yaml", "map.png", "map.npz"]
    for path in written:
        assert path.read_bytes() == (tmp_path / "built" / path.name).read_bytes()


def test_a_map_is_saved_as_its_options_say(log: Path, tmp_path: Path) -> None:
    grid = occmap.build_map(log, **BY_HAND, mode="scale", shade="light")
    assert not any("does nothing" in note for note in grid.report.notes)
    grid.save(str(tmp_path / "map.pgm"))
    assert "mode: scale\n" in (tmp_path / "map.yaml").read_text()
    grid.save(tmp_path / "map.png")
    grey = np.asarray(Image.open(tmp_path / "map.png"))[..., 0]
    assert grey.tolist() == [[15, 15, 15, 252]]  # 255/17, and 255 * 81/82


def test_a_map_passes_between_processes(log: Path, tmp_path: Path) -> None:
    grid = occmap.build_map(log, **BY_HAND, outputs=tmp_path / "map.npz")
    again = pickle.loads(pickle.dumps(grid))
    assert again.hits.tolist() == [[0, 0, 0, 2]]
    again.save(tmp_path / "again.npz")
    assert (tmp_path / "again.npz").read_bytes() == (tmp_path / "map.npz").read_bytes()
    more = occmap.build_map(log, **BY_HAND, resume=tmp_path / "map.npz")
    with pytest.raises(UsageError, match="did not keep when its cells were seen"):
        more.save(tmp_path / "more.npz")


@pytest.mark.parametrize(
    ("name", "error", "found"),
    [
        ("map.npz", UsageError, 'did not keep when .*; build it with outputs="map.npz"'),
        ("map.jpg", UsageError, "unknown suffix"),
        ("map.keepout.pgm", UsageError, "a keepout mask is of edits, and none"),
        ("nowhere/map.pgm", OutputError, "does not exist"),
    ],
)
def test_what_cannot_be_saved_is_refused(
    log: Path, tmp_path: Path, name: str, error: type[OccmapError], found: str
) -> None:
    grid = occmap.build_map(log)
    with pytest.raises(error, match=found):
        grid.save(tmp_path / name)
    assert list(tmp_path.iterdir()) == [log]


def test_an_input_is_never_saved_over(tmp_path: Path) -> None:
    bag = shutil.copytree(DRIVES[3], tmp_path / "bag")
    grid = occmap.build_map(bag, stride=50)
    with pytest.raises(UsageError, match="is an input"):
        grid.save(bag / "metadata.pgm")  # its YAML would be the bag's own
    grid = occmap.build_map(DRIVE, stride=50, outputs=tmp_path / "a.npz")
    with pytest.raises(UsageError, match="is an input"):
        occmap.merge(tmp_path / "a.npz").save(tmp_path / "a.npz")


def read_picture(grid: occmap.Map) -> Any:
    html = grid._repr_html_()
    (data,) = re.findall(r'<img src="data:image/png;base64,([^"]+)">', html)
    return np.asarray(Image.open(io.BytesIO(base64.b64decode(data))))


def test_a_notebook_shows_a_picture_and_the_notes(log: Path) -> None:
    grid = occmap.build_map(log, log, **BY_HAND)
    pixels = read_picture(grid)
    # Four cells of 90 pixels; four scans: odds of 1/256 and of 6561.
    assert pixels.shape == (90, 360, 3)
    assert pixels[0, ::90, 0].tolist() == [254, 254, 254, 0]
    html = grid._repr_html_()
    assert "Map of 4 x 1 cells of 0.1 m" in html
    assert f"{log.name} is in it more than once" in html


def test_a_large_map_is_shown_thinned(tmp_path: Path) -> None:
    log = write_csv(tmp_path / "log.csv", [(0.05, 0.05, 0.0)] * 2, [250.0])
    grid = occmap.build_map(log, **BY_HAND)
    assert grid.shape == (1, 2501)
    pixels = read_picture(grid)
    assert pixels.shape == (1, 834, 3)  # three cells a pixel
    assert pixels[0, -1, 0] == round(255 * (1 - 81 / 82))  # a wall is not thinned away


def hold_against_command(found: Any, *words: Any, **other: Any) -> Any:
    """See that a command prints what a function found, in which options are flags; return that."""
    printed, shown = ask(*words), json.loads(spell(json.dumps(found.to_json())))
    for each in (printed, shown):
        for variant in each.get("variants", []):
            assert variant.pop("seconds") >= 0
    assert printed == {**printed, **shown, **other}
    return printed


def test_check_and_tune_give_what_the_commands_print() -> None:
    found = occmap.check(DRIVE, resolution=0.1, max_range=5)
    hold_against_command(found, "check", DRIVE, "--resolution", "0.1", "--max-range", "5")
    assert found.buildable
    tuned = occmap.tune(DRIVE, stride=4)
    hold_against_command(tuned, "tune", DRIVE, "--stride", "4")
    assert tuned.scans.used == 104


@pytest.mark.parametrize(
    ("call", "needed"),
    [
        (occmap.build_map, "occmap.api.build"),
        (occmap.check, "occmap.inspection.inspect"),
        (occmap.compare, "occmap.page.compare_logs"),
        (lambda log: occmap.build([log], BuildOptions()), "occmap.pipeline.open_past"),
        (occmap.tune, "occmap.tuning.tune"),
    ],
)
def test_too_little_memory_is_told_with_what_to_do(
    call: Any, needed: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(*_: Any) -> None:
        raise MemoryError

    monkeypatch.setattr(needed, fail)
    with pytest.raises(OccmapError, match="out of memory; try a coarser `resolution`"):
        call(DRIVE)


def test_compare_gives_what_the_command_prints(tmp_path: Path) -> None:
    models: list[Any] = ["simple", CountingModel()]
    picture = tmp_path / "compare.png"
    found = occmap.compare(str(DRIVE), updates=["beam"], models=models, picture=picture, stride=4)
    words = ("--update", "beam", "--model", "simple", "--model", "counting", "--stride", "4")
    hold_against_command(found, "compare", DRIVE, *words, "-o", picture)
    assert {each.variant.name for each in found.results} == {"beam simple", "beam counting"}
    assert picture.exists()


@pytest.fixture(scope="module")
def halves(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with both halves of a drive, and the whole."""
    folder = tmp_path_factory.mktemp("halves")
    occmap.build_map(DRIVE, end_s=40, outputs=[folder / "a.npz", folder / "a.pgm"])
    occmap.build_map(DRIVE, start_s=40, outputs=folder / "b.npz")
    occmap.build_map(DRIVE, outputs=str(folder / "whole.pgm"))
    return folder


def test_merge_gives_what_the_command_prints_and_writes(halves: Path, tmp_path: Path) -> None:
    merged = occmap.merge(halves / "a.npz", str(halves / "b.npz"), mode="raw")
    assert repr(merged).endswith("; 414 of 414 scans used>")
    merged.save(tmp_path / "mine.npz")
    merged.save(tmp_path / "mine.pgm")
    outputs = ["-o", tmp_path / "its.npz", "-o", tmp_path / "its.pgm"]
    files = [str(tmp_path / f"its.{suffix}") for suffix in ("npz", "pgm", "yaml")]
    words = ("merge", halves / "a.npz", halves / "b.npz", "--mode", "raw", *outputs)
    hold_against_command(merged.report, *words, files=files)
    for suffix in (".npz", ".pgm"):
        written = (tmp_path / f"{name}{suffix}" for name in ("mine", "its"))
        assert len({file.read_bytes() for file in written}) == 1
    rest = occmap.merge(tmp_path / "mine.npz", subtract=[halves / "a.npz"])
    rest.save(tmp_path / "rest.npz")
    assert (tmp_path / "rest.npz").read_bytes() == (halves / "b.npz").read_bytes()


def test_a_part_of_evidence_is_shown_with_its_hits(halves: Path) -> None:
    whole, part = (occmap.merge(halves / "a.npz", extent=box) for box in (None, (0, 0, 2, 1)))
    assert (part.shape, part.origin) == ((20, 40), (0.0, 0.0))
    col, row = (round(-edge / 0.05) for edge in whole.origin)
    assert part.hits.sum() > 0
    assert np.array_equal(part.hits, whole.hits[row : row + 20, col : col + 40])


def test_one_file_of_evidence_is_rendered(halves: Path, tmp_path: Path) -> None:
    shown = occmap.merge(halves / "a.npz", model="simple", extent=(0, 0, 2, 1), min_passes=1)
    shown.save(tmp_path / "mine.pgm")
    choice = ("--model", "simple", "--extent", "0,0,2,1", "--min-passes", "1")
    files = [str(tmp_path / f"its.{suffix}") for suffix in ("pgm", "yaml")]
    words = ("render", halves / "a.npz", *choice, "-o", tmp_path / "its.pgm")
    hold_against_command(shown.report, *words, files=files)
    assert (tmp_path / "mine.pgm").read_bytes() == (tmp_path / "its.pgm").read_bytes()


def test_diff_gives_what_the_command_prints(halves: Path, tmp_path: Path) -> None:
    before, after, mine = halves / "a.npz", halves / "whole.pgm", tmp_path / "mine.png"
    found = occmap.diff(before, str(after), picture=mine, occupied_thresh=0.6)
    its = tmp_path / "its.png"
    hold_against_command(found, "diff", before, after, "-o", its, "--occupied-thresh", "0.6")
    assert found.share > 0
    assert mine.read_bytes() == its.read_bytes()
    with pytest.raises(UsageError, match="is not a picture"):
        occmap.diff(before, after, picture="diff.jpg")
    with pytest.raises(UsageError, match="diff has no option 'occupied'; did you mean 'occupied_"):
        occmap.diff(before, after, occupied=0.6)


def test_score_gives_what_the_command_prints(halves: Path, tmp_path: Path) -> None:
    mine, its, plan = tmp_path / "mine.png", tmp_path / "its.png", DRIVE.parent / "floor_plan.yaml"
    path = halves / "whole.pgm"
    found = occmap.score(path, logs=DRIVE, truth=plan, within_m=0.05, picture=mine, stride=4)
    words = ("--log", DRIVE, "--stride", "4", "--truth", plan, "--within", "0.05", "-o", its)
    hold_against_command(found, "score", path, *words, files=[str(its)])
    assert found.by_truth is not None
    assert found.by_logs is not None
    assert min(found.by_truth.edges_found, found.by_logs.share) > 0.9
    assert mine.read_bytes() == its.read_bytes()


@pytest.mark.parametrize(
    ("given", "found"),
    [
        ({}, "add `logs=LOG` or `truth=MAP`"),
        ({"logs": DRIVE, "picture": "a.png"}, "add `truth=MAP`"),
        ({"truth": "a.yaml", "within_m": 2}, "is not possible; give 0 to 1"),
        ({"truth": "a.yaml", "fit": 1}, "give True or False"),
        ({"logs": DRIVE, "resolution": 0.1}, "score has no option 'resolution'"),
        ({"logs": DRIVE, "occupied_tresh": 0.1}, "did you mean 'occupied_thresh'"),
        ({"logs": [3]}, "`logs` is 3; give a list, each item a path"),
        ({"logs": DRIVE, "qqqqq": 1}, "no option 'qqqqq'; see help(occmap.score)"),
    ],
)
def test_score_names_what_it_cannot_use(given: dict[str, Any], found: str, halves: Path) -> None:
    with pytest.raises(UsageError, match=re.escape(found)):
        occmap.score(halves / "whole.pgm", **given)


def test_explain_gives_what_the_command_prints(halves: Path) -> None:
    path = halves / "a.npz"
    found = occmap.explain(path, 1.5, -0.25, logs=DRIVE, model="simple", min_passes=1)
    words = ("--log", DRIVE, "--model", "simple", "--min-passes", "1")
    hold_against_command(found, "explain", path, "1.5", "-0.25", *words)
    assert found.scans
    grid = occmap.merge(path)
    x, y = grid.origin
    place = found.cell.lattice_row, found.cell.lattice_column
    index = place[0] - round(y / grid.resolution), place[1] - round(x / grid.resolution)
    assert found.seen.hits is not None
    assert grid.hits[index] == found.seen.hits / found.unit
    for wrong in ("here", None):
        with pytest.raises(UsageError, match=rf"^`x` is {wrong!r}; give a number"):
            occmap.explain(path, wrong, 0)  # type: ignore[arg-type]
        with pytest.raises(UsageError, match=f"`resolution` is {wrong!r}; give a number"):
            occmap.BuildOptions(resolution=wrong)  # type: ignore[arg-type]


def test_the_error_in_the_page_about_python_is_as_printed() -> None:
    text = (ROOT / "docs" / "python.md").read_text(encoding="utf-8")
    (shown,) = re.findall(r"print\(error\)  # (.*)", text)
    with pytest.raises(OccmapError) as caught:
        occmap.build_map("sample_logs/drive.mcap", maxrange=6)
    assert str(caught.value) == shown
