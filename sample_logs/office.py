"""The office that the robot drives through: its walls, what a laser sees of them, and the truth."""

from pathlib import Path
from typing import NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

Floats: TypeAlias = NDArray[np.float64]
Mask: TypeAlias = NDArray[np.bool_]

RESOLUTION = 0.05
"""Side of a cell of the floor plan (m)."""
FACE_INSET = 0.02
"""Faces lie this far inside their box, so that 1 cm noise leaves most hits in the wall's cells."""


class Box(NamedTuple):
    """A solid rectangle (m), drawn along cell borders; see `FACE_INSET`."""

    x0: float
    y0: float
    x1: float
    y1: float


BUILDING = Box(-4, -3, 12, 9)
GLASS = (Box(-3, 8.9, 0.4, 9), Box(0.5, 8.9, 3.5, 9))
"""The laser sees no glass: beams leave the building."""
WALLS = (
    Box(-4, -3, 12, -2.9),  # outside: south, west, east, north with the glass front's post
    Box(-4, -3, -3.9, 9),
    Box(11.9, -3, 12, 9),
    Box(-4, 8.9, -3, 9),
    Box(0.4, 8.9, 0.5, 9),
    Box(3.5, 8.9, 12, 9),
    Box(-4, 2.4, -1.6, 2.5),  # corridor: south side with three doors
    Box(-0.7, 2.4, 3.4, 2.5),
    Box(4.3, 2.4, 8.6, 2.5),
    Box(9.5, 2.4, 12, 2.5),
    Box(-4, 4.1, 0, 4.2),  # corridor: north side with two doors
    Box(1, 4.1, 6.5, 4.2),
    Box(7.5, 4.1, 12, 4.2),
    Box(1.5, -3, 1.6, 2.5),  # between the rooms; the second has a passage
    Box(6.3, -3, 6.4, -1),
    Box(6.3, 0, 6.4, 2.5),
    Box(4.2, 4.1, 4.3, 9),
    Box(8.5, 5.8, 8.55, 9),  # a partition one cell thin
    Box(-3.9, -2.9, -3.4, -1.7),  # cabinet, crate
    Box(10.4, -1.2, 11.2, -0.4),
)
PILLAR = (-1.2, 6.6, 0.3)
"""Centre x, y and radius (m)."""
_IN_WEST = [(-3.2, 3.3), (-1.15, 3.3), (-1.15, 0.8)]
_WEST = [(-2.6, -0.6), (-1.2, -2), (0.6, -1), (-1.15, 0.8), (-1.15, 3.3)]
_NORTH = [(0.5, 3.3), (0.5, 5.2), (-2.6, 5.4), (-2.8, 7.8), (1.8, 7.8), (2.6, 5.6), (0.5, 5.2)]
_MIDDLE = [(0.5, 3.3), (3.85, 3.3), (3.85, 0.8), (3, -1.6), (5.2, -1.9), (5.4, -0.5)]
_EAST = [(7.4, -0.5), (9.6, -2.1), (9.6, 0.6), (10.9, 1.2), (9.05, 1.2), (9.05, 3.3), (11.2, 3.3)]
_LAB = [(7, 3.3), (7, 5), (5.4, 5.4), (5.4, 7.9), (7.4, 7.9), (7.4, 5), (10.2, 5), (10.2, 7.9)]
WAY = np.array([*_IN_WEST, *_WEST, *_NORTH, *_MIDDLE, *_EAST, *_LAB], np.float64)
"""Corners of the drive through all rooms, (N, 2) m."""


def office_faces() -> Floats:
    """Return every face that a beam can meet, (N, 4): x0, y0, x1, y1."""
    return np.array([face for box in WALLS for face in box_faces(_inset(box))])


def box_faces(box: Box) -> list[tuple[float, float, float, float]]:
    """Return the four sides of a box as segments."""
    x0, y0, x1, y1 = box
    return [(x0, y0, x1, y0), (x1, y0, x1, y1), (x1, y1, x0, y1), (x0, y1, x0, y0)]


