"""Logs that count twice: the same file by its hash, and scans that two builds share."""

from typing import Any

import pytest

from occmap.evidence.manifest import list_repeated

ALL = {"topics": [], "start_s": "-inf", "end_s": "inf", "stride": 1}


def build_of(*names: str, poses: str | None = None, **selection: Any) -> dict[str, Any]:
    """A build of files, each with its name for a hash, of which the last may be a trajectory."""
    inputs = [{"name": name, "sha256": f"sha of {name}"} for name in names]
    return {"inputs": inputs, "options": {"selection": ALL | selection, "posing": {"poses": poses}}}


def name_repeated(*builds: dict[str, Any]) -> list[str]:
    """The logs that count more than once."""
    return [note.partition(" is in it more than once")[0] for note in list_repeated(builds)]


@pytest.mark.parametrize(
    ("one", "other"),
    [
        ({}, {}),
        ({"end_s": 40.0}, {"end_s": 40.0}),
        ({"stride": 2}, {"stride": 2}),
        ({}, {"end_s": 40.0}),
        ({"end_s": 40.0}, {"start_s": 39.9}),
        ({}, {"stride": 2}),
        ({}, {"topics": ["/a"]}),
        ({"topics": ["/a", "/b"]}, {"topics": ["/b"]}),
    ],
)
def test_shared_scans_count_twice(one: dict[str, Any], other: dict[str, Any]) -> None:
    for first, second in ((one, other), (other, one)):
        builds = [build_of("a.csv", "b.csv", **first), build_of("b.csv", "c.csv", **second)]
        assert name_repeated(*builds) == ["b.csv"]


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
    assert name_repeated(build_of("a.csv", **one), build_of("a.csv", **other)) == []


def test_a_log_is_named_once_and_a_folder_is_one_log() -> None:
    twice, part = build_of("a.csv", "a.csv"), build_of("a.csv", end_s=40.0)
    assert name_repeated() == name_repeated(part) == []
    assert name_repeated(twice, twice, part) == ["a.csv"]
    names = "day/day_0.mcap", "day/metadata.yaml"
    assert name_repeated(*[build_of(*names)] * 8) == ["day"]
    assert name_repeated(build_of(*names), build_of(names[0], "day/metadata2.yaml")) == ["day"]


def test_logs_that_share_a_trajectory_are_not_the_same() -> None:
    builds = [build_of(name, "path.txt", poses="path.txt") for name in ("a.csv", "b.csv")]
    assert name_repeated(*builds) == []
