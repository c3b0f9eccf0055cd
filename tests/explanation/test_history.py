"""Which builds a log went into, by its hash, and the options of these, as they wrote them down."""

import json
import math
import shutil
from collections.abc import Sequence
from dataclasses import fields, is_dataclass, replace
from itertools import product
from pathlib import Path
from typing import Any

import pytest

from occmap.cells import Evidence
from occmap.clouds import CloudOptions
from occmap.errors import LogError, MapError, PoseError
from occmap.evidence.manifest import UNRECORDED, describe_build, list_logs
from occmap.explanation import Use, find_uses, recall_options
from occmap.options import BuildOptions, Selection
from occmap.pipeline import build
from occmap.posing import Deskew, PosingOptions, Stamps
from occmap.readers import Echo, ReaderOptions
from occmap.sensor import NoReturn, ReturnOptions
from occmap.sensor.models import CountingModel, QuadraticModel, SimpleModel
from occmap.store.merging import merge
from occmap.types import Pose, PoseSample, Update
from occmap.writers import MapMode, Shade, WriteOptions
from occmap.writers.npz import read_evidence
from tests.samples import SAMPLE_LOGS, write_csv

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


def save(*logs: str, options: BuildOptions = SELECTED, into: str = "m.npz") -> Evidence:
    build([Path(log) for log in logs], options, [Path(into)])
    return read_evidence(Path(into))


def name_uses(uses: Sequence[Use]) -> list[tuple[str, int]]:
    return [(str(use.log), use.build) for use in uses]


def find(evidence: Evidence, *logs: str, poses: Sequence[str] = ()) -> list[Use]:
    return find_uses(evidence, [Path(log) for log in logs], [Path(path) for path in poses])


def test_a_log_is_found_with_the_options_of_its_build() -> None:
    (use,) = find(save("a.csv", "b.csv"), "b.csv")
    assert (use.log, use.build) == (Path("b.csv"), 0)
    assert use.options == replace(SELECTED, jobs=use.options.jobs)


def test_every_build_that_used_a_log_is_found_with_its_own_options() -> None:
    later = BuildOptions(selection=Selection(start_s=-1.0))
    evidence = merge([save("b.csv"), save("a.csv", "b.csv"), save("b.csv", options=later)])
    uses = find(evidence, "b.csv", "a.csv")
    assert name_uses(uses) == [("b.csv", 0), ("b.csv", 1), ("b.csv", 2), ("a.csv", 1)]
    assert [use.options.selection.start_s for use in uses[:3]] == [-float("inf")] * 2 + [-1.0]


def test_copies_of_a_log_are_one() -> None:
    shutil.copy("a.csv", "copy.csv")
    assert name_uses(find(save("a.csv"), "./a.csv", "a.csv", "copy.csv")) == [("copy.csv", 0)]


def test_a_folder_is_known_by_its_files(tmp_path: Path) -> None:
    shutil.copytree(SAMPLE_LOGS / "drive_ros2", tmp_path / "drive")
    evidence = save("drive", "a.csv")
    assert list_logs(evidence.manifest.builds[0]) == ["drive", "a.csv"]
    shutil.move("drive", "elsewhere")
    assert name_uses(find(evidence, "elsewhere")) == [("elsewhere", 0)]
    Path("elsewhere", "more.txt").write_text("?")
    with pytest.raises(LogError, match=r"elsewhere: m.npz was not made of it"):
        find(evidence, "elsewhere")


def build_followed() -> Evidence:
    return save("bare.csv", options=BuildOptions(posing=PosingOptions(poses="path.txt")))


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
    second = save("bare.csv", options=BuildOptions(posing=posing), into="n.npz")
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
    evidence = merge([build_followed(), save("a.csv", into="n.npz")])
    with pytest.raises(PoseError) as caught:
        find(evidence, log, poses=poses)
    assert found in str(caught.value)


