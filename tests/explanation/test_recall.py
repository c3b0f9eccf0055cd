"""Options survive the manifest: what a build wrote down is what it was built with."""

import json
import math
from dataclasses import fields, is_dataclass, replace
from itertools import product
from pathlib import Path
from typing import Any

import pytest

from occmap.clouds import CloudOptions
from occmap.errors import MapError
from occmap.evidence.manifest import UNRECORDED, describe_build
from occmap.explanation.history import recall_options
from occmap.options import BuildOptions, Selection
from occmap.posing import Deskew, PosingOptions, Stamps
from occmap.readers import Echo, ReaderOptions
from occmap.sensor import NoReturn, ReturnOptions
from occmap.sensor.models import CountingModel, QuadraticModel, SimpleModel
from occmap.types import Pose, PoseSample, Update
from occmap.writers import MapMode, Shade, WriteOptions
from tests.samples import write_csv

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


def write_down(options: BuildOptions, folder: Path) -> dict[str, Any]:
    """What a manifest says of a build with these options, by way of JSON as in a file."""
    log = write_csv(folder / "log.csv", [(0.0, 0.0, 0.0)], [0.3])
    text = json.dumps(describe_build([log], options, {}), allow_nan=False)
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
def test_options_come_back(tmp_path: Path, options: BuildOptions) -> None:
    assert recall_options(write_down(options, tmp_path), "m.npz") == options


def test_every_choice_comes_back(tmp_path: Path) -> None:
    for update, stamps, deskew, no_return in product(Update, Stamps, Deskew, NoReturn):
        posing, returns = (
            PosingOptions(stamps=stamps, deskew=deskew),
            ReturnOptions(no_return=no_return),
        )
        options = BuildOptions(update=update, posing=posing, returns=returns)
        again = recall_options(write_down(options, tmp_path), "m.npz")
        assert again == options
        assert isinstance(again.posing.stamps, Stamps)


def test_threads_and_resuming_are_forgotten(tmp_path: Path) -> None:
    options = replace(UNUSUAL, jobs=7, resume=Path("old.npz"))
    assert recall_options(write_down(options, tmp_path), "m.npz") == UNUSUAL


def test_a_trajectory_file_is_a_name(tmp_path: Path) -> None:
    trajectory = tmp_path / "poses.txt"
    trajectory.write_text("0 0 0 0 0 0 0 1\n")
    options = BuildOptions(posing=PosingOptions(poses=str(trajectory)))
    assert recall_options(write_down(options, tmp_path), "m.npz").posing.poses == "poses.txt"


def test_an_option_that_was_not_there_yet_has_its_default(tmp_path: Path) -> None:
    plain = write_down(UNUSUAL, tmp_path)
    del plain["jump"]
    assert recall_options(plain, "m.npz") == replace(UNUSUAL, jump=BuildOptions().jump)


@pytest.mark.parametrize(
    ("name", "value", "found"),
    [
        ("smoothing", 3, "no option is called 'smoothing'"),
        ("resolution", "wide", "could not convert"),
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
def test_what_cannot_be_an_option_is_refused(
    tmp_path: Path, name: str, value: Any, found: str
) -> None:
    plain = {**write_down(BuildOptions(), tmp_path), name: value}
    with pytest.raises(MapError) as caught:
        recall_options(plain, "m.npz")
    assert str(caught.value).startswith("m.npz: the options of a build in it cannot be read (")
    assert found in str(caught.value)
