"""What evidence was made of: input files with their hashes, options, and what became of scans."""

import hashlib
import json
import math
from collections import Counter, defaultdict
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import fields, is_dataclass
from enum import Enum
from importlib.metadata import version
from itertools import combinations
from pathlib import Path
from typing import Any

from occmap.cells import About, Manifest
from occmap.errors import refuse_unreadable
from occmap.grid.tiles import EvidenceKind
from occmap.posing import measure_drift
from occmap.report import join_names
from occmap.sensor.models import NO_CLAMP, RadialModel, SensorModel, describe_model
from occmap.types import Update

UNRECORDED = ("framing", "jobs", "resume", "resume_if_there", "fit")
"""Options that change nothing about what is observed, so builds do not record them."""
BuildRecord = dict[str, Any]
"""An entry of `Manifest.builds`, as `describe_build` makes it"""
RENDER_PARAMETERS = ("prior", "cut", *NO_CLAMP)
"""Parameters of models that change how evidence is rendered, not the evidence itself."""
MEANING = ("resolution", "update", "kind", "profile", "pass_gap_s", "hit_offset", "align")
"""What the numbers of evidence depend on: evidence that is combined is equal in all of these."""


def describe_build(
    logs: Iterable[dict[str, Any]], options: Any, scans: dict[str, Any]
) -> BuildRecord:
    """Describe what one build used, in values that JSON has.

    Files are named without their folders: the hashes say which files they are, and the same build
    makes the same bytes on every machine.

    Parameters
    ----------
    logs
        What `describe_files` says of them.

    Raises
    ------
    LogError
        A trajectory cannot be read any more.
    """
    chosen = write_options(options)
    if options.update is not Update.CLOUD and options.clouds == type(options.clouds)():
        del chosen["clouds"]
    if options.posing.level is None:
        del chosen["posing"]["level"]
    if (drift := options.posing.height_drift) is None:
        del chosen["posing"]["height_drift"]
    else:  # that of a log is found again, and may have many parts: how much it is is told (m)
        told = chosen["posing"]["height_drift"] = dict[str, float]()
        for log, each in drift.items():
            name = Path(log).name
            told[f"{name} ({len(told) + 1})" if name in told else name] = measure_drift(each)
    if (own := options.clouds.own_points) is None:
        chosen.get("clouds", {}).pop("own_points", None)
    else:  # likewise: whether anything was left out is told
        chosen["clouds"]["own_points"] = bool(own)
    edits = chosen["writing"].pop("edits")  # of the map, and nothing of the evidence
    del chosen["writing"]["georeference"]  # likewise
    for path in options.posing.files:
        _, topic = options.posing.recording or (path, "")
        chosen["posing"]["poses"] = f"{path.name}:{topic}" if topic else path.name
    return {
        "occmap": version("occmap"),
        "inputs": [*logs, *describe_files(*options.posing.files)],
        "options": {**chosen, "model": describe_model(options.model)},
        "scans": scans,
        **({"edits": Path(edits).name} if edits else {}),
    }


def leave_out(build: BuildRecord, part: BuildRecord) -> BuildRecord | None:
    """Take the logs of another build out of one that read them alike; None where it did not.

    What is left has no inputs if those were all. Else it names what was taken out.
    """
    logs, taken = list_inputs(build), list_inputs(part)
    left = [entry for entry in logs if entry not in taken]
    if len(left) + len(taken) != len(logs) or list_alike(build) != list_alike(part):
        return None
    whole, its = build["scans"], part["scans"]
    scans = {name: whole[name] - its[name] for name in ("read", "used")}
    for name in ("dropped", "beams"):
        scans[name] = {kind: n - its[name].get(kind, 0) for kind, n in whole[name].items()}
    out = [*build.get("subtracted", ()), *taken]
    inputs = [*left, *list_trajectory(build)] if left else []
    return {**build, "inputs": inputs, "scans": scans, "subtracted": out}


