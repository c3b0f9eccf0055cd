"""How a 3D sensor sits is found from the floor and the walls that its clouds show."""

from dataclasses import replace

import numpy as np
import pytest

from occmap.clouds.mounting import find_seat
from occmap.posing.chain import Transforms
from occmap.types import Float64, PosedScans
from tests.clouds.simulation import SENSOR_M, Room, drive, turn


def mount_on(mount: Float64, turning: float = 37.0) -> list[PosedScans]:
    """Drive with a sensor that sits so, posed as if it were the body, which turns as it goes."""
    made = []
    for number, posed in enumerate(drive(Room())):
        (cloud,) = posed.batch.clouds or ()
        heading = turn(0, 0, turning * number)
        points = (cloud.points @ heading @ mount).astype(np.float32)
        batch = replace(posed.batch, clouds=(cloud._replace(points=points),))
        made.append(replace(posed, batch=batch, rotation=heading[None]))
    return made


@pytest.mark.parametrize(
    "angles",
    [(0, 0, 0), (0, 0, 90), (0, 20, 0), (-12, 5, 180), (-90, 0, -90), (-105, 0, -90), (180, 0, 0)],
    ids=["level", "to the left", "nose down", "backwards", "optical", "optical, down", "upside"],
)
def test_a_mount_is_found_however_a_sensor_sits(angles: tuple[float, float, float]) -> None:
    mount = turn(*angles)
    seat = find_seat(mount_on(mount))

    assert seat is not None
    assert seat.has_yaw
    assert seat.height == pytest.approx(SENSOR_M, abs=0.02)
    found = Transforms.fixed(seat.mount).rotation[0]
    between = np.degrees(np.arccos((np.trace(found.T @ mount) - 1) / 2))
    assert between < 1.5


def test_where_a_robot_never_turns_no_wall_tells_the_yaw() -> None:
    seat = find_seat(mount_on(turn(0, 20, 0), turning=0)[:1] * 2)

    assert seat is not None
    assert not seat.has_yaw


def test_walls_alone_are_no_floor() -> None:
    walls = []
    for posed in mount_on(np.eye(3)):
        (cloud,) = posed.batch.clouds or ()
        high = cloud._replace(points=cloud.points[cloud.points[:, 2] > 0.1 - SENSOR_M])
        walls.append(replace(posed, batch=replace(posed.batch, clouds=(high,))))
    assert find_seat(walls) is None
    assert find_seat([]) is None
