"""Maps whose cells have a class, as text: top line = highest y."""

from pathlib import Path

import numpy as np

from occmap.cells import CellClass
from occmap.difference.maps import ClassMap, Place
from occmap.types import UInt8

CLASSES = {"?": CellClass.NEITHER, ".": CellClass.FREE, "#": CellClass.OCCUPIED}
AT_ZERO = Place(0.5, 0.0, 0.0)


def draw_map(art: str, place: Place | None = AT_ZERO, name: str = "m.pgm") -> ClassMap:
    """Build a map from a drawing."""
    rows = [[CLASSES[letter] for letter in line] for line in art.split()]
    return ClassMap(Path(name), np.array(rows[::-1], np.uint8), place)


def write_art(classes: UInt8) -> str:
    """The drawing; undecided and unknown cells look alike."""
    letters = {int(kind): letter for letter, kind in CLASSES.items()}
    return " ".join("".join(letters[cell] for cell in row) for row in classes[::-1].tolist())
