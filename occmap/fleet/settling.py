"""From the parts of a log to what the whole log shows: exactly what one process would find."""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import accumulate

import numpy as np

from occmap.arrays import Float64
from occmap.fleet.runs import Setting
from occmap.fleet.tasks import Survey, Traced, TraceJob
from occmap.posing.course import STANDS, STILL_M
from occmap.posing.leaps import MOST_PATHS, Ends, Laser
from occmap.selection import FROM_THE_START, Seam
from occmap.sensor.no_return import RangeLimits


class LogTrace:
    """The parts of one log, until all of them are traced by what the whole log shows.

    A part is traced as if nothing in it depended on the rest of its log. Where something does, the
    log is traced once more as a whole: where it is damaged, scans leap, a frame turns up late, the
    map frame jumps, a sensor stands still, or the notes on parts differ. Where only the limit of
    "no return" was another, parts are traced once more with the one that the whole log shows.
    """

    def __init__(self, setting: Setting, survey: Survey, wanted: Sequence[int]) -> None:
        self.survey = survey
        self.jobs = []
        for part, before in enumerate(accumulate(wanted[:-1], initial=0)):
            seam = Seam(survey.first_ns if part else None, before)
            name = f"{survey.name}-{part:05}"
            self.jobs.append(TraceJob(setting, name, str(survey.path), survey, part, seam))
        self.traced: dict[str, Traced] = {}
        """By the names of jobs"""
        self.limits: RangeLimits | None = None
        """Those of the whole log, once they are known"""

    @property
    def parts(self) -> list[Traced]:
        """What the parts showed, in order, once all of them are traced."""
        return [self.traced[job.name] for job in self.jobs]

    def list_findings(self) -> list[str]:
        """List what there is to say of its poses, scans and ranges, and of how it was traced."""
        first, ranges = self.parts[0], self.limits.list_notes() if self.limits else ()
        found = [*(first.notes if len(self.parts) == 1 else list_lasting(first)), *ranges]
        if self.survey.parts == 1 and self.survey.bytes > 2 * self.jobs[0].setting.slice_bytes:
            found.append(
                "is traced by one worker, since it cannot be cut: it is packed, its index is "
                "missing, or another's reader reads it"
            )
        return found

    def list_open(self) -> Iterator[TraceJob]:
        """List what is to be traced next; nothing where the log is done."""
        if self.limits is None and all(job.name in self.traced for job in self.jobs):
            self._settle()
        yield from (job for job in self.jobs if job.name not in self.traced)

    def _settle(self) -> None:
        """Find what the whole log shows, and what has to be traced once more by that."""
        if len(self.jobs) > 1 and not self._is_sum_of_parts():
            name = f"{self.survey.name}-whole"
            self.jobs = [replace(self.jobs[0], name=name, part=None, seam=FROM_THE_START)]
            return
        self.limits = RangeLimits(self.jobs[0].setting.options.returns)
        for part in self.parts:
            self.limits.merge(part.limits)
        self.limits.settle()
        self.jobs = [
            job
            if part.limits.agrees_with(self.limits)
            else replace(job, name=f"{job.name}-again", limits=self.limits)
            for job, part in zip(self.jobs, self.parts, strict=True)
        ]

    def _is_sum_of_parts(self) -> bool:
        """Whether no part depends on the others, so that together they are the log."""
        parts, max_speed = self.parts, self.jobs[0].setting.options.posing.max_speed
        return (
            sum(part.tally.scans_read for part in parts) == self.survey.scans
            and len({list_lasting(part) for part in parts}) == 1
            and not stand([part.bounds for part in parts])
            and not any(part.depends for part in parts)
            and not leap([part.ends for part in parts], max_speed)
        )


def list_lasting(part: Traced) -> tuple[str, ...]:
    """The notes of a part, but not that its sensor stands still: in the whole log it may move."""
    return tuple(note for note in part.notes if not note.endswith(STANDS))


def stand(parts: Sequence[dict[str, Float64]]) -> bool:
    """Whether a sensor stays at one place in all parts of a log."""
    around: dict[str, Float64] = {}
    for topic, (low, high) in (pair for part in parts for pair in part.items()):
        known = around.get(topic, np.stack([low, high]))
        around[topic] = np.stack([np.minimum(known[0], low), np.maximum(known[1], high)])
    return any(float(np.diff(each, axis=0).max()) < STILL_M for each in around.values())


def leap(parts: Sequence[dict[Laser, Ends]], max_speed: float) -> bool:
    """Whether there is a leap in any of the parts of a log, or between two of them."""
    before: dict[Laser, Ends] = {}
    for part in parts:
        for laser, ends in part.items():
            if ends.leaps or (
                laser in before and before[laser].last.leaps_to(ends.first, max_speed)
            ):
                return True
        before |= part
    return len(before) > MOST_PATHS  # then the whole log judges other scans than its parts
