"""Many workers make what one process makes, byte for byte."""

from dataclasses import replace
from pathlib import Path

import pytest

from occmap.batching import Selection
from occmap.fleet import Fleet
from occmap.options import BuildOptions
from occmap.pipeline import Build, build
from tests.samples import DRIVES

LOGS = [*DRIVES, DRIVES[0]]
"""One of them twice"""


def build_both(
    logs: list[Path], options: BuildOptions, address: str, slice_bytes: int, folder: Path
) -> tuple[Build, Build]:
    """Build with one process and by workers, and hold all that was written equal."""
    suffixes = "npz", "pgm", "tum"
    alone = build(logs, options, [folder / f"alone.{suffix}" for suffix in suffixes])
    fleet = Fleet(address, folder / "scratch", slice_bytes)
    outputs = [folder / f"fleet.{suffix}" for suffix in suffixes]
    together = build(logs, options, outputs, observe=fleet.observe)
    for suffix in suffixes:
        written = [(folder / f"{who}.{suffix}").read_bytes() for who in ("alone", "fleet")]
        assert written[0] == written[1]
    said = [replace(made.report, seconds={}, files=()) for made in (alone, together)]
    assert said[0] == said[1]
    assert not fleet.scratch.exists()
    return alone, together


@pytest.mark.parametrize("slice_bytes", [50_000, 400_000, 1 << 30])
def test_the_files_and_the_report_are_those_of_one_process(
    address: str, tmp_path: Path, slice_bytes: int
) -> None:
    build_both(LOGS, BuildOptions(jobs=1), address, slice_bytes, tmp_path)


@pytest.mark.parametrize(
    "selection",
    [Selection(stride=7), Selection(start_s=3.3, end_s=21.7), Selection(start_s=5.0, stride=4)],
)
def test_a_part_of_the_scans_is_the_same_part(
    address: str, tmp_path: Path, selection: Selection
) -> None:
    options = BuildOptions(jobs=1, selection=selection, min_passes=2, pass_gap_s=1.0)
    build_both(LOGS, options, address, 60_000, tmp_path)
