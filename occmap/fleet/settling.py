"""All logs traced by many workers, so that the parts show exactly what one process would find."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from itertools import accumulate, islice

import numpy as np

from occmap.fleet.cluster import Cluster
from occmap.fleet.runs import Setting
from occmap.fleet.tasks import LogSurvey, Traced, TraceJob, count_in_window, trace_part
from occmap.posing.course import STANDS, STILL_M
from occmap.posing.leaps import MOST_PATHS, Ends, Laser
from occmap.selection import FROM_THE_START, Seam
from occmap.sensor.no_return import RangeLimits
from occmap.steps.observing import Progress
from occmap.types import Float64


@dataclass
class LogTrace:
    """A log, the tasks that trace it, and what they showed."""

    survey: LogSurvey
    jobs: list[TraceJob]
    """One for each part, or one for all of the log"""
    limits: RangeLimits | None = None
    """Those that all of the log shows; None until it is traced"""
    traced: dict[int, Traced] = field(default_factory=dict)
    """What the jobs showed, by their places"""

    @property
    def parts(self) -> list[Traced]:
        """What the parts showed, in order."""
        return [self.traced[place] for place in range(len(self.jobs))]

    def is_sum_of_parts(self) -> bool:
        """Whether no part depends on the others, so that together they are the log."""
        parts, max_speed = self.parts, self.jobs[0].setting.options.posing.max_speed
        return len(parts) == 1 or (
            sum(part.tally.scans_read for part in parts) == self.survey.scans
            and len({list_lasting(part) for part in parts}) == 1
            and not stand([part.bounds for part in parts])
            and not any(part.depends for part in parts)
            and not leap([part.ends for part in parts], max_speed)
        )

    def become_whole(self) -> None:
        """Plan to trace the log as a single part, by its limits where these are known."""
        job = replace(self.jobs[0], part=None, seam=FROM_THE_START, limits=self.limits)
        self.jobs = [replace(job, name=f"{self.survey.name}-whole")]
        self.traced.clear()

    def settle_limits(self) -> list[int]:
        """Find the limits of the whole log; plan anew, and list, the parts that had others."""
        self.limits = limits = RangeLimits(self.jobs[0].setting.options.returns)
        for part in self.parts:
            limits.merge(part.limits)
        limits.settle()
        wrong = [
            place for place, part in enumerate(self.parts) if not part.limits.agrees_with(limits)
        ]
        for place in wrong:
            job = self.jobs[place]
            self.jobs[place] = replace(job, name=f"{job.name}-again", limits=limits)
        return wrong

    def list_findings(self) -> list[str]:
        """List what there is to say of its poses, scans and ranges, and of how it was traced."""
        first = self.parts[0]
        found = [*(first.notes if len(self.parts) == 1 else list_lasting(first))]
        found += self.limits.list_notes() if self.limits else ()
        if self.survey.parts == 1 and self.survey.bytes > 2 * self.jobs[0].setting.slice_bytes:
            found.append(
                "is traced by one worker, since it cannot be cut: it is packed, its index is "
                "missing, its lines end in CR alone, or another's reader reads it"
            )
        return found


def trace_logs(
    cluster: Cluster, setting: Setting, surveys: Sequence[LogSurvey], progress: Progress
) -> list[LogTrace]:
    """Trace all logs part by part, and once more what that does not show right.

    A part is traced as if nothing in it depended on the rest of its log. Where something does, the
    log is traced once more as a whole: where it is damaged, scans leap, a frame turns up late, the
    map frame jumps, a sensor stands still, or the notes on parts differ. Where only the limit of
    "no return" was another, parts are traced once more with the one that the whole log shows.
    """
    total = sum(survey.scans for survey in surveys)

    def tell(traced: Traced) -> None:
        progress(traced.tally.scans_read, total)

    def trace(places: Sequence[tuple[LogTrace, int]]) -> None:
        jobs = [log.jobs[place] for log, place in places]
        found = cluster.run("trace", trace_part, jobs, tell)
        for (log, place), traced in zip(places, found, strict=True):
            log.traced[place] = traced

    def trace_dependent() -> None:
        dependent = [log for log in logs if not log.is_sum_of_parts()]
        for log in dependent:
            log.become_whole()
        trace([(log, 0) for log in dependent])

    logs = plan_traces(cluster, setting, surveys)
    trace([(log, place) for log in logs for place in range(len(log.jobs))])
    trace_dependent()
    trace([(log, place) for log in logs for place in log.settle_limits()])
    # Some parts may show only by the limit of the whole log that they depend on it.
    trace_dependent()
    return logs


def plan_traces(cluster: Cluster, setting: Setting, surveys: Sequence[LogSurvey]) -> list[LogTrace]:
    """Plan the parts of all logs; for a stride, the wanted scans of each are counted first."""
    logs = []
    for survey in surveys:
        jobs = []
        for part in range(survey.parts):
            # The log's first scan lies in its first part; the others are told its stamp.
            seam = Seam(survey.first_ns) if part else FROM_THE_START
            name, number = f"{survey.name}-{part:05}", part if survey.parts > 1 else None
            jobs.append(TraceJob(setting, name, str(survey.path), survey, number, seam))
        logs.append(LogTrace(survey, jobs))
    if setting.options.selection.stride == 1:
        return logs
    cut = [log for log in logs if len(log.jobs) > 1]
    jobs = [job for log in cut for job in log.jobs]
    wanted = iter(cluster.run("count", count_in_window, jobs))
    for log in cut:
        *counts, _ = islice(wanted, len(log.jobs))
        befores = accumulate(counts, initial=0)
        log.jobs = [
            replace(job, seam=job.seam._replace(wanted=before))
            for job, before in zip(log.jobs, befores, strict=True)
        ]
    return logs


def list_lasting(part: Traced) -> tuple[str, ...]:
    """The notes of a part, but not that its sensor stands still: in the whole log it may move."""
    return tuple(note for note in part.notes if not note.endswith(STANDS))


def stand(parts: Sequence[dict[str, Float64]]) -> bool:
    """Whether a sensor stays at one place in all parts of a log."""
    around: dict[str, tuple[Float64, Float64]] = {}
    for part in parts:
        for topic, (low, high) in part.items():
            lowest, highest = around.get(topic, (low, high))
            around[topic] = np.minimum(lowest, low), np.maximum(highest, high)
    return any(float((high - low).max()) < STILL_M for low, high in around.values())


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
