"""Which builds of evidence a log went into, and with what options.

A log is known by its hash, not by its name. Options are read back from the JSON that
`write_value` made of them.
"""

from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, fields, is_dataclass, replace
from pathlib import Path
from types import GenericAlias, NoneType
from typing import Any, TypeVar, get_args, get_origin, get_type_hints

from occmap.cells import Evidence
from occmap.choices import drop_none
from occmap.errors import LogError, MapError, OccmapError, PoseError
from occmap.evidence.manifest import BuildRecord, describe_files, find_trajectory, list_inputs
from occmap.options import BuildOptions
from occmap.report.words import join_names
from occmap.sensor.models import parse_model

Value = TypeVar("Value")


@dataclass(frozen=True)
class Use:
    """A log, and how a build used it."""

    log: Path
    build: int
    """Which of `Manifest.builds`"""
    options: BuildOptions


def find_uses(evidence: Evidence, logs: Iterable[Path], poses: Sequence[Path]) -> list[Use]:
    """Find every build that used a log; one that used it twice is found twice.

    Parameters
    ----------
    poses
        The trajectory files of the builds that had one, in any order.

    Raises
    ------
    LogError
        The evidence was not made of a log, or a file cannot be read.
    PoseError
        A trajectory is missing, or none of these builds had it.
    """
    builds = evidence.manifest.builds
    given = {digest: path for path in poses for digest in hash_files(path)}
    distinct: dict[frozenset[tuple[str, int]], Path] = {}
    for log in logs:  # of equal logs the first will do: a build cannot tell them apart
        distinct.setdefault(frozenset(hash_files(log).items()), log)
    uses: list[Use] = []
    for hashes, log in distinct.items():
        times = [count_uses(hashes, build) for build in builds]
        used = [index for index in range(len(builds)) if times[index]]
        if not used:
            refuse_stranger(evidence, log)
        for index in used:
            options = recall_build(builds[index], evidence.where, log, given)
            uses += [Use(log, index, options)] * times[index]
    trajectories = [find_trajectory(builds[use.build]) for use in uses]
    had = {trajectory["sha256"] for trajectory in trajectories if trajectory}
    if idle := [path for digest, path in given.items() if digest not in had]:
        found = "is not a trajectory that these logs were built with"
        raise PoseError(found, where=idle[0], fix="leave it out")
    return uses


def hash_files(path: Path) -> Counter[str]:
    """SHA-256 of a file, or of all files in a folder, with how many have it.

    Raises
    ------
    LogError
        A file cannot be read.
    """
    return Counter(str(entry["sha256"]) for entry in describe_files(path))


