"""Whose map foretells the laser best: `python -m tests.bench.quality [LOG...] [--resolution M]`.

Every fifth scan is held out; each rule makes its map of the others. Two measures, both the share of
held-out beams whose first occupied cell is within two cells of the measured range: that of
`occmap compare`, which visits every cell that a beam crosses, and a plain walk in steps of one
cell, which owes nothing to occmap. Without logs it takes the real ones, and adds what the
neighbours of the defaults do.
"""

import argparse
import math
import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from functools import cache
from itertools import chain
from pathlib import Path
from statistics import mean
from time import thread_time
from typing import NamedTuple

import numpy as np

from occmap.cells import OccupancyMap
from occmap.choices import list_values, take
from occmap.errors import OccmapError
from occmap.evidence import render
from occmap.grid.kernels import HIT
from occmap.grid.tiles import MAX_CELLS, TileGrid
from occmap.jit import kernel
from occmap.options import OPTIONS, BuildOptions, choose_model
from occmap.posing import PosingOptions
from occmap.scans.tracing import Reading, ignore_progress
from occmap.scoring import Score, estimate_error, has_hits, hold_out, score_map
from occmap.scoring.compare import SharedEvidence, refuse_unscored
from occmap.sensor import ReturnOptions
from occmap.sensor.models import parse_model
from occmap.types import Bool, Float64, Pose, Rays, Update
from tests.bench.peers import CLASSES_ONLY, map_peers
from tests.bench.tables import draw
from tests.samples import REAL_LOGS

DEFAULT = BuildOptions()
PLAIN = replace(DEFAULT, update=Update.BEAM, model=parse_model("simple:spread=0"), hit_offset=0.0)
POLYGON = replace(DEFAULT, update=Update.POLYGON, model=choose_model(Update.POLYGON))
OURS = "occmap, no flags"


class Recording(NamedTuple):
    """A log, and what it does not say itself."""

    path: Path
    posing: PosingOptions = DEFAULT.posing


LOGS = {
    "Intel": Recording(REAL_LOGS / "carmen/intel-corrected.log.gz"),
    "Freiburg 079": Recording(REAL_LOGS / "carmen/freiburg-079-corrected.log.gz"),
    "CSAIL": Recording(REAL_LOGS / "carmen/csail-corrected.log.gz"),
    "robotlaser": Recording(REAL_LOGS / "carmen/fr079-robotlaser.log.gz"),
    "turtlebot": Recording(REAL_LOGS / "ros1/test_turtlebot.bag"),
    "room": Recording(
        REAL_LOGS / "ros1/mylaserdata2.bag", PosingOptions(sensor_pose=Pose.planar(0, 0, math.pi))
    ),
    "floor": Recording(REAL_LOGS / "ros2/macfirst_floor_take_2"),
    "standing": Recording(REAL_LOGS / "ros1/test_replay_crash.bag"),
}
"""Those whose poses are known: a depth camera, a laser that looks all round, raw odometry, and a
robot that stands still among them."""


def list_steps() -> dict[str, BuildOptions]:
    """The way from the plain rule to the default: each step by itself, then together."""

    def simple(parameters: str) -> BuildOptions:
        return replace(PLAIN, model=parse_model(f"simple:{parameters}"))

    return {
        "beam, written from 0.65": simple("spread=0,cut=0.65"),
        "beam, cut at even odds": PLAIN,
        "with hits half a cell out": replace(PLAIN, hit_offset=0.5),
        "with hits spread": simple(""),
        "with surfaces": replace(PLAIN, update=Update.SURFACE),
        "with all three": replace(DEFAULT, model=parse_model("simple")),
        "beam, the default's model": replace(DEFAULT, update=Update.BEAM),
        "polygon": POLYGON,
        OURS: DEFAULT,
    }


