"""Logs before their scans are read: those that a path stands for, their topics and their poses."""

import glob
import operator
import os
import re
from collections.abc import Collection, Iterator, Mapping, MutableSequence, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import reduce
from itertools import chain
from pathlib import Path
from typing import TypeAlias

from occmap import readers
from occmap.errors import LogError, OccmapError, PoseError, UsageError, require
from occmap.options import DEFAULT_UPDATE, BuildOptions, choose_model
from occmap.posing import PosingOptions
from occmap.posing.attach import Poser
from occmap.posing.frames import join_topic, last_part
from occmap.posing.sources import gather
from occmap.readers import Log, ReaderOptions, Role, open_log
from occmap.report import Note, count, is_damage, join_names
from occmap.sensor.models import CountingModel, RadialModel
from occmap.types import Cloud, Paths, PoseBatch, PoseSample, Scan, Update


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
        notes = sorted(log.notes, key=is_damage, reverse=True)
        found = f"holds no laser scans and no clouds; it holds {held or 'nothing'}"
        raise LogError(found, where=log.path, fix=str(notes[0]) if notes else "")
    asked = set(wanted)
    if missing := sorted(asked - set(there)):
        found = f"has no scans on the topic {missing[0]}"
        raise LogError(found, where=log.path, fix=f"it has scans on {', '.join(there)}")
    return [topic for topic in there if topic in asked or not asked]


def settle_update(logs: Sequence[Log], options: BuildOptions) -> BuildOptions:
    """Choose the update for clouds, with its model, where logs hold clouds and no scans.

    Raises
    ------
    UsageError
        An update is named that is not for what a log holds, or logs hold one and the other.
    """
    kinds = (list_kinds(log, options.selection.topics) for log in logs)
    return suit_kinds(reduce(operator.or_, kinds), options)


def list_kinds(log: Log, wanted: Sequence[str]) -> dict[Role, str]:
    """Say whether a log holds scans, or clouds, and on which topic; raises as `choose_topics`."""
    topics = choose_topics(log, wanted)
    return {s.role: f"{s.topic} of {log.path}" for s in log.streams if s.topic in topics}


def suit_kinds(kinds: Mapping[Role, str], options: BuildOptions) -> BuildOptions:
    """Choose the update, with its model, for scans or clouds, of which it is known who holds them.

    Raises
    ------
    UsageError
        As `settle_update`, or the model is none for clouds.
    """
    if Role.CLOUD not in kinds:
        found = "the logs hold no clouds of points"
        require(options.update is not Update.CLOUD, found, "name no update")
        return options
    found = f"{kinds.get(Role.SCAN)} holds laser scans, {kinds[Role.CLOUD]} clouds of points"
    require(Role.SCAN not in kinds, found, "map one kind at a time: choose with `topics`")
    found = f"{kinds[Role.CLOUD]} holds clouds of points, which"
    is_open = options.update in {DEFAULT_UPDATE, Update.CLOUD}
    require(is_open, f"{found} the {options.update} update does not take", "they have one only")
    is_radial = isinstance(options.model, RadialModel)
    require(not is_radial, f"{found} a model of beams does not take", "try `model=counting`")
    model = options.model
    # What the user changed of it is changed of that for clouds.
    if isinstance(model, CountingModel):
        usual = vars(choose_model(options.update))
        chosen = {name: value for name, value in vars(model).items() if value != usual[name]}
        model = replace(choose_model(Update.CLOUD), **chosen)
    return replace(options, update=Update.CLOUD, model=model)


def count_scans(log: Log, wanted: Sequence[str]) -> int:
    """Count the scans that will be read.

    Raises
    ------
    LogError
        As `choose_topics`.
    """
    topics = set(choose_topics(log, wanted))
    return sum(stream.count for stream in log.streams if stream.topic in topics)


def read_poser(log: Log, options: PosingOptions, topics: Sequence[str]) -> Poser:
    """Read every pose source of a log, for scans on some topics; raises as `gather`."""
    try:
        return Poser(gather(gather_poses(log, options), options, log.moments, topics), options)
    except PoseError as error:
        raise error.placed(log.path) from None


