"""Inspection: what is in logs and what will go wrong with them, before they are mapped.

It reads the poses once and the scans once, as a build does; only where the mount of the laser is
missing are the scans read twice, for the mount is then guessed from them.
"""

from collections import Counter, defaultdict
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from occmap.command import format_mount, spell_flag
from occmap.errors import LogError, OccmapError
from occmap.grid.lattice import MOST_CELLS_OF_BEAM
from occmap.inspection.advice import compose_command, list_apart, list_concerns
from occmap.inspection.findings import (
    Inspection,
    LogFindings,
    MapFindings,
    MountFindings,
    PoseFindings,
    ScanFindings,
)
from occmap.inspection.poses import (
    Posing,
    list_coverage,
    prepare,
    suggest_stamps,
)
from occmap.inspection.ranges import measure_crossing
from occmap.inspection.survey import Extent, Survey, TopicSurvey
from occmap.mounts import find_better
from occmap.opening import choose_topics, count_messages
from occmap.options import BuildOptions
from occmap.posing.course import Course
from occmap.posing.options import DropReason, Stamps
from occmap.readers import Log, open_log, read_scans
from occmap.sampling import estimate_agreement
from occmap.sensor.models import Spreading
from occmap.sensor.no_return import RangeLimits
from occmap.wording import write_unused

__all__ = ["Inspection", "inspect"]

MAX_LISTED_SHAPES = 5


def inspect(paths: Sequence[Path], options: BuildOptions) -> Inspection:
    """Look into logs. What would make a build fail is among the findings, and is not raised.

    Parameters
    ----------
    paths
        Recordings of any installed format.
    options
        Those that the build is to have; resolution, posing, returns, topics and `max_cells` matter.
    """
    extent, stamps = Extent(), options.posing.stamps
    logs = [inspect_path(path, options, extent) for path in paths]
    grid = extent.sum_up(options.resolution)
    problems = [log.problem for log in logs if log.problem]
    too_large = find_size_problem(grid, extent, options)
    is_unseen = grid is None and any(topic.poses.posed for log in logs for topic in log.scans)
    unseen = "no beam of any scan observes a cell: see the ranges" if is_unseen else ""
    others = [text for text in (too_large, unseen) if text][:1]
    problems += list_pose_problems(logs, stamps) or others
    mapped = [  # scans that have no poses may have some by the other of their two times
        log
        for log in logs
        if any(it.poses.posed or it.times.suggested_stamps != stamps for it in log.scans)
    ]
    apart = () if too_large else tuple(list_apart(mapped, options))
    command = compose_command(mapped, options) if mapped and not too_large and not apart else ()
    left = [log.path for log in logs if log not in mapped]
    if left and (command or apart):
        apart += (f"the line leaves out what cannot be mapped: {', '.join(left)}",)
    if unseen and spell_flag("no_return") not in command:
        command = ()  # nothing that is known makes anything of these logs
    damage = (f"{log.path}: {text}" for log in logs for text in log.damage)
    concerns = (concern.text for log in logs for concern in log.concerns)
    return Inspection(
        logs=tuple(logs),
        map=grid,
        problems=tuple(problems),
        warnings=(*damage, *concerns, *apart),
        command=command,
        buildable=not problems,
    )


def inspect_path(path: Path, options: BuildOptions, extent: Extent) -> LogFindings:
    """Look into one log; `extent` grows by what its map would cover."""
    log = None
    try:
        log = open_log(path, options.reading)
        posing = prepare(log, choose_topics(log, options.selection.topics), options)
    except OccmapError as error:
        known = describe_log(log) if log else LogFindings(str(path))
        return replace(known, problem=str(error.placed(path)))
    return inspect_log(log, posing, options, extent)


def inspect_log(log: Log, posing: Posing, options: BuildOptions, extent: Extent) -> LogFindings:
    """Read the scans of an opened log once, and sum up."""
    topics = choose_topics(log, options.selection.topics)
    expected = count_messages(log, topics)
    limits = RangeLimits(options.returns)
    model, problem = options.model, ""
    around = options.resolution if isinstance(model, Spreading) and model.spread > 0 else 0.0
    for _ in range(2):  # again where the first scans did not show what stands for "no return"
        unseen = replace(posing.poser, courses=defaultdict(Course))
        posing = replace(posing, poser=unseen)  # as it was before it saw a scan
        reach = Extent(options.hit_offset * options.resolution, around)
        survey = Survey(posing.poser, options, expected, limits, reach)
        try:
            survey.read(read_scans(log, topics))
        except LogError as error:
            problem = str(error.placed(log.path))
        if limits.settle():
            break
    extent.join(reach)
    seen = [survey.topics[topic] for topic in topics if topic in survey.topics]
    types = {stream.topic: stream.type for stream in reversed(log.streams)}
    scans = tuple(
        sum_up(log, types[topic.topic], topic, posing, options) for topic in seen if topic.shapes
    )
    spoilers = list(posing.poser.list_concerns(survey.first_ns, options.returns.max_range))
    if not scans and not problem:
        unused = sum((topic.left_out for topic in seen), Counter[str]())
        found = write_unused(unused.total(), unused) if unused else "holds no scan that can be read"
        problem = f"{log.path}: {found}"
    known = describe_log(log)
    findings = replace(
        known,
        scans=() if problem else scans,  # a part that was read says nothing of a damaged log
        coverage=tuple(list_coverage(posing.poser.sources)),
        notes=(*known.notes, *posing.poser.notes, *limits.list_notes(), *survey.list_notes()),
        problem=problem,
    )
    return replace(findings, concerns=tuple(list_concerns(findings, spoilers)))


