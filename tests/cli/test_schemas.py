"""A schema says of a type what its fields are, and refuses what is not of the type."""

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

CORNER = {
    "type": "object",
    "description": "A place.",
    "properties": {"x": {"type": "number", "description": "Where it is (m)"}},
    "required": ["x"],
    "additionalProperties": False,
}
ROOM = {
    "type": "object",
    "description": "A room of a house.",
    "properties": {
        "size": {"type": ("number", "null"), "description": "How large it is, wall to wall (m2)"},
        "corners": {"type": "array", "items": CORNER, "description": "Its corners"},
        "colour": {
            "anyOf": [{"enum": ["red", "blue"]}, {"type": "null"}],
            "description": "Of its walls",
        },
    },
    "required": ["size", "corners", "colour"],
    "additionalProperties": False,
}


def schema() -> dict[str, Any]:
    return make_schema("house", House, Sale)


def test_values_become_what_json_has() -> None:
    assert to_plain(HOUSE) == PRINTED


def test_a_schema_is_the_type_with_the_texts_below_its_fields() -> None:
    found = schema()
    assert found["title"] == "occmap house --json"
    assert found["description"] == "A house."
    assert found["properties"]["rooms"]["items"] == ROOM
    names = ["schema", "name", "rooms", "people", "lit", "age", "extent", "sold"]
    assert found["required"] == list(found["properties"]) == names
    assert found["properties"]["schema"]["const"] == "occmap/house/1"
    assert found["properties"]["name"]["description"] == "What it is called"
    assert found["properties"]["lit"] == {
        "type": "number",
        "minimum": 0,
        "maximum": 1,
        "description": "Share of the rooms that are lit",
    }
    assert found["properties"]["extent"]["maxItems"] == 4
    assert found["properties"]["people"]["additionalProperties"] == {
        "type": "integer",
        "minimum": 0,
    }


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
    ],
)
def test_what_is_not_of_the_type_is_refused(wrong: dict[str, Any]) -> None:
    validator = Draft202012Validator(with_lists(schema()))
    right = {"schema": "occmap/house/1", **PRINTED, "sold": True}
    validator.validate(right)
    assert not validator.is_valid(right | wrong)


def with_lists(part: Any) -> Any:
    """The same as JSON has it."""
    if isinstance(part, dict):
        return {key: with_lists(value) for key, value in part.items()}
    return [with_lists(value) for value in part] if isinstance(part, tuple | list) else part
