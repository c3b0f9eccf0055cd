"""From findings to advice: warnings, and the command line that makes the best of the logs."""

import shlex
from collections.abc import Iterator, Sequence

from occmap.batching import find_oddity
from occmap.command import chain_builds, compose_build
from occmap.inspection.findings import LogFindings, ScanFindings, TimeFindings
from occmap.mounts import warn_of_misfit
from occmap.options import BuildOptions
from occmap.posing.options import Concern
from occmap.remarks import LEAST_AGREEMENT
from occmap.wording import count, write_counts

SHARE_OF_NOTE = 0.05
DRIFT_S = 0.1
ASK_TUNE = "try `occmap tune`"


def compose_command(logs: Sequence[LogFindings], options: BuildOptions) -> tuple[str, ...]:
    """Compose the command line for logs that can be mapped: the options given, then the advice.

    Where the poses do not fit the scans, it is the one that looks for the reason; there is none
    where nothing helps, or where logs need different options.
    """
    paths = [log.path for log in logs if not log.problem]
    concerns = [concern for log in logs for concern in log.concerns]
    advised = list_advised(logs, options)
    for name, value in (pair for each in concerns for pair in (each.remedy or {}).items()):
        if advised.setdefault(name, value) != value:
            return ()
    command = compose_build(paths, options, advised)
    hopeless = [concern for concern in concerns if concern.remedy is None]
    if all(ASK_TUNE in concern.text for concern in hopeless):
        return ("occmap", "tune", *command[2:-2]) if hopeless else command
    return ()


def list_apart(logs: Sequence[LogFindings], options: BuildOptions) -> Iterator[str]:
    """Say which lines build logs that need different options, each added to those before."""
    lines = [compose_command([log], options) for log in logs]
    if len({(*line[:2], *line[3:-2]) for line in lines}) < 2:
        return
    if any(line[1:2] != ("build",) for line in lines):
        yield "the logs need different options: check them one by one"
        return
    yield "the logs need different options: build one after the other"
    yield from map(shlex.join, chain_builds(lines))


def list_advised(logs: Sequence[LogFindings], options: BuildOptions) -> dict[str, str]:
    """List the options that the findings suggest, where the user has not decided."""
    topics = [topic for log in logs for topic in log.scans]
    advised = {}
    for topic in topics:
        if topic.poses.assumed:
            advised["sensor_pose"] = topic.poses.assumed
        if not topic.poses.stated and topic.times.suggested_stamps != options.posing.stamps:
            advised["stamps"] = topic.times.suggested_stamps
    advice = {special.no_return for topic in topics for special in topic.ranges.specials} - {""}
    if advice == {"clear"}:
        advised["no_return"] = "clear"
    return advised


def list_concerns(log: LogFindings, spoilers: Sequence[tuple[str, Concern]]) -> list[Concern]:
    """List what will spoil a map, or surprise its maker.

    Parameters
    ----------
    spoilers
        What the poses show, with the topics of the scans.
    """
    has_poses = any(topic.poses.posed for topic in log.scans)  # that none has, is a problem
    found = []
    for topic in log.scans:
        mine = [concern for name, concern in spoilers if name == topic.topic]
        mine += list_doubts(topic, has_poses)
        if topic.agreement is not None and topic.agreement < LEAST_AGREEMENT:
            share = f"only {topic.agreement:.0%} of the hits of a sample of scans"
            text = f"{share} lie in occupied cells: the poses do not fit the scans; {ASK_TUNE}"
            is_mended = any(concern.remedy for concern in mine)
            mine.append(Concern(f"{text}, or another trajectory", {} if is_mended else None))
        found += [Concern(f"{log.path}: {topic.topic}: {text}", cure) for text, cure in mine]
    return found


def list_doubts(topic: ScanFindings, has_poses: bool) -> Iterator[Concern]:
    """Say what is strange about the beams of a topic, its mount, poses, stamps and ranges."""
    oddities = (find_oddity(shape.angle_increment, shape.beams) for shape in topic.shapes)
    yield from (Concern(oddity, None) for oddity in dict.fromkeys(oddities) if oddity)
    if topic.mount and topic.mount.better:
        yield warn_of_misfit(topic.mount.better)
    lost = topic.poses.dropped
    if has_poses and sum(lost.values()) > SHARE_OF_NOTE * topic.kept:
        yield Concern(f"scans without a pose: {write_counts(lost)}")
    if not topic.poses.stated:  # else stamps do not matter
        yield from map(Concern, list_clock_faults(topic.times))
    for item in topic.ranges.repeated:
        if not item.is_no_return:
            share = f"{item.value:g} m is {item.share:.0%} of the ranges"
            yield Concern(f"{share} and may mean no return")
    if not topic.ranges.measured:
        yield Concern("no range value is a measurement")


def list_clock_faults(times: TimeFindings) -> Iterator[str]:
    """Say what is wrong with stamps."""
    if times.all_equal:
        yield "all stamps are equal"
    if times.jumps_back:
        yield f"stamps jump back {count(times.jumps_back, 'time')}"
    if abs(times.drift_s) > DRIFT_S:
        yield f"stamps drift by {times.drift_s:.3g} s against the record times"
