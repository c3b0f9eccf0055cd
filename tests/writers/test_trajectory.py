from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from occmap import api
from occmap.errors import UsageError
from occmap.types import Journey, Trajectory
from occmap.writers import Product, WriteOptions, write_outputs
from tests.samples import SAMPLE_LOGS, Planar, write_csv
from tests.writers.maps import map_of, nothing_kept

TURNED = [1.0, 2.0, 0.5, 0.0, 0.0, 0.6, 0.8]
WAY = Trajectory(
    "a.bag",
    "/scan\nx",
    "map",
    "laser",
    stamp_ns=np.array([1_700_000_000_123_456_789, -1_500_000_000]),
    pose=np.array([TURNED, [-3.25, 0, 0, 0, 0, 0, 1.0]]),
)


def write(path: Path, way: Trajectory = WAY) -> list[str]:
    product = Product(map_of([[0.9]]), nothing_kept, Journey((way,), ()))
    write_outputs([path], product, WriteOptions())
    return path.read_text().splitlines()


TUM = [
    "# stamp x y z qx qy qz qw (s, m)",
    "# laser in map, at the scans of /scan?x",
    "-1.500000000 -3.25 0 0 0 0 0 1",
    "1700000000.123456789 1 2 0.5 0 0 0.6 0.8",
]
EUROC = [
    "#timestamp [ns],p_x [m],p_y [m],p_z [m],q_w [],q_x [],q_y [],q_z []",
    "# laser in map, at the scans of /scan?x",
    "-1500000000,-3.25,0,0,1,0,0,0",
    "1700000000123456789,1,2,0.5,0.8,0,0,0.6",
]


@pytest.mark.parametrize(("name", "lines"), [("t.tum", TUM), ("t.csv", EUROC)])
def test_poses_are_written_by_ascending_time(tmp_path: Path, name: str, lines: list[str]) -> None:
    assert write(tmp_path / name) == lines


FAR = [500_001.23456789, 5_400_002.4, 0.0]
SPOTS = [(FAR[0] + 0.01 * i, FAR[1] + 0.003 * i, 0.02 * i) for i in range(9)]
RANGES = [2.0, 2.1, 2.3, 2.6, 3.1, 3.7, 4.1]


def test_eight_decimals_are_kept_however_far_out(tmp_path: Path) -> None:
    pose = np.array([[*FAR, 0, 0, 0.123456789123, 1.0]])
    way = replace(WAY, stamp_ns=np.zeros(1, np.int64), pose=pose)
    *_, line = write(tmp_path / "t.tum", way)
    assert line == "0.000000000 500001.23456789 5400002.4 0 0 0 0.123456789 1"


def test_a_trajectory_far_out_makes_the_same_map_to_the_byte(tmp_path: Path) -> None:
    log, way = write_csv(tmp_path / "log.csv", SPOTS, RANGES, step=0.1), tmp_path / "t.tum"
    api.build_map(log, outputs=[way, tmp_path / "a.pgm"])
    api.build_map(log, poses=way, base_frame="laser", outputs=tmp_path / "b.pgm")
    assert (tmp_path / "a.pgm").read_bytes() == (tmp_path / "b.pgm").read_bytes()


@pytest.mark.parametrize("name", ["t.tum", "t.csv"])
def test_stamps_that_repeat_are_noted_where_poses_differ(tmp_path: Path, name: str) -> None:
    def list_repeats(spots: Sequence[Planar]) -> list[str]:
        log = write_csv(tmp_path / "log.csv", spots, RANGES, step=0.1, every=0)
        notes = api.build_map(log, outputs=tmp_path / name).report.notes
        return [note for note in notes if "8 scans of scan in" in note]

    (told,) = list_repeats(SPOTS)
    assert told.startswith(f"{tmp_path / name}: ")
    assert "`poses=FILE`" in told
    assert list_repeats(SPOTS[:1] * 9) == []


def test_a_map_has_none_after_its_build_and_says_so(here: Path) -> None:
    made = api.build_map(SAMPLE_LOGS / "drive.csv", resolution=0.2)
    with pytest.raises(UsageError, match="the map does not say where the robot went"):
        made.save("t.tum")
    assert not (here / "t.tum").exists()
