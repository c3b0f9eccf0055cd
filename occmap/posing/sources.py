"""Pose sources: every pose sample of a log, sorted into edges of the tree and trajectories.

Notes say where these contradict each other.
"""

from collections import defaultdict
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import numpy as np

from occmap.errors import PoseError
from occmap.posing.frames import BASE_NAMES, FIXED_NAMES, Edge, FrameTree, Source, last_part
from occmap.posing.options import PosingOptions, Stamps
from occmap.posing.tracks import Track, TrackBuilder, differ
from occmap.posing.trajectory import TRAJECTORY_FRAME, read_trajectory
from occmap.report.words import count, join_names
from occmap.types import Moments, PoseBatch, PoseSample

TF_TOPICS = frozenset({"", "tf", "tf_static"})
"""Last parts of topics that carry the tree itself; any other states the pose of one body."""

INTENTIONS = frozenset({"goal", "initialpose", "plan", "waypoints"})
"""Words in topics of poses that tell where a robot should be, not where it was."""
MOST_CHANGED = 3
"""How many of the static transforms that changed are named: their names are long."""
MOST_LOOPS = 8
"""Loops that are listed at most."""
USE_TF = "leave out `poses`: transforms are used without it"


@dataclass(frozen=True, eq=False)
class Sources:
    """All that is known about poses, before any scan is looked at."""

    tree: FrameTree
    pose_topics: tuple[Edge, ...]
    """Poses of one body each, the best source first; `child` is "" where it is not named."""
    trajectory: Edge | None
    """The one that the user chose instead of tf."""
    notes: tuple[str, ...]
    unusable: tuple[str, ...] = ()
    """Those of the notes that tell of poses left out"""

    @cached_property
    def unnamed_body(self) -> Edge | None:
        """The pose topic to fall back on where tf and odometry do not reach a scan."""
        usable = (edge for edge in self.pose_topics if not edge.child and len(edge.track) > 1)
        return next((edge for edge in usable if not _is_intention(edge.topic)), None)


def gather(
    samples: Iterable[PoseSample | PoseBatch],
    options: PosingOptions,
    moments: Moments | None = None,
) -> Sources:
    """Read every sample once and sort them by what they say.

    Raises
    ------
    PoseError
        The trajectory that the user chose is neither a file nor a topic with poses.
    LogError
        The trajectory file cannot be read.
    """
    edges, unusable, changes = _build_edges(samples, options.stamps)
    given = [
        Edge(each.parent.strip("/"), each.child.strip("/"), Track.fixed(each.pose), Source.GIVEN)
        for each in options.static_transforms
    ]
    if not any(edge.child for edge in [*given, *edges]):
        edges = [_name_body(edge) for edge in edges]
    tree = FrameTree([*given, *(edge for edge in edges if edge.child)])
    stated = (edge for edge in edges if edge.source is Source.ODOMETRY)
    poses = sorted(stated, key=lambda edge: (-len(edge.track), edge.topic))
    of_file: list[str] = []
    trajectory = _find_trajectory(options, poses, of_file, moments) if options.poses else None
    notes = [*_list_overruled(given, edges, tree), *unusable, *changes, *of_file]
    notes += _list_contradictions(edges, tree)
    return Sources(tree, tuple(poses), trajectory, tuple(notes), tuple(unusable))


def _build_edges(
    samples: Iterable[PoseSample | PoseBatch], stamps: Stamps
) -> tuple[list[Edge], list[str], list[str]]:
    """Make an edge of all samples that share topic and frames.

    Also return a note on each edge with poses that cannot be used, and on fixed ones that change.
    """
    builders: dict[tuple[str, str, str, bool], TrackBuilder] = defaultdict(TrackBuilder)
    for item in samples:
        builder = builders[item.topic, item.parent, item.child, item.static]
        if isinstance(item, PoseBatch):
            builder.add_batch(item, stamps)
        else:
            builder.add(item, stamps)
    edges: list[Edge] = []
    unusable: list[str] = []
    changed: dict[str, list[str]] = defaultdict(list)
    for (topic, parent, child, static), builder in sorted(builders.items()):
        track = builder.build()
        if builder.unusable:
            unusable.append(
                f"{count(builder.unusable, 'pose')} of {parent} -> {child or 'a body'} left out: "
                "not finite, beyond 1e12 m, without a rotation, or with a damaged stamp"
            )
        if static and builder.changes:
            changed[topic].append(f"{parent} -> {child}")
        if track is not None and parent != child:
            # Of a transform that was sent more than once the last pose counts.
            track = track.hold_last() if static else track
            is_tf = child and (static or last_part(topic) in TF_TOPICS)
            source = Source.TF if is_tf else Source.ODOMETRY
            edges.append(Edge(parent.strip("/"), child.strip("/"), track, source, topic))
    changes = [
        f"{topic} changes {join_names(names, MOST_CHANGED)}: the last pose counts"
        for topic, names in changed.items()
    ]
    return edges, unusable, changes


