"""What an inspection finds: frozen values with their JSON form, and words for terminal and page."""

import math
from collections.abc import Iterator
from dataclasses import dataclass, field

from occmap import report
from occmap.cells import Box, CellBox
from occmap.posing import Concern
from occmap.posing.frames import Source
from occmap.readers import Role, Stream
from occmap.report import HIDDEN, Finite, Noted, Printed, Row, Share, count
from occmap.scans.tally import count_wanted


@dataclass(frozen=True)
class ScanShape:
    """Beams and limits that scans share."""

    beams: int
    """Beams of a scan"""
    angle_min: Finite
    """Bearing of the first beam (rad); null where it is none"""
    angle_increment: Finite
    """Angle from one beam to the next (rad); null where it is none"""
    range_min: float
    """Nearest range that the sensor measures (m)"""
    range_max: Finite
    """The sensor's limit (m); null where the log states none"""
    scans: int
    """Scans of this shape"""


@dataclass(frozen=True)
class Special:
    """Range values of one kind that are not plain measurements."""

    name: str
    """The kind of value"""
    count: int
    """Values of the kind"""
    share: Share
    """Share of all range values"""
    meaning: str
    """What drivers mean by it"""
    no_return: str
    """The `no_return` that suits; empty where the value is skipped anyway"""


@dataclass(frozen=True)
class Repeated:
    """One finite range that occurs far more often than any near it, in a sample of the scans."""

    value: float
    """The range (m)"""
    share: Share
    """Share of the finite ranges of the sample"""
    is_no_return: bool
    """It is at or beyond the limit that the scans state, so that it is read as no return"""


@dataclass(frozen=True)
class RangeFindings:
    """What the range values of a topic are."""

    total: int
    """Range values"""
    measured: int
    """Range values that are plain measurements"""
    smallest: Finite
    """Smallest measured range (m); null where there is none"""
    largest: Finite
    """Largest measured range (m); null where there is none"""
    specials: tuple[Special, ...]
    """Values that are not plain measurements, by kind"""
    repeated: tuple[Repeated, ...]
    """Finite ranges that repeat suspiciously often"""
    crossed: Share | None
    """Share of the beams without return whose way leads through a surface that others hit, or
    beyond all that was hit; null where too few are known"""
    body: Box | None
    """Box around what is measured at the same range wherever the sensor goes, which is the robot
    (m, in the sensor's frame); null where there is no such thing"""


@dataclass(frozen=True)
class TimeFindings:
    """The stamps of a topic, beside the times at which it was recorded."""

    start_ns: int
    """Earliest stamp (ns)"""
    end_ns: int
    """Latest stamp (ns)"""
    duration_s: float
    """From the earliest to the latest stamp (s)"""
    rate_hz: float
    """Scans a second over the whole duration (1/s); 0 where that is 0"""
    largest_gap_s: float
    """Longest time from one scan to the next (s)"""
    offset_s: float
    """Median of stamp minus record time (s)"""
    drift_s: float
    """Growth of that from the first tenth of the scans to the last (s)"""
    jumps_back: int
    """Stamps earlier than the one before"""
    largest_jump_back_s: float
    """The largest of these jumps (s)"""
    duplicates: int
    """Scans with the stamp of the scan before"""
    time_increment_s: float
    """Median time from one beam to the next (s); 0 where the log states none"""
    all_equal: bool
    """All stamps are equal"""
    all_zero: bool
    """All stamps are 0"""
    simulated: bool
    """The stamps are of a simulation's clock, which keeps its own pace, so the drift is 0"""


@dataclass(frozen=True)
class MountFindings:
    """How a sensor sits, seen from the map."""

    upside_down: bool
    """The sensor hangs upside down"""
    tilt: float
    """Median angle between the scan plane and the map's (rad)"""
    height: float
    """Median height in the map (m)"""
    better: str = ""
    """The option, with its value, that mounts it so that the scans fit each other better; empty
    where they fit"""


@dataclass(frozen=True)
class PoseFindings:
    """How the scans of a topic get their poses."""

    stated: bool
    """The log holds a pose beside each scan"""
    chain: tuple[str, ...]
    """Frames from the map to the sensor; empty where poses are stated or missing"""
    posed: int
    """Scans with a pose"""
    dropped: dict[str, int]
    """Scans without a pose, by reason"""
    problem: str
    """Why there are none, and what to do; empty where there are"""
    assumed: str
    """The `sensor_pose` that was found to fit, and is assumed; empty where none is needed"""
    is_guess: bool
    """The assumed mount is a place holder: the scans do not tell it"""


