"""A wrong mount, and poses whose up is wrong, are told from the floor that clouds see."""

from dataclasses import replace

import numpy as np
import pytest

from occmap.clouds.ground import measure_slope
from occmap.clouds.mounting import measure_tilts
from occmap.types import Float64, PosedScans
from tests.clouds.simulation import Room, drive, find_ground, turn


def look_around(mount: Float64, up: Float64) -> list[PosedScans]:
    """Drive while the sensor turns round; its mount is turned, and so is the poses' up."""
    made = []
    for number, posed in enumerate(drive(Room())):
        (cloud,) = posed.batch.clouds or ()
        heading = turn(0, 0, 37 * number)
        points = (cloud.points @ heading).astype(np.float32)
        batch = replace(posed.batch, clouds=(cloud._replace(points=points),))
        made.append(replace(posed, batch=batch, rotation=(up @ heading @ mount)[None]))
    return made


@pytest.mark.parametrize("angles", [(0, 1, 0), (-0.8, 0.5, 0)])
def test_a_wrong_mount_is_measured_in_the_frame_of_the_sensor(
    angles: tuple[float, float, float],
) -> None:
    clouds = look_around(turn(*angles), np.eye(3))
    tilts = measure_tilts(clouds, find_ground(clouds))

    assert tilts
    assert tilts.is_mount
    assert np.degrees(tilts.sensor) == pytest.approx(-np.array(angles), abs=0.2)


def test_a_wrong_up_is_measured_in_the_map_though_the_ground_is_made_of_the_same() -> None:
    clouds = look_around(np.eye(3), turn(0, 1, 0))
    tilts = measure_tilts(clouds, find_ground(clouds))

    assert tilts
    assert not tilts.is_mount
    assert np.degrees(tilts.upright) == pytest.approx((0, -1, 0), abs=0.1)


def test_right_poses_are_not_blamed() -> None:
    clouds = look_around(np.eye(3), np.eye(3))
    ground = find_ground(clouds)
    tilts = measure_tilts(clouds, ground)

    assert tilts
    assert abs(np.degrees([*tilts.sensor, *tilts.upright])).max() < 0.1
    assert measure_slope(ground) == pytest.approx((0, 0), abs=0.002)