def list_neighbours() -> list[dict[str, BuildOptions]]:
    """Settings to compare, the default first in each group."""
    counting = "strength=0.2 hit_weight=2 cut=0.25 cut=0.4 cut=0.5 spread=0 spread=0.04 spread=0.12"
    others = "hit_offset=0 hit_offset=0.25 hit_offset=0.75 hit_offset=1 jump=0.05 jump=0.2 jump=0.4"
    others += " no_return=clear deskew=on"
    of_polygon = "model=counting:cut=0.32,spread=0 model=counting:cut=0.5,spread=0"
    of_polygon += " model=counting:cut=0.4 jump=0.05 jump=0.2"
    of_polygon += " border_gap=0 border_gap=4 border_gap=16"
    models = [f"model=counting:{each}" for each in counting.split()]
    return [
        {OURS: DEFAULT, **vary(DEFAULT, [*models, *others.split()])},
        {"polygon": POLYGON, **vary(POLYGON, of_polygon.split())},
    ]


def vary(base: BuildOptions, changes: Sequence[str]) -> dict[str, BuildOptions]:
    """Options that differ from some in one value, which is their name."""
    pairs = [(change, *change.split("=", 1)) for change in changes]
    return {
        f"{base.update.value}, {change}": take(
            BuildOptions, list_values(base) | {name: OPTIONS[name].read(value)}
        )
        for change, name, value in pairs
    }


FARTHEST_M = 30.0
NEAR = 2.0
"""Cells"""
ROUNDS = 3
"""The shortest of so many builds is told"""


class Scans:
    """Takes the scans of a log: what maps are made of, and what they are asked for."""

    def __init__(self) -> None:
        self.seen: list[Rays] = []
        self.held_out: list[Rays] = []
        """Every fifth scan"""

    def add(self, rays: Rays) -> None:
        """Take the scans of a batch."""
        self.seen.append(rays)


class Fare(NamedTuple):
    """How a map fared by both measures, and the processor time that it took (s)."""

    score: Score
    exact: Float64
    """(N, 2) of each held-out scan: beams that count, and those of them foretold"""
    walked: Float64
    seconds: float = math.nan

    @property
    def walked_share(self) -> float:
        """Of the plain walk."""
        beams, near = self.walked.sum(axis=0)
        return float(near / beams)


def read_scans(recording: Recording, options: BuildOptions) -> Scans:
    """Read a log; every fifth scan is held out.

    Raises
    ------
    OccmapError
        As `compare`.
    """
    posing = replace(recording.posing, deskew=options.posing.deskew)
    options = replace(options, posing=posing)
    kept = Scans()
    rays = Reading([recording.path], options, ignore_progress).list_rays()
    held_out = hold_out(rays, [kept], jobs=1)
    refuse_unscored([str(recording.path)], held_out.scans, has_hits(held_out))
    kept.held_out = held_out.parts
    return kept


def trace(scans: Scans, options: BuildOptions) -> tuple[TileGrid, float]:
    """Give the evidence of a build, and the processor time that it took (s)."""
    evidence = SharedEvidence(options)
    for rays in scans.seen:
        evidence.add(rays)
    return evidence.finish(), sum(evidence.seconds)


def score(grid: OccupancyMap, scans: Scans, seconds: float = math.nan) -> Fare:
    """Ask a map by both measures."""
    found = score_map(grid, scans.held_out, DEFAULT.jobs)
    return Fare(found.score, found.predicted, walk(grid, scans.held_out), seconds)


def score_builds(scans: Scans, settings: Mapping[str, BuildOptions]) -> dict[str, Fare]:
    """Make and score the maps of some settings, each by its name."""
    fares = {}
    for name, options in settings.items():
        seconds = []
        for _ in range(ROUNDS):
            evidence, spent = trace(scans, options)
            start = thread_time()
            grid = render(evidence, options.model, MAX_CELLS)
            seconds.append(spent + thread_time() - start)
        fares[name] = score(grid, scans, min(seconds))
    return fares