def count_uses(hashes: Iterable[tuple[str, int]], build: BuildRecord) -> int:
    """How many times a build read the log that has these hashes."""
    held = Counter(entry["sha256"] for entry in list_inputs(build))
    return min((held[digest] // count for digest, count in hashes), default=0)


def list_logs(build: BuildRecord) -> list[str]:
    """Name the logs of a build: the files, and the folders that were read as one log."""
    return list(dict.fromkeys(entry["name"].partition("/")[0] for entry in list_inputs(build)))


def list_missing(evidence: Evidence, uses: Sequence[Use]) -> list[str]:
    """Name the logs that went into the evidence, and that no use reads."""
    held = Counter(
        (index, entry["sha256"], entry["name"].partition("/")[0])
        for index, build in enumerate(evidence.manifest.builds)
        for entry in list_inputs(build)
    )
    read = {(use.build, digest) for use in uses for digest in hash_files(use.log)}
    return list(dict.fromkeys(name for index, digest, name in held if (index, digest) not in read))


def recall_build(build: BuildRecord, where: str, log: Path, given: dict[str, Path]) -> BuildOptions:
    """Recall the options of a build, with the trajectory that it had.

    Parameters
    ----------
    where
        The evidence file, for errors.
    log
        The log that needs the trajectory, for errors.
    given
        The trajectory files that the user gives, by their hashes.

    Raises
    ------
    PoseError
        The trajectory is not among those given.
    MapError
        As `recall_options`.
    """
    options = recall_options(build["options"], where)
    trajectory = find_trajectory(build)
    if trajectory is None:
        return options
    path = given.get(trajectory["sha256"])
    if path is None:
        others = ", ".join(map(str, given.values()))
        differs = f" (the SHA-256 of {others} is another)" if others else ""
        found = f"its poses came from {trajectory['name']}, which is needed again{differs}"
        raise PoseError(found, where=log, fix=f"add `poses={trajectory['name']}`")
    return replace(options, posing=replace(options.posing, poses=str(path)))


def refuse_stranger(evidence: Evidence, log: Path) -> None:
    """Refuse a log that the evidence was not made of.

    Raises
    ------
    LogError
        Saying whether it was changed, and what the evidence was made of.
    """
    names = list(dict.fromkeys(n for build in evidence.manifest.builds for n in list_logs(build)))
    if log.resolve().name in names:
        found = f"is not the {log.resolve().name} that {evidence.where} was made of: it was changed"
        raise LogError(found, where=log, fix="give the log as it was, or build the evidence again")
    found = f"{evidence.where} was not made of it"
    fix = f"it was made of {join_names(names or ['no log'])}: give `logs` with one of these"
    raise LogError(found, where=log, fix=fix)


def recall_options(plain: dict[str, Any], where: str) -> BuildOptions:
    """Turn what `describe_build` wrote of the options of a build back into options.

    What changes nothing about the evidence (threads, what was resumed) is at its default; a
    trajectory file is a name without its folder. An option that was not there yet has its default.

    Parameters
    ----------
    where
        The evidence file, for errors.

    Raises
    ------
    MapError
        This occmap does not know an option, or a value of it.
    """
    model_text = plain.get("model")
    try:
        chosen = {name: value for name, value in plain.items() if name != "model"}
        # Clouds were once flattened between two heights over the sensor.
        reading = chosen.get("reading", {}).items()
        gone = ("min_height", "max_height")
        chosen["reading"] = {name: value for name, value in reading if name not in gone}
        return make_group(BuildOptions, chosen, model=parse_model(str(model_text)))
    except (OccmapError, TypeError, ValueError, AttributeError, OverflowError) as error:
        found = f"the options of a build in it cannot be read ({error})"
        fix = "use the occmap that built it, or build it again"
        raise MapError(found, where=where, fix=fix) from None


def make_group(group: type[Value], plain: dict[str, Any], **others: Any) -> Value:
    """Make a group of options from values of JSON; `others` are taken as they are.

    Raises
    ------
    TypeError, ValueError, AttributeError, UsageError
        It has no option of such a name, or none that takes such a value.
    """
    kinds = get_type_hints(group)
    unknown = sorted(plain.keys() - {field.name for field in fields(group)})  # type: ignore[arg-type]  # dataclass
    if unknown:
        raise ValueError(f"no option is called {unknown[0]!r}")
    made = {name: make_value(kinds[name], value) for name, value in plain.items()}
    return group(**made, **others)


def make_value(kind: Any, plain: Any) -> Any:
    """Turn a value of JSON back into one of a type.

    Raises
    ------
    TypeError, ValueError, AttributeError, UsageError
        It is not of that type.
    """
    if is_dataclass(kind) and isinstance(kind, type):
        return make_group(kind, plain)
    if plain is None and NoneType in get_args(kind):
        return None
    kind = drop_none(kind)
    if get_origin(kind) is tuple:
        kinds = get_args(kind)
        kinds = kinds[:1] * len(list(plain)) if kinds[1:] == (Ellipsis,) else kinds
        return tuple(make_value(each, value) for each, value in zip(kinds, plain, strict=True))
    if issubclass(kind, tuple):  # a NamedTuple: the tuple of what its fields are
        return kind(*make_value(GenericAlias(tuple, tuple(get_type_hints(kind).values())), plain))
    return kind(plain)
