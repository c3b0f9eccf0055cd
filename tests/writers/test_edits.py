"""Edits are drawn where their corners say, and bad files of them are refused in one line."""

import json
import math
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from occmap.cells import OccupancyMap
from occmap.errors import UsageError
from occmap.writers.edits import Shape, apply_edits, cover, read_edits
from tests.writers.maps import map_of_places


def make_map(rows: int = 6, cols: int = 8) -> OccupancyMap:
    """A map of undecided cells of half a metre; its corner is at x -1, y 2."""
    log_odds = np.zeros((rows, cols), np.float32)
    return OccupancyMap(log_odds, np.ones((rows, cols), np.bool_), 0.5, (-1.0, 2.0))


def read(tmp_path: Path, *lines: str) -> tuple[Shape, ...]:
    """Read lines of edits as from a file."""
    path = tmp_path / "edits.csv"
    path.write_text("\n".join(lines))
    return read_edits(path)


def draw(tmp_path: Path, *lines: str) -> list[str]:
    """Draw lines of edits over that map; highest y first, as a person sees it."""
    made = apply_edits(make_map(), read(tmp_path, *lines))
    picture = np.full(made.shape, "?")
    picture[made.occupied], picture[made.free], picture[~made.observed] = "#", ".", " "
    return ["".join(row) for row in picture[::-1]]


def test_a_box_covers_the_cells_whose_middle_is_in_it(tmp_path: Path) -> None:
    # x from -0.5 to 0.6: middles -0.25, 0.25; y from 3.0 to 4.0: middles 3.25, 3.75.
    untouched, drawn = ["????????"] * 2, ["?..?????"] * 2
    assert draw(tmp_path, "free,box,-0.5,3.0,0.6,4.0") == untouched + drawn + untouched


def test_a_later_shape_goes_over_an_earlier_one_and_comments_are_nothing(tmp_path: Path) -> None:
    lines = "# rubbed out", "occupied,box,-1,2,3,5", "", "unknown,polygon,-1,2,1,2,1,3,-1,3 # here"
    assert draw(tmp_path, *lines) == ["########"] * 4 + ["    ####"] * 2


def test_a_slanted_polygon_follows_its_edge(tmp_path: Path) -> None:
    # Below the line from (-1, 2) to (3, 5): at a middle x the edge is at 2 + 0.75 (x + 1).
    expected = []
    for y in (4.75, 4.25, 3.75, 3.25, 2.75, 2.25):
        middles = (-0.75 + 0.5 * col for col in range(8))
        expected.append("".join("." if y < 2 + 0.75 * (x + 1) else "?" for x in middles))
    assert draw(tmp_path, "free,polygon,-1,2,3,2,3,5") == expected


def test_a_line_leaves_no_gap_to_slip_through(tmp_path: Path) -> None:
    drawn = draw(tmp_path, "occupied,line,-0.75,2.25,2.75,4.75")
    columns = ["".join(column) for column in zip(*drawn, strict=True)]
    assert all("#" in column for column in columns)
    for left, right in pairwise(columns):  # neighbours share a side
        assert any(a == b == "#" for a, b in zip(left, right, strict=True))


def test_a_wide_line_is_as_wide_as_it_says(tmp_path: Path) -> None:
    drawn = draw(tmp_path, "occupied,line,-1,3.5,3,3.5,2")  # 2 m: y 2.5 to 4.5
    assert drawn == ["????????", *["########"] * 4, "????????"]


def feature(kind: str, coordinates: Any, properties: Any) -> Any:
    geometry = {"type": kind, "coordinates": coordinates}
    return {"type": "Feature", "properties": properties, "geometry": geometry}


