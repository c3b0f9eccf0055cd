"""Pose sources: every pose sample of a log, sorted into edges of the tree and trajectories.

Notes say where these contradict each other. Resolution finds the way from the map to the frame of a
scan, and whose poses it follows.
"""

from collections import defaultdict
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import TypeAlias

import numpy as np

from occmap.errors import MountError, PoseError
from occmap.posing import Concern, PosingOptions, Stamps, frames
from occmap.posing.chain import Chain, make_chain
from occmap.posing.frames import Edge, FrameTree, Source, find_moving, find_strangers, last_part
from occmap.posing.tracks import Track, TrackBuilder, differ
from occmap.posing.trajectory import find_lidar, read_trajectory
from occmap.report import count, join_names
from occmap.types import Moments, PoseBatch, PoseSample
from occmap.values import name_origin

Poses: TypeAlias = Iterable[PoseSample | PoseBatch]
"""Samples as logs give them, many at once where one by one takes long"""
TF_TOPICS = frozenset({"", "tf", "tf_static"})
"""Last parts of topics that carry the tree itself; any other states the pose of one body."""

INTENTIONS = frozenset({"goal", "initialpose", "plan", "waypoints"})
"""Words in topics of poses that tell where a robot should be, not where it was."""
MOST_CHANGED = 3
"""How many of the static transforms that changed are named: their names are long."""


@dataclass(frozen=True, eq=False)
class Sources:
    """All that is known about poses, before any scan is looked at."""

    tree: FrameTree
    pose_topics: tuple[Edge, ...]
    """Poses of one body each, the best source first; `child` is "" where it is not named."""
    trajectory: Edge | None
    """The one that the user chose instead of tf."""
    notes: tuple[str, ...]
    doubts: tuple[str, ...] = ()
    """Those of the notes that tell of poses left out, or replaced by later ones"""
    lidar: Concern | None = None
    """Where the lidar sits on the camera whose poses were chosen, unless the user says it"""

    @cached_property
    def unnamed_body(self) -> Edge | None:
        """The pose topic to fall back on where tf and odometry do not reach a scan."""
        usable = (edge for edge in self.pose_topics if not edge.child and len(edge.track) > 1)
        return next((edge for edge in usable if not _is_intention(edge.topic)), None)


def gather(
    sent: Poses, options: PosingOptions, moments: Moments | None = None, topics: Sequence[str] = ()
) -> Sources:
    """Read every sample once and sort them by what they say.

    Parameters
    ----------
    topics
        Of the scans that are to be posed.

    Raises
    ------
    PoseError
        The trajectory that the user chose is neither a file nor a topic with poses, or the scans
        are those of several robots.
    LogError
        The trajectory file cannot be read.
    """
    notes: list[str] = []
    every = _build_edges(sent, options.stamps, notes)
    doubts = tuple(notes)
    edges, of_other = _borrow(every, options)
    strangers = find_strangers(edges, topics)
    edges = [edge for edge in edges if edge not in strangers]
    given = [
        Edge(each.parent.strip("/"), each.child.strip("/"), Track.fixed(each.pose), Source.GIVEN)
        for each in options.static_transforms
    ]
    if not any(edge.child for edge in [*given, *edges]):
        edges = [_name_body(edge) for edge in edges]
    tree = FrameTree([*given, *(edge for edge in edges if edge.child)])
    poses, trajectory, lidar = _rank(edges), None, None
    if options.poses and of_other is not None:
        named = of_other if options.recording else poses
        trajectory, lidar = _find_trajectory(options, named, notes, moments)
        if options.files:
            frame = options.map_frame or trajectory.parent
            body = trajectory.child if trajectory.child in tree else ""  # it may have another name
            trajectory = replace(trajectory, parent=frame, child=body)
        if given or options.sensor_pose or options.base_frame:
            lidar = None  # the user says it
    placed = {edge.child for edge in edges if edge.source is Source.TF}
    overruled = (f"{it.parent} -> {it.child}" for it in given if it.child in placed)
    notes[:0] = [f"the given transform {name} replaces the log's" for name in overruled]
    notes += [*_list_beside(edges, strangers, topics), *_list_contradictions(edges, tree)]
    return Sources(tree, tuple(poses), trajectory, tuple(notes), doubts, lidar)


