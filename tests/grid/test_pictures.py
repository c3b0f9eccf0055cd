"""Small scenes as pictures: # was hit, . was seen free, % both, blank is unknown; cells of 1 m."""

import math
from collections import Counter
from textwrap import dedent

import numpy as np
import pytest

from occmap.grid import Lattice
from occmap.grid.tiles import GridSpec
from occmap.types import BEAM_UPDATES, Kind, Rays, Update
from tests.bench.plans import Box, cast_scans
from tests.grid import reference
from tests.grid.scans import Evidence, aim, make_rays, observe


def box(x: float, y: float, x_end: float, y_end: float) -> list[Box]:
    """The four walls of a room, of no thickness."""
    across = [(x, each, x_end, each) for each in (y, y_end)]
    return across + [(each, y, each, y_end) for each in (x, x_end)]


DOOR: list[Box] = [(4.5, -5.5, 4.5, -0.9), (4.5, 1.9, 4.5, 6.5), (10.5, -7.0, 10.5, 8.0)]
"""A wall with a door in it, and the far wall of the next room."""
BROKEN: list[Box] = [(5.5, -3.0, 5.5, -0.5), (5.5, 1.5, 5.5, 4.0)]
"""A wall with a hole, behind which nothing ever answers."""
LONG: list[Box] = [(2.5, 2.5, 24.5, 2.5)]
TWO_ROOMS: list[Box] = [*box(0.5, 0.5, 12.5, 6.5), (6.5, 0.5, 6.5, 3.5)]


def draw(evidence: Evidence) -> str:
    """Largest y first."""
    cells = evidence.first.keys() | evidence.second.keys()
    rows, cols = [row for row, _ in cells], [col for _, col in cells]

    def mark(cell: tuple[int, int]) -> str:
        return " #.%"[(cell in evidence.first) + 2 * (cell in evidence.second)]

    lines = [
        "".join(mark((row, col)) for col in range(min(cols), max(cols) + 1)).rstrip()
        for row in range(max(rows), min(rows) - 1, -1)
    ]
    return "\n".join(lines)


def look(
    place: tuple[float, float],
    degrees: tuple[float, float, float],
    walls: list[Box],
    kind_of_nothing: Kind = Kind.SKIP,
    limit: float = 0.0,
) -> Rays:
    """Scan walls from a place: first bearing, last and step (degrees); where no wall is, a beam
    sees `kind_of_nothing`, up to `limit`.
    """
    first, last, step = (math.radians(each) for each in degrees)
    bearings = first + step * np.arange(round((last - first) / step) + 1, dtype=np.float64)
    reached = cast_scans(np.array([(*place, 0.0)]), bearings, np.array(walls, np.float64))
    found, closed = np.isfinite(reached), (len(bearings) + 0.5) * step >= math.tau
    ends, kinds = np.where(found, reached, limit), np.where(found, Kind.HIT, kind_of_nothing)
    return make_rays(place, aim(first, step, len(bearings)), ends, kinds, full_circle=closed)


def check(batches: list[Rays], spec: GridSpec, picture: str) -> None:
    """The engine and the slow reference both draw the picture."""
    expected = dedent(picture).strip("\n")
    assert draw(observe(spec, batches)) == expected
    drawn = Evidence(Counter(), Counter())
    for rays in batches:
        for layer, seen in zip(drawn, reference.trace(spec, rays), strict=True):
            layer.update(seen)
    assert draw(drawn) == expected


@pytest.mark.parametrize("update", BEAM_UPDATES)
def test_square_room_from_its_middle(update: Update) -> None:
    rays = look((0.5, 0.5), (0, 359, 1), box(-3.5, -3.5, 4.5, 4.5))
    picture = """
        #########
        #.......#
        #.......#
        #.......#
        #.......#
        #.......#
        #.......#
        #.......#
        #########
    """
    check([rays], GridSpec(update, Lattice(1.0)), picture)


def test_nothing_behind_the_posts_of_a_door_is_called_free() -> None:
    rays = look((0.5, 0.5), (-44, 44, 2), DOOR)
    picture = """
            #
            #     #
           .#  ...#
          ..#.....#
        ..........#
          ..#.....#
           .#  ...#
            #     #
            #
    """
    check([rays], GridSpec(Update.POLYGON, Lattice(1.0)), picture)


def test_where_nothing_came_back_nothing_is_known() -> None:
    rays = look((0.5, 0.5), (-30, 30, 2), BROKEN)
    picture = """
           #
          .#
        ...#

        ...#
          .#
           #
    """
    check([rays], GridSpec(Update.POLYGON, Lattice(1.0)), picture)


def test_a_wall_at_grazing_incidence_is_closed_as_far_as_it_is_one_surface() -> None:
    rays = look((0.5, 0.5), (5, 60, 1), LONG)
    nearly = """
         ########## ## #  #   #
        ...........
    """
    closed = """
         ##################   #
        ...........
    """
    check([rays], GridSpec(Update.POLYGON, Lattice(1.0)), nearly)
    check([rays], GridSpec(Update.POLYGON, Lattice(1.0), jump=3.0), closed)
    check([rays], GridSpec(Update.POLYGON, Lattice(1.0), jump=3.0, border_gap=0), nearly)


def test_two_viewpoints_add_up_to_two_rooms() -> None:
    west = look((3.5, 2.5), (0, 358, 2), TWO_ROOMS)
    east = look((9.5, 2.5), (0, 358, 2), TWO_ROOMS)
    from_both = """
        #############
        #...........#
        #...........#
        #.....#.....#
        #.....#.....#
        #.....#.....#
        #############
    """
    check([west, east], GridSpec(Update.POLYGON, Lattice(1.0)), from_both)
