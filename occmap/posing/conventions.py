"""Conventions: which frame is the map and which the robot, by the names that REP 105 gives."""

from occmap.posing.chain import find_driven
from occmap.posing.frames import FrameTree, last_part

FIXED_NAMES = ("map", "odom")
BASE_NAMES = ("base_link", "base_footprint")


def choose_fixed(tree: FrameTree, frame: str) -> str:
    """Choose the frame to map in: `map`, else `odom`, else the root above a scan's frame.

    The plain names may be anywhere in the scan's tree; with a namespace (`robot1/map`) only
    above the scan, for another robot's map may hang in the same tree.
    """
    for name in FIXED_NAMES:
        if tree.find_path(name, frame) is not None:
            return name
    above = tree.list_ancestors(frame)
    for name in FIXED_NAMES:
        for ancestor in above:
            if last_part(ancestor) == name:
                return ancestor
    return tree.find_root(frame)


def list_bases(tree: FrameTree, frame: str) -> list[str]:
    """List the frames that a sensor may be mounted on; only one where that is clear."""
    for name in BASE_NAMES:
        if name in tree:
            return [name]
    for name in BASE_NAMES:
        namesakes = tree.namesakes.get(name, [])
        kin = [other for other in namesakes if _namespace(other) == _namespace(frame)]
        if namesakes:
            return kin or namesakes
    return tree.bodies


def find_body(tree: FrameTree, frame: str) -> str:
    """Find the body that carries a frame of the tree: the lowest above it that moves, or the root.

    A trajectory that does not name its body is taken to be of this one.
    """
    root = tree.find_root(frame)
    driven = find_driven(tree.find_path(root, frame) or [])
    return driven.lower if driven else root


def _namespace(frame: str) -> str:
    return frame.rpartition("/")[0]
