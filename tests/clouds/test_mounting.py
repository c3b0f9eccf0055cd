"""How a 3D sensor sits is found from the floor and the walls, and a wrong mount or up is told."""

import numpy as np
import pytest

from occmap.clouds.mounting import find_seat, measure_tilts
from occmap.inspection.poses import find_tilted
from occmap.options import BuildOptions
from occmap.posing.chain import Transforms
from occmap.scans.levelling import measure_slope
from occmap.scans.mounts import Mount
from occmap.types import IDENTITY, Float64
from tests.clouds import simulation
from tests.clouds.simulation import change_points, drive_turning, find_ground, read_points, turn


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
    assert seat.height == pytest.approx(simulation.SENSOR_M, abs=0.02)
    found = Transforms.fixed(seat.mount).rotation[0]
    between = np.degrees(np.arccos((np.trace(found.T @ mount) - 1) / 2))
    assert between < 1.5


def test_where_a_robot_never_turns_no_wall_tells_the_yaw() -> None:
    seat = find_seat(drive_turning(turn(0, 20, 0), degrees=0)[:1] * 2)

    assert seat is not None
    assert not seat.has_yaw


def test_walls_alone_are_no_floor() -> None:
    clouds = [(posed, read_points(posed)) for posed in drive_turning()]
    walls = [
        change_points(posed, all_[all_[:, 2] > 0.1 - simulation.SENSOR_M]) for posed, all_ in clouds
    ]
    assert find_seat(walls) is None
    assert find_seat([]) is None


@pytest.mark.parametrize("is_ceiling", [True, False], ids=["ceiling", "wall"])
@pytest.mark.parametrize("given", [simulation.LEVEL, turn(0, 20, 0)], ids=["right", "wrong"])
def test_another_plane_along_a_straight_way_is_no_floor(is_ceiling: bool, given: Float64) -> None:
    """It is a metre above the sensor, or beside it, and holds more points than the floor."""
    along, across = (axis.ravel() for axis in np.mgrid[-4:4.01:0.1, -0.9:0.91:0.05])
    apart = np.ones(along.size)
    plane = np.column_stack([along, across, apart] if is_ceiling else [along, apart, across])
    clouds = [
        change_points(posed, np.concatenate([read_points(posed)[::20], plane]))
        for posed in drive_turning(degrees=0)
    ]
    seat = find_seat(clouds, given)
    assert seat is None or Transforms.fixed(seat.mount).rotation[0, 2, 2] > 0.999


@pytest.mark.parametrize(
    ("turned", "angles", "within"),
    [("posed_by", (0, 1, 0), 0.2), ("posed_by", (-0.8, 0.5, 0), 0.2), ("up", (0, 1, 0), 0.1)],
)
def test_a_wrong_mount_is_measured_in_the_frame_of_the_sensor_and_a_wrong_up_in_the_map(
    turned: str, angles: tuple[float, float, float], within: float
) -> None:
    """Though the ground is made of the same clouds."""
    clouds = drive_turning(**{turned: turn(*angles)})  # type: ignore[arg-type]
    ground = find_ground(clouds)
    tilts = measure_tilts(clouds, ground)

    assert tilts
    assert tilts.is_mount == (turned == "posed_by")
    measured = tilts.sensor if tilts.is_mount else tilts.upright
    assert np.degrees(measured) == pytest.approx(-np.array(angles), abs=within)
    concern = find_tilted(Mount(IDENTITY), clouds, ground, BuildOptions())
    assert (concern is None) == (turned == "up")


def test_right_poses_are_not_blamed() -> None:
    clouds = drive_turning()
    ground = find_ground(clouds)
    tilts = measure_tilts(clouds, ground)

    assert tilts
    assert abs(np.degrees([*tilts.sensor, *tilts.upright])).max() < 0.1
    assert measure_slope(ground) == pytest.approx((0, 0), abs=0.002)
