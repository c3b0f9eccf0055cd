"""Inspection: what is in logs and what will go wrong with them, before they are mapped.

It reads the poses once and the scans once, as a build does; only where the mount of the laser is
missing are the scans read twice, for the mount is then guessed from them.
"""

from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from occmap.command import format_mount, spell_flag
from occmap.errors import LogError, OccmapError
from occmap.grid.lattice import MOST_CELLS_OF_BEAM
from occmap.inspection.advice import compose_command, list_apart, list_concerns
from occmap.inspection.extent import Extent
from occmap.inspection.findings import (
    Inspection,
    LogFindings,
    MapFindings,
    MountFindings,
    PoseFindings,
    ScanFindings,
)
from occmap.inspection.poses import Posing, find_moving_stamp, prepare, suggest_stamps
from occmap.inspection.sample import measure_crossing
from occmap.inspection.survey import Survey, TopicSurvey
from occmap.mounts import find_better
from occmap.opening import choose_topics, count_messages
from occmap.options import BuildOptions
from occmap.posing.attach import Poser
from occmap.posing.concerns import Concern
from occmap.posing.coverage import list_coverage
from occmap.posing.options import DropReason, Stamps
from occmap.readers import Log, open_log, read_scans
from occmap.sampling import estimate_agreement
from occmap.sensor.bounds import Spreading
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
    extent = Extent()
    looks = [inspect_path(path, options, extent) for path in paths]
    logs = [log for log, _ in looks]
    concerns = [concern for _, found in looks for concern in found]
    grid = extent.sum_up(options.resolution)
    problems = [log.problem for log in logs if log.problem]
    too_large = _list_size_problems(grid, options) or _list_beam_problems(extent, options)
    unseen = _list_unseen(logs, grid)
    problems += _list_pose_problems(logs, options.posing.stamps) or too_large or unseen
    mapped = [look for look in looks if any(_is_usable(topic, options) for topic in look[0].scans)]
    apart = () if too_large else tuple(list_apart(mapped, options))
    usable = mapped and not too_large and not apart
    command = compose_command([log for log, _ in mapped], options, concerns) if usable else ()
    left = [log.path for log in logs if all(log is not each for each, _ in mapped)]
    if left and (command or apart):
        apart += (f"the line leaves out what cannot be mapped: {', '.join(left)}",)
    if unseen and spell_flag("no_return") not in command:
        command = ()  # nothing that is known makes anything of these logs
    damage = (f"{log.path}: {text}" for log in logs for text in log.damage)
    return Inspection(
        logs=tuple(logs),
        map=grid,
        problems=tuple(problems),
        warnings=(*damage, *(concern.text for concern in concerns), *apart),
        command=command,
    )


Look = tuple[LogFindings, list[Concern]]
"""What is in a log, and what of it will spoil a map, or surprise its maker"""


def inspect_path(path: Path, options: BuildOptions, extent: Extent) -> Look:
    """Look into one log; `extent` grows by what its map would cover."""
    try:
        log = open_log(path, options.reading)
    except OccmapError as error:
        return LogFindings(str(path), problem=_place(error, path)), []
    try:
        topics = choose_topics(log, options.selection.topics)
        posing = prepare(log, topics, options)
    except OccmapError as error:
        return replace(_describe(log), problem=_place(error, path)), []
    return inspect_log(log, posing, options, extent)


def inspect_log(log: Log, posing: Posing, options: BuildOptions, extent: Extent) -> Look:
    """Read the scans of an opened log once, and sum up."""
    topics = choose_topics(log, options.selection.topics)
    expected = count_messages(log, topics)
    limits = RangeLimits(options.returns)
    model, problem = options.model, ""
    around = options.resolution if isinstance(model, Spreading) and model.spread > 0 else 0.0
    for _ in range(2):  # again where the first scans did not show what stands for "no return"
        posing = replace(posing, poser=replace(posing.poser))  # as it was before it saw a scan
        reach = Extent(options.hit_offset * options.resolution, around)
        survey = Survey(posing.poser, options.returns, options.selection, expected, limits, reach)
        try:
            survey.read(read_scans(log, topics))
        except LogError as error:
            problem = _place(error, log.path)
        if limits.settle():
            break
    extent.join(reach)
    seen = [survey.topics[topic] for topic in topics if topic in survey.topics]
    types = {stream.topic: stream.type for stream in reversed(log.streams)}
    scans = tuple(
        _sum_up(log, types[topic.topic], topic, posing, options) for topic in seen if topic.shapes
    )
    spoilers = list(posing.poser.list_concerns(survey.first_ns, options.returns.max_range))
    known = _describe(log)
    findings = replace(
        known,
        scans=scans,
        coverage=tuple(list_coverage(posing.poser.sources)),
        notes=(*known.notes, *posing.poser.notes, *limits.list_notes(), *survey.list_notes()),
        problem=problem or ("" if scans else f"{log.path}: {_explain_nothing(seen)}"),
    )
    if problem:  # what was read before it says nothing of a log of which no map is made
        return replace(findings, scans=()), []
    return findings, list_concerns(findings, spoilers)


def _explain_nothing(topics: Sequence[TopicSurvey]) -> str:
    """Say why no scan of a log is left."""
    reasons: Counter[str] = Counter()
    for topic in topics:
        reasons.update({reason.value: count for reason, count in topic.left_out.items()})
    if not reasons:
        return "holds no scan that can be read"
    return write_unused(reasons.total(), reasons)