def score_peers(scans: Scans, resolution: float) -> dict[str, Fare]:
    """Make and score the maps of all peers."""
    by_beam, _ = trace(scans, replace(PLAIN, resolution=resolution))
    return {name: score(grid, scans) for name, grid in map_peers(scans.seen, by_beam).items()}


def walk(grid: OccupancyMap, held_out: Sequence[Rays]) -> Float64:
    """Walk beams in steps of one cell; (N, 2) of each scan: beams that count, those foretold."""
    totals = [np.zeros((len(rays.kind), 2)) for rays in held_out]
    for rays, total in zip(held_out, totals, strict=True):
        starts = (rays.origin - grid.origin) / grid.resolution
        ways = rays.direction * rays.distance[..., None] / grid.resolution
        counts = (rays.kind == HIT) & (rays.distance > 0) & (rays.distance < FARTHEST_M)
        walk_beams(starts, ways, counts, grid.occupied, total)
    return np.concatenate(totals)


@kernel
def walk_beams(
    starts: Float64, ways: Float64, counts: Bool, occupied: Bool, totals: Float64
) -> None:
    """Find the first occupied cell of each beam.

    Parameters
    ----------
    starts, ways
        (S, K, 2), (S, B, 2): x and y of sensors and of whole beams, in cells from the map's corner.
    counts
        (S, B) whether a beam does.
    totals
        (S, 2) added to.
    """
    for at in range(counts.size):
        s, b = divmod(at, counts.shape[1])
        if not counts[s, b]:
            continue
        k = min(b, starts.shape[1] - 1)
        x, y = starts[s, k, 0], starts[s, k, 1]
        reach = math.hypot(ways[s, b, 0], ways[s, b, 1])
        totals[s, 0] += 1
        for step in range(int(reach + NEAR) + 1 if reach > 0 else 0):
            col = int(np.floor(x + step * ways[s, b, 0] / reach))
            row = int(np.floor(y + step * ways[s, b, 1] / reach))
            inside = 0 <= row < occupied.shape[0] and 0 <= col < occupied.shape[1]
            if inside and occupied[row, col]:
                totals[s, 1] += abs(step - reach) <= NEAR
                break


def measure_lead(ours: Float64, theirs: Float64) -> tuple[float, float]:
    """How much larger our share is, and the standard error of that, scan by scan; (N, 2) each."""
    gained = ours[:, 1] - theirs[:, 1]
    return gained.sum() / ours[:, 0].sum(), estimate_error(gained, ours[:, 0])


Fares = Mapping[str, Mapping[str, Fare]]
"""By log, by rule"""


def list_rules(fares: Fares) -> Iterator[tuple[str, list[Fare]]]:
    """Each rule, and how it fared on the logs."""
    for name in next(iter(fares.values())):
        yield name, [of[name] for of in fares.values()]


def draw_shares(fares: Fares) -> str:
    """Every rule on every log, exact share and log-likelihood; what it costs beside plain beams."""
    spent = {name: sum(fare.seconds for fare in each) for name, each in list_rules(fares)}
    rows = []
    for name, each in list_rules(fares):
        shares = [fare.score.share for fare in each]
        likely = [fare.score.log_likelihood for fare in each]
        cost = spent[name] / spent["beam, cut at even odds"]
        texts = [
            f"{p:.3f}" if name in CLASSES_ONLY else f"{p:.3f} / {q:.2f}"
            for p, q in zip([*shares, mean(shares)], [*likely, mean(likely)], strict=True)
        ]
        rows.append((name, *texts, "" if math.isnan(cost) else f"{cost:.2f}"))
    return draw(("every cell, share / log-likelihood", *fares, "mean", "time"), rows)