def gather_poses(log: Log, posing: PosingOptions) -> Iterator[PoseSample | PoseBatch]:
    """Read every pose source of a log, and of other ones, whose topics begin with their path.

    These are the recording that `poses` names, whose damage is noted of the log, and what never
    changes in the first part of a split recording: the other parts lack it.
    """
    yield from log.stacked_poses()
    if first := find_first_part(log):
        with suppress(LogError):
            part = open_log(first)
            has_fixed = any(last_part(stream.topic) == "tf_static" for stream in part.streams)
            yield from (each for each in read_beside(part) if each.static) if has_fixed else ()
    if posing.recording is None:
        return
    path, _ = posing.recording
    other = open_log(path)
    yield from read_beside(other)
    damage = (note.placed(path) for note in other.notes if is_damage(note))
    if isinstance(log.notes, MutableSequence):  # a plugin's may be a tuple
        log.notes.extend(note for note in damage if note not in log.notes)


def read_beside(other: Log) -> Iterator[PoseSample | PoseBatch]:
    """Read every pose source of another log, with its path before each topic."""
    for each in other.stacked_poses():
        yield each._replace(topic=join_topic(other.path, each.topic))


PART = re.compile(r"_?(\d{4}(-\d\d){5})?_\d+(\.bag|\.mcap|\.db3)(\.active)?$")
"""How the names of the parts of a recording that was split end: PREFIX_DATE_NUMBER.bag, of which
the last one stays active where the recorder was killed"""


def find_first_part(log: Log) -> Path | None:
    """Find the first part of a split recording, if the log is a later one without /tf_static."""
    held = {last_part(each.topic) for each in log.streams if each.count}
    part = PART.search(log.path.name)
    if not part or "tf_static" in held:
        return None
    firsts = log.path.parent.glob(f"*_0{part[3]}")
    before = (each for each in firsts if each.name < log.path.name)
    prefix = log.path.name[: part.start()]
    return max((each for each in before if PART.sub("", each.name) == prefix), default=None)


def look_ahead(log: Log, options: BuildOptions) -> list[Scan | Cloud]:
    """Read the first scan or cloud of each topic that is used.

    Raises
    ------
    LogError
        As `choose_topics`.
    UsageError
        The mount is given, and would put lasers that have frames of their own at one place.
    """
    first = take_first(log, choose_topics(log, options.selection.topics))
    lasers = {scan.frame.strip("/"): scan.topic for scan in first}
    if options.posing.sensor_pose is None or len(lasers) == 1:
        return first
    frame, topic = next(iter(lasers.items()))
    own = f"`static_transforms={options.posing.base_frame or 'BASE'},{frame},X,Y,Z,ROLL,PITCH,YAW`"
    found = f"`sensor_pose` would put {len(lasers)} lasers at one place: {', '.join(lasers)}"
    fix = f"choose one: `topics={topic}`, or give each a mount of its own: {own}"
    raise UsageError(found, where=log.path, fix=fix)


def take_first(log: Log, topics: Sequence[str]) -> list[Scan | Cloud]:
    """Read the first scan or cloud of each topic, and stop reading when all are found."""
    first: dict[str, Scan | Cloud] = {}
    scans: Iterator[Scan | Cloud] = chain(log.scans(topics), log.clouds(topics))
    for scan in scans:
        first.setdefault(scan.topic, scan)
        if len(first) == len(topics):
            break
    return list(first.values())


RECORDED = (".mcap", ".bag", ".db3")
"""Suffixes that only recordings have; others are taken for such where a recording has them."""


Inputs: TypeAlias = tuple[list[Path], list[str]]
"""The recordings that paths stand for, and notes on what folders and patterns were found to hold"""


