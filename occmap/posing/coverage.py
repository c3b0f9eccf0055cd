"""Coverage: what each pose source of a log knows, and when; for `occmap check`."""

from dataclasses import dataclass

from occmap.posing.frames import Edge, Source
from occmap.posing.sources import Sources


@dataclass(frozen=True, slots=True)
class Coverage:
    """One edge of the transform tree, or one topic of poses."""

    parent: str
    child: str
    """"" where the source does not name what moved."""
    source: Source
    topic: str
    samples: int
    static: bool
    """It is stated to hold at all times; the stamps mean nothing."""
    moves: bool
    start_ns: int
    end_ns: int
    largest_gap_s: float
    largest_step_m: float
    """Between neighbouring samples: a jump shows here."""
    largest_step_rad: float


def list_coverage(sources: Sources) -> list[Coverage]:
    """Describe the edges of the tree, by name, and then the poses of bodies that are in no edge."""
    edges = list(sources.tree.edges)
    chosen = [sources.trajectory] if sources.trajectory else []
    others = [edge for edge in (*chosen, *sources.pose_topics) if edge not in edges]
    return [_describe(edge) for edge in dict.fromkeys([*edges, *others])]


def _describe(edge: Edge) -> Coverage:
    track = edge.track
    return Coverage(
        parent=edge.parent,
        child=edge.child,
        source=edge.source,
        topic=edge.topic,
        samples=len(track),
        static=track.static,
        moves=track.moves,
        start_ns=int(track.stamp_ns[0]),
        end_ns=int(track.stamp_ns[-1]),
        largest_gap_s=float(track.interval_s.max(initial=0)),
        largest_step_m=float(track.step_m.max(initial=0)),
        largest_step_rad=float(track.step_rad.max(initial=0)),
    )
