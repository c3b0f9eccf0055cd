import math

import pytest

from occmap.errors import UsageError
from occmap.posing import PosingOptions
from occmap.types import Pose
from tests.posing.scenes import bolted


@pytest.mark.parametrize("pose", [Pose.planar(math.nan, 0, 0), Pose(0, 0, 0, 0, 0, 0, 0)])
def test_a_mount_that_is_no_pose_is_refused(pose: Pose) -> None:
    with pytest.raises(UsageError, match="sensor's pose"):
        PosingOptions(sensor_pose=pose)
    with pytest.raises(UsageError, match="base -> laser"):
        PosingOptions(static_transforms=(bolted("base", "laser", pose),))


@pytest.mark.parametrize("pose", [Pose.planar(math.nan, 0, 0), Pose.planar(0, 2e8, 0)])
def test_a_frame_that_lies_nowhere_is_refused(pose: Pose) -> None:
    with pytest.raises(UsageError, match=r"the logs' map cannot be .*; give metres and radians"):
        PosingOptions(transform=pose)
