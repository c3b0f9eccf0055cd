"""`occmap tune`: a time offset and a mount by which a map predicts held-out scans better."""

import math
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import click

from occmap.choices import take
from occmap.cli import options
from occmap.cli.answers import Answer, answering, fail_if
from occmap.cli.console import Console, write_command
from occmap.cli.progress import show_progress
from occmap.cli.sections import join
from occmap.cli.streams import gather_logs
from occmap.gates import TUNE
from occmap.options import BuildOptions
from occmap.tuning import Tuning, tune
from occmap.tuning.search import Correction, Finding, Verdict
from occmap.wording import count


@answering("tune", Tuning)
@click.argument("logs", nargs=-1, required=True, type=options.PATH, metavar="LOG...")
@join(options.resolution, options.max_cells, options.reading)
@join(fail_if(TUNE, "gain > 2%"), options.jobs, options.config, options.printing)
def command(console: Console, /, logs: tuple[Path, ...], **values: Any) -> Answer:
    """Find the time offset and the mount that suit logs best.

    A map is made of four fifths of the scans, a thousand at most, and asked what the others will
    see: the share of beams whose first occupied cell is within two cells of the measured range. A
    search from coarse to fine, some thirty maps, looks for the time offset by which that share is
    largest, and then for yaw, x and y of the laser on its body. If an offset is found, some sixty
    more maps look for the mount first, as one may make up for the other, and if the mount is off,
    for all four together. A gain counts if it is more than two standard errors and half a percent,
    and if both halves of the held-out scans show it. What is found is added to the --time-offset
    and --sensor-pose that you give.

      occmap tune drive.mcap
      occmap tune room.bag --sensor-pose 0,0,3.14159
      occmap tune drive.bag --fail-if "gain > 2%"
    """
    common = take(BuildOptions, values)
    found = gather_logs(console, logs, common)
    with show_progress(console) as progress:
        tuning = tune(found, common, progress)
    return Answer(tuning, format_tuning(tuning))


def format_tuning(tuning: Tuning) -> Iterator[str]:
    """Write what came of each search, what the result rests on, and the build line."""
    gain = format_gain(tuning.gain, tuning.gain_error)
    gained = f" -> {tuning.share:.4f}" if tuning.command else ""
    rise = f", a gain of {gain}" if tuning.command else ""
    held = f"{count(tuning.beams, 'beam')} of {count(tuning.scans.held_out, 'held-out scan')}"
    maps = f"{count(len(tuning.tried), 'map')} of {count(tuning.scans.kept, 'scan')}"
    yield f"time     {format_finding(tuning.time, ['time_s'])}"
    yield f"mount    {format_finding(tuning.mount, ['yaw', 'x', 'y'])}"
    if tuning.together.verdict is Verdict.FOUND:
        together = format_finding(tuning.together, ["time_s", "yaw", "x", "y"])
        yield f"together {together}"
    yield f"share    {tuning.share_before:.4f}{gained} of the beams are predicted{rise}"
    yield f"scored   by {held}, on {maps} each"
    disagree = Verdict.DISAGREE in (tuning.time.verdict, tuning.mount.verdict)
    unsure = disagree or tuning.is_doubtful
    nothing = "nothing is recommended" if unsure else "nothing to gain"
    yield write_command(tuning.command) or nothing


def format_finding(finding: Finding, names: Sequence[str]) -> str:
    """Write what came of the search for some numbers of a correction."""
    if finding.verdict is Verdict.UNSEEN:
        return "not searched"
    if finding.verdict is Verdict.NOTHING:
        return "nothing to gain"
    (first, one), (second, other) = (
        (describe(half.correction, names), format_gain(half.gain, half.gain_error))
        for half in finding.halves
    )
    if finding.verdict is Verdict.FOUND:
        gain = format_gain(finding.gain, finding.gain_error)
        return f"{first} gains {gain}; the first half of the log gains {one}, the second {other}"
    return (
        "the halves of the log do not agree, so nothing is recommended: the first "
        f"gains {one} by {first}, the second {other} by {second}"
    )


def describe(correction: Correction, names: Sequence[str]) -> str:
    """Write some numbers of a correction, without those that are zero."""
    written = {
        "time_s": f"offset {correction.time_s:+.6g} s",
        "yaw": f"yaw {math.degrees(correction.yaw):+.4g} deg",
        "x": f"x {correction.x:+.6g} m",
        "y": f"y {correction.y:+.6g} m",
    }
    changed = [written[name] for name in names if getattr(correction, name)]
    return ", ".join(changed) or "no change"


def format_gain(gain: float, error: float) -> str:
    """Write a gain and its standard error, where that is known."""
    return f"{gain:.4f} +- {error:.4f}" if math.isfinite(error) else f"{gain:.4f}"
