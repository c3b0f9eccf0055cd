"""The transform tree: which frames a log knows, and the ways between them."""

from collections import defaultdict, deque
from collections.abc import Iterable
from dataclasses import dataclass
from enum import IntEnum

from occmap.posing.tracks import Track


class Source(IntEnum):
    """Who says so; the lowest number is believed."""

    GIVEN = 0
    """The user."""
    TF = 1
    ODOMETRY = 2
    """A message about one moving body."""


@dataclass(frozen=True, eq=False)
class Edge:
    """Where `child` was in `parent`, from one source."""

    parent: str
    child: str
    track: Track
    source: Source
    topic: str = ""


@dataclass(frozen=True, eq=False)
class Step:
    """An edge on the way from an upper frame to a lower one."""

    edge: Edge
    inverted: bool = False

    @property
    def upper(self) -> str:
        """The frame that the step starts from."""
        return self.edge.child if self.inverted else self.edge.parent

    @property
    def lower(self) -> str:
        """The frame that the step leads to."""
        return self.edge.parent if self.inverted else self.edge.child


class FrameTree:
    """Frames and the edges between them; what people record need not be a tree.

    A child's edges come from one source only: what the user gives goes before tf, and tf before
    odometry. Of several edges between the same two frames the one with the most samples stays.
    A child may keep several parents, and cycles harm nothing: ways are the shortest.
    """

    def __init__(self, edges: Iterable[Edge]) -> None:
        self._up: dict[str, list[Edge]] = defaultdict(list)
        self._down: dict[str, list[Edge]] = defaultdict(list)
        for edge in _choose_edges(edges):
            self._up[edge.child].append(edge)
            self._down[edge.parent].append(edge)
        self.frames: tuple[str, ...] = tuple(sorted(self._up.keys() | self._down.keys()))

    def __contains__(self, frame: str) -> bool:
        return frame in self._up or frame in self._down

    @property
    def edges(self) -> tuple[Edge, ...]:
        """Every edge, by the names of its frames."""
        return tuple(edge for frame in self.frames for edge in self._down.get(frame, ()))

    def list_ancestors(self, frame: str) -> list[str]:
        """List a frame and all above it, nearest first."""
        found = {frame: None}
        queue = deque([frame])
        while queue:
            for edge in self._up.get(queue.popleft(), ()):
                if edge.parent not in found:
                    found[edge.parent] = None
                    queue.append(edge.parent)
        return list(found)

    def find_root(self, frame: str) -> str:
        """Find the nearest frame above that has no parent; in a cycle, the farthest frame."""
        above = self.list_ancestors(frame)
        return next((name for name in above if not self._up.get(name)), above[-1])

    def find_path(self, upper: str, lower: str) -> list[Step] | None:
        """Find the shortest way down from one frame to another; None where there is none.

        Of equally short ways the one that climbs from `lower` is preferred, then names decide.
        """
        if upper not in self or lower not in self:
            return None
        onward: dict[str, Step | None] = {lower: None}
        queue = deque([lower])
        while queue and upper not in onward:
            frame = queue.popleft()
            for step in self._list_steps_to(frame):
                if step.upper not in onward:
                    onward[step.upper] = step
                    queue.append(step.upper)
        if upper not in onward:
            return None
        path = []
        step_down = onward[upper]
        while step_down is not None:
            path.append(step_down)
            step_down = onward[step_down.lower]
        return path

    def _list_steps_to(self, frame: str) -> list[Step]:
        climb = [Step(edge) for edge in self._up.get(frame, ())]
        return climb + [Step(edge, inverted=True) for edge in self._down.get(frame, ())]


def last_part(frame: str) -> str:
    """Strip the namespace: `robot1/odom` is an `odom`."""
    return frame.rsplit("/", 1)[-1]


def _choose_edges(edges: Iterable[Edge]) -> list[Edge]:
    """Keep the believed edges, in an order that does not depend on the log's."""
    ranked = sorted(edges, key=_rank)
    chosen: dict[tuple[str, str], Edge] = {}
    believed: dict[str, Source] = {}
    for edge in ranked:
        source = believed.setdefault(edge.child, edge.source)
        if edge.source == source:
            chosen.setdefault((edge.parent, edge.child), edge)
    return sorted(chosen.values(), key=lambda edge: (edge.parent, edge.child))


def _rank(edge: Edge) -> tuple[int, bool, int, str]:
    return edge.source, edge.track.static, -len(edge.track), edge.topic