def draw_walked(fares: Fares) -> str:
    """Every rule on every log by the plain walk."""
    rows = []
    for name, each in list_rules(fares):
        shares = [fare.walked_share for fare in each]
        rows.append((name, *(f"{share:.3f}" for share in [*shares, mean(shares)])))
    return draw(("steps of one cell, share", *fares, "mean"), rows)


def draw_leads(fares: Fares, peers: Sequence[str]) -> str:
    """How far occmap's default is ahead of the best peer on each log, with standard errors."""
    rows = []
    for log, of in fares.items():
        row = [log]
        for kind in ("exact", "walked"):
            tables = {name: getattr(of[name], kind) for name in peers}
            best = max(peers, key=lambda name: tables[name][:, 1].sum())
            lead, error = measure_lead(getattr(of[OURS], kind), tables[best])
            row.append(f"{lead:+.4f} +- {error:.4f} ({best})")
        rows.append(row)
    return draw(("ahead of the best peer", "every cell", "steps of one cell"), rows)


def draw_neighbours(fares: Fares, groups: Sequence[Mapping[str, BuildOptions]]) -> str:
    """The mean over all logs, and how far the share of each moves from the default's."""
    rows = []
    for group in groups:
        first = next(iter(group))
        for name in group:
            moved = [of[name].score.share - of[first].score.share for of in fares.values()]
            share = mean(of[name].score.share for of in fares.values())
            likely = mean(of[name].score.log_likelihood for of in fares.values())
            span = f"{min(moved):+.3f} to {max(moved):+.3f}" if name != first else ""
            rows.append((name, f"{share:.3f} / {likely:.2f}", span))
    return draw(("setting", "mean of all logs", "share, by log, against the first"), rows)


def score_neighbours(
    recording: Recording, groups: Sequence[Mapping[str, BuildOptions]]
) -> dict[str, Fare]:
    """Score what differs from a default in one setting; a log is read once for each way to read."""

    @cache
    def read(returns: ReturnOptions, posing: PosingOptions) -> Scans:
        return read_scans(recording, replace(DEFAULT, returns=returns, posing=posing))

    fares: dict[str, Fare] = {}
    for name, each in chain.from_iterable(group.items() for group in groups):
        fares |= score_builds(read(each.returns, each.posing), {name: each})
    return fares


def set_resolution(settings: Mapping[str, BuildOptions], metres: float) -> dict[str, BuildOptions]:
    """The same settings with cells of so many metres."""
    return {name: replace(each, resolution=metres) for name, each in settings.items()}


def main(words: Sequence[str] | None = None) -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(prog="python -m tests.bench.quality", description=__doc__)
    parser.add_argument("logs", nargs="*", type=Path, metavar="LOG")
    parser.add_argument("--resolution", type=float, default=DEFAULT.resolution, help="m")
    given = parser.parse_args(words)
    alike = len({path.name for path in given.logs}) < len(given.logs)
    logs = {str(path) if alike else path.name: Recording(path) for path in given.logs} or {
        name: each for name, each in LOGS.items() if each.path.exists()
    }
    if not logs:
        sys.exit(f"no real logs in {REAL_LOGS}; set OCCMAP_REAL_LOGS to where they are")
    steps = set_resolution(list_steps(), given.resolution)
    fares: dict[str, dict[str, Fare]] = {}
    peers: list[str] = []
    for name, recording in logs.items():
        scans = read_scans(recording, DEFAULT)
        found = score_peers(scans, given.resolution)
        peers = list(found)
        fares[name] = found | score_builds(scans, steps)
    sys.stdout.write("\n".join([draw_shares(fares), draw_walked(fares), draw_leads(fares, peers)]))
    if not given.logs:
        groups = [set_resolution(group, given.resolution) for group in list_neighbours()]
        around = {name: score_neighbours(each, groups) for name, each in logs.items()}
        sys.stdout.write(f"\n{draw_neighbours(around, groups)}")


if __name__ == "__main__":
    try:
        main()
    except OccmapError as error:
        sys.exit(str(error))