def test_geojson_says_the_same_as_lines(tmp_path: Path) -> None:
    hole = [[0, 3], [1, 3], [1, 4], [0, 4], [0, 3]]
    area = [[-1, 2], [3, 2], [3, 5], [-1, 5], [-1, 2]]
    across = [[-1, 2.25, 0], [3, 2.25, 0]]
    free, wall = {"class": "free"}, {"class": "occupied", "width": 0.1}
    single = feature("Polygon", [area, hole], free), feature("LineString", across, wall)
    many = feature("MultiPolygon", [[area, hole]], free), feature("MultiLineString", [across], wall)
    wanted = np.ones((6, 8), np.bool_)
    wanted[2:4, 2:4] = False  # the hole
    wanted[:1] = False  # the line
    for features in (single, many):  # as QGIS writes them, too
        text = json.dumps({"type": "FeatureCollection", "features": features})
        made = apply_edits(make_map(), read(tmp_path, text))
        assert (made.free == wanted).all()
        assert made.occupied[0].all()


def test_forbidden_shapes_leave_the_map_alone(tmp_path: Path) -> None:
    grid = make_map()
    shapes = read(tmp_path, "forbidden,box,-1,2,0,3", "forbidden,box,50,50,60,60")
    assert apply_edits(grid, shapes) is grid
    covered = cover(shapes, grid.box, grid.resolution)
    assert np.argwhere(covered).tolist() == [[0, 0], [0, 1], [1, 0], [1, 1]]


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("free,box,1,1,2", "line 1"),
        ("free,box,1,1,2,2\nfre,box,1,1,2,2", "line 2"),
        ("free,circle,1,1,2,2", "circle"),
        ("free,polygon,1,1,2,2", "polygon"),
        ("free,box,1,1,2,nan", "nan"),
        ("free,box,1,,2,3,4", "line 1"),
        ('{"features": null}', "GeoJSON"),
        ("occupied,line,0,0,5,0,-1", "-1"),
        ('{"features": 3', "GeoJSON"),
        ('{"features": [], "crs": {"properties": {"name": "urn:ogc:CRS84"}}}', "WGS 84"),
        ('{"features": [{"properties": {}, "geometry": null}]}', 'feature 1: {"prop'),
        *(
            (json.dumps({"features": [feature(kind, places, {"class": "free"})]}), "feature 1")
            for kind, places in (
                ("Polygon", [[[1], [2], [3]]]),
                ("MultiPolygon", []),
                ("Polygon", [[[0, 0], [math.inf, 1], [1, 0]]]),
                ("Point", [1, 2]),
            )
        ),
    ],
)
def test_what_is_no_shape_is_refused_with_its_place(tmp_path: Path, text: str, words: str) -> None:
    with pytest.raises(UsageError, match=r"edits\.csv") as caught:
        read(tmp_path, text)
    assert words in str(caught.value)
    assert caught.value.fix


def test_a_file_that_is_not_there_is_named(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match=r"nowhere\.csv"):
        read_edits(tmp_path / "nowhere.csv")


def test_parts_and_the_whole_agree_where_edges_lie_on_the_middles_of_cells(tmp_path: Path) -> None:
    corners = [(0.05 + 0.1 * a, 0.15 + 0.1 * b) for a, b in ((-7, 3), (2, -9), (11, 4), (-3, 17))]
    boxes = (f"free,box,{x:.2f},{y:.2f},{x + 0.7:.2f},{y + 0.4:.2f}" for x, y in corners)
    others = "occupied,line,-0.75,-1.25,1.75,1.75,0.2", "free,polygon,0,-1,2,-1,2,1"
    shapes = read(tmp_path, *boxes, *others)
    grid = map_of_places((40, 40), (-1.3, -1.7), (np.s_[:], 0.0))
    whole = apply_edits(grid, shapes).classes
    assert (whole == 1).any()
    for row in range(0, 40, 7):
        for col in range(0, 40, 9):
            rows, cols = slice(row, row + 7), slice(col, col + 9)
            part = apply_edits(grid.take(rows, cols), shapes)
            assert (part.classes == whole[rows, cols]).all()
