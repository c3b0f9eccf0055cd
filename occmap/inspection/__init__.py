"""Inspection: what is in logs and what will go wrong with them, before they are mapped.

It reads the poses once and the scans once, as a build does. They are read again where the mount of
the laser is missing, to guess it from the scans, and where the other of their two times may be
right. Other options are tried on a sample of the scans.

`poses` and `survey` measure, and `findings` holds what they find and puts it into words. Here it
is judged: problems, warnings, and the command that makes the best of the logs.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import reduce
from operator import itemgetter
from pathlib import Path

from occmap.cells import CellBox
from occmap.choices import mark_options
from occmap.errors import OccmapError
from occmap.grid import Lattice, refuse_long
from occmap.grid.tiles import refuse_large
from occmap.inspection import findings, poses
from occmap.inspection.findings import Inspection, LogFindings, ScanFindings
from occmap.inspection.survey import BEYOND, MOSTLY_OPEN, Survey, TopicSurvey
from occmap.options import FLAGS, BuildOptions, compose_build, find_child
from occmap.posing import Concern, Doubt, DropReason
from occmap.readers import Role, open_log
from occmap.report import count, is_damage, write_counts, write_unused
from occmap.report.results import LEAST_AGREEMENT, doubt_agreement, doubt_frames, hint_at_tune
from occmap.scans import estimate_agreement
from occmap.scans.logs import look_ahead, suit_kinds
from occmap.scans.mounts import PosePlan, find_better_mount, prepare
from occmap.scans.stream import Drive
from occmap.scans.tally import MEND_CLOUDS, UNSEEN_CLOUDS
from occmap.sensor.bands import BAND
from occmap.types import Paths, PosedScans
from occmap.values import DEGREES

SHARE_OF_NOTE = 0.05
"""More scans of a topic without a pose than this share are worth a warning."""
BYTES_PER_CELL = 4 + 1 + 8
"""In memory: log-odds, observed, and two counts of four bytes as evidence."""
WRONG_TO_CLEAR = "beams without return lead through walls: `no_return=clear` is wrong here"


def inspect(paths: Paths, options: BuildOptions, notes: Sequence[str] = ()) -> Inspection:
    """Look into logs, and judge them by what is in them, and by how large their map would be.

    What would make a build fail is among the findings, and is not raised.

    Parameters
    ----------
    paths
        Recordings of any installed format.
    options
        Those that the build is to have; resolution, posing, returns, topics and `max_cells` matter.
    notes
        Of `find_inputs`; those of damage become warnings.
    """
    logs = [inspect_path(path, options) for path in paths]
    lattice, boxes = Lattice(options.resolution), [log.box for log in logs if log.box]
    box = reduce(CellBox.join, boxes) if boxes else None
    found, unseen = None, ""
    if box is not None:
        size = box.cols, box.rows, box.cells, box.cells * BYTES_PER_CELL
        found = findings.MapFindings(lattice.resolution, lattice.measure(box), *size)
    elif posed := [topic for log in logs for topic in log.scans if topic.poses.posed]:
        of_clouds = any(topic.is_of_clouds for topic in posed)
        unseen = "no beam of any scan observes a cell: see the ranges"
        unseen = f"{UNSEEN_CLOUDS}: {MEND_CLOUDS}" if of_clouds else unseen
    refusal = find_refusal(logs, box, options)
    # That no scan has a pose is why nothing is seen.
    faults = list_pose_problems(logs) or [refusal or unseen]
    problems = tuple(filter(None, [*(log.problem for log in logs), *faults]))

    command, differing = ((), ()) if refusal else recommend(logs, options)
    if unseen and FLAGS["no_return"] not in command:
        command = ()  # no known option makes a map of these logs
    of_logs = (f"{log.path}: {text}" for log in logs for text in log.damage)
    damage = (*of_logs, *filter(is_damage, notes))
    concerns = (concern.text for log in logs for concern in log.concerns)
    frames = {log.path: it.poses.chain[0] for log in logs for it in log.scans if it.poses.chain}
    warnings = *damage, *concerns, *doubt_frames(frames), *differing
    told = tuple(notes), damage
    return Inspection(tuple(logs), found, problems, warnings, command, not problems, *told)


def find_refusal(logs: Sequence[LogFindings], box: CellBox | None, options: BuildOptions) -> str:
    """Say why no build takes the logs: some hold scans, others clouds, or the map is too large."""
    kinds = {
        Role.CLOUD if topic.is_of_clouds else Role.SCAN: f"{topic.topic} of {log.path}"
        for log in logs
        for topic in log.scans
    }
    try:
        suit_kinds(kinds, options)
        if box is not None:
            refuse_large(box, Lattice(options.resolution), options.max_cells)
            refuse_long(max(log.longest for log in logs), options.resolution)
    except OccmapError as error:
        return str(error)
    return ""


def list_pose_problems(logs: Sequence[LogFindings]) -> list[str]:
    """Say why no scan has a pose, of each log or of all: a build needs at least one."""
    found = []
    for log in logs:
        faults = dict.fromkeys(topic.poses.problem for topic in log.scans)
        if "" not in faults:  # else some topic of the log has poses
            found += [f"{log.path}: {fault}" for fault in faults]
    topics = [topic for log in logs for topic in log.scans]
    if found or any(topic.poses.posed for topic in topics):
        return found
    return [
        f"{topic.topic}: {write_unused(topic.scans, {**topic.left_out, **topic.poses.dropped})}"
        f"{bridge_clocks(topic)}"
        for topic in topics
    ]


def bridge_clocks(topic: ScanFindings) -> str:
    """Suggest an option for scans that have no pose at their times."""
    if topic.better:
        return f"; try {mark_options(topic.better.remedy)}"
    if topic.poses.dropped.keys().isdisjoint({DropReason.BEFORE, DropReason.AFTER}):
        return ""
    return "; compare stamps and sources, and try `time_offset_s=S`"


def recommend(
    logs: Sequence[LogFindings], options: BuildOptions
) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Recommend a command line for the logs that can be mapped: the options given, then the advice.

    Returns
    -------
    command, remarks
        The words of the line, none where nothing helps or the logs need several; and what there is
        to say of it.
    """
    # Those with poses, or with an option that gives some.
    mapped = [log for log in logs if any(it.poses.posed or it.better for it in log.scans)]
    advice = [advise(log) for log in mapped]
    if any(each != advice[0] for each in advice):
        return (), ("the logs need different options: check them one by one",)
    if not advice or advice[0] is None:
        return (), ()
    name, advised = advice[0]
    if all(map(is_open, mapped)):  # else a map is as right without it
        advised["no_return", ""] = "clear"
    changes = ((option, value) for (option, _), value in advised.items())
    command = compose_build([log.path for log in mapped], options, changes)
    if name == "tune":
        command = ("occmap", name, *command[2:-2])
    left = ", ".join(log.path for log in logs if log not in mapped)
    return command, (f"the line leaves out what cannot be mapped: {left}",) if left else ()