def _build_edges(sent: Poses, stamps: Stamps, notes: list[str]) -> list[Edge]:
    """Make an edge of all samples that share topic and frames.

    Parameters
    ----------
    notes
        Grows by a note on each edge with poses that cannot be used, and on fixed ones that change.
    """
    builders: dict[tuple[str, str, str, bool], TrackBuilder] = defaultdict(TrackBuilder)
    for item in sent:
        builder = builders[item.topic, item.parent, item.child, item.static]
        # The stamps of what holds at all times mean nothing.
        stamp_ns = item.record_ns if item.static else stamps.choose(item.stamp_ns, item.record_ns)
        builder.add(stamp_ns, item.record_ns, item.pose)
    edges: list[Edge] = []
    changed: dict[str, list[str]] = defaultdict(list)
    for (topic, parent, child, static), builder in sorted(builders.items()):
        track = builder.build()
        if builder.unusable:
            notes.append(
                f"{count(builder.unusable, 'pose')} of {parent} -> {child or 'a body'} left out: "
                "not finite, beyond 1e12 m, without a rotation, or with a damaged or unset stamp"
            )
        if track is not None:
            if static and track.moves:
                changed[topic].append(f"{parent} -> {child}")
            edges += _make_edges(topic, parent, child, track, static)
    for topic, names in changed.items():
        notes.append(f"{topic} changes {join_names(names, MOST_CHANGED)}: the last pose counts")
    return edges


def _make_edges(topic: str, parent: str, child: str, track: Track, static: bool) -> Iterator[Edge]:
    """Make an edge of a track; none of a transform that leads from a frame to itself."""
    # Scans that always begin at one place of their frame say nothing of how that went.
    if static or (child == name_origin(parent, topic) and not track.moves):
        track = track.hold_last()  # of a transform that was sent more than once
    is_tf = static or last_part(frames.split_topic(topic)[1]) in TF_TOPICS
    if not is_tf and parent == child:
        child = ""  # as if it named no body
    if parent != child or not is_tf:
        source = Source.TF if is_tf and child else Source.ODOMETRY
        yield Edge(parent.strip("/"), child.strip("/"), track, source, topic)


def _borrow(every: Sequence[Edge], options: PosingOptions) -> tuple[list[Edge], list[Edge] | None]:
    """Put what another recording lends in the place of what leads from frame to frame as well.

    Returns
    -------
    edges, poses
        Those that count; and the topics of poses in that recording, None where it lends transforms.
    """
    recording, topic = options.recording or (None, "")
    others = [edge for edge in every if frames.split_topic(edge.topic)[0] == str(recording)]
    # Of a recording one pose, such as where a robot was said to start, is no trajectory.
    poses = [edge for edge in _rank(others) if len(edge.track) > 1]
    lent = list(_list_lent(others, topic.strip("/"))) if topic or not poses else []
    replaced = {(edge.parent, edge.child) for edge in lent}
    own = (edge for edge in every if edge not in others)
    edges = [*lent, *(edge for edge in own if (edge.parent, edge.child) not in replaced)]
    return edges, None if lent else poses


def _list_lent(others: Iterable[Edge], name: str) -> Iterator[Edge]:
    """List the transforms of another recording, or those on a topic: with /tf go /tf_static."""
    for edge in others:
        own = frames.split_topic(edge.topic)[1].strip("/")
        if edge.source is Source.TF and own in {name or own, f"{name}_static"}:
            yield edge


def _rank(edges: Iterable[Edge]) -> list[Edge]:
    """List the topics of poses, the one with the most of them first."""
    stated = (edge for edge in edges if edge.source is Source.ODOMETRY)
    return sorted(stated, key=lambda edge: (-len(edge.track), edge.topic))


def _name_body(edge: Edge) -> Edge:
    """Name the body of odometry that names none, in a log without other frames, as REP 105 does."""
    is_odometry = last_part(edge.parent) == frames.FIXED_NAMES[1] and len(edge.track) > 1
    is_robot = is_odometry and not _is_intention(edge.topic)
    return replace(edge, child=frames.BASE_NAMES[0]) if is_robot else edge


def _is_intention(topic: str) -> bool:
    return not INTENTIONS.isdisjoint(topic.lower().replace("/", "_").split("_"))


