"""How a 3D sensor sits is found from the floor and the walls that its clouds show."""

import numpy as np
import pytest

from occmap.clouds.mounting import find_seat
from occmap.posing.chain import Transforms
from tests.clouds.simulation import SENSOR_M, change_points, drive_turning, read_points, turn


@pytest.mark.parametrize(
    "angles",
    [(0, 0, 0), (0, 0, 90), (0, 20, 0), (-12, 5, 180), (-90, 0, -90), (-105, 0, -90), (180, 0, 0)],
    ids=["level", "to the left", "nose down", "backwards", "optical", "optical, down", "upside"],
)
def test_a_mount_is_found_however_a_sensor_sits(angles: tuple[float, float, float]) -> None:
    mount = turn(*angles)
    seat = find_seat(drive_turning(mount))

    assert seat is not None
    assert seat.has_yaw
    assert seat.height == pytest.approx(SENSOR_M, abs=0.02)
    found = Transforms.fixed(seat.mount).rotation[0]
    between = np.degrees(np.arccos((np.trace(found.T @ mount) - 1) / 2))
    assert between < 1.5


def test_where_a_robot_never_turns_no_wall_tells_the_yaw() -> None:
    seat = find_seat(drive_turning(turn(0, 20, 0), degrees=0)[:1] * 2)

    assert seat is not None
    assert not seat.has_yaw


def test_walls_alone_are_no_floor() -> None:
    clouds = [(posed, read_points(posed)) for posed in drive_turning()]
    walls = [change_points(posed, all_[all_[:, 2] > 0.1 - SENSOR_M]) for posed, all_ in clouds]
    assert find_seat(walls) is None
    assert find_seat([]) is None
