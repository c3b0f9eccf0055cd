"""Many workers make what one process makes, byte for byte."""

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from occmap.fleet import Fleet
from occmap.fleet.settling import leap
from occmap.options import BuildOptions
from occmap.pipeline import build
from occmap.posing.leaps import MOST_PATHS, Ends, Moment
from occmap.readers import open_log, split_log
from occmap.report.results import Report
from occmap.selection import Selection
from tests.samples import DRIVES, write_csv

LOGS = [*DRIVES, DRIVES[0]]
"""One of them twice"""


SUFFIXES = "npz", "pgm", "tum"
Made = tuple[Report, list[bytes]]
"""What a build says, and all that it writes"""


@pytest.fixture(scope="module")
def alone(tmp_path_factory: pytest.TempPathFactory) -> Callable[[BuildOptions], Made]:
    """What one process makes of the logs; it is asked once."""

    @cache
    def build_alone(options: BuildOptions) -> Made:
        folder = tmp_path_factory.mktemp("alone")
        outputs = [folder / f"alone.{suffix}" for suffix in SUFFIXES]
        report = build(LOGS, options, outputs).report
        return report, [output.read_bytes() for output in outputs]

    return build_alone


def hold_equal(expected: Made, options: BuildOptions, fleet: Fleet, folder: Path) -> None:
    """Build by workers, and hold all that was written and said equal."""
    outputs = [folder / f"fleet.{suffix}" for suffix in SUFFIXES]
    report = build(LOGS, options, outputs, observe=fleet.observe).report
    assert [output.read_bytes() for output in outputs] == expected[1]
    said = [replace(each, seconds={}, files=()) for each in (expected[0], report)]
    assert said[0] == said[1]
    assert not fleet.scratch.exists()


@pytest.mark.parametrize("slice_bytes", [50_000, 400_000, 1 << 30])
def test_the_files_and_the_report_are_those_of_one_process(
    address: str, alone: Callable[[BuildOptions], Made], tmp_path: Path, slice_bytes: int
) -> None:
    options = BuildOptions(jobs=1)
    hold_equal(alone(options), options, Fleet(address, tmp_path / "scratch", slice_bytes), tmp_path)


def test_a_worker_of_its_own_makes_the_same(
    alone: Callable[[BuildOptions], Made], tmp_path: Path
) -> None:
    options = BuildOptions(jobs=1)
    hold_equal(alone(options), options, Fleet("local", tmp_path / "scratch", 400_000), tmp_path)


@pytest.mark.parametrize(
    "selection",
    [Selection(stride=7), Selection(start_s=3.3, end_s=21.7), Selection(start_s=5.0, stride=4)],
)
def test_a_part_of_the_scans_is_the_same_part(
    address: str, alone: Callable[[BuildOptions], Made], tmp_path: Path, selection: Selection
) -> None:
    options = BuildOptions(jobs=1, selection=selection, min_passes=2, pass_gap_s=1.0)
    hold_equal(alone(options), options, Fleet(address, tmp_path / "scratch", 60_000), tmp_path)


def test_a_log_with_leaps_is_the_same(address: str, tmp_path: Path) -> None:
    """A while elsewhere that lies across the parts of a log, and a last scan."""
    poses = [(second / 2, 0.0, 0.0) for second in range(400)]
    poses[196:203] = [(x + 900, y, yaw) for x, y, yaw in poses[196:203]]
    poses[-1] = (-4e3, 0.0, 0.0)
    log = write_csv(tmp_path / "log.csv", poses, [1.0, 1.5, 2.0], step=0.1)
    size = log.stat().st_size // 4
    assert len(split_log(open_log(log), size)) > 3
    options = BuildOptions(jobs=1)
    alone = build([log], options).report
    many = build([log], options, observe=Fleet(address, tmp_path / "scratch", size).observe).report
    assert replace(many, seconds={}) == replace(alone, seconds={})
    assert sum(many.scans.dropped.values()) == 8


def test_parts_too_short_to_show_what_no_return_reads_as_are_no_map_too_large(
    address: str, tmp_path: Path
) -> None:
    """One beam in twenty never came back; five scans are too few to tell that from a wall."""
    poses = [(second / 2, 0.0, 0.0) for second in range(60)]
    log = write_csv(tmp_path / "log.csv", poses, [*np.linspace(1, 2, 19), 9e5], step=0.1)
    size = log.stat().st_size // 12
    options = BuildOptions(jobs=1)
    alone = build([log], options).report
    many = build([log], options, observe=Fleet(address, tmp_path / "scratch", size).observe).report
    assert alone.beams.no_return == 60
    assert replace(many, seconds={}) == replace(alone, seconds={})


@pytest.mark.parametrize(("lasers", "expected"), [(MOST_PATHS, False), (MOST_PATHS + 1, True)])
def test_a_log_of_more_lasers_than_are_judged_is_traced_whole(lasers: int, expected: bool) -> None:
    nowhere = Moment(0, 0, [0.0, 0.0, 0.0])
    ends = Ends(nowhere, nowhere, 0)
    parts = [{("/scan", str(laser), False): ends} for laser in range(lasers)]
    assert leap(parts, 50.0) is expected
