"""3D lidars and depth cameras: the ground below a drive, and what stands on it.

Here is what a user may choose about them, and how some of many clouds are drawn.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from hashlib import blake2b
from pathlib import Path

from occmap.choices import ABOVE_ZERO, FOUND, check_bounds, option
from occmap.errors import require
from occmap.sensor import Sensor, Voxels

LOCAL, FLAT = "local", "flat"
"""How the ground is found, if no file has it"""
HIGHEST_M = 1e6
"""Nothing lies higher."""


@dataclass(frozen=True)
class CloudOptions:
    """The choices.

    Raises
    ------
    UsageError
        The heights leave nothing between them.
    """

    min_height: float = option(
        0.1, "Clouds: what lies this high above the ground is an obstacle: the clearance.", unit="m"
    )
    max_height: float = option(
        1.5, "Clouds: what lies this high above the ground is none: the robot's height.", unit="m"
    )
    range_margin: float = option(
        0.012,
        "Clouds: the clearance grows by this for each metre from where it makes 0.1 m on, since "
        "poses and mounts are off by tenths of a degree.",
        unit="m/m",
        metavar="M",
        bounds=(0, 1),
    )
    ground: str | None = option(
        None,
        "Clouds: find the ground where the drive went (local), take a plane (flat), or take the "
        "ground of saved evidence.",
        metavar="local|flat|NPZ",
    )
    sensor_height: float | None = option(
        None,
        "Clouds: the sensor's height above the ground, where clouds do not show it.",
        unit="m",
        bounds=(ABOVE_ZERO, 100),
    )
    # None: found in each log. Else by sensor.
    own_points: Mapping[Sensor, Voxels] | None = option(
        None,
        "Clouds: leave out what stays at one place around the sensor wherever it goes, as that is "
        "the robot itself (on), or keep it (off).",
        metavar="on|off",
        none=("on", "to leave them out"),
        form=FOUND,
    )

    def __post_init__(self) -> None:
        check_bounds(self)
        found = f"no point lies above {self.min_height} m and below {self.max_height} m"
        fix = "give a `min_height` below the `max_height`, both above the ground"
        require(0 < self.min_height < self.max_height, found, fix)
        found = f"{self.ground!r} is no way to find the ground"
        is_known = self.ground in {None, LOCAL, FLAT} or self.file is not None
        require(is_known, found, f"give `ground={FLAT}`, or evidence: `ground=first.npz`")

    @property
    def band_mm(self) -> tuple[int, int]:
        """How high above the ground obstacles begin, and end."""
        low, high = (
            round(1000 * min(each, HIGHEST_M)) for each in (self.min_height, self.max_height)
        )
        return low, high

    @property
    def file(self) -> Path | None:
        """The evidence whose ground is taken; None: the ground is found."""
        name = self.ground or ""
        return Path(name) if name.endswith((".npz", ".zarr")) else None


def draw(number: int) -> float:
    """Draw from 0 to 1 by a stamp or a place, in step with nothing that comes again and again."""
    digest = blake2b((number % 2**64).to_bytes(8, "little"), digest_size=8).digest()
    return int.from_bytes(digest, "little") / 2**64
