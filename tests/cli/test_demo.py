"""`occmap demo` shows a log and its map, and what it says to type works."""

import shlex
from pathlib import Path

from tests.cli.runner import occmap
from tests.samples import SAMPLE_LOGS


def test_what_the_demo_says_to_type_works(here: Path) -> None:
    done = occmap("demo")
    assert done.code == 0
    folder = here / "occmap-demo"
    assert (folder / "drive.mcap").read_bytes() == (SAMPLE_LOGS / "drive.mcap").read_bytes()
    assert {"map.pgm", "map.yaml", "map.png", "map.npz"} < {each.name for each in folder.iterdir()}
    lines = [line.split("occmap ", 1)[1] for line in done.out.splitlines() if "  occmap " in line]
    assert len(lines) == 5
    for line in lines[:-1]:
        assert occmap(*shlex.split(line)).code == 0, line
