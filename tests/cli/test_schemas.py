"""A schema says of a type what its fields are, and refuses what is not of the type."""

import json
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Any, Literal, NamedTuple

import pytest
from jsonschema import Draft202012Validator

from occmap.cells import Box
from occmap.cli.lists import make_schema
from occmap.report import HIDDEN, Count, Finite, Share, printed_as, to_plain


class Colour(StrEnum):
    RED = "red"
    BLUE = "blue"


class Corner(NamedTuple):
    """A place."""

    x: float
    """Where it is (m)"""


@dataclass(frozen=True)
class Room:
    """A room of a house."""

    size: Finite
    """How large it is,
    wall to wall (m2)"""
    corners: tuple[Corner, ...]
    """Its corners"""
    paint: Colour | None = field(metadata=printed_as("colour"))
    """Of its walls"""
    key: object = field(default=None, metadata=HIDDEN)


@dataclass(frozen=True)
class Named:
    """What has a name."""

    name: str
    """What it is called"""


@dataclass(frozen=True)
class House(Named):
    """A house."""

    rooms: list[Room]
    """Its rooms"""
    people: dict[str, Count]
    """Who lives there, by age"""
    lit: Share
    """Share of the rooms that are lit"""
    age: Literal["old", "new"]
    """How old it is"""
    extent: Box
    """Lowest x and y, highest x and y (m)"""


@dataclass(frozen=True)
class Sale:
    """What an agent adds."""

    sold: bool
    """It is sold"""


HOUSE = House(
    name="ours",
    rooms=[Room(float("nan"), (Corner(1.0), Corner(2.0)), Colour.BLUE), Room(9.5, (), None)],
    people={"children": 2},
    lit=0.5,
    age="old",
    extent=(0.0, 0.0, 4.0, 5.0),
)

PRINTED = {
    "name": "ours",
    "rooms": [
        {"size": None, "corners": [{"x": 1.0}, {"x": 2.0}], "colour": "blue"},
        {"size": 9.5, "corners": [], "colour": None},
    ],
    "people": {"children": 2},
    "lit": 0.5,
    "age": "old",
    "extent": [0.0, 0.0, 4.0, 5.0],
}

SCHEMA = make_schema("house", House, Sale)


def test_values_become_what_json_has() -> None:
    assert to_plain(HOUSE) == PRINTED


def test_a_schema_is_the_type_with_the_texts_below_its_fields() -> None:
    fields, room = SCHEMA["properties"], SCHEMA["properties"]["rooms"]["items"]
    assert (SCHEMA["title"], SCHEMA["description"]) == ("occmap house --json", "A house.")
    assert list(fields) == ["schema", *PRINTED, "sold"]
    assert fields["schema"]["const"] == "occmap/house/1"
    assert fields["name"]["description"] == "What it is called"
    assert room["description"] == "A room of a house."
    assert room["properties"]["size"]["description"] == "How large it is, wall to wall (m2)"


@pytest.mark.parametrize(
    "wrong",
    [
        {"name": 1},
        {"name": None},
        {"rooms": [{"size": "large", "corners": [], "colour": None}]},
        {"rooms": [{"size": 1.0, "corners": [], "colour": "green"}]},
        {"rooms": [{"size": 1.0, "corners": [{"x": 1.0, "y": 2.0}], "colour": None}]},
        {"rooms": [{"size": 1.0, "corners": []}]},
        {"people": {"children": -1}},
        {"people": {"children": 1.5}},
        {"lit": 1.5},
        {"age": "odd"},
        {"extent": [0.0, 0.0, 4.0]},
        {"sold": 1},
        {"news": 1},
        {"extent": [0.0, 0.0, 4.0, 5.0, 6.0]},
        {"lit": -0.5},
    ],
)
def test_what_is_not_of_the_type_is_refused(wrong: dict[str, Any]) -> None:
    validator = Draft202012Validator(json.loads(json.dumps(SCHEMA)))
    right = {"schema": "occmap/house/1", **PRINTED, "sold": True}
    validator.validate(right)
    assert not validator.is_valid(right | wrong)
