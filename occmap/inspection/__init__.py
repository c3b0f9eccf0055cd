"""Inspection: what is in logs and what will go wrong with them, before they are mapped.

It reads the poses once and the scans once, as a build does; only where the mount of the laser is
missing are the scans read twice, for the mount is then guessed from them.

`poses`, `survey` and `ranges` measure, `findings` holds what they find, `advice` judges it, and
`telling` puts it into words for a terminal and a page.
"""

from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from occmap.errors import LogError, OccmapError
from occmap.grid.lattice import Lattice
from occmap.inspection.advice import judge, list_concerns
from occmap.inspection.findings import Inspection, LogFindings, MountFindings, ScanFindings
from occmap.inspection.floor import list_floor_concerns, tell_slope
from occmap.inspection.poses import Posing, list_coverage, prepare, suggest_stamps, sum_up_poses
from occmap.inspection.ranges import measure_crossing
from occmap.inspection.survey import Extent, Survey, TopicSurvey
from occmap.options import BuildOptions
from occmap.posing.attach import Poser
from occmap.readers import Log, Role, Stream, open_log, read_recorded
from occmap.report.words import write_unused
from occmap.scans.logs import choose_topics, count_messages
from occmap.scans.mounts import estimate_agreement, find_better
from occmap.scans.tracing import find_ground
from occmap.sensor.models import Spreading
from occmap.sensor.no_return import RangeLimits

__all__ = ["Inspection", "inspect"]

MAX_LISTED_SHAPES = 5
"""How many shapes of a topic are told: the most frequent ones, and how many more there are"""


def inspect(paths: Sequence[Path], options: BuildOptions) -> Inspection:
    """Look into logs. What would make a build fail is among the findings, and is not raised.

    Parameters
    ----------
    paths
        Recordings of any installed format.
    options
        Those that the build is to have; resolution, posing, returns, topics and `max_cells` matter.
    """
    return judge([inspect_path(path, options) for path in paths], options)


def inspect_path(path: Path, options: BuildOptions) -> LogFindings:
    """Look into one log."""
    log = None
    try:
        log = open_log(path, options.reading)
        posing = prepare(log, choose_topics(log, options.selection.topics), options)
    except OccmapError as error:
        known = describe_log(log) if log else LogFindings(str(path))
        return replace(known, problem=str(error.placed(path)))
    return inspect_log(log, posing, options)


def inspect_log(log: Log, posing: Posing, options: BuildOptions) -> LogFindings:
    """Read the scans of an opened log, and sum up."""
    survey, problem = read_log(log, posing.poser, options)
    posing = replace(posing, poser=survey.poser)
    streams = {stream.topic: stream for stream in reversed(log.streams)}
    topics = choose_topics(log, options.selection.topics)
    seen = [survey.topics[topic] for topic in topics if topic in survey.topics]
    scans = tuple(
        sum_up(log, streams[topic.topic], topic, posing, options) for topic in seen if topic.shapes
    )
    spoilers = list(posing.poser.list_concerns(survey.first_ns, options.returns.max_range))
    if not scans and not problem:
        unused = sum((topic.left_out for topic in seen), Counter[str]())
        found = write_unused(unused.total(), unused) if unused else "holds no scan that can be read"
        problem = f"{log.path}: {found}"
    known, ground = describe_log(log), list[str]()
    if not problem and any(topic.is_of_clouds for topic in scans):
        below, posed = None, replace(options, posing=posing.poser.options)
        try:
            below, ground = find_ground([log], posed, None)
            ground += tell_slope(below)
        except OccmapError as error:
            problem = str(error.placed(log.path))
        against = list(list_floor_concerns(log, posing.poser, posed, below))
        problem = "; ".join([problem, *(each.text for _, each in against)]) if problem else ""
        spoilers += against
    notes = *ground, *posing.poser.notes, *survey.limits.list_notes(), *survey.list_notes()
    findings = replace(
        known,
        scans=() if problem else scans,  # a part that was read says nothing of a damaged log
        coverage=tuple(list_coverage(posing.poser.sources)),
        notes=known.notes + notes,
        box=survey.extent.box,
        longest=survey.extent.longest,
        problem=problem,
    )
    return replace(findings, concerns=tuple(list_concerns(findings, spoilers)))


def read_log(log: Log, poser: Poser, options: BuildOptions) -> tuple[Survey, str]:
    """Read the scans of a log, once more if the first ones hid what stands for "no return".

    Returns
    -------
    survey, problem
        With a poser of its own; and why the log cannot be read to its end, "" where it can.
    """
    topics = choose_topics(log, options.selection.topics)
    expected, limits, problem = count_messages(log, topics), RangeLimits(options.returns), ""
    model, lattice = options.model, Lattice(options.resolution)
    spreads = isinstance(model, Spreading) and model.spread > 0
    aside = options.hit_offset * options.resolution, options.resolution if spreads else 0.0
    for _ in range(2):
        survey = Survey(poser.start_over(), options, expected, limits, Extent(lattice, *aside))
        try:
            survey.read(read_recorded(log, topics))
        except LogError as error:
            problem = str(error.placed(log.path))
        if limits.settle():
            break
    return survey, problem


def describe_log(log: Log) -> LogFindings:
    """Describe a log by what its reader says of it."""
    return LogFindings(
        str(log.path),
        streams=tuple(log.streams),
        notes=tuple(log.notes),
    )


def sum_up(
    log: Log, stream: Stream, topic: TopicSurvey, posing: Posing, options: BuildOptions
) -> ScanFindings:
    """Sum up all about one topic of scans, as its reader and the survey have it."""
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
        type=stream.type,
        frames=tuple(topic.frames),
        is_of_clouds=stream.role is Role.CLOUD,
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