def advise(log: LogFindings) -> tuple[str, dict[tuple[str, str], str]] | None:
    """Name the command that makes the best of a log, and the options that it needs.

    Of transforms there may be one to each frame. Where the poses do not fit the scans, it is
    `occmap tune`, which looks for the reason. None: nothing helps, or the findings ask for two
    values of an option.
    """
    found = set(list_advised(log))
    advised = {(name, find_child(name, value)): value for name, value in list_advised(log)}
    commands = {concern.command for concern in log.concerns}
    is_lost = "" in commands or any(DEGREES in note for note in log.notes)
    if is_lost or len(advised) < len(found):
        return None
    return ("tune" if "tune" in commands else "build"), advised


def list_advised(log: LogFindings) -> Iterator[tuple[str, str]]:
    """List the options that the findings about a log suggest, with their values."""
    yield from (("sensor_pose", it.poses.assumed) for it in log.scans if it.poses.assumed)
    betters = [it.better for it in log.scans if it.better]
    for concern in (*betters[:1], *log.concerns):  # each of the first was tried alone
        yield from concern.remedy.items()


def is_open(log: LogFindings) -> bool:
    """Whether space is open wherever a beam of a log does not come back."""
    specials = (special for topic in log.scans for special in topic.ranges.specials)
    return {special.no_return for special in specials} - {""} == {"clear"}


def list_concerns(
    log: LogFindings, doubts: Sequence[Doubt], parts: Sequence[PosedScans], options: BuildOptions
) -> list[Concern]:
    """List what will spoil a map, or surprise its maker.

    Parameters
    ----------
    doubts
        What poses, floor, angles and ranges show.
    parts
        A sample of the scans of all topics.
    """
    has_poses = any(topic.poses.posed for topic in log.scans)  # that none has, is a problem
    found = []
    for topic in log.scans:
        others = [other for other in log.scans if other is not topic]
        mine = [concern for name, concern in doubts if name == topic.topic]
        mine += list_oddities(topic, has_poses)
        if options.returns.no_return == "clear" and (topic.ranges.crossed or 0) >= MOSTLY_OPEN:
            mine.append(Concern(WRONG_TO_CLEAR, {"no_return": ""}))
        if topic.better and topic.poses.posed:
            mine.append(Concern(topic.better.text))
        elif not any(it.remedy or it.command != "build" for it in mine):  # else the reason is known
            mine += doubt_poses(topic, others)
        found += [it._replace(text=f"{topic.topic}: {it.text}") for it in mine]
    if not any(topic.better for topic in log.scans) and not any(each.remedy for each in found):
        found += list_apart(log.scans, parts, options)
    return [it._replace(text=f"{log.path}: {it.text}") for it in found]


