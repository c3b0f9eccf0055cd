import itertools

import pytest

from occmap.posing.frames import Edge, FrameTree, Source, last_part
from occmap.posing.tracks import Track
from occmap.types import Pose

TRACK = Track.fixed(Pose.planar(0, 0, 0))


def edge(parent: str, child: str, source: Source = Source.TF, topic: str = "/tf") -> Edge:
    return Edge(parent, child, TRACK, source, topic)


def tree_of(*names: str) -> FrameTree:
    return FrameTree(edge(upper, lower) for upper, lower in (name.split(">") for name in names))


def path_of(tree: FrameTree, upper: str, lower: str) -> list[str] | None:
    """The steps from a frame to one below it; < is one that was recorded the other way round."""
    steps = tree.find_path(upper, lower)
    if steps is None:
        return None
    return [f"{step.parent}{'<' if step.inverted else '>'}{step.child}" for step in steps]


def test_the_path_goes_from_the_upper_frame_to_the_lower() -> None:
    tree = tree_of("odom>base", "map>odom", "base>laser", "base>camera")
    assert path_of(tree, "map", "laser") == ["map>odom", "odom>base", "base>laser"]
    assert path_of(tree, "map", "map") == []
    assert tree.list_ancestors("laser") == ["laser", "base", "odom", "map"]
    assert tree.find_root("laser") == "map"


def test_a_frame_that_hangs_below_the_robot_can_be_the_map() -> None:
    tree = tree_of("base>laser", "base>map")
    assert path_of(tree, "map", "laser") == ["map<base", "base>laser"]


def test_there_is_no_path_between_two_trees() -> None:
    tree = tree_of("odom>base", "other>laser")
    assert path_of(tree, "odom", "laser") is None
    assert path_of(tree, "nowhere", "laser") is None


def test_a_cycle_hangs_nothing() -> None:
    tree = tree_of("a>b", "b>c", "c>a", "c>laser")
    assert path_of(tree, "b", "laser") == ["b>c", "c>laser"]
    assert path_of(tree, "elsewhere", "laser") is None
    assert tree.find_root("laser") in tree.frames


@pytest.mark.parametrize("order", list(itertools.permutations(range(3))))
def test_two_parents_are_both_ways_whatever_the_order_of_the_log(order: tuple[int, ...]) -> None:
    names = ["map>base", "odom>base", "base>laser"]
    tree = tree_of(*(names[i] for i in order))
    assert path_of(tree, "map", "laser") == ["map>base", "base>laser"]
    assert path_of(tree, "odom", "laser") == ["odom>base", "base>laser"]


def test_odometry_gives_no_parent_to_what_tf_places() -> None:
    tree = FrameTree([edge("world", "base", Source.ODOMETRY, "/odom"), edge("odom", "base")])
    assert tree.frames == ("base", "odom")


def test_odometry_fills_what_tf_lacks() -> None:
    tree = FrameTree([edge("odom", "base", Source.ODOMETRY, "/odom"), edge("base", "laser")])
    assert path_of(tree, "odom", "laser") == ["odom>base", "base>laser"]


def test_what_the_user_gives_goes_before_tf() -> None:
    tree = FrameTree([edge("base", "laser"), edge("mast", "laser", Source.GIVEN)])
    assert path_of(tree, "mast", "laser") == ["mast>laser"]
    assert "base" not in tree


@pytest.mark.parametrize("topics", [("/a", "/b"), ("/b", "/a")])
def test_of_two_equal_odometry_topics_the_name_decides(topics: tuple[str, str]) -> None:
    tree = FrameTree(edge("odom", "base", Source.ODOMETRY, topic) for topic in topics)
    assert [found.topic for found in tree.edges] == ["/a"]


def test_the_last_part_of_a_name_is_without_its_namespace() -> None:
    assert [last_part(name) for name in ("odom", "robot1/odom")] == ["odom", "odom"]
