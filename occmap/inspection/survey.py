"""One pass over the scans of a log: everything about them is counted as they stream by.

That is their shapes, their times, the extent of their map, and their range values: which are not
measurements, which repeat too often, and what no return means. A sample of posed scans shows
whether beams without return lead through walls.
"""

import math
from array import array
from collections import Counter, defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import TypeAlias

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from occmap import sensor
from occmap.cells import Box, CellBox
from occmap.grid import Lattice
from occmap.inspection.findings import RangeFindings, Repeated, ScanShape, Special, TimeFindings
from occmap.posing.tracks import MAX_STAMP_NS
from occmap.readers import Stream
from occmap.scans import TopicSample, encode_cells
from occmap.scans.stream import Drive, Selector
from occmap.scans.tally import NOT_ASKED_FOR, LeftOut, Tally
from occmap.sensor import ReturnOptions, bands
from occmap.sensor.models import get_parameter
from occmap.types import Bool, Cloud, Float32, Float64, Kind, PosedScans, Rays, Recorded, ScanBatch
from occmap.values import as_float32

REPEATED_SHARE = 0.01
NEIGHBOURHOOD_M = 0.1
"""A value is suspicious if one finite range in a hundred has it, and ten times as many as have any
other value within this distance (`bands.DOMINANCE`). Ranges to a wall spread by their noise, even
if nothing moves."""

BEYOND = "> range_max"
NO_RETURNS = ("+inf", "= range_max", BEYOND)
"""The kinds that `no_return` decides about; all others are skipped."""

MOSTLY_OPEN = 0.05
"""Space is open where a smaller share than this of the beams without return leads through walls or
out of everything that was hit. On most real logs nearly all of them do; in a building that is
larger than the sensor's range none does."""

HIT_CELL_M = 0.1
"""Side of the cells by which it is looked up whether something was hit (m), and the step along a
beam"""
ASIDE_M = 0.15
"""How far to the left and right of a beam hits are looked for (m): a surface that it leads through
has hits on both sides, a corner or a wall that it grazes on one side only."""
STEPS_AROUND = 2
"""Steps before and behind that are looked at, too: a surface may be crossed at an angle"""
SHORT_OF_END_M = 0.2
"""A beam is looked at up to this far before its end (m), where it may meet a wall after all."""
MAX_REACH_M = 30.0
"""A beam is looked at up to here (m), however far it would clear space."""
MAX_CROSSING_BEAMS = 250
"""So many beams without return are looked at: enough to tell a share of 5%"""
MIN_CROSSING_BEAMS = 50
"""Fewer beams without return tell nothing."""
SIDES = np.arange(8) * math.pi / 4
"""Directions in which the sides of the octagon around all hits face (rad)"""


def tell_kinds(it: Float32, low: Float32, high: Float32) -> Iterator[tuple[str, str, Bool]]:
    """Tell which ranges are no plain measurements, kind by kind, and what drivers mean by them.

    The nearest and the farthest range are those that the scans state.
    """
    nothing = "the driver's way to say that nothing came back"
    yield "+inf", "did not come back (REP 117)", it == np.inf
    yield "= range_max", nothing, (it == high) & (it < np.inf)
    yield BEYOND, f"beyond the limit, stated or found: {nothing}", (it > high) & (it < np.inf)
    yield "-inf", "too close to measure (REP 117)", it == -np.inf
    yield "nan", "not measured (REP 117)", np.isnan(it)
    yield "zero", "no return or too close: drivers differ", it == 0
    yield "negative", "an error code", (it < 0) & (it > -np.inf)
    yield "< range_min", "too close to trust", (it > 0) & (it < low)


