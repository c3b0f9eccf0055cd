import math

import pytest

from occmap.errors import UsageError
from occmap.posing.options import PosingOptions
from occmap.types import Pose
from tests.posing.scenes import bolted


@pytest.mark.parametrize("offset_s", [math.nan, math.inf, -1e10])
def test_an_offset_that_no_clock_has_is_refused(offset_s: float) -> None:
    with pytest.raises(UsageError, match=r"time_offset_s=.* is not possible"):
        PosingOptions(time_offset_s=offset_s)


@pytest.mark.parametrize("gap_s", [0.0, -1.0, math.nan])
def test_a_gap_that_bridges_nothing_is_refused(gap_s: float) -> None:
    with pytest.raises(UsageError, match=r"max_pose_gap_s=.* give more than 0"):
        PosingOptions(max_pose_gap_s=gap_s)


@pytest.mark.parametrize("pose", [Pose.planar(math.nan, 0, 0), Pose(0, 0, 0, 0, 0, 0, 0)])
def test_a_mount_that_is_no_pose_is_refused(pose: Pose) -> None:
    with pytest.raises(UsageError, match="sensor's pose"):
        PosingOptions(sensor_pose=pose)
    with pytest.raises(UsageError, match="base -> laser"):
        PosingOptions(static_transforms=(bolted("base", "laser", pose),))


@pytest.mark.parametrize("pose", [Pose.planar(math.nan, 0, 0), Pose.planar(0, 2e8, 0)])
def test_a_frame_that_lies_nowhere_is_refused(pose: Pose) -> None:
    with pytest.raises(UsageError, match=r"no log lies at .*; give metres and radians"):
        PosingOptions(transform=pose)


@pytest.mark.parametrize("degrees", [math.nan, math.inf, 361.0])
def test_an_angle_that_turns_nothing_is_refused(degrees: float) -> None:
    with pytest.raises(UsageError, match=r"align=.* give -360 to 360"):
        PosingOptions(align=degrees)