def _describe(log: Log) -> LogFindings:
    """Describe a log by what its reader says of it."""
    return LogFindings(
        str(log.path),
        streams=tuple(log.streams),
        notes=tuple(note.text for note in log.notes),
        damage=tuple(note.text for note in log.notes if note.damage),
    )


def _place(error: OccmapError, path: Path) -> str:
    """Write an error with its place; that is the log where the error names none."""
    return str(error.placed(path))


def _sum_up(
    log: Log, kind: str, topic: TopicSurvey, posing: Posing, options: BuildOptions
) -> ScanFindings:
    ranked = topic.shapes.most_common()
    crossed = measure_crossing(topic.sample.parts, options.returns)
    return ScanFindings(
        topic=topic.topic,
        type=kind,
        frames=tuple(topic.frames),
        scans=topic.read,
        left_out={reason.value: count for reason, count in topic.left_out.items()},
        shapes=tuple(replace(shape, scans=n) for shape, n in ranked[:MAX_LISTED_SHAPES]),
        shape_count=len(ranked),
        ranges=topic.census.sum_up(crossed),
        times=topic.stamps.sum_up(
            suggest_stamps(log, posing, topic), find_moving_stamp(posing.poser)
        ),
        poses=_sum_up_poses(topic, posing),
        mount=_describe_mount(topic, posing.poser, options),
        agreement=estimate_agreement(topic.sample.parts, options),
    )


def _describe_mount(
    topic: TopicSurvey, poser: Poser, options: BuildOptions
) -> MountFindings | None:
    """Say how a sensor sits; None where no scan has a pose."""
    stance = poser.courses[topic.topic].stance
    if stance is None:
        return None
    better = find_better(poser, topic.sample.parts, options.returns)
    return MountFindings(stance.upside_down, stance.tilt, stance.height, better)


def _sum_up_poses(topic: TopicSurvey, posing: Posing) -> PoseFindings:
    frames = tuple(topic.frames)
    stated = topic.stated and posing.poser.sources.trajectory is None
    chain = None if stated else posing.poser.chains.get(frames[0])
    faults = [posing.faults[frame] for frame in frames if frame in posing.faults]
    return PoseFindings(
        stated=stated,
        chain=chain.frames if chain else (),
        posed=topic.posed,
        dropped=dict(topic.dropped),
        problem="; ".join(map(str, faults)),
        assumed=format_mount(posing.assumed) if posing.assumed and faults else "",
        is_guess=posing.is_guess and bool(faults),
    )


def _list_pose_problems(logs: Sequence[LogFindings], stamps: Stamps) -> list[str]:
    """Say why no scan has a pose, of each log or of all: a build needs at least one."""
    found = []
    for log in logs:
        faults = dict.fromkeys(topic.poses.problem for topic in log.scans if topic.poses.problem)
        unfaulted = any(not topic.poses.problem for topic in log.scans)
        if faults and not unfaulted:
            found += [f"{log.path}: {fault}" for fault in faults]
    topics = [(log, topic) for log in logs for topic in log.scans]
    if topics and not found and not any(topic.poses.posed for _, topic in topics):
        found += [f"{topic.topic}: {_explain(log, topic, stamps)}" for log, topic in topics]
    return found


def _is_usable(topic: ScanFindings, options: BuildOptions) -> bool:
    """Whether scans have poses, or would with the other of their two times."""
    return topic.poses.posed > 0 or topic.times.suggested_stamps != options.posing.stamps


def _explain(log: LogFindings, topic: ScanFindings, stamps: Stamps) -> str:
    reasons = {**topic.left_out, **topic.poses.dropped}
    return write_unused(topic.scans, reasons) + _bridge_clocks(log, topic, stamps)


def _bridge_clocks(log: LogFindings, topic: ScanFindings, stamps: Stamps) -> str:
    """Suggest an option for scans and poses whose times do not overlap."""
    if not topic.poses.dropped.keys() & {DropReason.BEFORE.value, DropReason.AFTER.value}:
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


def _list_unseen(logs: Sequence[LogFindings], grid: MapFindings | None) -> list[str]:
    """Say where scans have poses, and yet observe no cell."""
    if grid is not None or not any(topic.poses.posed for log in logs for topic in log.scans):
        return []
    return ["no beam of any scan observes a cell: see the ranges"]


def _list_beam_problems(extent: Extent, options: BuildOptions) -> list[str]:
    if extent.longest / options.resolution <= MOST_CELLS_OF_BEAM:
        return []
    return [
        f"a beam of {extent.longest:.6g} m is too long for cells of {options.resolution} m; limit "
        "ranges with `max_range`, or use a coarser `resolution`"
    ]


def _list_size_problems(grid: MapFindings | None, options: BuildOptions) -> list[str]:
    if grid is None or grid.columns * grid.rows <= options.max_cells:
        return []
    x, y, x_end, y_end = grid.extent
    return [
        f"the map would have {grid.columns} x {grid.rows} cells, more than "
        f"`max_cells={options.max_cells}`: x from {x:g} to {x_end:g} m, y from "
        f"{y:g} to {y_end:g} m; try a coarser `resolution` or a `max_range`"
    ]
