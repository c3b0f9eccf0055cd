"""The transform tree: the frames of a log, and the ways between them.

The names that REP 105 gives tell which frame is the map and which is the robot.
"""

from collections import defaultdict
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from enum import IntEnum
from functools import cached_property
from itertools import chain, combinations
from os.path import commonprefix
from pathlib import Path
from typing import Self, TypeAlias

from occmap.errors import PoseError
from occmap.posing.tracks import Track

FIXED_NAMES = ("map", "odom")
BASE_NAMES = ("base_link", "base_footprint")
"""The names that REP 105 gives to the map and to the robot"""
STILL_NAMES = (*FIXED_NAMES, "world", "camera_init")
"""Frames that are no sensor's: FAST-LIO and its kin write clouds in such a one"""
MOST_ABOVE = 100
"""Frames above another that are looked at: those of a robot are some ten deep."""


class Source(IntEnum):
    """Who states a transform; the lowest number is believed."""

    GIVEN = 0
    """The user."""
    TF = 1
    ODOMETRY = 2
    """A message about one moving body."""


@dataclass(frozen=True, eq=False)
class Edge:
    """Where `child` was in `parent`, from one source; a step on the way from frame to frame."""

    parent: str
    child: str
    track: Track
    source: Source
    topic: str = ""
    inverted: bool = False
    """The track is of the parent in the child: somebody recorded it the other way round"""

    def invert(self) -> Self:
        """Make the way back, from the child to the parent."""
        return replace(self, parent=self.child, child=self.parent, inverted=not self.inverted)


class FrameTree:
    """Frames and the edges between them; what people record need not be a tree.

    A child's edges come from one source only: what the user gives goes before tf, and tf before
    odometry, unless nothing in tf moves. Of several edges between the same two frames the one with
    the most samples stays. A child may have several parents, and cycles do no harm: the shortest
    way is taken.
    """

    def __init__(self, edges: Iterable[Edge]) -> None:
        self._up: dict[str, list[Edge]] = defaultdict(list)
        self.edges = tuple(_choose_edges(edges))
        for edge in self.edges:
            self._up[edge.child].append(edge)
        self._steps = defaultdict(list, {child: up.copy() for child, up in self._up.items()})
        """To each frame, from those above it and then from those below"""
        for edge in self.edges:
            self._steps[edge.parent].append(edge.invert())
        self.frames: tuple[str, ...] = tuple(sorted(self._steps))

    def __contains__(self, frame: str) -> bool:
        return frame in self._steps

    @cached_property
    def bodies(self) -> list[str]:
        """The frames that drive: they move, and above them only `odom` does.

        So neither the correction of odometry nor a turning wheel counts. Where nothing moves, a
        frame that was sent again and again counts.
        """
        edges = [edge for edge in self.edges if "odom" not in last_part(edge.child).lower()]
        moving = [edge for edge in edges if edge.track.moves]
        driven = moving or [edge for edge in edges if not edge.track.static]
        children = {edge.child for edge in driven}
        top = {e.child for e in driven if children.isdisjoint(self.list_ancestors(e.parent))}
        return sorted(top)

    def list_ancestors(self, frame: str) -> list[str]:
        """List a frame and those above it, nearest first."""
        found = [frame]
        for below in found:  # it grows meanwhile
            if len(found) > MOST_ABOVE:
                break
            found += [e.parent for e in self._up.get(below, ()) if e.parent not in found]
        return found

    def find_root(self, frame: str) -> str:
        """Find the nearest frame above that has no parent, rather one that the frame moves in.

        In a cycle, the farthest frame counts.
        """
        above = self.list_ancestors(frame)
        roots = [name for name in above if not self._up.get(name)] or above[-1:]
        moving = (root for root in roots if find_moving(self.find_path(root, frame) or ()))
        return next(moving, roots[0])

    def find_path(self, upper: str, lower: str) -> list[Edge] | None:
        """Find the shortest way down from one frame to another; None where there is none.

        Of equally short ways the one that climbs from `lower` is preferred, then names decide.
        """
        down: dict[str, Edge] = {}  # from each frame above `lower`, the step on the way to it
        queue = [lower]
        for frame in queue:  # it grows meanwhile
            if frame == upper:
                break
            for step in self._steps.get(frame, ()):
                if step.parent != lower and step.parent not in down:
                    down[step.parent] = step
                    queue.append(step.parent)
        path: list[Edge] = []
        while upper != lower:
            if upper not in down:
                return None
            path.append(down[upper])
            upper = path[-1].child
        return path

    def choose_fixed(self, frame: str) -> str:
        """Choose the frame to map in: `map`, else `odom`, else the root above a scan's frame.

        The plain names may be anywhere in the scan's tree; with a namespace (`robot1/map`) only
        above the scan, for another robot's map may hang in the same tree.
        """
        above = self.list_ancestors(frame)
        plain = (name for name in FIXED_NAMES if self.find_path(name, frame) is not None)
        named = (each for name in FIXED_NAMES for each in above if last_part(each) == name)
        return next(chain(plain, named, [self.find_root(frame)]))

    def list_bases(self, frame: str) -> list[str]:
        """List the frames that a sensor may be mounted on; only one where that is clear."""
        for name in BASE_NAMES:
            if name in self:
                return [name]
        for name in BASE_NAMES:
            if namesakes := [each for each in self.frames if last_part(each) == name]:
                space = frame.rpartition("/")[0]
                return [each for each in namesakes if each.rpartition("/")[0] == space] or namesakes
        return self.bodies

    def find_base(self, frame: str) -> str:
        """Find the frame that a sensor is mounted on; "" where that is not clear."""
        bases = self.list_bases(frame)
        return bases[0] if len(bases) == 1 else ""

    def find_body(self, frame: str) -> str:
        """Find the body that carries a frame: the lowest above it that moves, or the root.

        A trajectory that does not name its body is taken to be of this one.
        """
        root = self.find_root(frame)
        moving = find_moving(self.find_path(root, frame) or [])
        return moving[-1].child if moving else root