def _find_trajectory(
    options: PosingOptions, poses: Sequence[Edge], notes: list[str], moments: Moments | None
) -> tuple[Edge, Concern | None]:
    """Take the chosen trajectory: from a file, or by topic; the best where that is not named.

    Of a file of a camera's poses, say where the lidar sits on it, too, if that is known.
    """
    name = options.poses or ""
    recording, topic = options.recording or (None, name)
    if recording is None and Path(name).is_file():
        poses_of_file, is_of_camera = read_trajectory(Path(name), notes, moments)
        if not (edges := _build_edges([poses_of_file], Stamps.HEADER, notes)):
            raise PoseError("holds no usable pose: none is finite", where=name)
        return replace(edges[0], topic=name), find_lidar(Path(name)) if is_of_camera else None
    wanted = frames.join_topic(recording, topic) if recording else name
    for edge in poses:
        if not topic or edge.topic.strip("/") == wanted.strip("/"):
            return edge, None
    if ":" not in name and last_part(name) in TF_TOPICS - {""}:
        fix = "leave out `poses`: without it a scan goes by the transforms of its namespace"
        raise PoseError("transforms are not a topic of poses", where=name, fix=fix)
    held = f"holds no {'such ' if topic else ''}topic of poses"
    found = held if recording else "no such file, and no such topic of poses"
    there = f"topics of poses: {join_names(sorted({edge.topic for edge in poses}))}"
    fix = there if poses else "`poses` takes a trajectory file, or a topic of a log"
    if recording is None and Path(name).is_dir():
        inside = sorted(each.name for each in Path(name).glob("*.*"))
        found = f"a folder that is not a recording: it holds {join_names(inside)}"
        fix = f"give a file of it, such as `poses={Path(name) / next(iter(inside), 'FILE')}`"
    raise PoseError(found, where=name, fix=fix)


def _list_beside(edges: list[Edge], strangers: list[Edge], topics: Iterable[str]) -> Iterator[str]:
    """Say which transforms are left out as another robot's, and which are of other recordings."""
    tf = sorted({edge.topic for edge in edges if edge.source is Source.TF})
    if left_out := sorted({edge.topic for edge in strangers}):
        why = f"they contradict {join_names(tf)}, by which {join_names(topics)} goes"
        yield f"transforms on {join_names(left_out)} are left out: {why}"
    if beside := [topic for topic in tf if frames.split_topic(topic)[0]]:
        yield f"transforms are taken from {join_names(beside)}, too"


def _list_contradictions(edges: Iterable[Edge], tree: FrameTree) -> Iterator[str]:
    """Say where the transforms of a log contradict each other, and which of them count."""
    tf: dict[tuple[str, str], list[Edge]] = defaultdict(list)
    for edge in edges:
        if edge.source is Source.TF:
            tf[edge.parent, edge.child].append(edge)
    doubles: dict[tuple[str, str], list[str]] = defaultdict(list)
    parents: dict[str, list[str]] = defaultdict(list)
    for used in tree.edges:
        parents[used.child].append(used.parent)
        same = tf[used.parent, used.child]
        if used.source is Source.TF and _disagree(same):
            topics = join_names(sorted({edge.topic for edge in same}))
            doubles[topics, used.topic].append(f"{used.parent} -> {used.child}")
    for (topics, topic), names in doubles.items():
        yield f"{topics} differ on {join_names(names)}: {topic} counts"
    several = [f"{child} ({', '.join(up)})" for child, up in parents.items() if len(up) > 1]
    if several:
        yield f"frames that have several parents: {join_names(several)}; the shortest way counts"


def _disagree(same: Sequence[Edge]) -> bool:
    """Whether edges between the same two frames, some of them fixed, hold different poses."""
    if len(same) < 2 or not any(edge.track.static for edge in same):
        return False
    positions = np.concatenate([edge.track.position for edge in same])
    return differ(positions, np.concatenate([edge.track.quaternion for edge in same]))


Way: TypeAlias = tuple[str, list[Edge]]
"""A fixed frame, and the steps from it to the sensor."""