def describe_log(log: Log) -> LogFindings:
    """Describe a log by what its reader says of it."""
    return LogFindings(
        str(log.path),
        streams=tuple(log.streams),
        notes=tuple(note.text for note in log.notes),
        damage=tuple(note.text for note in log.notes if note.damage),
    )


def sum_up(
    log: Log, kind: str, topic: TopicSurvey, posing: Posing, options: BuildOptions
) -> ScanFindings:
    """Sum up all about one topic of scans, whose messages are of some kind."""
    ranked = topic.shapes.most_common()
    crossed = measure_crossing(topic.sample.parts, options.returns)
    tracks = [edge.track for edge in posing.poser.sources.tree.edges if edge.track.moves]
    moving_ns = max((int(track.stamp_ns[-1]) for track in tracks), default=None)
    mount, stance = None, posing.poser.courses[topic.topic].stance
    if stance is not None:  # of no scan where none has a pose
        better = find_better(posing.poser, topic.sample.parts, options.returns)
        mount = MountFindings(stance.upside_down, stance.tilt, stance.height, better)
    return ScanFindings(
        topic=topic.topic,
        type=kind,
        frames=tuple(topic.frames),
        scans=topic.read,
        left_out=dict(topic.left_out),
        shapes=tuple(replace(shape, scans=n) for shape, n in ranked[:MAX_LISTED_SHAPES]),
        shape_count=len(ranked),
        ranges=topic.census.sum_up(crossed),
        times=topic.stamps.sum_up(suggest_stamps(log, posing, topic), moving_ns),
        poses=sum_up_poses(topic, posing),
        mount=mount,
        agreement=estimate_agreement(topic.sample.parts, options),
    )


def sum_up_poses(topic: TopicSurvey, posing: Posing) -> PoseFindings:
    """Sum up how the scans of a topic get their poses."""
    stated = topic.stated and posing.poser.sources.trajectory is None
    chain = None if stated else posing.poser.chains.get(next(iter(topic.frames)))
    faults = [posing.faults[frame] for frame in topic.frames if frame in posing.faults]
    return PoseFindings(
        stated=stated,
        chain=chain.frames if chain else (),
        posed=topic.posed,
        dropped=dict(topic.dropped),
        problem="; ".join(map(str, faults)),
        assumed=format_mount(posing.assumed) if posing.assumed and faults else "",
        is_guess=posing.is_guess and bool(faults),
    )


def list_pose_problems(logs: Sequence[LogFindings], stamps: Stamps) -> list[str]:
    """Say why no scan has a pose, of each log or of all: a build needs at least one."""
    found = []
    for log in logs:
        faults = dict.fromkeys(topic.poses.problem for topic in log.scans)
        if "" not in faults:  # else some topic of the log has poses
            found += [f"{log.path}: {fault}" for fault in faults]
    topics = [(log, topic) for log in logs for topic in log.scans]
    if topics and not found and not any(topic.poses.posed for _, topic in topics):
        for log, topic in topics:
            unused = write_unused(topic.scans, {**topic.left_out, **topic.poses.dropped})
            found.append(f"{topic.topic}: {unused}{bridge_clocks(log, topic, stamps)}")
    return found


def bridge_clocks(log: LogFindings, topic: ScanFindings, stamps: Stamps) -> str:
    """Suggest an option for scans and poses whose times do not overlap."""
    if topic.poses.dropped.keys().isdisjoint({DropReason.BEFORE, DropReason.AFTER}):
        return ""
    times = topic.times
    if times.suggested_stamps is not stamps:
        return f"; try `stamps={times.suggested_stamps.value}`"
    for source in log.coverage if stamps is Stamps.HEADER else ():
        apart = source.end_ns < times.start_ns or times.end_ns < source.start_ns
        if source.moves and apart:
            offset_ms = -((times.start_ns - source.start_ns) // 10**6)  # up: not before the pose
            option = f"`time_offset_s={offset_ms / 1e3:.12g}`"
            return f"; {option} would put the first scan at the first pose"
    return "; compare stamps and sources: `time_offset_s=S` or `stamps=record`"


def find_size_problem(grid: MapFindings | None, extent: Extent, options: BuildOptions) -> str:
    """Say why no map can be made for its size; "" where it can."""
    if grid is not None and grid.columns * grid.rows > options.max_cells:
        x, y, x_end, y_end = grid.extent
        return (
            f"the map would have {grid.columns} x {grid.rows} cells, more than "
            f"`max_cells={options.max_cells}`: x from {x:g} to {x_end:g} m, y from "
            f"{y:g} to {y_end:g} m; try a coarser `resolution` or a `max_range`"
        )
    if extent.longest / options.resolution > MOST_CELLS_OF_BEAM:
        return (
            f"a beam of {extent.longest:.6g} m is too long for cells of {options.resolution} m; "
            "limit ranges with `max_range`, or use a coarser `resolution`"
        )
    return ""