def list_alike(build: BuildRecord) -> list[Any]:
    """List what is the same in builds that read logs alike: edits are drawn over a map alone."""
    others = ("inputs", "scans", "edits", "subtracted")
    return [list_trajectory(build), {key: build[key] for key in build if key not in others}]


def write_options(options: Any) -> dict[str, Any]:
    """Write the options that change what is observed."""
    return {name: value for name, value in write_value(options).items() if name not in UNRECORDED}


def describe_files(*paths: Path) -> Iterator[dict[str, Any]]:
    """Name, size and SHA-256 of files, and of each file in folders.

    Raises
    ------
    LogError
        A file cannot be read any more.
    """
    for path in paths:
        for each in list_files(path):
            with refuse_unreadable(each), each.open("rb") as file:
                digest = hashlib.file_digest(file, "sha256").hexdigest()
                size = file.tell()
            name = each.relative_to(path.parent).as_posix()
            yield {"name": name, "bytes": size, "sha256": digest}


def measure_files(path: Path) -> int:
    """Count the bytes of a file, or of all files in a folder.

    Raises
    ------
    LogError
        A file cannot be read any more.
    """
    with refuse_unreadable(path):
        return sum(each.stat().st_size for each in list_files(path))


def list_files(path: Path) -> list[Path]:
    """List a file, or all files in a folder."""
    return sorted(each for each in path.rglob("*") if each.is_file()) if path.is_dir() else [path]


def list_trajectory(build: BuildRecord) -> list[dict[str, Any]]:
    """List the entries of the trajectory: the last input, or all files of that folder."""
    inputs = build["inputs"]
    name, slash, _ = inputs[-1]["name"].partition("/")
    poses = build["options"]["posing"]["poses"] or ""
    if poses != name and not poses.startswith(f"{name}:"):  # of a recording, its topic may follow
        return []
    first = len(inputs) - 1
    # The files of one folder are in order, so that a folder of logs of that name ends before them.
    while slash and first and f"{name}/" <= inputs[first - 1]["name"] < inputs[first]["name"]:
        first -= 1
    return list(inputs[first:])


def list_inputs(build: BuildRecord) -> list[dict[str, Any]]:
    """List the entries of a build's logs, without its trajectory."""
    return list(build["inputs"][: len(build["inputs"]) - len(list_trajectory(build))])


def list_logs(*builds: BuildRecord) -> list[str]:
    """Name the logs of builds: the files, and the folders that were read as one log."""
    inputs = (entry for build in builds for entry in list_inputs(build))
    # Of a folder, the inputs are called folder/file.
    return list(dict.fromkeys(entry["name"].partition("/")[0] for entry in inputs))


def write_value(value: Any) -> Any:
    """Write an option so that JSON holds it and `recall_options` reads it back: inf as "inf"."""
    if is_dataclass(value):
        return {field.name: write_value(getattr(value, field.name)) for field in fields(value)}
    if isinstance(value, Enum):
        return value.value
    if isinstance(value, tuple):
        return [write_value(each) for each in value]
    if isinstance(value, float) and not math.isfinite(value):
        return str(value)
    return value if isinstance(value, int | float | str | None) else str(value)


def plan_manifest(options: Any) -> Manifest:
    """Say what evidence a build makes, before it is known what it makes it of."""
    profile = describe_profile(options.model)
    kind = EvidenceKind.LOG_ODDS if profile else EvidenceKind.COUNTS
    return Manifest(
        options.resolution,
        options.update.value,
        kind.value,
        profile,
        options.pass_gap_s,
        options.hit_offset,
        describe_model(options.model),
        builds=(),
        align=options.posing.align,
    )


MOST_NAMED = 20
"""Logs that a file of a map names at most"""


