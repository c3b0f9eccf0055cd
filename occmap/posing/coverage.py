"""Coverage: what each pose source of a log knows, and when; for `occmap check`."""

from dataclasses import dataclass

from occmap.posing.frames import Source
from occmap.posing.sources import Sources


@dataclass(frozen=True, slots=True)
class Coverage:
    """One edge of the transform tree, or one topic of poses."""

    parent: str
    """Frame that the poses are in"""
    child: str
    """Frame whose poses these are; empty where the log does not say"""
    source: Source
    """Kind of source"""
    topic: str
    """Topic, or name of the trajectory file"""
    samples: int
    """Poses"""
    static: bool
    """It holds for all times"""
    moves: bool
    """The poses differ"""
    start_ns: int
    """Earliest stamp (ns)"""
    end_ns: int
    """Latest stamp (ns)"""
    largest_gap_s: float
    """Longest time from one pose to the next (s)"""
    largest_step_m: float
    """Longest way from one pose to the next (m)"""
    largest_step_rad: float
    """Largest turn from one pose to the next (rad)"""


def list_coverage(sources: Sources) -> list[Coverage]:
    """Describe the edges of the tree, by name, and then the poses of bodies that are in no edge."""
    edges = list(sources.tree.edges)
    chosen = [sources.trajectory] if sources.trajectory else []
    others = [edge for edge in (*chosen, *sources.pose_topics) if edge not in edges]
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
        for edge in dict.fromkeys([*edges, *others])
    ]
