"""Tuning: the time offset and the mount by which a map predicts scans best."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from occmap.options import BuildOptions, compose_build
from occmap.report import HIDDEN, Count, Finite, Share, count
from occmap.report.results import LEAST_AGREEMENT
from occmap.scans.logs import count_scans, open_scans
from occmap.scans.tally import Tally
from occmap.scans.tracing import Progress, Remarks, ignore_progress
from occmap.scoring import Gain
from occmap.scoring.compare import FEW_SCANS, HeldOutScans, Scored
from occmap.tuning import search
from occmap.tuning.search import (
    MOST_SCANS,
    Correction,
    Finding,
    KeptLog,
    Knob,
    Scorer,
    Verdict,
    find_mount,
    keep_logs,
)
from occmap.types import Pose, Rays

USUAL_SCORINGS = 35
"""About how many maps a search scores, for the progress bar"""
TRAVEL_M = 0.5
"""A robot that stays nearer than this to its start does not show the yaw of a mount: the whole map
turns with it, and cells fit the walls better or worse by chance."""
TURN_RAD = 0.5
"""A robot that turns less does not show the place of a mount: the whole map shifts with it."""


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
    recommended, or where what was found is not sure"""
    agreement: float | None = field(metadata=HIDDEN)
    """Share of the hits in cells that the map of the best calls occupied; None without any"""

    @property
    def is_doubtful(self) -> bool:
        """Whether scans contradict each other even with the best that was found."""
        return self.agreement is not None and self.agreement < LEAST_AGREEMENT

    @property
    def is_sure(self) -> bool:
        """Whether enough scans say what was found, and fit each other with it."""
        return not self.is_doubtful and self.scans.held_out // 2 >= FEW_SCANS


def tune(
    paths: Sequence[Path], options: BuildOptions, progress: Progress = ignore_progress
) -> Tuning:
    """Search for a time offset and for a mount, by the share of held-out beams.

    What is found must gain more than noise, and in both halves of the held-out scans. The logs are
    read once; at most a thousand scans are kept.

    Raises
    ------
    OccmapError
        As `build`, or no held-out beam measured a range.
    """
    tally = Tally()
    opened = open_scans(paths, options)
    total = sum(count_scans(log, options.selection.topics) for log in opened)
    planned = total + USUAL_SCORINGS * min(total, MOST_SCANS)
    tally.tell = lambda scans: progress(scans, planned)
    remarks = Remarks([str(log.path) for log in opened])
    logs = keep_logs(opened, options, tally, remarks)
    kept = sum(log.scans for log in logs)
    mount = find_mount(logs, options.posing)
    scorer = Scorer(logs, options, mount, lambda: tally.advance(kept))
    before = scorer.score(Correction())
    timed, place, unsearched = plan_search(logs, mount, scorer.trace(Correction()))
    time, mounted, best = search.find_both(scorer, timed, place)
    # Both once more, since one may have hidden part of the other.
    again = search.TOGETHER if timed and mounted.verdict is Verdict.FOUND else []
    together = search.find_correction(scorer, best, again)
    best = together.correction
    after = scorer.score(best)
    gain, gain_error = Gain.measure(before.predicted, after.predicted)
    better = replace(options, posing=best.apply(options.posing, mount))
    tuning = Tuning(
        **vars(remarks),
        scans=KeptScans(**vars(tally.scans), held_out=len(before.predicted), kept=kept),
        resolution=options.resolution,
        beams=before.score.beams,
        share_before=before.score.share,
        share=after.score.share,
        gain=gain,
        gain_error=gain_error,
        correction=best,
        time=time,
        mount=mounted,
        together=together,
        tried=[
            TriedCorrection(**vars(correction), share=trial.score.share)
            for correction, trial in scorer.tried.items()
        ],
        command=(),
        agreement=scorer.measure_agreement(best),
    )
    if tuning.is_sure and best != Correction():
        tuning = replace(tuning, command=compose_build(remarks.logs, better, {}))
    doubts = list_doubts(tuning, options.posing.time_offset_s)
    return replace(tuning, notes=[*remarks.notes, *unsearched, *doubts])


def plan_search(
    logs: Sequence[KeptLog], mount: Pose | None, scans: Sequence[Rays]
) -> tuple[list[Knob], list[Knob], list[str]]:
    """Choose what to search: what would blur the map of these scans if it was wrong.

    Where the sensors stay near the first scan, or never turn, a wrong mount turns or shifts all of
    the map, which no scan contradicts.

    Returns
    -------
    timed, place, notes
        By what to find the time offset, and the mount; and what is not searched, and why.
    """
    origin = np.concatenate([rays.origin[:, 0] for rays in scans])
    ahead = np.concatenate([rays.turn[:, 0, :, 0] for rays in scans])
    cosine = ahead @ ahead[0] / np.maximum(np.linalg.norm(ahead, axis=1), 1e-9)
    travels = np.linalg.norm(origin - origin[0], axis=1).max() > TRAVEL_M
    turns = np.arccos(np.clip(cosine, -1, 1)).max() > TURN_RAD
    if not travels and not turns:
        return [], [], ["the sensor hardly moves: neither time nor mount shows in these scans"]
    timed, place, notes = [search.TIME], list[Knob](), list[str]()
    if all(log.stated for log in logs):
        timed = []
        notes.append("the poses stand beside the scans: there is no time offset to search")
    if mount is None:
        notes.append(
            "the mount is not searched: no single `sensor_pose` says where the lasers sit; name "
            "one laser by `topics`, or its body by `base_frame`"
        )
        return timed, place, notes
    if travels:
        place.append(search.YAW)
    else:
        needed = f"more than {TRAVEL_M:g} m of travel"
        notes.append(f"the yaw of the mount is not searched: it takes {needed}")
    if turns:
        place += [search.X, search.Y]
    else:
        notes.append(f"x and y of the mount are not searched: it takes a turn of {TURN_RAD:g} rad")
    return timed, place, notes


def list_doubts(tuning: Tuning, time_offset_s: float) -> Iterator[str]:
    """Say what makes the result less sure."""
    if tuning.is_doubtful:
        yield (
            f"with the best that was found only {tuning.agreement:.0%} of the hits lie in occupied "
            f"cells, still below {LEAST_AGREEMENT:.0%}: the search may have ended far from what is "
            "right; measure the mount and give it by `sensor_pose`, or see `occmap check`"
        )
    if tuning.time.verdict is Verdict.DISAGREE:
        yield "the mount is not searched: it would make up for times that change within the log"
    half = tuning.scans.held_out // 2
    if half < FEW_SCANS:
        yield f"{count(half, 'held-out scan')} in each half: too few to tell; give a longer log"
    if abs(tuning.correction.time_s) > search.TIME.reach - search.TIME.steps[-1]:
        offset = time_offset_s + tuning.correction.time_s
        yield f"no larger time offset is tried: tune again with `time_offset_s={offset:g}`"
