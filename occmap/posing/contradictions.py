"""Contradictions between the transforms of a log, one sentence each."""

from collections import defaultdict
from collections.abc import Iterable, Iterator
from graphlib import CycleError, TopologicalSorter

import numpy as np

from occmap.posing.frames import Edge, FrameTree, Source
from occmap.posing.tracks import differ
from occmap.wording import join_names

MOST_LOOPS = 8
"""Loops that are listed at most."""


def list_contradictions(edges: Iterable[Edge], tree: FrameTree) -> Iterator[str]:
    """Say where the edges of a log contradict each other, and which of them count."""
    yield from _list_doubles(edges, tree)
    parents: dict[str, list[str]] = defaultdict(list)
    for edge in tree.edges:
        if edge.source is not Source.GIVEN:
            parents[edge.child].append(edge.parent)
    several = [
        f"{child} ({', '.join(above)})" for child, above in parents.items() if len(above) > 1
    ]
    if several:
        yield f"frames that have several parents: {join_names(several)}; the shortest way counts"
    yield from _list_loops(parents)


def _list_doubles(edges: Iterable[Edge], tree: FrameTree) -> Iterator[str]:
    """Say which fixed transforms are stated differently by another topic."""
    doubles: dict[tuple[str, str], list[str]] = defaultdict(list)
    stated: dict[tuple[str, str], list[Edge]] = defaultdict(list)
    for edge in edges:
        if edge.source is Source.TF:
            stated[edge.parent, edge.child].append(edge)
    for used in tree.edges:
        same = stated[used.parent, used.child] if used.source is Source.TF else []
        if len(same) > 1 and any(edge.track.static for edge in same):
            tracks = [edge.track for edge in same]
            positions = np.concatenate([track.position for track in tracks])
            if differ(positions, np.concatenate([track.quaternion for track in tracks])):
                topics = join_names(sorted({edge.topic for edge in same}))
                doubles[topics, used.topic].append(f"{used.parent} -> {used.child}")
    for (topics, topic), names in doubles.items():
        yield f"{topics} differ on {join_names(names)}: {topic} counts"


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
