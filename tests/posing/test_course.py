"""How a sensor sits and where it goes: tilts that spoil maps, and lasers that stand."""

import math

import pytest

from occmap.posing.attach import Poser
from occmap.types import Pose
from tests.posing.scenes import at, attach, batch_at, bolted, build, drive


def mount(roll: float = 0.0, pitch: float = 0.0, height: float = 0.3, nod: int = 1) -> Poser:
    """A drive whose laser is turned on the robot, in degrees; it nods at each scan by -1."""
    sensor = []
    for s in range(41):
        angles = math.radians(roll), math.radians(pitch) * nod**s, 0.0
        sensor += [at(s, "base_link", "laser", Pose.from_xyzrpy((0, 0, height), angles))]
    poser = build(*drive("odom", "base_link", seconds=range(41)), *sensor)
    for first in (0, 10, 20, 30):
        attach(poser, batch_at(range(first, first + 10)))
    return poser


def tell(poser: Poser, max_range: float = math.inf) -> list[str]:
    return [concern.text for _, concern in poser.list_concerns(0, max_range)]


@pytest.mark.parametrize(
    ("poser", "found"),
    [
        # 0.3 m / sin 5 deg = 3.44 m
        (mount(pitch=5), ["by 5.0 deg (5.0 deg down ahead)", "0.3 m over", "`max_range=3.4`"]),
        (mount(roll=4, height=0.5), ["by 4.0 deg", "0.5 m over", "7.1 m away", "`max_range=7.1`"]),
        (mount(pitch=5, height=0.0), ["by 5.0 deg (5.0 deg down ahead): it meets the floor"]),
        (mount(pitch=45), ["by 45.0 deg (45.0 deg down ahead)", "the floor or the ceiling, not"]),
        (mount(pitch=-60), ["(60.0 deg up ahead): the laser looks at the floor or the ceiling"]),
        (mount(pitch=5, nod=-1), ["nods by 10 deg and meets the floor: map clouds of its scans"]),
        (mount(roll=90), ["by 90.0 deg: the laser looks at the floor or the ceiling"]),
    ],
)
def test_a_tilted_laser_is_told(poser: Poser, found: list[str]) -> None:
    (told,) = tell(poser)
    for part in found:
        assert part in told


@pytest.mark.parametrize("poser", [mount(), mount(pitch=2.5), mount(roll=180), mount(pitch=178)])
def test_a_level_laser_is_not_told(poser: Poser) -> None:
    assert tell(poser) == []


def test_a_range_that_ends_before_the_floor_is_right() -> None:
    poser = mount(pitch=5)
    assert tell(poser, max_range=3.4) == []
    ((_, concern),) = poser.list_concerns(0, 10.0)
    assert concern.remedy == {"max_range": "3.4"}


STILL = "/scan: the laser never moves, so the map is what it sees from one place"


def stand(*poses: Pose, scans: int = 41) -> list[str]:
    """What is noted of a robot at these poses, one a second in turn."""
    samples = [at(t, "odom", "base_link", poses[t % len(poses)]) for t in range(41)]
    sensor = bolted("base_link", "laser", Pose.planar(0.2, 0, 0))
    poser = build(*samples, sensor)
    batch = batch_at(range(scans))
    attach(poser, batch)
    assert not list(poser.list_concerns(0, math.inf))
    return [note for note in poser.notes if "never moves" in note]


def test_a_laser_that_stands_is_noted() -> None:
    (note,) = stand(Pose.planar(1, 2, 3), Pose.planar(1.01, 2, 3.001))
    assert note.removeprefix(": ").startswith(STILL.removeprefix("/scan: "))
    assert note.endswith("its poses are missing: give them with `poses`")


@pytest.mark.parametrize(
    "elsewhere", [Pose.planar(1.1, 2, 3), Pose.planar(1, 1.9, 3), Pose.planar(1, 2, 3.1)]
)
def test_a_laser_that_moves_or_turns_does_not_stand(elsewhere: Pose) -> None:
    assert stand(Pose.planar(1, 2, 3), elsewhere) == []


def test_a_few_scans_are_no_drive() -> None:
    assert stand(Pose.planar(1, 2, 3), Pose.planar(1, 2, 3), scans=19) == []