@dataclass(frozen=True)
class ScanFindings:
    """All about one topic of scans."""

    topic: str
    """Name of the topic"""
    type: str
    """Message type"""
    frames: tuple[str, ...]
    """Frames that the scans are in"""
    is_of_clouds: bool
    """They are clouds of points, which have no beams, ranges or shape"""
    scans: int
    """Scans of the topic"""
    left_out: dict[str, int]
    """Scans that are left out whatever their poses, by reason"""
    shapes: tuple[ScanShape, ...]
    """The most frequent shapes, with the most frequent first"""
    shape_count: int
    """How many shapes there are, listed or not"""
    ranges: RangeFindings
    """What the range values are"""
    times: TimeFindings
    """How the stamps run"""
    poses: PoseFindings
    """Where the poses come from"""
    mount: MountFindings | None
    """How the sensor sits; null where no scan has a pose"""
    agreement: Share | None
    """Share of the hits of a sample of scans that lie in cells which their map calls occupied;
    null where they make no map"""
    hint: str = field(default="", metadata=HIDDEN)
    """What to try where these are few, and nothing else that was found may be why"""
    misfit: Concern | None = field(default=None, metadata=HIDDEN)
    """That another mount fits the scans better"""
    better: Concern | None = field(default=None, metadata=HIDDEN)
    """That another option does, whatever it is but a mount"""

    @property
    def kept(self) -> int:
        """Scans that are not left out before anybody asks for their poses."""
        return self.scans - sum(self.left_out.values())


@dataclass(frozen=True)
class MapFindings:
    """The map that the logs would make."""

    resolution: float
    """Side of a cell (m)"""
    extent: Box
    """Lowest x and y, highest x and y (m)"""
    columns: int
    """Cells from left to right (along x)"""
    rows: int
    """Cells from bottom to top (along y)"""
    file_bytes: int
    """Size of the map as PGM (bytes)"""
    memory_bytes: int
    """Memory that the map and its evidence take at most (bytes)"""


@dataclass(frozen=True)
class Coverage:
    """One edge of the transform tree, or one topic of poses."""

    parent: str
    """Frame that the poses are in"""
    child: str
    """Frame whose poses these are; empty where the log does not say"""
    source: Source
    """Kind of source"""
    topic: str
    """Topic, or name of the trajectory file"""
    samples: int
    """Poses"""
    static: bool
    """It holds for all times"""
    moves: bool
    """The poses differ"""
    start_ns: int
    """Earliest stamp (ns); of what holds for all times, when it was recorded last"""
    end_ns: int
    """Latest stamp (ns)"""
    largest_gap_s: float
    """Longest time from one pose to the next (s)"""
    largest_step_m: float
    """Longest way from one pose to the next (m)"""
    largest_step_rad: float
    """Largest turn from one pose to the next (rad)"""


@dataclass(frozen=True)
class LogFindings(Noted):
    """All about one log."""

    path: str
    """The log, as it was given"""
    streams: tuple[Stream, ...] = ()
    """Topics of the log, also those that no map needs"""
    scans: tuple[ScanFindings, ...] = ()
    """Topics with scans"""
    coverage: tuple[Coverage, ...] = ()
    """Sources of poses"""
    notes: tuple[str, ...] = ()
    """What a user should know, one sentence each, as on stderr"""
    damage: tuple[str, ...] = field(init=False)
    """Those of the notes that tell of damage to a log"""
    concerns: tuple[Concern, ...] = field(default=(), metadata=HIDDEN)
    """What will spoil a map, or surprise its maker"""
    problem: str = ""
    """Why the log gives no scans for a map; empty where it does"""
    box: CellBox | None = field(default=None, metadata=HIDDEN)
    """The cells that its scans observe; None: they observe none"""
    longest: float = field(default=0.0, metadata=HIDDEN)
    """The longest beam (m)"""