def doubt_poses(topic: ScanFindings, others: Sequence[ScanFindings]) -> Iterator[Concern]:
    """Say if hardly any hits of a topic agree; tune mends one topic at a time."""
    if not (doubt := doubt_agreement(topic.agreement, "the hits of a sample of scans")):
        return
    found = f"{doubt}: the poses do not fit the scans"
    if topic.poses.stated:  # at their own times
        yield Concern(f"{found}; try another trajectory by `poses=FILE`", command="")
        return
    fit = others and all((other.agreement or 0.0) >= LEAST_AGREEMENT for other in others)
    remedy = {"topics": topic.topic} if fit else {}
    yield Concern(f"{found}; try `occmap tune`, or another trajectory", remedy, "tune")


def list_apart(
    topics: Sequence[ScanFindings], parts: Sequence[PosedScans], options: BuildOptions
) -> Iterator[Concern]:
    """Say if the scans of several topics contradict each other, and whose mount may be why."""
    if len(topics) < 2:
        return
    together = estimate_agreement(parts, options)
    alone = {topic.topic: topic.agreement or 0.0 for topic in topics}
    by_part = [(alone[part.batch.topic], part.batch.ranges.size) for part in parts]
    expected = sum(share * size for share, size in by_part) / max(sum(it[1] for it in by_part), 1)
    if together is None or together >= expected - poses.BETTER:
        return
    (worst, share), (_, least), *_ = sorted(alone.items(), key=itemgetter(1))
    found = f"{together:.0%} of the hits of a sample of all topics lie in occupied cells"
    if share < least - poses.BETTER:
        found += f", {share:.0%} of those of {worst}, and {least:.0%} or more of each other topic"
        mend = f"are its mount and its clock right? try `occmap tune` with `topics={worst}`"
        yield Concern(f"{found}: {mend}", {"topics": worst}, "tune")
        return
    found += f", and {share:.0%} or more of those of each alone: do their frames fit each other?"
    mend = "build each alone by `topics`, and `occmap merge` with `fit` finds how they lie"
    yield Concern(f"{found} {mend}; lasers at different heights contradict each other, too")


def list_oddities(topic: ScanFindings, has_poses: bool) -> Iterator[Concern]:
    """Say what is strange about the poses of a topic, its stamps and ranges."""
    lost = topic.poses.dropped
    if has_poses and sum(lost.values()) > SHARE_OF_NOTE * topic.kept:
        yield Concern(f"scans without a pose: {write_counts(lost)}")
    if not topic.poses.stated:  # else the stamps do not matter
        yield from list_clock_faults(topic)
    if not topic.is_of_clouds:
        yield from list_odd_ranges(topic.ranges)


def list_clock_faults(topic: ScanFindings) -> Iterator[Concern]:
    """Say what is wrong with the stamps of a topic."""
    times = topic.times
    if times.all_equal:
        yield Concern("all stamps are equal")
        return
    if times.jumps_back:
        yield Concern(f"stamps jump back {count(times.jumps_back, 'time')}")
    if abs(times.drift_s) > poses.DRIFT_S:
        yield Concern(f"stamps drift by {times.drift_s:.3g} s against the record times")


def list_odd_ranges(ranges: findings.RangeFindings) -> Iterator[Concern]:
    """Say which ranges may not be measurements, or which of the robot itself."""
    for item in ranges.repeated:
        if not item.is_no_return:
            found = f"{item.value:g} m is {item.share:.0%} of the ranges and may mean no return"
            is_last = item.value > (1 - BAND) * ranges.largest
            yield Concern(found + f", as `range_max={item.value:.9g}` takes it" * is_last)
    if ranges.body is not None:
        yield poses.warn_of_body(ranges.body)
    if ranges.measured:
        return
    if any(special.name == BEYOND for special in ranges.specials):
        found = "all ranges lie beyond the limit that the scans state: is one of the two in mm?"
        yield Concern(found, command="")
    else:
        yield Concern("no range value is a measurement")


__all__ = ["Inspection", "inspect"]

MAX_LISTED_SHAPES = 5
"""How many shapes of a topic are told: the most frequent ones, and how many more there are"""


def inspect_path(path: Path, options: BuildOptions) -> LogFindings:
    """Look into one log."""
    known, log = LogFindings(str(path)), None
    try:
        log = open_log(path, options.reading)
        known = replace(known, streams=tuple(log.streams))
        plan = prepare(log, look_ahead(log, options), options)
        drive = Drive(log, plan.poser, options)
        for _ in drive.rounds():  # once more if the first ones hid "no return", or some leap away
            survey = Survey(drive)
            survey.survey()
    except OccmapError as error:  # a part that was read says nothing of the log
        notes = tuple(log.notes) if log else ()
        return replace(known, notes=notes, problem=str(error.placed(path)))
    return sum_up_log(known, survey, plan)


