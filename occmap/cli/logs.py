"""`occmap check`, `compare` and `tune`: what is asked of logs.

What is in them and what will go wrong; and what suits them better, as scored on held-out scans.
"""

import math
import shlex
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import click

from occmap.choices import Form, take
from occmap.cli import options
from occmap.cli.console import Console, align, write_rows
from occmap.cli.declaring import CONFIG, Answer, command, fail_if
from occmap.inspection import Inspection, findings, inspect
from occmap.options import OPTIONS, BuildOptions
from occmap.page import compare_logs, write_inspection
from occmap.report import Row, count, label_first
from occmap.report.limits import CHECK, COMPARE, TUNE
from occmap.scoring import SMALL, compare
from occmap.tuning import TunedLog, Tuning, tune
from occmap.tuning.search import Correction, Finding, Verdict
from occmap.types import BEAM_UPDATES, Update
from occmap.writers import check_picture

LABEL = 10
"""Width of the column of labels"""


@command(
    "check",
    Inspection,
    options.LOGS,
    options.one_output("output", "FILE.html", "Write the findings as a page as well."),
    *options.OF_LOGS,
    *(fail_if(CHECK, "dropped_scans > 5%"), CONFIG),
)
def check_command(console: Console, /, logs: tuple[Path, ...], **values: Any) -> Answer:
    """Say what is in logs, and what will go wrong with them.

    It takes the options of `occmap build` that concern scans, poses and ranges, and ends with the
    command line that it recommends. Exits with 1 if a build with the options given would fail.

      occmap check drive.mcap
      occmap check room.bag --sensor-pose 0,0,3.14159 --resolution 0.02
      occmap check intel.log.gz --json
    """
    check_picture(values["output"], logs, [".html"])
    chosen = take(BuildOptions, values)
    recordings, notes = options.gather_logs(console, logs, chosen)
    inspection = inspect(recordings, chosen, notes)
    words, last = inspection.command, 2 + len(recordings)
    if len(recordings) > len(logs) and words[2:last] == tuple(map(str, recordings)):
        line = (*words[:2], *map(str, logs), *words[last:])  # with the folders and patterns given
        inspection = replace(inspection, command=line)
    if values["output"]:
        write_inspection(values["output"], inspection)
    if console.quiet or console.as_json:
        for problem in inspection.problems:
            console.tell(f"error: {problem}")
    failure = None if inspection.buildable else click.exceptions.Exit(1)
    return Answer(inspection, format_inspection(inspection), failure)


def format_inspection(inspection: Inspection) -> Iterator[str]:
    """Write all findings; problems and the recommended command come last."""
    for log in inspection.logs:
        yield log.path
        topics = label_first("topics", align(findings.list_streams(log), "<<><"))
        listed = ((f"  {name}", text) for name, text in [*topics, *findings.list_rows(log)])
        yield from (*write_rows(listed, LABEL), "")
    rows = [] if inspection.map is None else [("map", findings.describe_map(inspection.map))]
    rows += [("warning", text) for text in inspection.warnings]
    rows += [("problem", text) for text in inspection.problems]
    yield from write_rows(rows, LABEL)
    if inspection.command:
        yield from (*[""] * bool(rows), shlex.join(inspection.command))


BEAMS = Form(Update, " or ".join(f'"{update}"' for update in BEAM_UPDATES))
"""What is told: `combine` says why the update for clouds is none of them"""
VARIED: dict[str, Any] = {"section": "What to compare", "is_many": True}


