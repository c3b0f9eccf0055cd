"""Where the poses of a log come from, what is missing, and which option would mend it."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from occmap.choices.values import format_mount
from occmap.errors import MountError, PoseError
from occmap.inspection.findings import Coverage, PoseFindings
from occmap.inspection.survey import TopicSurvey
from occmap.options import BuildOptions
from occmap.posing.attach import Poser
from occmap.posing.chain import Status
from occmap.posing.options import Stamps
from occmap.posing.sources import Sources
from occmap.readers import Log, get_moments, read_poses
from occmap.scans.logs import refuse_shared_mount, take_first
from occmap.scans.mounts import guess_place, sample_scans
from occmap.types import IDENTITY, Pose

WELL_POSED = 0.9
"""If a smaller share of the scans has poses, the other of the two times is tried."""


@dataclass(frozen=True)
class Posing:
    """How the scans of a log are posed, with the options given or with those that would help."""

    poser: Poser
    faults: dict[str, PoseError] = field(default_factory=dict)
    """By frame: why its scans have no pose with the options given"""
    assumed: Pose | None = None
    """The mount that the poser uses though the user did not give it"""
    is_guess: bool = False
    """The assumed mount is a place holder, since the scans do not tell the right one"""


def prepare(log: Log, topics: Sequence[str], options: BuildOptions) -> Posing:
    """Find the way to every frame of a log's scans; where it lacks the mount, guess that.

    Raises
    ------
    PoseError, LogError
        The trajectory that the user chose cannot be used.
    UsageError
        As `refuse_shared_mount`.
    """
    first = take_first(log, topics)
    refuse_shared_mount(log, first, options.posing)
    poser = Poser.build(read_poses(log), options.posing, get_moments(log))
    frames = {scan.frame for scan in first if scan.pose is None or options.posing.poses}
    faults = poser.find_chains(frames)
    if faults and len(frames) == 1 and options.posing.sensor_pose is None:
        at_body = Poser(poser.sources, replace(options.posing, sensor_pose=IDENTITY))
        if not at_body.find_chains(frames):  # nothing but the mount is missing
            return assume_mount(log, topics, options, Posing(at_body, faults))
    return Posing(poser, faults)


def assume_mount(log: Log, topics: Sequence[str], options: BuildOptions, at_body: Posing) -> Posing:
    """Read the scans as if the sensor were the body, and find the mount that suits them best."""
    parts = sample_scans(log, topics, at_body.poser, options)
    guess = guess_place(at_body.poser, parts, options)
    posing = replace(at_body.poser.options, sensor_pose=guess.mount if guess else IDENTITY)
    poser = Poser(at_body.poser.sources, posing, notes=list(at_body.poser.sources.notes))
    faults = at_body.faults
    if guess is not None:  # the error says that the mount is missing, and names the likely one
        found = format_mount(guess.mount), guess.why
        faults = {
            frame: fault.named(*found) if isinstance(fault, MountError) else fault
            for frame, fault in faults.items()
        }
    return Posing(poser, faults, posing.sensor_pose, is_guess=guess is None)


def suggest_stamps(log: Log, posing: Posing, topic: TopicSurvey) -> Stamps:
    """Find out by which of the two times of a message more scans have a pose."""
    chosen = posing.poser.options.stamps
    scans = topic.left_out.total() + topic.posed + topic.dropped.total()
    if topic.stated or not posing.poser.chains or topic.posed >= WELL_POSED * scans:
        return chosen
    other = Stamps.HEADER if chosen is Stamps.RECORD else Stamps.RECORD
    others = replace(posing.poser.options, stamps=other)
    poser = Poser.build(read_poses(log), others, get_moments(log))
    poser.find_chains(topic.frames)
    stamps = other.choose(topic.stamps.header_ns, topic.stamps.record_ns)
    stamp_ns = np.array(stamps) + round(poser.options.time_offset_s * 1e9)
    chain = poser.chains.get(next(iter(topic.frames)))
    found = 0 if chain is None else np.count_nonzero(chain.at(stamp_ns).status == Status.POSED)
    return other if found > topic.posed / WELL_POSED else chosen


def list_coverage(sources: Sources) -> list[Coverage]:
    """Describe the edges of the tree, by name, and then the poses of bodies that are in no edge."""
    chosen = [sources.trajectory] if sources.trajectory else []
    return [
        Coverage(
            parent=edge.parent,
            child=edge.child,
            source=edge.source,
            topic=edge.topic,
            samples=len(edge.track),
            static=edge.track.static,
            moves=edge.track.moves,
            start_ns=int(edge.track.stamp_ns[0]),
            end_ns=int(edge.track.stamp_ns[-1]),
            largest_gap_s=float(edge.track.interval_s.max(initial=0)),
            largest_step_m=float(edge.track.step_m.max(initial=0)),
            largest_step_rad=float(edge.track.step_rad.max(initial=0)),
        )
        for edge in dict.fromkeys([*sources.tree.edges, *chosen, *sources.pose_topics])
    ]


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
