"""What is known of a log before its scans are read: its topics, and where the robot went."""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import chain

from occmap.errors import LogError, UsageError, require
from occmap.options import DEFAULT_UPDATE, BuildOptions, choose_model
from occmap.posing.attach import Poser
from occmap.posing.options import PosingOptions
from occmap.readers import Counting, HoldingClouds, Log, Role, read_poses
from occmap.types import Cloud, Scan, Update


def choose_topics(log: Log, wanted: Sequence[str]) -> list[str]:
    """Choose the scan topics of a log: those that the user names, else all.

    Clouds of points are taken where there are no scans, or where the user names them.

    Raises
    ------
    LogError
        The log has no scans, or not on a wanted topic.
    """
    scans = [s.topic for s in log.streams if s.role is Role.SCAN and s.count]
    clouds = [s.topic for s in log.streams if s.role is Role.CLOUD and s.count]
    there = scans + clouds if wanted else scans or clouds
    if not there:
        held = ", ".join(f"{s.topic} ({s.type}, {s.count})" for s in log.streams if s.count)
        notes = sorted(log.notes, key=lambda note: not note.damage)
        found = f"holds no laser scans; it holds {held or 'nothing'}"
        raise LogError(found, where=log.path, fix=notes[0].text if notes else "")
    missing = sorted(set(wanted) - set(there))
    if missing:
        found = f"has no scans on the topic {missing[0]}"
        raise LogError(found, where=log.path, fix=f"it has scans on {', '.join(there)}")
    return [topic for topic in there if topic in wanted or not wanted]


def settle_update(logs: Sequence[Log], options: BuildOptions) -> BuildOptions:
    """Choose the update for clouds, with its model, where logs hold clouds and no scans.

    Raises
    ------
    UsageError
        An update is named that is not for what a log holds, or logs hold one and the other.
    """
    kinds: dict[Role, str] = {}
    for log in logs:
        topics = choose_topics(log, options.selection.topics)
        roles = {s.topic: s.role for s in log.streams if s.topic in topics}
        kinds |= {role: f"{topic} of {log.path}" for topic, role in roles.items()}
    if Role.CLOUD not in kinds:
        found = "the logs hold no clouds of points"
        require(options.update is not Update.CLOUD, found, "leave out `update=cloud`")
        return options
    found = f"{kinds.get(Role.SCAN)} holds laser scans, {kinds[Role.CLOUD]} clouds of points"
    require(Role.SCAN not in kinds, found, "map one kind at a time: choose with `topics`")
    require(options.min_passes is None, "`min_passes` is not for clouds of points", "leave it out")
    if options.update is Update.CLOUD:
        return options
    found = f"{kinds[Role.CLOUD]} holds clouds of points, which the {options.update} update"
    require(options.update is DEFAULT_UPDATE, f"{found} does not take", "name no update")
    is_default = options.model == choose_model(options.update)
    model = choose_model(Update.CLOUD) if is_default else options.model
    return replace(options, update=Update.CLOUD, model=model)


def count_scans(log: Log, wanted: Sequence[str]) -> int:
    """Count the scans that will be read.

    Raises
    ------
    LogError
        As `choose_topics`.
    """
    return count_messages(log, choose_topics(log, wanted))


def count_messages(log: Log, topics: Sequence[str]) -> int:
    """Count the messages on some topics, by what the reader says of its streams."""
    return sum(stream.count for stream in log.streams if stream.topic in topics)


def make_poser(log: Log, topics: Sequence[str], options: PosingOptions) -> Poser:
    """Read the poses of a log, unless it states them beside its scans.

    Raises
    ------
    PoseError
        No scan frame has a chain of transforms to a map frame.
    UsageError
        As `refuse_shared_mount`.
    """
    first = take_first(log, topics)
    refuse_shared_mount(log, first, options)
    stated = options.poses is None and all(scan.pose is not None for scan in first)
    moments = log.moments if isinstance(log, Counting) else None
    poser = Poser.build([] if stated else read_poses(log), options, moments)
    if not stated:
        failures = poser.find_chains({scan.frame for scan in first})
        if failures and poser.fixed is None:
            raise next(iter(failures.values())).placed(log.path)
    return poser


def refuse_shared_mount(log: Log, first: Sequence[Scan | Cloud], options: PosingOptions) -> None:
    """Refuse to put lasers that have frames of their own at one place.

    Raises
    ------
    UsageError
        The mount is given, and the first scans of each topic are in different frames.
    """
    lasers = {scan.frame.strip("/"): scan.topic for scan in first}
    if options.sensor_pose is None or len(lasers) == 1:
        return
    frame, topic = next(iter(lasers.items()))
    own = f"`static_transforms={options.base_frame or 'BASE'},{frame},X,Y,Z,ROLL,PITCH,YAW`"
    found = f"`sensor_pose` would put {len(lasers)} lasers at one place: {', '.join(lasers)}"
    fix = f"choose one: `topics={topic}`, or give each a mount of its own: {own}"
    raise UsageError(found, where=log.path, fix=fix)


def take_first(log: Log, topics: Sequence[str]) -> list[Scan | Cloud]:
    """Read the first scan or cloud of each topic, and stop reading when all are found."""
    first: dict[str, Scan | Cloud] = {}
    scans: Iterator[Scan | Cloud] = log.scans(set(topics))
    if isinstance(log, HoldingClouds):
        scans = chain(scans, log.clouds(set(topics)))
    for scan in scans:
        first.setdefault(scan.topic, scan)
        if len(first) == len(topics):
            break
    return list(first.values())
