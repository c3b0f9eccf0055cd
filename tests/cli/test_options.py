import math

import pytest

from occmap.errors import UsageError
from occmap.options import OPTIONS, spell_flags
from occmap.types import Pose


def test_a_sensor_pose_in_the_plane() -> None:
    half = math.sqrt(0.5)
    expected = (0.1, -0.2, 0.0, 0.0, 0.0, half, half)
    assert OPTIONS["sensor_pose"].read_one(f"0.1, -.2,{math.pi / 2}") == pytest.approx(expected)


def test_a_sensor_pose_upside_down() -> None:
    # Half a turn about x.
    expected = (0, 0, 0, 1, 0, 0, 0)
    assert OPTIONS["sensor_pose"].read_one(f"0,0,0,{math.pi},0") == pytest.approx(
        expected, abs=1e-12
    )


@pytest.mark.parametrize(
    ("text", "found"),
    [
        ("0,0", "2 values where 3 or 5 belong"),
        ("0,0,0,0", "4 values where 3 or 5 belong"),
        ("", "1 value where 3 or 5 belong"),
        ("0,0,pi", "'pi' is not a number"),
        ("0,,0", "'' is not a number"),
        ("0,nan,0", "'nan' is not a number"),
        ("inf,0,0", "'inf' is not a number"),
        ("0,0;0,0", "'0;0' is not a number"),
    ],
)
def test_a_wrong_sensor_pose_says_what_to_write(text: str, found: str) -> None:
    with pytest.raises(UsageError, match=found) as caught:
        OPTIONS["sensor_pose"].read_one(text)
    assert "give x,y,yaw or x,y,yaw,roll,pitch in metres" in str(caught.value)


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("sensor_pose", "0,0,180"),
        ("static_transforms", "base,laser,0,0,0,0,180,0"),
        ("transform", "1,2,180"),
        ("ignore_sectors", "-1,180"),
    ],
)
def test_degrees_are_refused_and_turned_to_radians(name: str, text: str) -> None:
    with pytest.raises(UsageError, match=r"write radians: 180 degrees are 3.14159"):
        OPTIONS[name].read_one(text)


@pytest.mark.parametrize(
    ("name", "text", "found"),
    [
        ("ignore_sectors", "1", "--ignore-sector 1: 1 value where 2 belong; give from,to in rad"),
        ("ignore_sectors", "1,one", "--ignore-sector 1,one: 'one' is not a number"),
        ("footprint", "1,2,3", "--footprint 1,2,3: 3 values where 4 belong; give x_min,y_min"),
        ("extent", "1", "--extent 1: 1 value where 4 belong; give x_min,y_min,x_max,y_max in met"),
        ("transform", "1,2", "--transform 1,2: 2 values where 3 belong; give x,y,yaw"),
        ("max_range", "far", "--max-range is 'far'; give a number"),
        ("stride", "1.5", "--stride is '1.5'; give a whole number"),
        ("align", "north", "--align is 'north'; give a number, or auto, so that walls run"),
        ("map_frame", "a\0", "--map-frame is 'a\\x00'; give text"),
    ],
)
def test_a_refused_value_names_its_option(name: str, text: str, found: str) -> None:
    with pytest.raises(UsageError) as caught:
        OPTIONS[name].read_one(text)
    assert spell_flags(str(caught.value)).startswith(found)


@pytest.mark.parametrize(
    ("name", "typed", "value"),
    [
        ("max_range", "inf", math.inf),
        ("stride", "3", 3),
        ("align", "auto", None),
        ("align", "-90", -90.0),
        ("max_pose_gap_s", "inf", math.inf),
        ("topics", "/scan", ("/scan",)),
        ("extent", "0, 0,5,4", (0.0, 0.0, 5.0, 4.0)),
        ("extent", ["0", 0, 5, 4.0], (0.0, 0.0, 5.0, 4.0)),
        ("ignore_sectors", ["2.5,-2.5", (1, 2)], ((2.5, -2.5), (1.0, 2.0))),
    ],
)
def test_a_value_may_be_given_as_it_is_typed(name: str, typed: object, value: object) -> None:
    assert OPTIONS[name].read(typed) == value


def test_a_transform() -> None:
    sample = OPTIONS["static_transforms"].read_one("base_link, laser,1,2,3,0,0,0")
    assert (sample.parent, sample.child, sample.static) == ("base_link", "laser", True)
    assert sample.pose == Pose(1, 2, 3, 0, 0, 0, 1)


@pytest.mark.parametrize(
    "text", ["a,b,1,2,3,0,0", "a,,1,2,3,0,0,0", "a,b,1,2,3,0,0,x", "a,b,1,2,3,0,0,0,0", ""]
)
def test_a_wrong_transform_says_what_to_write(text: str) -> None:
    with pytest.raises(UsageError, match="give parent,child,x,y,z,roll,pitch,yaw in metres"):
        OPTIONS["static_transforms"].read_one(text)