@dataclass(frozen=True)
class Inspection(Printed):
    """What a build of these logs would meet."""

    logs: tuple[LogFindings, ...]
    """The logs, one by one"""
    map: MapFindings | None
    """The map that they would make; null where no scan has a pose"""
    problems: tuple[str, ...]
    """Why occmap build with the options given would fail; any of them makes the exit code 1"""
    warnings: tuple[str, ...]
    """What will spoil the map, or surprise its maker"""
    command: tuple[str, ...]
    """The recommended command line, word by word; empty where nothing helps"""
    buildable: bool
    """Whether occmap build with the options given makes a map"""
    notes: tuple[str, ...] = ()
    """Which recordings folders and patterns were found to hold, and what was passed over"""
    damage: tuple[str, ...] = field(default=(), metadata=HIDDEN)
    """What tells of damage to a log, or of a recording in a folder that nothing can read"""

    def __post_init__(self) -> None:
        # It is among the warnings.
        others = tuple(note for note in self.notes if note not in self.damage)
        object.__setattr__(self, "notes", others)

    @property
    def topics(self) -> list[ScanFindings]:
        """All topics of scans."""
        return [topic for log in self.logs for topic in log.scans]

    @property
    def dropped_share(self) -> float:
        """The share of the scans asked for that have no pose; 0 of nothing."""
        wanted = sum(count_wanted(topic.scans, topic.left_out) for topic in self.topics)
        return (wanted - sum(topic.poses.posed for topic in self.topics)) / max(wanted, 1)

    @property
    def beam_shares(self) -> dict[str, float]:
        """Which share of all ranges is measured; none where it is on clouds."""
        ranges = [topic.ranges for topic in self.topics]
        share = sum(it.measured for it in ranges) / max(sum(it.total for it in ranges), 1)
        return {} if any(topic.is_of_clouds for topic in self.topics) else {"hits": share}


def list_rows(log: LogFindings) -> Iterator[Row]:
    """List all about one log beside its topics, for a terminal and for a page."""
    for topic in log.scans:
        yield "", ""
        yield from list_facts(topic)
    if log.coverage:
        yield "", ""
    yield from report.label_first("sources", list_sources(log.coverage))
    yield from report.label_first("note", log.other_notes)


def list_streams(log: LogFindings) -> list[tuple[str, str, str, str]]:
    """List the topics of a log with their types and counts, and what each is good for."""
    roles = {role: "" if role is Role.OTHER else f"{role}s" for role in Role}
    return [(it.topic, it.type, f"{it.count:>8,}", roles[it.role]) for it in log.streams]


def list_facts(topic: ScanFindings) -> Iterator[Row]:
    """Say all about one topic of scans."""
    times, title = topic.times, "clouds" if topic.is_of_clouds else "scans"
    left = f"{topic.kept:,} of " if topic.left_out else ""
    scans = f"{topic.topic}: {left}{topic.scans:,} in {times.duration_s:.6g} s"
    yield title, f"{scans}, {times.rate_hz:.3g} a second, frame {', '.join(topic.frames)}"
    if topic.left_out:
        yield "dropped", report.write_counts(topic.left_out)
    if not topic.is_of_clouds:
        yield from report.label_first("shape", list_shapes(topic))
        yield from report.label_first("ranges", list_ranges(topic.ranges))
    yield "stamps", report.write_span(times.start_ns, times.end_ns)
    yield "", ", ".join(list_times(times))
    yield "poses", describe_poses(topic)
    if topic.agreement is not None:
        share = f"{topic.agreement:.0%} of the hits of a sample lie in cells called occupied"
        yield "", share + topic.hint
    if topic.mount is not None:
        yield "sensor", describe_mount(topic.mount, topic)


def list_shapes(topic: ScanFindings) -> Iterator[str]:
    """Say where the beams of scans point and how far they reach, for the most frequent shapes."""
    for shape in topic.shapes:
        scans = "" if topic.shape_count == 1 else f"{count(shape.scans, 'scan')}: "
        start, step = math.degrees(shape.angle_min), math.degrees(shape.angle_increment)
        view = max(shape.beams - 1, 0) * abs(step)
        limit = "without limit" if math.isinf(shape.range_max) else f"to {shape.range_max:.6g} m"
        yield (
            f"{scans}{count(shape.beams, 'beam')} over {view:.4g} deg, from {start:.4g} deg every "
            f"{step:.3g} deg, ranges from {shape.range_min:.3g} {limit}"
        )
    if topic.shape_count > len(topic.shapes):
        yield f"and {topic.shape_count - len(topic.shapes)} more"