class RangeCensus:
    """Counts the range values of one topic by kind, batch by batch."""

    def __init__(self) -> None:
        self.counts: Counter[tuple[str, str]] = Counter()
        """How many ranges are of each kind, and what drivers mean by it"""
        self.total = 0
        self.limit = 0.0
        """The largest range_max that the scans state (m)"""
        self.smallest = math.inf
        self.largest = -math.inf

    def add(self, batch: ScanBatch) -> None:
        """Count the values of a batch."""
        ranges = batch.ranges
        low, high = as_float32(batch.range_min), as_float32(batch.range_max)
        for name, meaning, mask in tell_kinds(ranges, low, high):
            self.counts[name, meaning] += int(np.count_nonzero(mask))
        self.total += ranges.size
        self.limit = max(self.limit, batch.range_max)
        measured = ranges[(ranges > 0) & (ranges >= low) & (ranges < high)]
        self.smallest = min(self.smallest, float(measured.min(initial=np.inf)))
        self.largest = max(self.largest, float(measured.max(initial=-np.inf)))

    def sum_up(self, sample: Sequence[PosedScans], options: ReturnOptions) -> RangeFindings:
        """Sum up; a sample of the scans shows which values repeat, and what no return means.

        Beams without return are to clear space if the log states the limit up to which, if their
        value is not an error code of the SICK LMS, of which not all mean that space is open, and if
        hardly one of them leads through a wall or, as through glass, out of all that was hit.
        """
        repeated = tuple(list_repeated(sample, self.limit))
        if sum(not item.is_no_return for item in repeated) > bands.MOST_CODES:
            # So many are no codes of a driver: without noise a wall repeats its ranges, too.
            repeated = tuple(item for item in repeated if item.is_no_return)
        crossed = measure_crossing(sample, options)
        low, high = bands.SICK_CODES
        is_code = any(low <= item.value <= high for item in repeated)
        measured = self.total - self.counts.total()
        is_open = crossed is not None and crossed < MOSTLY_OPEN
        # Where all ranges lie beyond the limit, one of the two is in another unit.
        beyond = 0 if measured else sum(n for (name, _), n in self.counts.items() if name == BEYOND)
        is_limit = math.isfinite(self.limit) and not beyond
        suggested = "clear" if is_open and not is_code and is_limit else "ignore"
        return RangeFindings(
            total=self.total,
            measured=measured,
            smallest=self.smallest if measured else math.nan,
            largest=self.largest if measured else math.nan,
            specials=tuple(
                Special(name, n, n / self.total, meaning, suggested if name in NO_RETURNS else "")
                for (name, meaning), n in self.counts.items()
                if n
            ),
            repeated=repeated,
            crossed=crossed,
            body=find_body_in_sample(sample, options),
        )


def list_repeated(parts: Sequence[PosedScans], limit: float) -> Iterator[Repeated]:
    """List the ranges of scans that occur suspiciously often, the most frequent ones first.

    Parameters
    ----------
    limit
        From here on a range is no return in any case (m).
    """
    ranges = np.concatenate([np.zeros(0, np.float32), *(it.batch.ranges.ravel() for it in parts)])
    values, counts = np.unique(ranges[np.isfinite(ranges) & (ranges > 0)], return_counts=True)
    if len(values) < bands.MIN_VALUES:
        return
    total = int(counts.sum())
    frequent = np.flatnonzero(counts >= max(REPEATED_SHARE * total, bands.MIN_READINGS))
    for at in frequent[np.argsort(-counts[frequent], kind="stable")].tolist():
        value, number = float(values[at]), int(counts[at])
        near = np.float32(NEIGHBOURHOOD_M)
        beside = (values >= values[at] - near) & (values <= values[at] + near)
        beside[at] = False
        if number >= bands.DOMINANCE * counts[beside].max(initial=0):
            yield Repeated(value, number / total, value >= limit)


