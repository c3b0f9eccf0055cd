"""Options are read as they are typed, held to their bounds, and called by their flags.

Texts from below the command line name options by their fields; here they become flags.
"""

import math

import click
import pytest

from occmap.choices import UNBOUNDED, take
from occmap.cli import COMMANDS
from occmap.cli.console import Console
from occmap.errors import UsageError
from occmap.options import FLAGS, OPTIONS, OTHER_FLAGS, BuildOptions, spell_flags
from occmap.types import Pose
from tests.cli.runner import find_command


def list_options(command: str) -> list[click.Option]:
    return [each for each in find_command(command).params if isinstance(each, click.Option)]


HALF = math.sqrt(0.5)


@pytest.mark.parametrize(
    ("text", "pose"),
    [
        (f"0.1, -.2,{math.pi / 2}", (0.1, -0.2, 0.0, 0.0, 0.0, HALF, HALF)),
        (f"0,0,0,{math.pi},0", (0, 0, 0, 1, 0, 0, 0)),  # upside down: half a turn about x
    ],
)
def test_a_sensor_pose(text: str, pose: tuple[float, ...]) -> None:
    assert OPTIONS["sensor_pose"].read_one(text) == pytest.approx(pose, abs=1e-12)


@pytest.mark.parametrize(
    ("text", "found"),
    [
        ("0,0", "2 values where 3 or 5 belong"),
        ("0,0,pi", "'pi' is not a number"),
        ("0,,0", "'' is not a number"),
        ("0,nan,0", "'nan' is not a number"),
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
        ("footprint", "1,2,3", "--footprint 1,2,3: 3 values where 4 belong; give x_min,y_min"),
        ("transform", "1,2", "--transform 1,2: 2 values where 3 or 4 belong; give x,y,"),
        ("max_range", "far", "--max-range is 'far'; give a number"),
        ("stride", "1.5", "--stride is '1.5'; give a whole number"),
        ("align", "north", "--align is 'north'; give a number, or auto, so that walls run"),
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


@pytest.mark.parametrize(
    ("name", "pose", "typed"),
    [
        ("sensor_pose", Pose.from_xyzrpy((0.1, 0, 0.3), (0, 0.02, 0.5)), "0.1,0,0.5,0,0.02"),
        ("transform", Pose.planar(1, 2, 0.5)._replace(z=-0.4), "1,2,0.5,-0.4"),
        ("transform", Pose.planar(1, 2, 0.5), "1,2,0.5"),
    ],
)
def test_a_pose_is_written_as_its_option_takes_it(name: str, pose: Pose, typed: str) -> None:
    assert OPTIONS[name].write(pose) == [typed]
    OPTIONS[name].read_one(typed)


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


@pytest.mark.parametrize(
    ("text", "spelled"),
    [
        ("limit ranges with `max_range`", "limit ranges with --max-range"),
        ("try `no_return=clear`, or wait", "try --no-return clear, or wait"),
        ("longer than `max_pose_gap_s`", "longer than --max-pose-gap"),
        ("`start_s=3.0` is not before `end_s=2.0`", "--start 3.0 is not before --end 2.0"),
        ("`static_transforms=a,b,X`; `topics`", "--static-tf a,b,X; --scan-topic"),
        ("`sensor_pose=(x,y)` `base_frame=F`", "--sensor-pose x,y --base-frame F"),
        ("see `occmap check`, `merge` and `x=1`", "see `occmap check`, `merge` and `x=1`"),
        ("a frame `map_frame", "a frame `map_frame"),
    ],
)
def test_a_named_option_becomes_its_flag(text: str, spelled: str) -> None:
    assert spell_flags(text) == spelled


@pytest.mark.parametrize("name", COMMANDS)
def test_a_flag_is_what_the_rule_says(name: str) -> None:
    flags = {each.name: each.opts for each in list_options(name) if each.name in FLAGS}
    assert all(FLAGS[option] in flags[option] for option in flags)


def test_every_option_can_be_typed() -> None:
    names = ("build", "explain", "render", "score")
    typed = {option for name in names for each in list_options(name) for option in each.opts}
    positional = {"update"}  # the first word of a build
    assert {FLAGS[name] for name in {*OPTIONS, *OTHER_FLAGS} - positional} <= typed


def test_whatever_is_printed_is_spelled(capsys: pytest.CaptureFixture[str]) -> None:
    console = Console(as_json=True)
    console.note("try `max_range=6`")
    console.put(["left out by `stride`"])
    console.put_json("x", {"left out by `stride`": ["try `stride=2`", 1, None, ("`min_range`",)]})
    console.answered = False
    console.fail(UsageError("`jobs` is 0", where="`limits` 'x'", fix="give `jobs=1`"), 2)
    out, err = capsys.readouterr()
    assert err == "note: try --max-range 6\nerror: --fail-if 'x': --jobs is 0; give --jobs 1\n"
    for spelled in ("left out by --stride", "try --stride 2", "--min-range", "give --jobs 1"):
        assert f'"{spelled}"' in out
    assert "`" not in out


@pytest.mark.parametrize("name", COMMANDS)
def test_every_option_says_what_it_does(name: str) -> None:
    assert all(each.help for each in list_options(name))  # shells show it where they complete


@pytest.mark.parametrize(
    ("name", "value", "bounds"),
    [
        ("jump", -0.1, "0 or more"),
        ("border_gap", 1001, "0 to 1000"),
        ("hit_offset", 10.5, "0 to 10"),
        ("pass_gap_s", math.inf, "0.001 to 1e+09"),
        ("jobs", 0, "1 or more"),
        ("stride", 0, "1 or more"),
        ("margin", 1e9, "0 to 1e+08"),
        ("range_max", 0.0, "more than 0"),
        ("max_pose_gap_s", math.nan, "more than 0"),
        ("max_speed", -1.0, "more than 0"),
        ("time_offset_s", -5e9, "-4e+09 to 4e+09"),
        ("align", 361.0, "-360 to 360"),
    ],
)
def test_a_value_beyond_its_bounds_is_refused_with_the_flag(
    name: str, value: float, bounds: str
) -> None:
    with pytest.raises(UsageError) as caught:
        take(BuildOptions, {name: value})
    refused = f"{OPTIONS[name].flag} {value} is not possible; give {bounds}"
    assert spell_flags(str(caught.value)) == refused


def test_every_option_with_bounds_is_held_to_them() -> None:
    for name, known in OPTIONS.items():
        if known.bounds != UNBOUNDED:
            with pytest.raises(UsageError, match=f"`{name}=nan`"):
                take(BuildOptions, {name: math.nan})
