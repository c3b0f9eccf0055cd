"""Which clouds count while their sensor stands still."""

from pathlib import Path

import numpy as np

from occmap.scans.tracing import Standstill
from tests.cli.runner import ask
from tests.clouds.simulation import Room, drive, read_points


def test_of_a_long_standstill_few_clouds_count_evenly() -> None:
    """It has 640 at 10 a second, in which four sectors take turns, or nine."""
    stamp_ns, standstill = 1_700_000_000_000_000_000 + np.arange(640) * 10**8, Standstill()
    used = np.flatnonzero([standstill.choose(each, np.full(1, 64.0)) for each in stamp_ns[:, None]])

    assert 40 <= len(used) <= 90
    assert np.diff(used).max() <= 16
    assert all(10 <= part <= 30 for part in np.bincount(used // 160))
    assert set(used % 9) == set(range(9))
    assert set(used % 4) == set(range(4))


def test_clouds_of_one_view_are_named_and_are_no_loss(tmp_path: Path) -> None:
    """It stands for 40 s at 5 clouds a second; 3 s at the beginning and the end are not long."""
    folder, rows = tmp_path / "clouds", []
    folder.mkdir()
    way = drive(Room(), clouds=5)
    for number, posed in enumerate([way[0]] * 200 + way):
        stamp_s = f"{number / 5 + 1000:.1f}"
        np.save(folder / f"{stamp_s}.npy", read_points(posed))
        rows.append([float(stamp_s), *posed.position[0], 0, 0, 0, 1])
    np.savetxt(tmp_path / "way.tum", rows)
    words = folder, "--poses", tmp_path / "way.tum", "-o", tmp_path / "map.pgm"
    scans = ask("build", *words, "--fail-if", "dropped_scans > 0")["scans"]

    assert scans["read"] == 205
    assert 60 < scans["used"] < 130
    left = {"of one view, as the sensor stood still": 205 - scans["used"]}
    assert scans["dropped"] == left
