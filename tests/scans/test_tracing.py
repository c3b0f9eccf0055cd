"""Which clouds count while their sensor stands still."""

from pathlib import Path

import numpy as np

from occmap.scans.tracing import Standstill
from tests.cli.runner import ask
from tests.clouds.simulation import Room, drive, place, read_points, turn

NUMBERS = [*range(1, 41), 45, 50, 56, 63, 70, 78, 87, 97]
"""Of a hundred: after 40 each that comes a tenth of its number after the last, by hand"""


def test_the_longer_a_sensor_stands_the_fewer_clouds_count() -> None:
    """It stands, goes on by 6 cm, turns by 3 degrees, and stands until it has 100 clouds again."""
    (posed,) = drive(Room(), clouds=1)
    (cloud,), here, level = posed.batch.clouds or (), posed.position[0], turn(0, 0, 0)[None]
    on, turned = here + np.array([0.06, 0, 0]), turn(0, 0, 3)[None]
    places = [(here, level)] * 100 + [(on, level)] * 50 + [(on, turned)] * 100
    places[70] = here + np.array([0.02, -0.04, 0]), turn(0.5, 0.5, 1)[None]  # poses are noisy
    standstill = Standstill()
    counts = [standstill.choose(place(cloud, *each)).item() for each in places]

    assert (np.flatnonzero(counts[:100]) + 1).tolist() == NUMBERS
    assert (np.flatnonzero(counts[100:150]) + 1).tolist() == NUMBERS[:42]
    assert (np.flatnonzero(counts[150:]) + 1).tolist() == NUMBERS


def test_clouds_of_one_view_are_named_and_are_no_loss(tmp_path: Path) -> None:
    folder, rows = tmp_path / "clouds", []
    folder.mkdir()
    way = drive(Room(), clouds=5)
    for number, posed in enumerate([way[0]] * 100 + way):
        np.save(folder / f"{number:03}.npy", read_points(posed))
        rows.append([number, *posed.position[0], 0, 0, 0, 1])
    np.savetxt(tmp_path / "way.tum", rows)
    words = folder, "--poses", tmp_path / "way.tum", "-o", tmp_path / "map.pgm"
    found = ask("build", *words, "--fail-if", "dropped_scans > 0")

    # The drive's first cloud is the 101st from that place.
    used, unused = len(NUMBERS) + 4, 100 - len(NUMBERS) + 1
    assert (found["scans"]["read"], found["scans"]["used"]) == (105, used)
    assert found["scans"]["dropped"] == {"of one view, as the sensor stood still": unused}
