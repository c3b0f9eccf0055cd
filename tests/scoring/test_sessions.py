"""Sessions in frames of their own: where one lies in the other is found, or it is refused."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from occmap.cells import Evidence
from occmap.choices import to_rpy
from occmap.difference import Place
from occmap.errors import PoseError
from occmap.options import BuildOptions, Selection
from occmap.pipeline import build
from occmap.posing import PosingOptions
from occmap.scoring.fit import Transform, Walls, find_transform, fit
from occmap.types import Pose
from tests.samples import SAMPLE_LOGS

DRIVE = SAMPLE_LOGS / "drive.mcap"
MOVED = (1.2, -0.7, 0.2)
SECOND = BuildOptions(selection=Selection(start_s=41.3))


def save_first_half(path: Path, align: float = 0.0) -> Evidence:
    posing = PosingOptions(transform=Pose.planar(*MOVED), align=align)
    first = BuildOptions(selection=Selection(end_s=41.3), posing=posing)
    evidence = build([DRIVE], first, [path]).evidence
    assert evidence is not None
    return evidence


@pytest.mark.parametrize("align", [0.0, 30.0])
def test_the_second_half_of_a_drive_is_laid_on_the_first(align: float, tmp_path: Path) -> None:
    past = save_first_half(tmp_path / "first.npz", align)
    options = replace(SECOND, posing=PosingOptions(align=align))
    pose, note = find_transform([DRIVE], options, past)
    true, found = Transform(*MOVED), Transform(pose.x, pose.y, to_rpy(pose)[2])
    corners = np.array([(-4.0, -3.0), (12.0, -3.0), (12.0, 9.0), (-4.0, 9.0)])  # of the office
    apart = found.move(corners) - true.move(corners)
    assert np.linalg.norm(apart.mean(axis=0)) < 0.03
    assert abs(found.yaw - true.yaw) < math.radians(0.2)
    assert "`transform=(1." in note


def test_what_fit_finds_makes_the_same_map_when_it_is_typed(tmp_path: Path) -> None:
    save_first_half(tmp_path / "first.npz")
    fitted = replace(SECOND, resume=tmp_path / "first.npz", fit=True)
    made = build([DRIVE], fitted, [tmp_path / "fitted.npz"])
    (note,) = [note for note in made.report.notes if "first.npz" in note]
    numbers = note.split("transform=(")[1].split(")")[0]
    posing = PosingOptions(transform=Pose.planar(*map(float, numbers.split(","))))
    typed = replace(SECOND, resume=tmp_path / "first.npz", posing=posing)
    build([DRIVE], typed, [tmp_path / "typed.npz"])
    one, other = (dict(np.load(tmp_path / f"{name}.npz")) for name in ("fitted", "typed"))
    for name in ("tiles", "observed", "first", "second"):
        assert np.array_equal(one[name], other[name])


def test_a_first_transform_is_where_the_search_begins(tmp_path: Path) -> None:
    past = save_first_half(tmp_path / "first.npz")
    near = Pose.planar(2.0, -1.4, 0.3)
    options = replace(SECOND, posing=PosingOptions(transform=near))
    pose, _ = find_transform([DRIVE], options, past)
    assert (pose.x, pose.y, to_rpy(pose)[2]) == pytest.approx(MOVED, abs=0.05)


def test_a_corridor_lets_the_search_slide() -> None:
    occupied = np.zeros((60, 400), np.bool_)
    occupied[[5, 55], :] = True  # two walls 2.5 m apart, 20 m long
    walls = Walls.of(occupied, Place(0.05, 0.0, 0.0), 2.0)
    along = np.arange(5.0, 15.0, 0.02)
    points = np.concatenate(
        [np.column_stack([along, np.full_like(along, y)]) for y in (0.28, 2.78)]
    )
    found = fit(points, walls)
    assert found.share > 0.9
    assert found.rival > 0.9
    assert not found.is_sure


def test_sessions_of_different_buildings_are_not_fitted(tmp_path: Path) -> None:
    past = save_first_half(tmp_path / "first.npz")
    elsewhere = replace(SECOND, posing=PosingOptions(transform=Pose.planar(4.0, 3.0, 1.0)))
    with pytest.raises(PoseError, match="not sure") as caught:
        find_transform([DRIVE], elsewhere, past)
    assert "transform" in caught.value.fix


def test_clouds_are_not_fitted(tmp_path: Path) -> None:
    past = save_first_half(tmp_path / "first.npz")
    of_clouds = replace(past, manifest=replace(past.manifest, update="cloud"))
    with pytest.raises(PoseError, match="planar lasers"):
        find_transform([DRIVE], SECOND, of_clouds)


def test_there_must_be_something_to_fit_to() -> None:
    (note,) = BuildOptions(fit=True).list_idle()
    assert "`fit`" in note
    assert "`resume`" in note
