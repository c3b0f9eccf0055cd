"""A wrong mount, and poses whose up is wrong, are told from the floor that clouds see."""

import numpy as np
import pytest

from occmap.clouds.ground import measure_slope
from occmap.clouds.mounting import measure_tilts
from tests.clouds.simulation import drive_turning, find_ground, turn


@pytest.mark.parametrize("angles", [(0, 1, 0), (-0.8, 0.5, 0)])
def test_a_wrong_mount_is_measured_in_the_frame_of_the_sensor(
    angles: tuple[float, float, float],
) -> None:
    clouds = drive_turning(posed_by=turn(*angles))
    tilts = measure_tilts(clouds, find_ground(clouds))

    assert tilts
    assert tilts.is_mount
    assert np.degrees(tilts.sensor) == pytest.approx(-np.array(angles), abs=0.2)


def test_a_wrong_up_is_measured_in_the_map_though_the_ground_is_made_of_the_same() -> None:
    clouds = drive_turning(up=turn(0, 1, 0))
    tilts = measure_tilts(clouds, find_ground(clouds))

    assert tilts
    assert not tilts.is_mount
    assert np.degrees(tilts.upright) == pytest.approx((0, -1, 0), abs=0.1)


def test_right_poses_are_not_blamed() -> None:
    clouds = drive_turning()
    ground = find_ground(clouds)
    tilts = measure_tilts(clouds, ground)

    assert tilts
    assert abs(np.degrees([*tilts.sensor, *tilts.upright])).max() < 0.1
    assert measure_slope(ground) == pytest.approx((0, 0), abs=0.002)