def measure_crossing(parts: Sequence[PosedScans], options: ReturnOptions) -> float | None:
    """Measure how many beams without return would clear space that they should not.

    Such a beam leads through a surface that other beams hit, or out of everything that was hit: a
    front of glass gives no hits, but what stands around it does.

    Returns
    -------
    float or None
        Their share; None where there are too few such beams, or no distance up to which they would
        call space free.
    """
    options = replace(options, no_return=sensor.NoReturn.CLEAR)
    hits, beams = [np.zeros((0, 2))], [np.zeros((0, 5))]
    for part in parts:
        rays, _ = sensor.interpret(part, options)
        limit = part.batch.range_max if options.range_max is None else options.range_max
        lost = (rays.kind == Kind.FREE) & (part.batch.ranges >= as_float32(limit))
        hits.append(rays.end[rays.kind == Kind.HIT])
        origin, direction = np.broadcast_arrays(rays.origin, rays.direction)
        beams.append(np.column_stack([origin[lost], direction[lost], rays.distance[lost]]))
    hit, every = np.concatenate(hits), np.concatenate(beams)
    if len(every) < MIN_CROSSING_BEAMS:
        return None
    some = np.linspace(0, len(every) - 1, min(len(every), MAX_CROSSING_BEAMS)).astype(np.int64)
    origin, direction, reach = np.split(every[some], [2, 4], axis=1)
    reach = np.minimum(reach.astype(np.float32), MAX_REACH_M)
    # A beam leaves all that was hit where it ends outside of the octagon around it.
    sides = np.stack([np.cos(SIDES), np.sin(SIDES)])
    far = (hit @ sides).max(axis=0) if len(hit) else np.inf  # no hit, no building
    leaves = ((origin + reach * direction) @ sides > far).any(axis=1)
    return float((leaves | find_crossing(origin, direction, reach[:, 0], hit)).mean())


def find_crossing(origin: Float64, direction: Float64, reach: Float64, hit: Float64) -> Bool:
    """(N,) whether beams (N,) lead through a surface of which there are hits (H, 2)."""
    walls = np.unique(encode_cells(hit, HIT_CELL_M))
    far = reach[:, None] - SHORT_OF_END_M
    steps = np.minimum(np.arange(HIT_CELL_M, MAX_REACH_M, HIT_CELL_M), far)
    ways = origin[:, None] + steps[..., None] * direction[:, None]
    aside = ASIDE_M * np.stack([-direction[:, 1], direction[:, 0]], axis=1)[:, None]
    there, left, right = (
        np.isin(encode_cells(ways + side * aside, HIT_CELL_M), walls) for side in (0, 1, -1)
    )
    return np.asarray((there & look_around(left) & look_around(right)).max(axis=1))


def look_around(steps: Bool) -> Bool:
    """(N, K) whether a step (N, K) of a beam, or one of those around it, is true."""
    ends = np.pad(steps, ((0, 0), (STEPS_AROUND, STEPS_AROUND)))
    return np.asarray(sliding_window_view(ends, 2 * STEPS_AROUND + 1, axis=1).max(axis=2))


NO_HIT_M = 1e6
"""What stands for the range of a beam without a hit here (m)"""
OWN_RANGE_M, OWN_SPREAD_M = 1.0, 0.03
"""The robot stands nearer in its own scans than this, and its parts keep their range so well (m)"""
OWN_SHARE = 0.8
"""In so many scans, for people stand before it at times"""
PLACE_M, MIN_PLACES = 0.5, 8
MOST_STRAIGHT = 0.9
"""Of the scans at one place, so large, only the first counts: a parked robot sees a wall as it sees
itself. At fewer places, or where the mean of all headings is longer, nothing is told"""
OWN_CELL_M, MOST_WALL = 0.2, 0.5
"""A wall that the robot follows is hit by other beams, too: in more of its cells (m) than this"""
MIN_OWN_BEAMS = 3
OWN_MARGIN_M = 0.05
"""How far the box around the robot's parts reaches beyond them (m)"""


Form: TypeAlias = tuple[float, float, int]
"""Bearing of the first beam, the angle from one to the next (rad), and how many there are"""


def find_body_in_sample(parts: Sequence[PosedScans], options: ReturnOptions) -> Box | None:
    """Find the robot in a sample of scans; those of one form are looked through together."""
    seen: defaultdict[Form, list[tuple[PosedScans, Float64]]] = defaultdict(list)
    for part in parts:
        batch, (kind, reach, _) = part.batch, sensor.classify(part.batch, options)
        form = batch.angle_min, batch.angle_increment, batch.ranges.shape[1]
        seen[form].append((part, np.where(kind == Kind.HIT, reach, NO_HIT_M)))
    return next(filter(None, (find_body(scans, form) for form, scans in seen.items())), None)