def list_ranges(ranges: RangeFindings) -> Iterator[str]:
    """Say how many ranges are measured, which values are special, and what each suggests."""
    span = f", {ranges.smallest:.3g} to {ranges.largest:.4g} m" if ranges.measured else ""
    yield f"{ranges.total:,}: {ranges.measured / max(ranges.total, 1):.1%} measured{span}"
    for each in ranges.specials:
        advice = f"`no_return={each.no_return}`" if each.no_return else "skipped"
        yield f"{each.name:<12} {each.count:>10,} {each.share:>6.1%}  {each.meaning}: {advice}"
    for it in ranges.repeated:
        meaning = "no return, by the limit" if it.is_no_return else "may mean no return"
        yield f"{it.value:<12.6g} repeated: {it.share:.1%} of the ranges of a sample; {meaning}"
    if ranges.crossed is not None:
        where = "lead through walls or out of everything that was hit"
        advised = any(special.no_return == "clear" for special in ranges.specials)
        keep = "" if advised else ": `no_return=ignore` is right"
        yield f"{ranges.crossed:.0%} of beams without return {where}{keep}"


def list_times(times: TimeFindings) -> Iterator[str]:
    """Say how the stamps run, beside the record times where the log has any of their own.

    CSV has none. Those of CARMEN count from the start of the recording, and stamps are dates.
    """
    if times.simulated:
        yield "simulated time"
    elif (times.offset_s or times.drift_s) and times.offset_s < report.DATES_S.start:
        apart = report.write_duration(abs(times.offset_s))
        side = "after" if times.offset_s > 0 else "before"
        yield f"{apart} {side} the record times, drift {times.drift_s:.2g} s"
    yield f"largest gap {report.write_duration(times.largest_gap_s)}"
    if times.time_increment_s:
        yield f"{1e3 * times.time_increment_s:.3g} ms between beams"
    if times.jumps_back:
        yield f"{count(times.jumps_back, 'jump')} back, up to {times.largest_jump_back_s:.3g} s"
    if times.duplicates:
        yield f"{count(times.duplicates, 'scan')} with the stamp of the one before"
    if times.all_equal:
        yield "all zero" if times.all_zero else "all equal"


def describe_poses(topic: ScanFindings) -> str:
    """Say how many scans have a pose, and where it comes from."""
    poses = topic.poses
    way = "stated beside the scans" if poses.stated else " > ".join(poses.chain)
    lost = report.write_counts(poses.dropped)
    share = f"{poses.posed:,} of {count(topic.kept, 'scan')}"
    given = f" with `sensor_pose=({poses.assumed})`" if poses.assumed else ""
    return f"{share}{given}" + (f", {way}" if way else "") + (f"; {lost}" if lost else "")


def describe_mount(mount: MountFindings, topic: ScanFindings) -> str:
    """Say how the sensor of a topic sits; z of the frame of a camera points where it looks."""
    tilt = math.degrees(mount.tilt)
    lean = f"tilted {tilt:.1f} deg" if tilt >= 0.05 else "level"
    parts = ["upside down", lean] if mount.upside_down else [lean]
    if topic.is_of_clouds and tilt > 45:
        parts = [f"its z axis points {90 - tilt:.1f} deg {'down' if mount.upside_down else 'up'}"]
    # Of clouds a note says how high they were above the ground, which may rise.
    parts.append(f"{'z' if topic.is_of_clouds else 'height'} {mount.height:.3g} m")
    if topic.poses.assumed:
        turn = "not known: measure it" if topic.poses.is_guess else "found from the scans"
        parts.append(f"turn {turn}")
    return ", ".join(parts)


def list_sources(sources: tuple[Coverage, ...]) -> Iterator[str]:
    """Say what the pose sources that move know, and how many others there are."""
    moving = [source for source in sources if source.moves]
    for it in moving:
        yield (
            f"{it.parent} > {it.child or 'a body'}{it.topic and f' on {it.topic}'}: "
            f"{count(it.samples, 'sample')}, "
            f"{it.start_ns / 1e9:.1f} to {it.end_ns / 1e9:.1f} s, largest gap "
            f"{it.largest_gap_s:.3g} s, largest step {it.largest_step_m:.3g} m, "
            f"{math.degrees(it.largest_step_rad):.3g} deg"
        )
    if fixed := len(sources) - len(moving):
        yield f"{count(fixed, 'transform')} that never {'changes' if fixed == 1 else 'change'}"


def describe_map(grid: MapFindings) -> str:
    """Say how large the map would be."""
    return (
        f"{grid.columns:,} x {grid.rows:,} cells of {grid.resolution:g} m, "
        f"{report.write_box(grid.extent)}; {write_bytes(grid.file_bytes)} as PGM, "
        f"{write_bytes(grid.memory_bytes)} of memory at most"
    )


def write_bytes(size: float) -> str:
    """Write a number of bytes with a unit."""
    for unit in ("B", "kB", "MB"):
        if size < 1000:
            return f"{size:.3g} {unit}"
        size /= 1000
    return f"{size:,.3g} GB"
