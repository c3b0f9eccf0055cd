"""What was tuned, as values for people and for programs."""

from dataclasses import dataclass, replace
from typing import Any

from occmap.command import compose_build
from occmap.options import BuildOptions
from occmap.plain import Count, Finite, Share, Told, to_plain
from occmap.remarks import LEAST_AGREEMENT, Remarks
from occmap.scoring.compare import HeldOutScans, describe_run
from occmap.scoring.score import Trial
from occmap.tally import Tally
from occmap.tuning.search import Correction
from occmap.tuning.verdict import Finding, Gain
from occmap.types import Pose


@dataclass(frozen=True)
class KeptScans(HeldOutScans):
    """What became of the scans."""

    kept: Count
    """Scans that the maps were made of and scored on: spread over the logs, and with a pose at
    every time offset"""


@dataclass(frozen=True, kw_only=True)
class PrintedTrial(Correction):
    """A correction that was tried."""

    share: Share
    """Share of held-out beams that the map predicts"""


class PrintedTuning(Told):
    """What is wrong with time and mount, by held-out beams: what occmap tune prints."""

    logs: list[str]
    """Logs, as they were given"""
    scans: KeptScans
    """What became of the scans"""
    resolution: float
    """Side of a cell (m)"""
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
    tried: list[PrintedTrial]
    """All corrections that were tried, in the order of the search"""
    command: list[str]
    """The command line that builds the better map, word by word; empty where nothing is
    recommended"""


@dataclass(frozen=True, eq=False)
class Tuning:
    """What was tried, and what came of it."""

    options: BuildOptions
    remarks: Remarks
    tally: Tally
    kept: int
    """Scans that maps were made from and scored on"""
    time: Finding
    mount: Finding
    together: Finding
    """What time and mount gain beyond that, where a mount was found and they are searched again"""
    sensor_pose: Pose | None
    """Where the laser sits on its body by what is known; None where no single pose says that"""
    before: Trial
    after: Trial
    tried: dict[Correction, Trial]
    agreement: float | None
    """Share of the hits in cells that the map of the best calls occupied; None without any"""

    @property
    def is_doubtful(self) -> bool:
        """Whether scans contradict each other even with the best that was found."""
        return self.agreement is not None and self.agreement < LEAST_AGREEMENT

    @property
    def correction(self) -> Correction:
        """All that is worth correcting: each search begins with what the one before found."""
        return self.together.correction

    @property
    def held_out(self) -> int:
        """How many of the kept scans score the maps."""
        return len(self.before.predicted)

    @property
    def gain(self) -> Gain:
        """What all corrections together gain, in a map of all scans."""
        return Gain.measure(self.before, self.after)

    @property
    def command(self) -> tuple[str, ...]:
        """The command line that builds the better map; empty where there is nothing to gain."""
        if self.correction == Correction():
            return ()
        posing = self.correction.apply(self.options.posing, self.sensor_pose)
        return compose_build(self.remarks.logs, replace(self.options, posing=posing), {})

    def to_json(self) -> dict[str, Any]:
        """The result as values that JSON has."""
        run = describe_run(self.options, self.remarks, self.tally, self.held_out)
        printed: PrintedTuning = {
            **run,
            "scans": KeptScans(**vars(run["scans"]), kept=self.kept),
            "beams": self.before.score.beams,
            "share_before": self.before.score.share,
            "share": self.after.score.share,
            "gain": self.gain.share,
            "gain_error": self.gain.error,
            "correction": self.correction,
            "time": self.time,
            "mount": self.mount,
            "together": self.together,
            "tried": [
                PrintedTrial(**vars(correction), share=trial.score.share)
                for correction, trial in self.tried.items()
            ],
            "command": list(self.command),
        }
        plain: dict[str, Any] = to_plain(printed)
        return plain
