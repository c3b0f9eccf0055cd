"""What the defaults rest on: `python -m tests.bench.defaults` scores their neighbours on real logs.

Prints two tables in Markdown: each log by the usual variants, and the mean over all logs where one
setting differs from its default.
"""

import math
import sys
from collections.abc import Sequence
from dataclasses import dataclass, replace
from statistics import mean
from typing import NamedTuple

from occmap.pipeline import BuildOptions
from occmap.posing.options import Deskew, PosingOptions
from occmap.scoring.compare import compare
from occmap.scoring.score import Score
from occmap.scoring.variants import Variant, combine
from occmap.sensor.models import parse_model
from occmap.sensor.returns import NoReturn, ReturnOptions
from occmap.types import Pose, Update
from tests.bench.tables import draw
from tests.samples import REAL_LOGS

PLAIN = BuildOptions()


class Recording(NamedTuple):
    """A real log, and what it does not say itself."""

    path: str
    posing: PosingOptions = PLAIN.posing


LOGS = {
    "Intel": Recording("carmen/intel-corrected.log.gz"),
    "Freiburg 079": Recording("carmen/freiburg-079-corrected.log.gz"),
    "CSAIL": Recording("carmen/csail-corrected.log.gz"),
    "Freiburg 079, robotlaser": Recording("carmen/fr079-robotlaser.log.gz"),
    "turtlebot (depth camera)": Recording("ros1/test_turtlebot.bag"),
    "a room (360 degrees)": Recording(
        "ros1/mylaserdata2.bag", PosingOptions(sensor_pose=Pose.planar(0, 0, math.pi))
    ),
    "a floor (raw odometry)": Recording("ros2/macfirst_floor_take_2"),
}
"""Those in which a robot moves, and whose poses are known."""


@dataclass(frozen=True)
class Setting:
    """One way to build."""

    name: str
    update: Update
    model: str
    options: BuildOptions = PLAIN

    @property
    def variant(self) -> Variant:
        """What `compare` is asked for."""
        return Variant(self.update, parse_model(self.model))


def list_neighbours() -> list[list[Setting]]:
    """Settings to compare, the default first in each list."""
    return [
        vary_model("simple", "p_hit=0.6", "p_hit=0.8", "p_hit=0.9", "p_miss=0.45", "p_miss=0.48"),
        vary_model(
            "quadratic", "epsilon=0.025", "epsilon=0.05", "epsilon=0.1", "p_min=0.3", "p_min=0.45"
        ),
        vary_model("counting", "strength=0.2", "strength=0.02", "strength=0.02,hit_weight=2"),
        vary_border("simple"),
        vary_border("counting:strength=0.02"),
        vary_reading(),
    ]


def vary_model(model: str, *parameters: str) -> list[Setting]:
    """A model by itself, and with some parameters."""
    models = [model, *(f"{model}:{some}" for some in parameters)]
    return [Setting(f"beam {each}", Update.BEAM, each) for each in models]


def vary_border(model: str) -> list[Setting]:
    """Which neighbouring ends the polygon update joins."""
    changes = {
        "": PLAIN,
        **{f", --jump {m:g}": replace(PLAIN, jump=m) for m in (0.1, 0.4)},
        **{f", --border-gap {n}": replace(PLAIN, border_gap=n) for n in (0, 2, 16)},
    }
    return [
        Setting(f"polygon {model}{name}", Update.POLYGON, model, options)
        for name, options in changes.items()
    ]


def vary_reading() -> list[Setting]:
    """What becomes of beams without return, and of the motion within a scan."""
    changes = {
        "beam simple": PLAIN,
        "--no-return clear": replace(PLAIN, returns=ReturnOptions(no_return=NoReturn.CLEAR)),
        "--deskew on": replace(PLAIN, posing=PosingOptions(deskew=Deskew.ON)),
    }
    return [Setting(name, Update.BEAM, "simple", options) for name, options in changes.items()]


def score(log: Recording, settings: Sequence[Setting]) -> dict[str, Score]:
    """Score settings on a log, each by its name; one read for those of equal options."""
    scores: dict[str, Score] = {}
    for options in {id(each.options): each.options for each in settings}.values():
        some = [each for each in settings if each.options is options]
        variants = {each.variant.name: each.variant for each in some}
        posing = replace(log.posing, deskew=options.posing.deskew)
        tuned = replace(options, posing=posing)
        results = compare([REAL_LOGS / log.path], list(variants.values()), tuned).results
        found = {result.variant.name: result.score for result in results}
        scores |= {each.name: found[each.variant.name] for each in some}
    return scores


def write(score: Score) -> str:
    """Share and log-likelihood."""
    return f"{score.share:.3f} / {score.log_likelihood:.2f}"


def average(scores: Sequence[Score]) -> str:
    """The same, over logs."""
    return f"{mean(s.share for s in scores):.3f} / {mean(s.log_likelihood for s in scores):.2f}"


def draw_usual(logs: Sequence[str]) -> str:
    """Every log by the variants that `compare` tries unasked."""
    usual = [Setting(v.name, v.update, v.name.split(" ", 1)[1]) for v in combine([], [])]
    scores = {log: score(LOGS[log], usual) for log in logs}
    rows = [(log, *(write(scores[log][each.name]) for each in usual)) for log in logs]
    means = [average([scores[log][each.name] for log in logs]) for each in usual]
    return draw(("log", *(each.name for each in usual)), [*rows, ("mean", *means)])


def draw_neighbours(logs: Sequence[str]) -> str:
    """The mean over all logs, and how far the share of each moves from the default's."""
    groups = list_neighbours()
    every = [setting for group in groups for setting in group]
    scores = {log: score(LOGS[log], every) for log in logs}
    rows = []
    for group in groups:
        for each in group:
            moves = [
                scores[log][each.name].share - scores[log][group[0].name].share for log in logs
            ]
            span = f"{min(moves):+.3f} to {max(moves):+.3f}" if each is not group[0] else ""
            rows.append((each.name, average([scores[log][each.name] for log in logs]), span))
    return draw(("setting", "mean of all logs", "share, by log, against the default's"), rows)


def main() -> None:
    """Print both tables for the logs that are there."""
    logs = [log for log, recording in LOGS.items() if (REAL_LOGS / recording.path).exists()]
    if not logs:
        sys.exit(f"no real logs in {REAL_LOGS}; set OCCMAP_REAL_LOGS to where they are")
    sys.stdout.write(f"{draw_usual(logs)}\n{draw_neighbours(logs)}")


if __name__ == "__main__":
    main()
