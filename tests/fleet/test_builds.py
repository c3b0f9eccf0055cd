"""Many workers make what one process makes, byte for byte."""

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path

import pytest

from occmap.fleet import Fleet
from occmap.options import BuildOptions, Selection
from occmap.pipeline import build
from occmap.posing import PosingOptions
from occmap.report.results import Report
from tests.clouds.simulation import HALL, turn, write_leaning
from tests.samples import DRIVES

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


PLAIN = BuildOptions(jobs=1)


@pytest.mark.parametrize(
    "options",
    [
        PLAIN,
        replace(PLAIN, posing=PosingOptions(align=None)),
        *(
            replace(PLAIN, selection=selection, min_passes=2, pass_gap_s=1.0)
            for selection in (
                Selection(stride=7),
                Selection(start_s=3.3, end_s=21.7),
                Selection(start_s=5.0, stride=4),
            )
        ),
    ],
)
def test_the_files_and_the_report_are_those_of_one_process(
    address: str, alone: Callable[[BuildOptions], Made], tmp_path: Path, options: BuildOptions
) -> None:
    hold_equal(alone(options), options, Fleet(address, tmp_path / "scratch"), tmp_path)


def test_a_worker_of_its_own_makes_the_same(
    alone: Callable[[BuildOptions], Made], tmp_path: Path
) -> None:
    hold_equal(alone(PLAIN), PLAIN, Fleet("local", tmp_path / "scratch"), tmp_path)


@pytest.mark.parametrize("leans", [False, True])
def test_clouds_of_several_logs_are_traced_over_one_ground(
    address: str, tmp_path: Path, leans: bool
) -> None:
    logs, options = [HALL] * 2, BuildOptions(jobs=1)
    if leans:
        poses = write_leaning(tmp_path / "leaning.tum", turn(4, -6, 0))
        options = replace(options, posing=PosingOptions(poses=str(poses)))
    files = [tmp_path / name for name in ("alone.npz", "fleet.npz")]
    alone = build(logs, options, files[:1]).report
    fleet = Fleet(address, tmp_path / "scratch")
    report = build(logs, options, files[1:], observe=fleet.observe).report
    assert files[0].read_bytes() == files[1].read_bytes()
    assert sorted(report.notes) == sorted(alone.notes)
    assert any("level=" in note for note in alone.notes) == leans