def find_body(seen: Sequence[tuple[PosedScans, Float64]], form: Form) -> Box | None:
    """Find a box around what beams measure at the same range wherever the sensor goes: the robot.

    It is in the sensor's frame (m); None where there is no such thing.

    Parameters
    ----------
    seen
        Scans of one form, and their ranges (S, B), NO_HIT_M where there is no hit.
    """
    scans, measured = zip(*seen, strict=True)
    position, rotation = map(np.concatenate, zip(*(it.at_first_beam for it in scans), strict=True))
    _, first = np.unique(np.floor(position[:, :2] / PLACE_M), axis=0, return_index=True)
    place, turn = position[first, :2], rotation[first, :2, :2]
    ranges, ways = np.concatenate(measured)[first], sensor.tabulate_bearings(*form)
    if len(first) < MIN_PLACES or np.hypot(*turn[:, :, 0].mean(axis=0)) > MOST_STRAIGHT:
        return None
    middle = np.median(ranges, axis=0)
    stays = (np.abs(ranges - middle) <= OWN_SPREAD_M).mean(axis=0) >= OWN_SHARE
    own = stays & (middle < OWN_RANGE_M)
    if own.sum() < MIN_OWN_BEAMS:
        return None
    ends = place[:, None] + np.einsum("sij,jb,sb->sbi", turn, ways, ranges)
    cells, is_hit = encode_cells(ends, OWN_CELL_M), ranges < NO_HIT_M
    is_wall = np.isin(cells[is_hit & own], cells[is_hit & ~own])
    if is_wall.mean() > MOST_WALL:
        return None
    every = (middle * ways).T[own]
    low, high = every.min(axis=0) - OWN_MARGIN_M, every.max(axis=0) + OWN_MARGIN_M
    x_min, y_min, x_max, y_max = np.round([*low, *high], 2).tolist()
    return x_min, y_min, x_max, y_max


SAMPLED_TOPICS = 100
"""How many topics are sampled: no robot has more lasers, and the map of each takes time."""
LONGEST_RUN_NS = 10**16
"""A simulation lasts no longer than this: 115 days."""
BELIEVABLE_S = 1e9
"""No beam is sent so long after the one before; a log may state any number."""
EARLIEST_DATE_NS = 631_152_000 * 10**9
"""A log with the date of its recording is of 1990 or later."""