@dataclass(slots=True)
class Search:
    """The search for the way to a scan's frame; gathers notes as it decides.

    Where the user names a trajectory, it carries the scans. Else the tree of tf does, which
    odometry fills where tf says nothing; else, where nothing in the tree moves, a topic of poses.

    A way leads down to the anchor. That is the scan's frame or, where the user gives the sensor's
    pose, the body that the sensor is on; one more step then leads from there to the sensor.
    """

    sources: Sources
    options: PosingOptions
    frame: str
    alone: bool
    """No other laser of the log is mapped."""
    notes: list[str] = field(default_factory=list)

    def resolve(self, fixed: str | None) -> tuple[str, Chain]:
        """Find the frame that the scans are mapped in, and the way from there.

        Parameters
        ----------
        fixed
            The frame that other scans are mapped in already.

        Raises
        ------
        PoseError
            There is no way; says what is missing, and which option mends it.
        """
        poses = self.sources.trajectory or (None if self.tree.frames else self.sources.unnamed_body)
        name, steps = self.go_by_poses(poses) if poses else self.go_by_tree(fixed)
        if fixed is not None and name != fixed:
            found = f"{self.frame!r} maps in {name!r} while other scans map in {fixed!r}"
            fix = f"join the two: `static_transforms={fixed},{name},X,Y,Z,ROLL,PITCH,YAW`"
            raise PoseError(found, fix=fix)
        return name, make_chain(steps, self.options.max_pose_gap_s)

    @property
    def tree(self) -> FrameTree:
        """The frames of the log."""
        return self.sources.tree

    @property
    def known(self) -> str:
        """Their names, for errors, and what is doubtful about the transforms between them."""
        named = join_names(filter(None, self.tree.frames))
        return "; ".join([f"known: {named}", *self.sources.doubts])

    def go_by_tree(self, fixed: str | None) -> Way:
        """Go by the tree; where nothing in it moves, by a topic of poses."""
        if not self.tree.frames:
            raise self._miss_poses("looked for tf, odometry and topics of poses in the log")
        anchor = self._find_base() if self.options.sensor_pose else self.frame
        if anchor not in self.tree:
            raise self._miss_mount()
        usual = self.tree.choose_fixed(anchor)
        if not find_moving(self._find_path(usual, anchor)):
            if self.sources.unnamed_body:
                return self.go_by_poses(self.sources.unnamed_body)
            if not (self.options.map_frame or fixed or last_part(usual) in frames.STILL_NAMES):
                raise self._miss_motion(usual)
        name = self.options.map_frame or fixed or usual
        steps = self._find_path(name, anchor)
        self.notes += [
            f"tf does not give {step.parent} -> {step.child}: taken from {step.topic}"
            for step in steps
            if step.source is Source.ODOMETRY
        ]
        if self.options.base_frame and not self.options.sensor_pose:
            self.notes.append("`base_frame` does nothing: it is for `sensor_pose` and `poses`")
        return name, [*steps, *self._mount_on(anchor)]

    def go_by_poses(self, trajectory: Edge) -> Way:
        """Go by the poses of one body, and from there down to the sensor."""
        base = self.options.base_frame
        body = trajectory.child or base or self._guess_body()
        anchor = (base or body) if self.options.sensor_pose else self.frame
        if anchor != body and anchor not in self.tree:
            raise self._miss_mount()
        if base and self.tree.find_path(body, anchor) is None:
            body = base
        fixed = self.options.map_frame or trajectory.parent
        above = self._find_path(fixed, trajectory.parent)
        below = self._find_path(body, anchor)
        note = f"poses from {trajectory.topic}, taken as those of {body!r}"
        if not (trajectory.child or base or self.options.sensor_pose):
            mount, own = f"`sensor_pose=({MountError.UNKNOWN})`", f"`base_frame={self.frame}`"
            note += (
                f", the laser itself: give {mount} if they are the robot's"
                if body == self.frame
                else f": give {own} if they are the sensor's own"
            )
        self.notes.append(note)
        return fixed, [*above, replace(trajectory, child=body), *below, *self._mount_on(anchor)]

    def _guess_body(self) -> str:
        """Guess whose poses a trajectory holds: the laser's own if tf does not know its frame."""
        if self.frame in self.tree:
            return self.tree.find_body(self.frame)
        if not self.options.sensor_pose:
            return self.frame
        return self.tree.find_base(self.frame) or frames.BASE_NAMES[0]

    def _find_base(self) -> str:
        """Find the frame that the given sensor pose is measured from."""
        wanted = self.options.base_frame
        if wanted and wanted not in self.tree:
            fix = f"`base_frame` takes {join_names(self.tree.frames)}"
            raise PoseError(f"no frame {wanted!r} in the log", fix=fix)
        if base := wanted or self.tree.find_base(self.frame):
            return base
        example = next(iter(self.tree.list_bases(self.frame)), self.tree.find_root(self.frame))
        found = f"which frame the laser is mounted on is not clear ({self.known})"
        raise PoseError(found, fix=f"name it: `base_frame={example}`")

    def _mount_on(self, anchor: str) -> list[Edge]:
        """Make the step from the body to a sensor whose pose the user gave."""
        if self.options.sensor_pose is None:
            return []
        if self.frame in self.tree:
            self.notes.append(f"the given sensor pose replaces the log's of {self.frame!r}")
        return [Edge(anchor, self.frame, Track.fixed(self.options.sensor_pose), Source.GIVEN)]

    def _find_path(self, upper: str, lower: str) -> list[Edge]:
        """Find the steps down from one frame to another; raises PoseError where there are none."""
        if upper == lower:
            return []
        if (steps := self.tree.find_path(upper, lower)) is not None:
            return steps
        if upper not in self.tree:
            is_given = upper == self.options.map_frame
            fix = "give one of these as `map_frame`, or leave it out" if is_given else ""
            raise PoseError(f"no frame {upper!r} in the log ({self.known})", fix=fix)
        found = f"no transform from {upper!r} to {lower!r} ({self.known})"
        root, top = self.tree.find_root(lower), upper
        if lower == self.frame and not find_moving(self.tree.find_path(root, lower) or []):
            bodies = (each for each in self.tree.bodies if self.tree.find_path(upper, each))
            top = next(bodies, upper)  # the sensor drives: it does not hang on the map
        fix = f"join them: `static_transforms={top},{root},X,Y,Z,ROLL,PITCH,YAW`"
        raise PoseError(found, fix=fix)

    def _miss_mount(self) -> PoseError:
        """Say that nothing tells where the laser sits, and how to give that."""
        found = f"no transform to the laser's frame {self.frame!r} ({self.known})"
        base = self.tree.find_base(self.frame)
        if base and self.alone:  # else a sensor pose would be that of every laser
            mount = f"`sensor_pose=({MountError.UNKNOWN})`"
            return MountError(found, fix=f"give its mount on {base}: {mount}")
        alike = [name for name in self.tree.frames if last_part(name) == self.frame]
        if alike and not base:  # one of each robot
            joint = f"`static_transforms={alike[0]},{self.frame},0,0,0,0,0,0`"
            fix = f"if it is {alike[0]!r}: {joint}, and `topics=TOPIC` of that robot alone"
            return PoseError(found, fix=fix)
        given = f"{base or 'BASE'},{self.frame},X,Y,Z,ROLL,PITCH,YAW"
        return PoseError(found, fix=f"give its mount: `static_transforms={given}`")

    def _miss_motion(self, root: str) -> PoseError:
        """Say that nothing moves on the way from a root to the laser, and how to mend that."""
        if bodies := self.tree.bodies:
            found = f"the laser's frame {self.frame!r} hangs on {root!r}, which is not connected to"
            fix = f"join them: `static_transforms={bodies[0]},{root},0,0,0,0,0,0`"
            return PoseError(f"{found} what moves: {join_names(bodies)}", fix=fix)
        found = f"tf only says where {self.frame!r} sits on {root!r}, and no odometry and no topic"
        return self._miss_poses(f"{found} of poses says where that went")

    def _miss_poses(self, found: str) -> PoseError:
        """Say that the scans have no poses, and why a topic that holds some is of no use."""
        stated = (it for it in self.sources.pose_topics if not _is_intention(it.topic))
        fix = "give a trajectory: `poses=FILE`"
        if bare := [edge.topic for edge in stated if not edge.track.stamp_ns.any()]:
            found = f"those on {join_names(bare)} have no times, as all of their stamps are zero"
            fix = "`stamps=record` takes the recorder's times"
        return PoseError(f"the scans have no poses: {found}", fix=fix)
