"""Tuning: the time offset and the mount by which a map predicts scans best."""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from occmap.inspection import inspect, list_advised
from occmap.options import BuildOptions
from occmap.posing import PosingOptions
from occmap.report import HIDDEN, Count, Share, count
from occmap.report.results import doubt_agreement
from occmap.scans.tracing import Progress, Reading, ignore_progress
from occmap.scoring import Gain, Trial
from occmap.scoring.compare import FEW_SCANS, HeldOutScans, Scored
from occmap.tuning import search
from occmap.tuning.search import Correction, Finding, KeptLog, Knob, Scorer, Verdict
from occmap.types import Float64, Paths

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
class Improvement(Gain):
    """How much better held-out beams are predicted with a correction."""

    beams: Count
    """Held-out beams that measured a range"""
    share_before: Share
    """Share of these whose first occupied cell is within two cells of the range, with the
    options given"""
    share: Share
    """The same share with what is recommended"""


@dataclass(frozen=True, kw_only=True)
class TunedLog(Improvement):
    """What a correction for all logs does for one of them, in a map of its own."""

    log: str
    """The log, as it was given"""
    agreement: float | None
    """Share of the hits in occupied cells with the correction; null without any"""


@dataclass(frozen=True, kw_only=True)
class Tuning(Improvement, Scored):
    """What is wrong with time and mount, by held-out beams: what occmap tune prints."""

    scans: KeptScans
    """What became of the scans"""
    correction: Correction
    """All that is recommended; zeros where nothing is"""
    deskew: Finding
    """Whether poses for single beams alone gain on the best time offset and mount for whole scans;
    if so, those are searched again. Unseen where scans do not say when beams were measured"""
    time: Finding
    """What came of the search for a time offset"""
    mount: Finding
    """What came of the search for the laser's yaw, x and y on its body; the one of these two that
    explains more is searched first, and the other with what that found"""
    together: Finding
    """What came of the search for both once more, where a mount was found"""
    tried: list[TriedCorrection]
    """All corrections that were tried, in the order of the search"""
    by_log: list[TunedLog]
    """What the correction does for each log; where it is zero, what the best that was tried does"""
    command: tuple[str, ...]
    """The command line that builds the better map, word by word; empty where nothing is
    recommended, or where what was found is not sure"""
    doubts: Sequence[str] = field(default=(), metadata=HIDDEN)
    """Those of the notes that are why nothing is recommended"""


def tune(paths: Paths, options: BuildOptions, progress: Progress = ignore_progress) -> Tuning:
    """Search for a time offset and for a mount, by the share of held-out beams.

    What is found must gain more than noise, and in both halves of the held-out scans. Several logs
    are taken for those of one robot: one time offset and one mount suit them all best, each in a
    map of its own. The logs are read once; at most a thousand scans of each are kept.

    Raises
    ------
    OccmapError
        As `build`, or no held-out beam measured a range.
    """
    reading = Reading(paths, options, progress)
    logs, tally = search.keep_logs(reading), reading.tally
    kept = sum(log.scans for log in logs)
    scorer = Scorer(logs, options, search.find_common_mount(logs), lambda: tally.advance(kept))
    findings, unsearched = search_all(scorer)
    best, before = findings["together"].correction, scorer.score(Correction())
    after = scorer.score(best)
    leading = max(scorer.tried.values(), key=lambda trial: trial.score.share)
    told = after if best.is_any else leading
    by_log = [
        TunedLog(**improve(old, new), log=log, agreement=new.agreement)
        for log, old, new in zip(tally.logs, before.parts, told.parts, strict=True)
    ]
    doubts = list(list_doubts(scorer, best, by_log))
    if best.is_any or findings["time"].verdict is Verdict.DISAGREE:
        doubts += list_other_cures(paths, options)
    return Tuning(
        logs=tally.logs,
        notes=(*tally.notes, *unsearched, *doubts),
        scans=KeptScans(**vars(tally.scans), held_out=len(before.predicted), kept=kept),
        resolution=options.resolution,
        **improve(before, after),
        correction=best,
        **findings,
        tried=[
            TriedCorrection(**vars(correction), share=trial.score.share)
            for correction, trial in scorer.tried.items()
        ],
        by_log=by_log,
        command=search.compose(scorer, best) if best.is_any and not doubts else (),
        doubts=doubts,
    )


def search_all(scorer: Scorer) -> tuple[dict[str, Any], list[str]]:
    """Search for the time offset and the mount, for poses of single beams, and for all together.

    Returns
    -------
    findings, notes
        What came of each search, as fields of a `Tuning`; and what was not searched, and why.
    """
    timed, place, unsearched = plan_search(scorer)
    time, mount, best = search.find_both(scorer, Correction(), timed, place)
    deskew = search.find_deskew(scorer, best, timed)
    if deskew.verdict is Verdict.FOUND:
        time, mount, best = search.find_both(scorer, deskew.correction, timed, place)
    if place and mount.verdict is Verdict.UNSEEN:
        unsearched.append("the mount is not searched: it would make up for a wrong time")
    # Both once more, since one may have hidden part of the other.
    both = [*timed, *place] if timed and mount.verdict is Verdict.FOUND else []
    again = [replace(knob, steps=knob.steps[-3:]) for knob in both]
    together = search.find_correction(scorer, best, again)
    timeless = replace(together.correction, time_s=best.time_s)
    if not search.is_better(scorer, timeless, together.correction):
        together = search.find_correction(scorer, best, again[1:])
    return {"time": time, "mount": mount, "deskew": deskew, "together": together}, unsearched


