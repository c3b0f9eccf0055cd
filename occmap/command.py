"""The `occmap build` line that makes a map, and the flag by which each option is typed."""

import math
import re
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from occmap.keywords import NONE, list_options, list_values
from occmap.options import BuildOptions
from occmap.types import Pose, PoseSample
from occmap.writers import WriteOptions

FLAGS = {
    "ignore_sectors": "--ignore-sector",
    "limits": "--fail-if",
    "logs": "--log",
    "outputs": "-o",
    "shade": "--light-occupied",
    "static_transforms": "--static-tf",
    "topics": "--scan-topic",
}
"""The flags of options that are not spelt like their names"""

MODEL_PARAMETERS = {
    "p_hit": ("P", "simple: probability of occupied, given one hit."),
    "p_miss": ("P", "simple: probability of occupied, given one miss."),
    "epsilon": ("M", "quadratic: half the depth of a hit."),
    "p_min": ("P", "quadratic: keep each observation within [P, 1 - P]."),
    "prior": ("P", "Probability of occupied before any observation."),
    "cut": ("P", "A cell is occupied above this probability, free below."),
    "spread": ("SHARE", "How much of a hit counts for each cell beside it."),
    "clamp_min": ("P", "Lowest probability of an observed cell."),
    "clamp_max": ("P", "Highest probability of an observed cell."),
}
"""Parameters of sensor models that are flags as well: what stands for the value, and the help"""

OPTIONS = {*list_options(BuildOptions), *MODEL_PARAMETERS, *FLAGS, "overview", "dask", "slice"}
"""The names of what can be typed as a flag"""

MARK = re.compile(r"`([a-z_]+)(?:=([^`]*))?`")
"""An option in a text, as libraries write it: `max_range`, `max_range=6`, `transform=(1,2,0)`"""

NOT_WRITTEN = (
    *("jobs", "update", "model", "min_passes", "pass_gap_s", "resume", "resume_if_there"),
    *list_options(WriteOptions),
)
"""Options that do not change how logs are read, or that a caller names itself"""

LEVEL_RAD = 5e-6
"""A smaller angle is written as 0."""


def spell_flag(option: str) -> str:
    """Spell an option as it is typed: `max_pose_gap_s` as --max-pose-gap."""
    return FLAGS.get(option) or "--" + option.removesuffix("_s").replace("_", "-")


def spell_flags(text: str) -> str:
    """Spell the options that a text names, as in `max_range=6`, as they are typed."""

    def spell(mark: re.Match[str]) -> str:
        if mark[1] not in OPTIONS:
            return mark[0]
        value = mark[2]
        if value is not None and value.startswith("("):  # a tuple, as Python has it
            value = value.strip("()")
        return spell_flag(mark[1]) if value is None else f"{spell_flag(mark[1])} {value}"

    return MARK.sub(spell, text)


def compose_build(
    logs: Sequence[str], options: BuildOptions, changes: Mapping[str, str], update: str = ""
) -> tuple[str, ...]:
    """Compose the words of an `occmap build`.

    Parameters
    ----------
    options
        Those that differ from their defaults are written; not so update, model and outputs.
    changes
        Values of options by name, which go before those of `options`.
    """
    usual = list_values(BuildOptions())
    given = {
        name: [NONE[name][0]] if value is None else list_texts(value)
        for name, value in list_values(options).items()
        if value != usual[name] and name not in NOT_WRITTEN
    }
    for name, text in changes.items():
        kept = []
        if name == "static_transforms":  # the transforms to other frames stay beside a new one
            child = text.split(",")[1]
            kept = [each for each in given.get(name, []) if each.split(",")[1] != child]
        given[name] = [*kept, text]
    words = [w for name, texts in given.items() for text in texts for w in (spell_flag(name), text)]
    start = ("occmap", "build", update) if update else ("occmap", "build")
    return (*start, *logs, *words, "-o", f"{name_map(logs[0])}.pgm")


def chain_builds(lines: Sequence[tuple[str, ...]]) -> Iterator[tuple[str, ...]]:
    """Let each of several `occmap build` lines add to what the lines before it observed."""
    saved = Path(lines[0][-1]).with_suffix(".npz").name
    kept: tuple[str, ...] = ()
    for line in lines:
        yield (*line[:-2], *kept, "-o", saved, *line[-2:])
        kept = (spell_flag("resume"), saved)


def name_map(path: str) -> str:
    """Name a map after its log: the base name without what it is packed and written in."""
    stem = Path(Path(path).resolve().name.removesuffix(".gz")).stem
    return "stdin" if stem == "-" else stem or "map"


def list_texts(value: Any) -> list[str]:
    """Write the value of an option as it is typed; some options are typed once for each item."""
    one = not isinstance(value, tuple) or isinstance(value, Pose) or isinstance(value[0], float)
    return [write_item(item) for item in ([value] if one else value)]


def write_item(value: Any) -> str:
    """Write a value, or one item of several, as it is typed."""
    if isinstance(value, Pose):
        return format_mount(value)
    if isinstance(value, PoseSample):
        return format_static(value.parent, value.child, value.pose)
    if isinstance(value, tuple):
        return _join(value)
    return f"{value:.12g}" if isinstance(value, float) else str(value)


def format_mount(pose: Pose) -> str:
    """Write a pose as --sensor-pose takes it: x,y,yaw, and roll,pitch where it is not level."""
    roll, pitch, yaw = to_rpy(pose)
    level = abs(roll) < LEVEL_RAD and abs(pitch) < LEVEL_RAD
    return _join([pose.x, pose.y, yaw] if level else [pose.x, pose.y, yaw, roll, pitch])


def format_static(parent: str, child: str, pose: Pose) -> str:
    """Write a transform as --static-tf takes it: parent,child,x,y,z,roll,pitch,yaw."""
    return f"{parent},{child},{_join([pose.x, pose.y, pose.z, *to_rpy(pose)])}"


def to_rpy(pose: Pose) -> tuple[float, float, float]:
    """Roll, pitch and yaw about fixed axes (rad) of a pose's rotation (REP 103)."""
    _, _, _, x, y, z, w = pose
    roll = math.atan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y))
    pitch = math.asin(min(max(2 * (w * y - z * x), -1.0), 1.0))
    yaw = math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
    return roll, pitch, yaw


def _join(numbers: Sequence[float]) -> str:
    """Join numbers, to hundredths of a millimetre and without a negative zero."""
    return ",".join(f"{round(number, 5) + 0.0:.12g}" for number in numbers)