def find_inputs(paths: Paths, options: ReaderOptions, others: Paths = ()) -> Inputs:
    """Replace folders and patterns by the recordings in them, in the order of their time.

    What holds no recording stays as it is: opening it says what is wrong. What occmap wrote into a
    folder is none.

    Parameters
    ----------
    others
        Files that are not recordings, though a folder may hold them: outputs and trajectories.
    """
    logs: list[Path] = []
    notes: list[str] = []
    known = set(map(os.path.realpath, others))
    for path in paths:
        entries = list_entries(path)
        unnamed = (each for each in entries if os.path.realpath(each) not in known)
        maybe = [each for each in unnamed if not is_made(each)]
        kept = list(filter(is_recording, maybe))
        if not kept or is_whole(path, kept):
            logs.append(path)
            continue
        kept.sort(key=lambda each: find_start(each, options))
        logs += kept
        suffixes = {*RECORDED, *(each.suffix.lower() for each in kept)}
        lost = [each for each in maybe if each.suffix.lower() in suffixes and each not in kept]
        notes.append(describe_found(path, kept, len(entries) - len(kept) - len(lost)))
        packed = (each for each in kept if each.suffix.lower() == ".gz")  # such text is read, too
        if twins := [each.name for each in packed if each.with_suffix("") in kept]:
            notes.append(f"{path}: {join_names(twins)}: lies there unpacked, too: both count")
        for each in lost:
            try:
                open_log(each, options)
            except LogError as error:
                told = f"passed over, though named like a recording: {error.found}"
                # Text may be anything, but a bag or an MCAP file was recorded.
                notes.append(Note(f"{each}: {told}", damage=each.suffix.lower() in RECORDED))
    return logs, notes


def list_entries(path: Path) -> list[Path]:
    """List what a folder holds, or what a pattern matches; nothing where a path is a log itself."""
    if path.is_dir():
        with suppress(OSError):
            return sorted(each for each in path.iterdir() if not each.name.startswith("."))
    elif glob.has_magic(str(path)) and not path.exists():
        return sorted(map(Path, glob.glob(str(path), recursive=True)))  # noqa: PTH207  any path
    return []


def is_whole(path: Path, recordings: Collection[Path]) -> bool:
    """Whether a folder is one recording, of clouds or a bag of ROS 2, and not one of several."""
    from occmap.readers import cloud_folder, rosbag  # noqa: PLC0415  late: these bring mcap, apsw

    if not path.is_dir() or (path / rosbag.METADATA).exists():
        return path.is_dir()
    if all(map(Path.is_dir, recordings)):  # else no clouds are listed, which takes long
        return set(recordings) <= {cloud.parent for cloud in cloud_folder.list_clouds(path)}
    files = rosbag.list_storage(path)
    with suppress(LogError):
        rosbag.refuse_mixed(path, files)
        return set(recordings) <= set(files)
    return False


def is_recording(path: Path) -> bool:
    """Whether any reader recognises a path."""
    with suppress(LogError):
        return readers.find_reader(readers.probe_path(path)) is not None
    return False


MADE = b"\x06\0\0\0occmap", b"#timestamp [ns],p_x [m]"
"""What stands at the beginning of maps as MCAP and of trajectories as CSV that occmap wrote"""


def is_made(path: Path) -> bool:
    """Whether occmap wrote a file that could be taken for a recording by its name or content."""
    if path.suffix.lower() in {".mcap", ".csv"}:
        with suppress(LogError):
            begin = readers.probe_path(path).raw[:64]
            return any(mark in begin for mark in MADE)
    return False


def find_start(path: Path, options: ReaderOptions) -> tuple[int, str]:
    """Find when the scans of a recording begin (ns); what cannot be read comes last."""
    start = 2**63
    with suppress(OccmapError):
        log = open_log(path, options)
        first = take_first(log, choose_topics(log, ()))
        start = min((scan.stamp_ns for scan in first), default=start)
    return start, str(path)


def describe_found(path: Path, logs: Paths, others: int) -> str:
    """Say which recordings a folder holds, and how many other files."""
    names = join_names(log.name for log in logs)
    passed = f"; {count(others, 'other file')} passed over" if others else ""
    order = ", in the order of their time" if len(logs) > 1 else ""
    return f"{path}: {count(len(logs), 'recording')}{order}: {names}{passed}"
