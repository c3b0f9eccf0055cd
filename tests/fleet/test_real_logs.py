"""Real logs in one build, some of them cut short, by workers: what one process makes."""

from pathlib import Path

import pytest

from tests.cli.runner import occmap
from tests.samples import find_real

WITH_POSES = [
    "carmen/fr079-robotlaser.log.gz",
    "ros1/test_turtlebot.bag",
    "ros1/mylaserdata2.bag",
    "ros2/macfirst_floor_take_2",
    "ros1/test_turtlebot.bag",
]
"""Of each format, with poses of each kind; one of them twice"""
MOUNT = ("--static-tf", "base_link,laser,0,0,0,0,0,3.14159")
"""Of the one log that does not state it"""
COARSE = ("--resolution", "0.1", "--stride", "3")
CUT_SHORT = ["ros1/test_turtlebot.bag", "carmen/intel-corrected.log.gz"]

ALONE = "does not fit the logs before it"
"""What only one process can say: many workers sum up a map block by block, not log by log"""


@pytest.fixture(scope="module")
def logs(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    folder = tmp_path_factory.mktemp("damaged")
    damaged = []
    for name in CUT_SHORT:
        whole = find_real(name).read_bytes()
        path = folder / Path(name).name
        path.write_bytes(whole[: len(whole) * 2 // 3])
        damaged.append(path)
    return [*(find_real(name) for name in WITH_POSES), *damaged]


def test_files_and_text_are_those_of_one_process(
    logs: list[Path], address: str, tmp_path: Path
) -> None:
    fleet = ("--dask", address)
    done, files = [], []
    for flags in (("--jobs", "1"), fleet):
        output = tmp_path / "map.npz"
        done.append(occmap("build", *logs, "-o", output, *MOUNT, *COARSE, *flags))
        assert done[-1].code == 0, done[-1].err
        files.append(output.read_bytes())
    assert files[0] == files[1]
    one, other = ([*strip(each.out), *strip(each.err)] for each in done)
    assert "the file ends in the middle of" in " ".join(one)
    assert one == other


def strip(text: str) -> list[str]:
    """All lines but that of times and those that only one process can say."""
    lines = [each for each in text.splitlines() if not each.startswith("time ")]
    return [each for each in lines if ALONE not in each]
