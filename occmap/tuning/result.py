"""What was tuned, as values for people and for programs."""

from dataclasses import dataclass, replace
from typing import Any

from occmap.command import compose_build
from occmap.pipeline import BuildOptions
from occmap.report import Remarks, Tally
from occmap.scoring.compare import drop_infinite
from occmap.scoring.score import Trial
from occmap.tuning.search import Correction
from occmap.tuning.verdict import Finding, Gain
from occmap.types import Pose


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

    @property
    def correction(self) -> Correction:
        """All that is worth correcting: each search begins with what the one before found."""
        return self.together.correction

    @property
    def held_out(self) -> int:
        """Of the scans kept, those that scored."""
        return len(self.before.predicted)

    @property
    def gain(self) -> Gain:
        """Of all corrections together, in a map of all scans."""
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
        tally = self.tally
        return {
            "logs": self.remarks.logs,
            "scans": {
                "read": tally.scans_read,
                "used": tally.scans_used,
                "kept": self.kept,
                "held_out": self.held_out,
                "dropped": tally.dropped,
            },
            "resolution": self.options.resolution,
            "beams": self.before.score.beams,
            "share_before": self.before.score.share,
            "share": self.after.score.share,
            **gain_to_json(self.gain),
            "correction": self.correction._asdict(),
            "time": finding_to_json(self.time),
            "mount": finding_to_json(self.mount),
            "together": finding_to_json(self.together),
            "tried": [
                {**each._asdict(), "share": trial.score.share} for each, trial in self.tried.items()
            ],
            "command": list(self.command),
            "notes": self.remarks.notes,
            "damage": self.remarks.damage,
        }


def finding_to_json(finding: Finding) -> dict[str, Any]:
    """What came of a search as values that JSON has."""
    return {
        "verdict": finding.verdict.value,
        "correction": finding.correction._asdict(),
        **gain_to_json(finding.gain),
        "halves": [
            {"correction": best._asdict(), **gain_to_json(gain)} for best, gain in finding.halves
        ],
    }


def gain_to_json(gain: Gain) -> dict[str, Any]:
    """A gain as values that JSON has."""
    return {"gain": gain.share, "gain_error": drop_infinite(gain.error)}
