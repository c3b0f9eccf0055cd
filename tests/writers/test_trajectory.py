from pathlib import Path

import numpy as np
import pytest

from occmap import api
from occmap.errors import UsageError
from occmap.types import Journey, Trajectory
from occmap.writers import Product, WriteOptions, write_outputs
from tests.samples import SAMPLE_LOGS
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


def write(path: Path) -> list[str]:
    product = Product(map_of([[0.9]]), nothing_kept, Journey((WAY,), ()))
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


def test_a_trajectory_makes_the_same_map_again(tmp_path: Path) -> None:
    first = api.build_map(SAMPLE_LOGS / "drive.csv", resolution=0.1, outputs=tmp_path / "t.tum")
    again = api.build_map(SAMPLE_LOGS / "drive.csv", resolution=0.1, poses=tmp_path / "t.tum")
    assert again.report.scans.used >= first.report.scans.used - 2
    assert again.agreement == pytest.approx(first.agreement, abs=0.002)


def test_a_map_has_none_after_its_build_and_says_so(here: Path) -> None:
    made = api.build_map(SAMPLE_LOGS / "drive.csv", resolution=0.2)
    with pytest.raises(UsageError, match="the map does not say where the robot went"):
        made.save("t.tum")
    assert not (here / "t.tum").exists()
