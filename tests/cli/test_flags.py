"""Texts from below the command line name options by their fields; here they become flags."""

import math

import click
import pytest

from occmap.choices import Option, take
from occmap.cli import COMMANDS
from occmap.cli.console import Console
from occmap.errors import UsageError
from occmap.options import FLAGS, OPTIONS, OTHER_FLAGS, BuildOptions, spell_flags
from tests.cli.runner import find_command


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
    command = find_command(name)
    options = [each for each in command.params if isinstance(each, click.Option)]
    flags = {
        each.name: each.opts for each in options if each.name in OPTIONS or each.name in OTHER_FLAGS
    }
    assert all(FLAGS[option] in flags[option] for option in flags)


def test_every_option_can_be_typed() -> None:
    names = ("build", "explain", "render", "score")
    commands = [find_command(name) for name in names]
    typed = {option for command in commands for each in command.params for option in each.opts}
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
    command = find_command(name)
    options = [each for each in command.params if isinstance(each, click.Option)]
    assert all(each.help for each in options)  # shells show it, too, where they complete a word


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
        if known.bounds != Option().bounds:
            with pytest.raises(UsageError, match=f"`{name}=nan`"):
                take(BuildOptions, {name: math.nan})