class StampLog:
    """The times of every scan of a topic, 24 bytes each."""

    def __init__(self) -> None:
        self.header_ns = array("q")
        """What the driver wrote"""
        self.record_ns = array("q")
        """When the recorder stored it"""
        self._increment = array("d")

    def add(self, some: Recorded) -> None:
        """Take the times of one scan, or of all scans of a run."""
        for times, own in ((self.header_ns, some.stamp_ns), (self.record_ns, some.record_ns)):
            times.frombytes(np.clip(own, -MAX_STAMP_NS, MAX_STAMP_NS, dtype=np.int64).tobytes())
        self._increment.frombytes(np.asarray(some.time_increment, np.float64).tobytes())

    def sum_up(self, poses_ns: int | None = None) -> TimeFindings:
        """Sum up the times of at least one scan.

        Parameters
        ----------
        poses_ns
            The stamp of some pose that is not stated beside a scan, if there is one.
        """
        header, record = np.array(self.header_ns), np.array(self.record_ns)
        steps = np.diff(header) / 1e9
        offset = (header.astype(np.float64) - record) / 1e9
        all_equal = len(header) > 1 and bool((header == header[0]).all())
        duration_s = float(header.max() - header.min()) / 1e9
        # A simulation's clock begins at 0. That of a laser may, too, but then the poses have dates.
        latest = max(int(header.max()), LONGEST_RUN_NS if poses_ns is None else poses_ns)
        began_at_zero = header.min() >= 0 and latest < LONGEST_RUN_NS and not all_equal
        simulated = bool(began_at_zero and record.min() >= EARLIEST_DATE_NS)
        tenth = max(len(offset) // 10, 1)
        drift_s = float(np.median(offset[-tenth:]) - np.median(offset[:tenth]))
        increments = np.array(self._increment)
        increments = increments[np.abs(increments) < BELIEVABLE_S]
        return TimeFindings(
            start_ns=int(header.min()),
            end_ns=int(header.max()),
            duration_s=duration_s,
            rate_hz=(len(header) - 1) / duration_s if duration_s else 0.0,
            largest_gap_s=float(steps.max(initial=0)),
            offset_s=float(np.median(offset)),
            drift_s=0.0 if simulated else drift_s,
            jumps_back=int(np.count_nonzero(steps < 0)),
            largest_jump_back_s=float((-steps).max(initial=0)),
            duplicates=int(np.count_nonzero(steps == 0)),
            time_increment_s=float(np.median(increments)) if len(increments) else 0.0,
            all_equal=all_equal,
            all_zero=bool((header == 0).all()),
            simulated=simulated,
        )


@dataclass
class TopicSurvey:
    """What is known about the scans of one topic so far."""

    stream: Stream
    is_sampled: bool
    stated: bool
    """Poses beside scans count, and every scan so far had one"""
    sample: TopicSample = field(default_factory=TopicSample)
    stamps: StampLog = field(default_factory=StampLog)
    census: RangeCensus = field(default_factory=RangeCensus)
    shapes: Counter[ScanShape] = field(default_factory=Counter)
    frames: dict[str, None] = field(default_factory=dict)
    read: int = 0
    left_out: Counter[str] = field(default_factory=Counter)
    posed: int = 0

    def see(self, some: Recorded, reason: LeftOut | None) -> None:
        """Take note of scans; those that nobody asked for are only counted."""
        self.read += some.scans
        if reason is not None:
            self.left_out[reason] += 1
        if reason in NOT_ASKED_FOR:
            return
        self.stamps.add(some)
        self.stated &= some.pose is not None
        self.frames.setdefault(some.frame)
        if isinstance(some, Cloud):
            return
        angles = some.angle_min, some.angle_increment
        shape = ScanShape(some.ranges.shape[-1], *angles, *sensor.read_limits(some), scans=0)
        self.shapes[shape] += some.scans


class Survey(Selector):
    """Takes note of all scans of a log while it says which of them a build would use."""

    def __init__(self, drive: Drive) -> None:
        options = drive.options
        super().__init__(options)
        self.drive = drive
        streams = {each.topic: each for each in reversed(drive.log.streams)}
        stated = options.posing.takes_stated()
        self.topics = {
            topic: TopicSurvey(streams[topic], place < SAMPLED_TOPICS, stated)
            for place, topic in enumerate(drive.topics)
        }
        self._behind = options.hit_offset * options.resolution
        """How far behind the measured range a hit is placed (m)"""
        self._around = options.resolution if get_parameter(options.model, "spread") > 0 else 0.0
        """How far around a hit cells are taken as observed, too (m)"""
        self.box: CellBox | None = None
        """The cells that rays observe, which a map must hold; None: they observe none"""
        self.longest = 0.0
        """The longest beam (m)"""

    def survey(self) -> None:
        """Read all scans once, holding no more than a batch of each topic."""
        for posed in self.drive.read(Tally(), self):
            survey = self.topics[posed.batch.topic]
            survey.posed += len(posed.batch.stamp_ns)
            if survey.is_sampled:
                survey.sample.add(posed)
            if not posed.batch.clouds:
                self._enclose(sensor.interpret(posed, self.drive.options.returns)[0])

    def _enclose(self, rays: Rays) -> None:
        """Take in the beams that are used, from where they were sent to where they end."""
        hit, used = rays.kind == Kind.HIT, rays.kind != Kind.SKIP
        end = rays._replace(distance=rays.distance + hit * np.float32(self._behind)).end
        one_viewpoint = rays.origin.shape[1] == 1
        begun = used.any(axis=1, keepdims=True) if one_viewpoint else used
        self.longest = max(self.longest, float(rays.distance.max(initial=0.0)) + self._behind)
        lattice = Lattice(self.drive.options.resolution)
        for some, around in ((rays.origin[begun], 0.0), (end[used], 0.0), (end[hit], self._around)):
            if len(some):
                box = lattice.enclose(some, around)
                self.box = box.join(self.box) if self.box else box

    def see_batch(self, batch: ScanBatch) -> None:
        """Count the ranges of a batch; those of clouds only stand for moments."""
        if not batch.clouds:
            self.topics[batch.topic].census.add(batch)

    def see(self, some: Recorded, reason: LeftOut | None) -> None:
        """Count scans, and take note of what their topic has."""
        super().see(some, reason)
        self.topics[some.topic].see(some, reason)
