"""Logs that count twice: the same file by its hash, and scans that two builds share."""

from typing import Any

import pytest

from occmap.evidence.manifest import list_repeated

ALL = {"topics": [], "start_s": "-inf", "end_s": "inf", "stride": 1}


def build_of(*names: str, poses: str | None = None, **selection: Any) -> dict[str, Any]:
    """A build of files, each with its name for a hash, of which the last may be a trajectory."""
    inputs = [{"name": name, "sha256": f"sha of {name}"} for name in names]
    return {
        "inputs": inputs,
        "options": {"selection": ALL | selection, "posing": {"poses": poses}},
    }


def say(name: str, times: str = "twice") -> str:
    return (
        f"{name} is in it {times}, and what it observed counts as often; to take it out once, "
        "build it again alone, and let `occmap merge` subtract that"
    )


IN_PART = "more than once, in part"


@pytest.mark.parametrize(
    ("one", "other", "times"),
    [
        ({}, {}, "twice"),
        ({"end_s": 40.0}, {"end_s": 40.0}, "twice"),
        ({"stride": 2}, {"stride": 2}, "twice"),
        ({}, {"end_s": 40.0}, IN_PART),
        ({"end_s": 40.0}, {"start_s": 39.9}, IN_PART),
        ({}, {"stride": 2}, IN_PART),
        ({}, {"topics": ["/a"]}, IN_PART),
        ({"topics": ["/a", "/b"]}, {"topics": ["/b"]}, IN_PART),
    ],
)
def test_shared_scans_count_twice(one: dict[str, Any], other: dict[str, Any], times: str) -> None:
    for first, second in ((one, other), (other, one)):
        builds = [build_of("a.csv", "b.csv", **first), build_of("b.csv", "c.csv", **second)]
        assert list(list_repeated(builds)) == [say("b.csv", times)]


@pytest.mark.parametrize(
    ("one", "other"),
    [
        ({"end_s": 40.0}, {"start_s": 40.0}),  # the end is outside
        ({"start_s": 10, "end_s": 20}, {"start_s": 30}),
        ({"topics": ["/a"]}, {"topics": ["/b"]}),
        ({"stride": 2}, {"stride": 2, "start_s": 0.1}),  # they may take turns
    ],
)
def test_parts_that_share_no_scan_are_no_repetition(
    one: dict[str, Any], other: dict[str, Any]
) -> None:
    assert list(list_repeated([build_of("a.csv", **one), build_of("a.csv", **other)])) == []


def test_a_log_is_named_once_with_how_often_it_counts() -> None:
    twice = build_of("a.csv", "a.csv")
    assert list(list_repeated([twice])) == [say("a.csv")]
    assert list(list_repeated([twice, twice, build_of("a.csv")])) == [say("a.csv", "5 times")]
    more = [twice, build_of("a.csv", end_s=40.0), build_of("a.csv", end_s=20.0)]
    assert list(list_repeated(more)) == [say("a.csv", "twice, and more in part")]
    assert list(list_repeated([])) == []


def test_a_folder_is_one_log() -> None:
    names = "day/day_0.mcap", "day/metadata.yaml"
    assert list(list_repeated([build_of(*names, *names)])) == [say("day")]
    assert list(list_repeated([build_of(*names)] * 8)) == [say("day", "8 times")]
    mended = build_of("day/day_0.mcap", "day/metadata2.yaml")
    assert list(list_repeated([build_of(*names), mended])) == [say("day")]


def test_logs_that_share_a_trajectory_are_not_the_same() -> None:
    builds = [build_of(name, "path.txt", poses="path.txt") for name in ("a.csv", "b.csv")]
    assert list(list_repeated(builds)) == []
