"""Logs that went into evidence more than once: their scans count as often."""

from collections.abc import Iterator, Sequence
from itertools import combinations
from typing import Any

from occmap.evidence.manifest import BuildRecord, list_inputs


def list_repeated(builds: Sequence[BuildRecord]) -> Iterator[str]:
    """Say which logs count twice. Parts of one log that share no scan do not."""
    said: dict[str, None] = {}
    for build in builds:
        hashes = [entry["sha256"] for entry in list_inputs(build)]
        again = (e for i, e in enumerate(list_inputs(build)) if e["sha256"] in hashes[:i])
        said |= dict.fromkeys(tell_repeated(entry["name"]) for entry in again)
    for one, other in combinations(builds, 2):
        mine, its = one["options"]["selection"], other["options"]["selection"]
        hashes = [entry["sha256"] for entry in list_inputs(one)]
        again = (entry for entry in list_inputs(other) if entry["sha256"] in hashes)
        if overlap(mine, its):
            part = "" if mine == its else ", in part"
            said |= dict.fromkeys(tell_repeated(entry["name"], part) for entry in again)
    yield from said


def tell_repeated(name: str, part: str = "") -> str:
    """Say that a log counts twice, and how to take it out."""
    return (
        f"{name} is in it twice{part}, and what it observed counts as often; to take it out once, "
        "build it again alone, and let `occmap merge` subtract that"
    )


def overlap(one: dict[str, Any], other: dict[str, Any]) -> bool:
    """Whether two selections share scans, as far as can be told without the log.

    Where both leave out scans by a stride and are not the same, they may well take turns.
    """
    begin = max(float(each["start_s"]) for each in (one, other))
    end = min(float(each["end_s"]) for each in (one, other))
    topics, others = set(one["topics"]), set(other["topics"])
    apart = begin >= end or (topics and others and not topics & others)
    return not apart and (one == other or 1 in (one["stride"], other["stride"]))