def cast_rays(
    origin: tuple[float, float], bearings: Floats, faces: Floats, circle: tuple[float, float, float]
) -> Floats:
    """Return the distance (B,) to what each beam meets first, inf where it meets nothing.

    Parameters
    ----------
    origin
        Where the beams start (m).
    bearings
        (B,) rad
    faces
        (N, 4) m, segments x0, y0, x1, y1
    circle
        Centre x, y and radius (m).
    """
    dx, dy = np.cos(bearings)[:, None], np.sin(bearings)[:, None]
    to_faces = _distance_to_faces(faces - np.tile(origin, 2), dx, dy)
    to_circle = _distance_to_circle(
        (circle[0] - origin[0], circle[1] - origin[1]), circle[2], dx, dy
    )
    nearest: Floats = np.hstack([to_faces, to_circle]).min(axis=1)
    return nearest


def _distance_to_faces(faces: Floats, dx: Floats, dy: Floats) -> Floats:
    """Return (B, N) distances along beams from the origin, inf where they do not meet."""
    x, y = faces[:, 0], faces[:, 1]
    ex, ey = faces[:, 2] - x, faces[:, 3] - y
    with np.errstate(divide="ignore", invalid="ignore"):  # beams parallel to a face
        distance = (x * ey - y * ex) / (dx * ey - dy * ex)
        along = (x * dy - y * dx) / (dx * ey - dy * ex)
    return np.where((distance > 0) & (along >= 0) & (along <= 1), distance, np.inf)


def _distance_to_circle(
    centre: tuple[float, float], radius: float, dx: Floats, dy: Floats
) -> Floats:
    """Return (B, 1) distances along beams that start outside, inf where they pass by."""
    ahead = centre[0] * dx + centre[1] * dy
    square = radius**2 - (centre[0] * dy - centre[1] * dx) ** 2
    distance = ahead - np.sqrt(np.maximum(square, 0))
    return np.where((square > 0) & (distance > 0), distance, np.inf)


def write_floor_plan(path: Path) -> None:
    """Write the truth as a PGM with its YAML: faces black, rooms white, all else unknown grey.

    Unknown is what no laser can tell: the outside, the glass, and the inside of what is solid.
    """
    pixels = draw_floor_plan()
    rows, cols = pixels.shape
    path.write_bytes(f"P5\n{cols} {rows}\n255\n".encode("ascii") + pixels[::-1].tobytes())
    path.with_suffix(".yaml").write_text(
        f"image: {path.name}\nmode: trinary\nresolution: {RESOLUTION}\n"
        f"origin: [{BUILDING.x0}, {BUILDING.y0}, 0.0]\n"
        "negate: 0\noccupied_thresh: 0.65\nfree_thresh: 0.196\n",
        encoding="ascii",
        newline="\n",
    )


def draw_floor_plan() -> NDArray[np.uint8]:
    """Return the pixels of the floor plan (H, W), row 0 = lowest y."""
    x = np.arange(BUILDING.x0 + RESOLUTION / 2, BUILDING.x1, RESOLUTION)
    y = np.arange(BUILDING.y0 + RESOLUTION / 2, BUILDING.y1, RESOLUTION)[:, None]
    solid = np.hypot(x - PILLAR[0], y - PILLAR[1]) <= PILLAR[2]
    for box in WALLS:
        solid |= _covers(box, x, y)
    glass = np.zeros_like(solid)
    for box in GLASS:
        glass |= _covers(box, x, y)
    wall = solid & ~_erode(solid)
    return np.where(wall, 0, np.where(solid | glass, 205, 254)).astype(np.uint8)


def _covers(box: Box, x: Floats, y: Floats) -> Mask:
    """Whether cells with these centres lie in a box."""
    covered: Mask = (x > box.x0) & (x < box.x1) & (y > box.y0) & (y < box.y1)
    return covered


def _erode(solid: Mask) -> Mask:
    """Return the cells whose eight neighbours are solid too."""
    padded = np.pad(solid, 1)
    rows, cols = solid.shape
    shifts = [(i, j) for i in range(3) for j in range(3)]
    eroded: Mask = np.all([padded[i : i + rows, j : j + cols] for i, j in shifts], axis=0)
    return eroded


def _inset(box: Box) -> Box:
    return Box(box.x0 + FACE_INSET, box.y0 + FACE_INSET, box.x1 - FACE_INSET, box.y1 - FACE_INSET)