def sum_up_log(known: LogFindings, survey: Survey, plan: PosePlan) -> LogFindings:
    """Add to what is known of a log what its scans showed."""
    drive, poser, seen = survey.drive, plan.poser, list(survey.topics.values())
    log, options = drive.log, drive.options
    scans = tuple(describe_topic(drive, each, plan) for each in seen if each.frames)
    doubts = list(poser.list_concerns(survey.first_ns or 0, options.returns.max_range))
    doubts += ((it.topic, it.misfit) for it in scans if it.misfit)
    if any(it.better and poses.OTHER_POSES & it.better.remedy.keys() for it in scans):
        # What would mend the poses given does not go with others.
        doubts = [(topic, Concern(concern.text)) for topic, concern in doubts]
    doubts += drive.list_doubts()
    box, ground, problem = survey.box, list[str](), ""
    if any(topic.is_of_clouds and topic.poses.posed for topic in scans):
        box, ground, against, problem = inspect_ground(survey)
        doubts += against
    elif not scans:
        unused, lack = survey.left_out, "holds no scan that can be read"
        lack = write_unused(unused.total(), unused) if unused else lack
        problem = f"{log.path}: {lack}"
    fixes = list(poses.tell_fixes(drive))  # the log and the poser take notes meanwhile
    found = replace(
        known,
        scans=() if problem else scans,
        coverage=tuple(poses.list_coverage(poser.sources)),
        notes=(*log.notes, *ground, *drive.list_remarks(), *fixes),
        box=box,
        longest=survey.longest,
        problem=problem,
    )
    parts = [part for topic in seen for part in topic.sample.parts]
    return replace(found, concerns=tuple(list_concerns(found, doubts, parts, options)))


def inspect_ground(survey: Survey) -> tuple[CellBox | None, list[str], list[Doubt], str]:
    """Find the ground below the clouds of a log.

    Returns
    -------
    box, notes, concerns, problem
        What the clouds observe over the ground; notes on it; what it says against mounts and poses,
        with their topics; and why there is none, "" where there is.
    """
    from occmap.scans.levelling import find_ground  # noqa: PLC0415  late: it brings numba

    ground, notes, problem = None, list[str](), ""
    log, poser = survey.drive.log, survey.drive.poser
    options = replace(survey.drive.options, posing=poser.options)
    try:
        ground, notes, options = find_ground([survey.drive], options, None)
    except OccmapError as error:
        problem = str(error.placed(log.path))
    # By the options of the ground; it has seen no cloud, but knows the chains and what leaps away.
    drive = Drive(log, replace(poser, options=options.posing, courses={}), options)
    again = {topic: poses.pose_again(each, drive.poser) for topic, each in survey.topics.items()}
    some = {topic: clouds for topic, clouds in again.items() if clouds}
    against = list(poses.list_cloud_concerns(some, drive, ground))
    box = poses.enclose_clouds(drive, ground) if ground else None
    problem = "; ".join([problem, *(each.text for _, each in against)]) if problem else ""
    return box, notes, against, problem


def describe_topic(drive: Drive, topic: TopicSurvey, plan: PosePlan) -> ScanFindings:
    """Sum up all about one topic of scans, as its reader and the survey have it."""
    options, parts, ranked = drive.options, topic.sample.parts, topic.shapes.most_common()
    misfit = find_better_mount(drive, parts)
    tracks = [edge.track for edge in drive.poser.sources.tree.edges if edge.track.moves]
    moving_ns = max((int(track.stamp_ns[-1]) for track in tracks), default=None)
    found = ScanFindings(
        topic=topic.stream.topic,
        type=topic.stream.type,
        frames=tuple(topic.frames),
        is_of_clouds=topic.stream.role is Role.CLOUD,
        scans=topic.read,
        left_out=dict(topic.left_out),
        shapes=tuple(replace(shape, scans=n) for shape, n in ranked[:MAX_LISTED_SHAPES]),
        shape_count=len(ranked),
        ranges=topic.census.sum_up(parts, options.returns),
        times=topic.stamps.sum_up(moving_ns),
        poses=poses.sum_up_poses(topic, plan),
        mount=poses.sum_up_mount(drive.poser, topic.stream.topic, misfit),
        agreement=estimate_agreement(parts, options),
        misfit=misfit,
    )
    better = poses.find_better(drive, topic, found)
    is_explained = found.poses.stated or found.poses.problem or better or misfit
    hint = "" if is_explained else hint_at_tune(found.agreement, [str(drive.log.path)], options)
    return replace(found, better=better, hint=hint)
