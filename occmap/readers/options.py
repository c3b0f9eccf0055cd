"""What a user may choose about reading: how messages that are not plain scans become scans."""

from dataclasses import dataclass
from enum import StrEnum

from occmap.choices import option
from occmap.errors import require


class Echo(StrEnum):
    """Which return of a beam to take where a laser states several."""

    FIRST = "first"
    """The nearest thing: glass, rain, leaves."""
    LAST = "last"
    """What stands behind it."""


@dataclass(frozen=True, slots=True)
class ReaderOptions:
    """The choices.

    Raises
    ------
    UsageError
        The heights leave nothing between them.
    """

    echo: Echo = option(Echo.FIRST, "MultiEchoLaserScan: the echo of a beam that counts.")
    # A slice around the sensor: above the floor for a lidar on a robot's body.
    min_height: float = option(
        -0.2, "PointCloud2: use points from this height over the sensor on.", unit="m"
    )
    max_height: float = option(
        0.2, "PointCloud2: use points up to this height over the sensor.", unit="m"
    )

    def __post_init__(self) -> None:
        found = f"no point lies above {self.min_height} m and below {self.max_height} m"
        fix = "give a `min_height` below the `max_height`"
        require(self.min_height < self.max_height, found, fix)