def list_other_cures(paths: Paths, options: BuildOptions) -> Iterator[str]:
    """Say what mends faults of logs that a correction could at best make up for.

    The scans may fit the other of their two times better, poses may jump, or a laser be turned.
    """
    for log in inspect(paths, options).logs:
        # Poses for single beams are tried here, and what no return means is no fault.
        cures = [each for each in list_advised(log) if each[0] not in {"deskew", "no_return"}]
        if cures:
            typed = " and ".join(f"`{name}={value}`" for name, value in dict.fromkeys(cures))
            yield f"{log.path}: tune again with {typed}, as `occmap check` advises"


def improve(before: Trial, after: Trial) -> dict[str, Any]:
    """Measure how much better maps fare, as fields of an `Improvement`."""
    gain = Gain.measure(before.predicted, after.predicted)
    old, new = before.score, after.score
    return {"beams": old.beams, "share_before": old.share, "share": new.share, **vars(gain)}


def plan_search(scorer: Scorer) -> tuple[list[Knob], list[Knob], list[str]]:
    """Choose what to search: what would blur a map of these scans if it was wrong.

    Where the sensor stays near the first scan of a log, or never turns, a wrong mount turns or
    shifts all of its map, which no scan contradicts.

    Returns
    -------
    timed, place, notes
        By what to find the time offset, and the mount; and what is not searched, and why.
    """
    moved = [measure_motion(log, scorer.options.posing) for log in scorer.logs if log.scans]
    travels = max(travel for travel, _ in moved) > TRAVEL_M
    turns = max(turn for _, turn in moved) > TURN_RAD
    if not travels and not turns:
        return [], [], ["the sensor hardly moves: neither time nor mount shows in these scans"]
    timed, notes = [search.TIME], list[str]()
    if all(log.stated for log in scorer.logs):
        timed = []
        notes.append("the poses stand beside the scans: there is no time offset to search")
    if scorer.mount is None:
        found = "the mount is not searched: no single `sensor_pose` says where the lasers sit"
        lasers = next((log.topics for log in scorer.logs if len(log.topics) > 1), [])
        one_by_one = ", then with ".join(f"`topics={topic}`" for topic in lasers)
        fix = f"tune with {one_by_one}" if lasers else "name the body of one by `base_frame`"
        notes.append(f"{found}; {fix}")
        return timed, [], notes
    if not travels:
        notes.append(f"the yaw of the mount is not searched: it takes {TRAVEL_M:g} m of travel")
    if not turns:
        notes.append(f"x and y of the mount are not searched: it takes a turn of {TURN_RAD:g} rad")
    return timed, [search.YAW] * travels + [search.X, search.Y] * turns, notes


def measure_motion(log: KeptLog, options: PosingOptions) -> tuple[float, float]:
    """How far the sensor gets from where a log begins (m), and how far it turns away (rad)."""
    seen = [posed.at_first_beam for posed in log.pose(replace(options, max_pose_gap_s=None))]
    origin, rotation = map(np.concatenate, zip(*seen, strict=True))
    ahead = rotation[:, :2, 0]
    cosine = ahead @ ahead[0] / np.maximum(np.linalg.norm(ahead, axis=1), 1e-9)
    travel: Float64 = np.linalg.norm((origin - origin[0])[:, :2], axis=1)
    return float(travel.max()), float(np.arccos(np.clip(cosine, -1, 1)).max())


def list_doubts(scorer: Scorer, best: Correction, by_log: Iterable[TunedLog]) -> Iterator[str]:
    """Say what makes the best correction, and what it does for each log, less sure."""
    trial = scorer.score(best)
    if doubt := doubt_agreement(trial.agreement):
        yield (
            f"{doubt} with the best that was found: the search may have ended far from what "
            "is right; measure the mount and give it by `sensor_pose`, or see `occmap check`"
        )
    for each in by_log:
        if each.loses:
            yield (
                f"{each.log} loses {-each.gain:.4f} +- {each.gain_error:.4f} by what the other "
                "logs gain by: its mount or its clock may be another; tune it by itself"
            )
    if best.is_any:
        yield from list_unlike(scorer, best)
    half = len(trial.predicted) // 2
    if half < FEW_SCANS:
        few = f"{count(half, 'held-out scan')} in each half: too few to tell"
        yield f"{few}; give a longer log, or more logs of this robot"
    if scorer.is_at_edge(best):
        offset = scorer.options.posing.time_offset_s + best.time_s
        yield f"no larger time offset is tried: tune again with `time_offset_s={offset:g}`"


def list_unlike(scorer: Scorer, best: Correction) -> Iterator[str]:
    """Say which half of the scans, or which of several lasers, does not gain for sure by itself.

    What is wrong with a log is wrong in all of it: each half alone would lead to the same advice,
    and a clock that is wrong blurs the map of each laser alone. An offset that only makes lasers
    fit each other makes up for the mount of one of them, or for a clock of its own.
    """
    both = Correction(), best
    fared = [scorer.score(each).predicted for each in both]
    halves = zip(*(np.split(each, [len(each) // 2]) for each in fared), strict=True)
    parts = dict(zip(("the first half of the scans", "the second half"), halves, strict=True))
    topics = sorted({topic for log in scorer.logs for topic in log.topics})
    for topic in topics if len(topics) > 1 and best.time_s else ():
        alone = [log.take(topic) for log in scorer.logs]
        trials = (Trial.join(scorer.score_log(log, each) for log in alone) for each in both)
        parts[f"{topic}, mapped alone,"] = tuple(trial.predicted for trial in trials)
    for part, predicted in parts.items():
        gain = Gain.measure(*predicted)
        if not gain.certain:
            why = "which may be chance or make up for another fault"
            yield f"{part} gains only {gain} by what is found, {why}"