def test_what_is_no_log_of_the_evidence_is_refused_with_what_it_was_made_of() -> None:
    with pytest.raises(LogError, match=r"b.csv: m.npz was not made of it, .* a.csv: .*`logs`"):
        find(save("a.csv"), "b.csv")
    with pytest.raises(LogError, match=r"path.txt: m.npz was not made of it, .* bare.csv"):
        find(build_followed(), "path.txt")


MOUNT = Pose.from_xyzrpy((0.1, -0.2, 0.3), (math.pi, 0.1, -0.7))
UNUSUAL = BuildOptions(
    resolution=0.1 + 0.2,
    update=Update.POLYGON,
    model=CountingModel(
        *(0.45, 1 / 3, 2.5, 0.4, 0.01, 0.1, 0.96), ceiling=0.9, doubt=0.1, repeat_from=8.0
    ),
    reading=ReaderOptions(echo=Echo.LAST),
    clouds=CloudOptions(0.2, 1.1, 0.02, "flat", 0.7),
    returns=ReturnOptions(
        min_range=0.05,
        max_range=7.7,
        range_max=29.9,
        no_return=NoReturn.CLEAR,
        ignore_sectors=((2.5, -2.5), (0.1, 0.2)),
        footprint=(-0.4, -0.3, 0.2, 0.3),
    ),
    posing=PosingOptions(
        map_frame="world",
        base_frame="robot",
        sensor_pose=MOUNT,
        poses="/slam/pose",
        max_pose_gap_s=None,
        time_offset_s=-1e-9,
        max_speed=math.inf,
        transform=Pose.planar(1 / 3, -2.5, 0.1),
        align=-12.34,
        level=(1.25, -100.0),
        height_drift={},
        deskew=Deskew.AUTO,
        stamps=Stamps.RECORD,
        static_transforms=(PoseSample(0, "robot", "laser", MOUNT, static=True),),
    ),
    selection=Selection(topics=("/front", "/rear"), start_s=1.5, end_s=1e6, stride=3),
    writing=WriteOptions(MapMode.SCALE, 0.7, 0.2, Shade.LIGHT_OCCUPIED),
    jump=math.inf,
    border_gap=0,
    hit_offset=0.25,
    max_cells=12,
    min_passes=3,
    pass_gap_s=0.25,
)
"""Nothing in it is as usual."""


def write_down(options: BuildOptions) -> dict[str, Any]:
    """What a manifest says of a build with these options, by way of JSON as in a file."""
    text = json.dumps(describe_build([Path("a.csv")], options, {}), allow_nan=False)
    chosen: dict[str, Any] = json.loads(text)["options"]
    return chosen


def list_usual(group: Any, usual: Any, name: str = "") -> list[str]:
    """Names of the options that have the same value in both."""
    if not is_dataclass(group):
        return [name] if group == usual else []
    pairs = [(f.name, getattr(group, f.name), getattr(usual, f.name)) for f in fields(group)]
    return [each for field, mine, its in pairs for each in list_usual(mine, its, field)]


def test_every_option_is_tested() -> None:
    left = {"extent", "margin", "edits", "georeference"} | set(UNRECORDED) - {"framing"}
    assert set(list_usual(UNUSUAL, BuildOptions())) == left


@pytest.mark.parametrize(
    "options",
    [
        BuildOptions(),
        UNUSUAL,
        replace(UNUSUAL, model=QuadraticModel(0.07, 0.3, 0.4), min_passes=None),
        replace(UNUSUAL, model=SimpleModel(0.9, 1 / 3, 0.45, cut=0.6, spread=0.0, clamp_min=0.1)),
        replace(UNUSUAL, returns=ReturnOptions(), posing=PosingOptions(max_pose_gap_s=math.inf)),
    ],
    ids=lambda options: options.model.name,
)
def test_options_come_back(options: BuildOptions) -> None:
    assert recall_options(write_down(options), "m.npz") == options


def test_every_choice_comes_back() -> None:
    for update, stamps, deskew, no_return in product(Update, Stamps, Deskew, NoReturn):
        posing = PosingOptions(stamps=stamps, deskew=deskew)
        returns = ReturnOptions(no_return=no_return)
        options = BuildOptions(update=update, posing=posing, returns=returns)
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