def describe_about(manifest: Manifest, name: str, options: Any, logs: Iterable[str] = ()) -> About:
    """Say what a map is of.

    Parameters
    ----------
    name
        What `Manifest.identify` calls the evidence.
    options
        As `RenderOptions` of `occmap.store`.
    logs
        Names of those that the manifest does not have.
    """
    writing, framing = options.writing, options.framing
    drawn = [[s.change, [ring.tolist() for ring in s.rings], s.width] for s in writing.shapes]
    given = write_value(writing) | write_value(framing)
    given["edits"] = drawn or None
    given |= {name: getattr(options, name) for name in ("min_passes", "since", "until")}
    usual = write_value(type(writing)()) | write_value(type(framing)())
    # An option that a later version adds changes no name where nobody gives it.
    how = {name: value for name, value in given.items() if value != usual.get(name)}
    text = json.dumps([manifest.model, how], sort_keys=True)
    rendering = hashlib.sha256(text.encode()).hexdigest()[:12]
    names = sorted({*list_logs(*manifest.builds), *logs})
    named = join_names(map(json.dumps, names), MOST_NAMED)
    return About(version("occmap"), name, rendering, named, manifest.align or 0.0)


def list_doubts(manifest: Manifest) -> Iterator[str]:
    """Say what a reader of evidence should know of it."""
    yield from list_repeated(manifest.builds)
    names = {
        Update.BEAM: ("level",),
        Update.SURFACE: ("jump", "level"),
        Update.POLYGON: ("jump", "border_gap", "level"),
        # Of clouds no level is told: it lays their grounds on each other, which are compared.
        Update.CLOUD: ("min_height", "max_height", "range_margin"),
    }
    of_builds = [
        {"level": [0.0, 0.0]} | options["posing"] | options.get("clouds", {}) | options
        for options in (build["options"] for build in manifest.builds)
    ]
    for name in names[Update(manifest.update)]:
        values = {str(options[name]) for options in of_builds if name in options}
        if len(values) > 1:
            yield f"its builds differ in `{name}` ({', '.join(sorted(values))})"
    if manifest.subtracted:
        yield (
            "what was subtracted was no whole build and no whole logs of one, so logs, scans and "
            "beams are counted as before, and numbers of visits are upper bounds"
        )
    if any("subtracted" in build for build in manifest.builds):
        yield "some logs of a build were subtracted, so numbers of visits are upper bounds"


def list_repeated(builds: Sequence[BuildRecord]) -> Iterator[str]:
    """Say which logs count more than once. Parts of one log that share no scan do not."""
    uses: dict[str, dict[Any, Any]] = defaultdict(dict)
    for number, build in enumerate(builds):
        times = Counter[str]()
        for entry in list_inputs(build):
            times[entry["name"]] += 1
            # Of a folder, the inputs are called folder/file; some may be equal, as empty clouds.
            log = entry["name"].partition("/")[0], number, times[entry["name"]]
            uses[entry["sha256"]][log] = build["options"]["selection"]
    pairs = (pair for logs in uses.values() for pair in combinations(logs.items(), 2))
    names = dict.fromkeys(name for (_, one), ((name, *_), other) in pairs if overlap(one, other))
    if names:
        are, they, them = ("is", "it", "it") if len(names) == 1 else ("are", "they", "them")
        yield (
            f"{join_names(names)} {are} in it more than once, in whole or in part, and what {they} "
            f"observed counts as often; to take {them} out once, build {them} again alone, and let "
            "`occmap merge` subtract that"
        )


def overlap(one: dict[str, Any], other: dict[str, Any]) -> bool:
    """Whether two selections share scans, as far as can be told without the log.

    Two different selections that both have a stride may take turns, so they count as apart.
    """
    begin = max(float(each["start_s"]) for each in (one, other))
    end = min(float(each["end_s"]) for each in (one, other))
    topics, others = set(one["topics"]), set(other["topics"])
    apart = begin >= end or (topics and others and not topics & others)
    return not apart and (one == other or 1 in (one["stride"], other["stride"]))


def describe_profile(model: SensorModel) -> str:
    """Name the radial model that log-odds are summed by, without prior and bounds; else ""."""
    if not isinstance(model, RadialModel):
        return ""
    name, _, pairs = describe_model(model).partition(":")
    kept = (pair for pair in pairs.split(",") if pair.partition("=")[0] not in RENDER_PARAMETERS)
    return f"{name}:{','.join(kept)}"
