"""Logs of very many frames, topics or notes: memory and time grow with their number only."""

import resource
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path

import pytest

from tests.cli.runner import spawn
from tests.readers.ros import ROS2, SECOND, Written, drive, scan, transforms, write_mcap

MEMORY = 1 << 31
FRAMES = 500
SECONDS = 10
"""Of the processor, as it may have much else to do; what grows with the square takes minutes."""


def many_lasers() -> list[Written]:
    """Each laser has a frame of its own on the robot, of which the half has no transform."""
    mounts = [("base", f"laser{n}", 0.25) for n in range(0, FRAMES, 2)]
    edges = [transforms(ROS2, SECOND, mounts), transforms(ROS2, SECOND, [("base", "/laser", 0.25)])]
    static = [Written("/tf_static", SECOND, each) for each in edges]
    return [
        *static,
        *drive(ROS2)[1:],
        *(Written("/scan", 2 * SECOND, scan(ROS2, 2 * SECOND, f"laser{n}")) for n in range(FRAMES)),
    ]


def long_chain() -> list[Written]:
    names = ["base", *(f"frame{n}" for n in range(FRAMES)), "deep"]
    edges = [(upper, lower, 0.25) for upper, lower in pairwise(names)]
    deep = Written("/deep", 2 * SECOND, scan(ROS2, 2 * SECOND, "deep"))
    return [Written("/tf_static", SECOND, transforms(ROS2, SECOND, edges)), *drive(ROS2), deep]


def many_topics() -> list[Written]:
    seen = scan(ROS2, 2 * SECOND, "/laser")
    return [*drive(ROS2), *(Written(f"/scan{n}", 2 * SECOND, seen) for n in range(FRAMES))]


@pytest.mark.parametrize(
    ("log", "used"),
    [(many_lasers, "256 of 506"), (long_chain, "7 of 7"), (many_topics, "506 of 506")],
)
def test_a_log_of_very_many(tmp_path: Path, log: Callable[[], list[Written]], used: str) -> None:
    path = write_mcap(tmp_path / "log.mcap", log())
    words = ["build", path, "-o", tmp_path / "map.pgm", "--resolution", "0.5", "--jobs", "1"]
    assert f"{used} used" in run_bounded(*words)


def limit() -> None:
    """End this process by a signal where it takes more."""
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))
    resource.setrlimit(resource.RLIMIT_CPU, (SECONDS, SECONDS))


def run_bounded(*words: object) -> str:
    """Return what a command says that may take neither much memory nor much time."""
    done = spawn(*words, preexec_fn=limit, timeout=None)
    assert done.returncode == 0, done.stderr[-400:]
    return str(done.stdout + done.stderr)