@command(
    "compare",
    compare.VariantComparison,
    options.LOGS,
    options.field(
        replace(OPTIONS["update"], kind=BEAM_UPDATES, form=BEAMS, **VARIED),
        metavar=f"[{'|'.join(BEAM_UPDATES)}]",
        show_default="all",
    ),
    options.field(
        replace(OPTIONS["model"], **VARIED),
        show_default="the default of each update, " + ", ".join(compare.DEFAULT_MODELS),
    ),
    options.one_output(
        "picture",
        "FILE",
        "Write all maps here: .png is a picture with where they disagree, .html a page.",
    ),
    *options.OF_LOGS,
    *(fail_if(COMPARE, "share < 70%"), CONFIG),
)
def compare_command(console: Console, /, logs: tuple[Path, ...], **values: Any) -> Answer:
    """Say which update and sensor model suits logs best.

    Every fifth scan is held out, and each map is scored on these scans: by the share of beams whose
    first occupied cell is within two cells of the measured range, by the log-likelihood of the
    range, and by the cross-entropy of the cells found free and found occupied. A share that is
    behind the best by less than two standard errors, or by less than half a percent, counts as
    equally good. Of those that are equally good the default is recommended. The one with the best
    log-likelihood is named, too: its probabilities are the ones to plan and localise with.

    A table says whether the probabilities of the recommended map mean what they say: for the cells
    of each tenth of probability, the share that beams found occupied.

      occmap compare drive.mcap
      occmap compare intel.log.gz -o compare.png --resolution 0.1
      occmap compare room.bag --update beam --model counting --model simple:p_hit=0.8
    """
    chosen = compare.combine(values.pop("update"), values.pop("model"))
    common = take(BuildOptions, values)
    found, notes = options.gather_logs(console, logs, common)
    comparison = compare_logs(found, chosen, common, values["picture"], console.advance)
    comparison = comparison.add_notes(notes)
    return Answer(comparison, format_comparison(comparison))


def format_comparison(comparison: compare.VariantComparison) -> list[str]:
    """Write the table, on what it rests, and the command line of the best."""
    best, scans = comparison.recommended, comparison.scans
    beams, held = count(best.score.beams, "beam"), count(scans.held_out, "held-out scan")
    bins = best.score.reliability
    reliability = [
        ("predicted occupied", *(f"{each.predicted:.3f}" for each in bins)),
        ("found occupied", *(f"{each.observed:.3f}" for each in bins)),
        ("looks", *(f"{each.looks:,}" for each in bins)),
    ]
    return [
        *align([compare.SCORES, *map(compare.list_scores, comparison.results)], "<"),
        "",
        f"cells of {best.name}, as held-out beams look at them",
        *align(reliability, "<"),
        "",
        f"scored by {beams} of {held}; {scans.used:,} of {scans.read:,} used",
        *(f"picture: {file}" for file in comparison.files),
        *compare.tell_verdict(comparison),
    ]


@command("tune", Tuning, *(options.LOGS, *options.OF_LOGS, fail_if(TUNE, "gain > 2%"), CONFIG))
def tune_command(console: Console, /, logs: tuple[Path, ...], **values: Any) -> Answer:
    """Find the time offset and the mount that suit logs best.

    A map is made of four fifths of the scans, a thousand at most, and asked what the others will
    see: the share of beams whose first occupied cell is within two cells of the measured range. A
    search from coarse to fine, some thirty maps, looks for the time offset by which that share is
    largest, and then for yaw, x and y of the laser on its body. Where scans say when each beam was
    measured, --deskew is tried, too. If an offset is found, some sixty more maps look for the mount
    first, as one may make up for the other, and if the mount is off, for all four together. A gain
    counts if it is more than two standard errors and half a percent, and if both halves of the
    held-out scans show it. What is found is added to the --time-offset and --sensor-pose that you
    give. A command is printed if each half, and each laser mapped alone, gains so much by itself.

    Of several lasers in a log, choose one by --scan-topic to look for its mount, which is then
    given by --static-tf.

    Several logs are taken for recordings of one robot, whose mount is one: each has a map of its
    own, in whatever frame, and a table says what each gains by what suits all of them best.

      occmap tune drive.mcap
      occmap tune monday.bag tuesday.bag wednesday.bag
      occmap tune room.bag --sensor-pose 0,0,3.14159
      occmap tune drive.bag --fail-if "gain > 2%"
    """
    common = take(BuildOptions, values)
    found, notes = options.gather_logs(console, logs, common)
    tuning = tune(found, common, console.advance).add_notes(notes)
    return Answer(tuning, format_tuning(tuning))