def _name_body(edge: Edge) -> Edge:
    """Name the body of odometry that names none, in a log without other frames, as REP 105 does."""
    is_odometry = last_part(edge.parent) == FIXED_NAMES[1] and not _is_intention(edge.topic)
    return replace(edge, child=BASE_NAMES[0]) if is_odometry and len(edge.track) > 1 else edge


def _is_intention(topic: str) -> bool:
    words = topic.lower().replace("/", "_").split("_")
    return not INTENTIONS.isdisjoint(words)


def _list_overruled(given: Sequence[Edge], edges: Sequence[Edge], tree: FrameTree) -> Iterator[str]:
    """Say which of the user's transforms replace one of the log, or close a loop."""
    known = {edge.child for edge in edges if edge.source is Source.TF}
    for edge in given:
        name = f"the given transform {edge.parent} -> {edge.child}"
        if edge.child in known:
            yield f"{name} replaces the log's"
        if edge.child in tree.list_ancestors(edge.parent):
            yield f"{name} closes a loop: {edge.child} is above {edge.parent} already"


def _find_trajectory(
    options: PosingOptions, poses: Sequence[Edge], notes: list[str], moments: Moments | None
) -> Edge:
    """Take the chosen trajectory: from a file where there is one of that name, else by topic."""
    name = options.poses or ""
    if Path(name).is_file():
        samples = read_trajectory(Path(name), notes, moments)
        edges, unusable, _ = _build_edges(samples, Stamps.HEADER)
        notes.extend(unusable)
        if not edges:
            raise PoseError("holds no usable pose: none is finite", where=name)
        frame = options.map_frame or TRAJECTORY_FRAME
        return replace(edges[0], parent=frame, topic=name)
    for edge in poses:
        if edge.topic.strip("/") == name.strip("/"):
            return edge
    if name.strip("/") in TF_TOPICS - {""}:
        raise PoseError("transforms are not a topic of poses", where=name, fix=USE_TF)
    if Path(name).suffix:  # no topic has one
        fix = "check the path: `poses` takes a trajectory file, or a topic of the log"
        raise PoseError("no such file", where=name, fix=fix)
    topics = ", ".join(sorted({edge.topic for edge in poses}))
    found = "neither a file nor a topic with poses"
    fix = f"topics with poses: {topics}" if topics else "the log has no topic with poses"
    raise PoseError(found, where=name, fix=fix)


def _list_contradictions(edges: Iterable[Edge], tree: FrameTree) -> Iterator[str]:
    """Say where the transforms of a log contradict each other, and which of them count."""
    stated: dict[tuple[str, str], list[Edge]] = defaultdict(list)
    for edge in (edge for edge in edges if edge.source is Source.TF):
        stated[edge.parent, edge.child].append(edge)
    doubles: dict[tuple[str, str], list[str]] = defaultdict(list)
    parents: dict[str, list[str]] = defaultdict(list)
    for used in (edge for edge in tree.edges if edge.source is not Source.GIVEN):
        parents[used.child].append(used.parent)
        same = stated[used.parent, used.child] if used.source is Source.TF else []
        if _disagree(same):
            topics = join_names(sorted({edge.topic for edge in same}))
            doubles[topics, used.topic].append(f"{used.parent} -> {used.child}")
    for (topics, topic), names in doubles.items():
        yield f"{topics} differ on {join_names(names)}: {topic} counts"
    several = [f"{child} ({', '.join(up)})" for child, up in parents.items() if len(up) > 1]
    if several:
        yield f"frames that have several parents: {join_names(several)}; the shortest way counts"
    yield from _list_loops(parents)


def _disagree(same: Sequence[Edge]) -> bool:
    """Whether edges between the same two frames, some of them fixed, hold different poses."""
    if len(same) < 2 or not any(edge.track.static for edge in same):
        return False
    positions = np.concatenate([edge.track.position for edge in same])
    return differ(positions, np.concatenate([edge.track.quaternion for edge in same]))


def _list_loops(parents: dict[str, list[str]]) -> Iterator[str]:
    """Name the loops, the first few of many; each is cut open to find the next."""
    for _ in range(MOST_LOOPS):
        try:
            TopologicalSorter(parents).prepare()
        except CycleError as error:
            loop: list[str] = error.args[1]
            parents[loop[1]].remove(loop[0])
            yield f"the transforms {' -> '.join(loop)} form a loop: the shortest way counts"
        else:
            return