def last_part(frame: str) -> str:
    """Strip the namespace: the last part of `robot1/odom` is `odom`."""
    return frame.rsplit("/", 1)[-1]


def join_topic(recording: str | Path, topic: str) -> str:
    """Name a topic of another recording, by the path of that."""
    return f"{recording}:{topic}"


def split_topic(name: str) -> tuple[str, str]:
    """Tell the path of another recording, "" for the log itself, and its topic."""
    recording, _, topic = name.rpartition(":")
    return recording, topic


Space: TypeAlias = tuple[str, ...]
"""A namespace of topics: that of `/site/robot1/tf` is site, robot1; that of `/tf` is empty"""
Moved: TypeAlias = dict[tuple[str, str], Track]
"""What moves in a namespace, by the frames"""


def find_space(topic: str) -> Space:
    """Find the namespace that a topic is in, whatever recording it is of."""
    return tuple(split_topic(topic)[1].strip("/").split("/")[:-1])


def find_strangers(edges: Iterable[Edge], topics: Iterable[str]) -> list[Edge]:
    """Find the transforms that belong to other robots than scans on some topics do.

    Scans go by the namespace of transforms that their topic shares most with. One that moves the
    same frames in another way is another robot's, and nothing in it counts. But the root is there
    for all robots: of it only the transforms that the scans' own namespace has, too, do not count.

    Raises
    ------
    PoseError
        The scans belong to several robots.
    """
    tf = [(edge, find_space(edge.topic)) for edge in edges if edge.source is Source.TF]
    moved = defaultdict[Space, Moved](dict)
    for edge, space in tf:
        if not edge.track.static:
            moved[space][edge.parent, edge.child] = edge.track
    if len(moved) < 2:
        return []
    homes = {_find_home(find_space(topic), moved): topic for topic in topics}
    for one, other in combinations(homes, 2):
        if _contradict(moved[one], moved[other]):
            found = f"{homes[one]} and {homes[other]} go by transforms that contradict each other"
            fix = f"map one robot at a time, as with `topics={homes[one]}`, and merge their `.npz`"
            raise PoseError(found, fix=fix)
    own = {name: track for home in homes for name, track in moved[home].items()}
    others = {space for space in moved if _contradict(own, moved[space])}
    return [it for it, space in tf if space in others and (space or (it.parent, it.child) in own)]


def _contradict(one: Moved, other: Moved) -> bool:
    """Whether two namespaces move one of the same frames, each in its own way."""
    return any(not one[name].repeats(other[name]) for name in one.keys() & other.keys())


def _find_home(space: Space, spaces: Iterable[Space]) -> Space:
    """Find which namespace shares most with another one, and of equal ones the outermost."""
    shared = {each: len(commonprefix([each, space])) for each in spaces}  # noqa: RUF071  of names
    return max(shared, key=lambda each: (shared[each], -len(each)))


def _choose_edges(edges: Iterable[Edge]) -> list[Edge]:
    """Keep the edges that are believed, in an order that does not depend on that in the log."""
    chosen: dict[tuple[str, str], Edge] = {}
    believed: dict[str, Source] = {}
    ranked = sorted(edges, key=lambda e: (e.source, e.track.static, -len(e.track), e.topic))
    tf_moves = any(edge.track.moves for edge in ranked if edge.source is not Source.ODOMETRY)
    for edge in ranked:
        source = believed.setdefault(edge.child, edge.source)
        if edge.source == source or (edge.track.moves and not tf_moves):
            chosen.setdefault((edge.parent, edge.child), edge)
    return sorted(chosen.values(), key=lambda edge: (edge.parent, edge.child))


def find_moving(steps: Sequence[Edge]) -> list[Edge]:
    """Find the steps that move; where none does, the one that was sent again and again, if any."""
    moving = [step for step in steps if step.track.moves]
    sampled = [step for step in steps if not step.track.static]
    if moving or not sampled:
        return moving
    return [max(sampled, key=lambda step: len(step.track))]
