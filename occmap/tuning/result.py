"""What was tuned, as values for people and for programs."""

from dataclasses import dataclass, field

from occmap.plain import HIDDEN, Count, Finite, Share
from occmap.remarks import LEAST_AGREEMENT
from occmap.scoring.compare import HeldOutScans, Scored
from occmap.tuning.search import Correction
from occmap.tuning.verdict import Finding


@dataclass(frozen=True)
class KeptScans(HeldOutScans):
    """What became of the scans."""

    kept: Count
    """Scans that the maps were made of and scored on: spread over the logs, and with a pose at
    every time offset"""


@dataclass(frozen=True, kw_only=True)
class TriedCorrection(Correction):
    """A correction that was tried."""

    share: Share
    """Share of held-out beams that the map predicts"""


@dataclass(frozen=True, kw_only=True)
class Tuning(Scored):
    """What is wrong with time and mount, by held-out beams: what occmap tune prints."""

    scans: KeptScans
    """What became of the scans"""
    beams: Count
    """Held-out beams that measured a range"""
    share_before: Share
    """Share of these whose first occupied cell is within two cells of the range, with the
    options given"""
    share: Share
    """The same share with what is recommended"""
    gain: float
    """How much larger the share is"""
    gain_error: Finite
    """Standard error of the gain, from the differences scan by scan; null where one scan is all
    there is"""
    correction: Correction
    """All that is recommended; zeros where nothing is"""
    time: Finding
    """What came of the search for a time offset"""
    mount: Finding
    """What came of the search for the laser's yaw, x and y on its body; the one of these two that
    explains more is searched first, and the other with what that found"""
    together: Finding
    """What came of the search for both once more, where a mount was found"""
    tried: list[TriedCorrection]
    """All corrections that were tried, in the order of the search"""
    command: tuple[str, ...]
    """The command line that builds the better map, word by word; empty where nothing is
    recommended"""
    agreement: float | None = field(metadata=HIDDEN)
    """Share of the hits in cells that the map of the best calls occupied; None without any"""

    @property
    def is_doubtful(self) -> bool:
        """Whether scans contradict each other even with the best that was found."""
        return self.agreement is not None and self.agreement < LEAST_AGREEMENT