SEARCHES = {
    "deskew": ["deskew"],
    "time": ["time_s"],
    "mount": ["yaw", "x", "y"],
    "together": ["time_s", "yaw", "x", "y"],
}
"""By the name of a search the numbers of a correction that it changes"""


def format_tuning(tuning: Tuning) -> Iterator[str]:
    """Write what came of each search, what the result rests on, and the build line."""
    yield from write_rows(list_searches(tuning))
    if len(tuning.by_log) > 1:
        yield from ("", *align([TUNED, *map(list_tuned, tuning.by_log)], "<"), "")
    is_open = tuning.mount.verdict in {Verdict.UNSEEN, Verdict.DISAGREE}
    is_open |= tuning.time.verdict is Verdict.DISAGREE
    nothing = "nothing is recommended" if is_open or tuning.doubts else "nothing to gain"
    yield shlex.join(tuning.command) or ": ".join([nothing, *tuning.doubts[:1]])


def list_searches(tuning: Tuning) -> Iterator[Row]:
    """Say what came of each search, and what that rests on; notes say why there was none."""
    alone = tuning.time.correction.time_s
    for name, numbers in SEARCHES.items():
        finding = getattr(tuning, name)
        # All together are searched once more, and what that adds is told if it is sure.
        passed_over = set(Verdict) - {Verdict.FOUND} if name == "together" else {Verdict.UNSEEN}
        if finding.verdict not in passed_over:
            is_alone = finding is tuning.time and tuning.together.correction.time_s != alone
            yield name, f"{'by itself ' * is_alone}{format_finding(finding, numbers)}"
    rise = f", {tuning.share:.4f} with what is found: a gain of {tuning}"
    share = f"{tuning.share_before:.4f} of the beams are predicted"
    yield "share", share + rise * tuning.correction.is_any
    held = f"{count(tuning.beams, 'beam')} of {count(tuning.scans.held_out, 'held-out scan')}"
    maps = f"{count(len(tuning.tried), 'map')} of {count(tuning.scans.kept, 'scan')}"
    yield "scored", f"by {held}, on {maps} each"


def format_finding(finding: Finding, names: Sequence[str]) -> str:
    """Write what came of the search for some numbers of a correction."""
    halves = "the first half of the scans gains {}, the second {}"
    if finding.verdict is Verdict.DISAGREE:
        by = (f"{it} by {describe_correction(it.correction, names)}" for it in finding.halves)
        return f"the halves do not agree: {halves.format(*by)}"
    halves, best = halves.format(*finding.halves), finding.halves[0].correction
    told = f"{describe_correction(best, names)} gains {finding}"
    if finding.verdict is Verdict.FOUND:
        return f"{told}; {halves}"
    if best == finding.correction:
        return "nothing to gain"
    small = "too little to show in a map"
    return f"nothing sure to gain: {told}, {small if finding.gain <= SMALL else halves}"


TUNED = ("log", "share before", "share", "gain", "agreement")
"""What `list_tuned` lists"""


def list_tuned(tuned: TunedLog) -> list[str]:
    """Write what tuning does for one of several logs as a row of a table.

    Of a log without a held-out beam there is nothing to say.
    """
    if not tuned.beams:
        return [tuned.log, *"----"]
    shares = f"{tuned.share_before:.4f}", f"{tuned.share:.4f}"
    agreement = "-" if tuned.agreement is None else f"{tuned.agreement:.1%}"
    return [tuned.log, *shares, str(tuned), agreement]


def describe_correction(correction: Correction, names: Sequence[str]) -> str:
    """Write some numbers of a correction, without those that are zero."""
    written = {
        "time_s": f"offset {correction.time_s:+.6g} s",
        "yaw": f"yaw {math.degrees(correction.yaw):+.4g} deg",
        "x": f"x {correction.x:+.6g} m",
        "y": f"y {correction.y:+.6g} m",
        "deskew": "a pose for each beam",
    }
    return ", ".join(written[name] for name in names if getattr(correction, name)) or "no change"
