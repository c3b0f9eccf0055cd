"""What a user may choose about reading: how messages that are not plain scans become scans."""

from dataclasses import dataclass
from enum import StrEnum

from occmap.choices import option


class Echo(StrEnum):
    """Which return of a beam to take where a laser states several."""

    FIRST = "first"
    """The nearest thing: glass, rain, leaves."""
    LAST = "last"
    """What stands behind it."""


@dataclass(frozen=True, slots=True)
class ReaderOptions:
    """The choices."""

    echo: Echo = option(Echo.FIRST, "MultiEchoLaserScan: the echo of a beam that counts.")
