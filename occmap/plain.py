"""Results as JSON values, and the types that describe them.

`occmap schema` works out a JSON Schema from such types, and takes descriptions from the text below
each field.
"""

import math
from dataclasses import fields, is_dataclass
from enum import Enum
from typing import Annotated, Any, TypeAlias, TypedDict

Count: TypeAlias = Annotated[int, ("minimum", 0)]
Share: TypeAlias = Annotated[float, ("minimum", 0), ("maximum", 1)]
Finite: TypeAlias = Annotated[float, ("type", ("number", "null"))]
"""A number that becomes null where it is infinite or not a number."""


class Told(TypedDict):
    """What a command says beside its numbers."""

    notes: list[str]
    """What a user should know, one sentence each, as on stderr"""
    damage: list[str]
    """Those of the notes that tell of damage to a log"""


def to_plain(value: Any) -> Any:  # noqa: PLR0911  a line for each kind
    """Turn a result into JSON values; a number that is not finite becomes None.

    The underscore of a name such as `class_`, which keeps it apart from a word of Python, is left
    out.
    """
    if isinstance(value, dict):
        return {str(key).removesuffix("_"): to_plain(item) for key, item in value.items()}
    if is_dataclass(value):
        return {each.name: to_plain(getattr(value, each.name)) for each in fields(value)}
    if isinstance(value, tuple) and hasattr(value, "_asdict"):
        return to_plain(value._asdict())
    if isinstance(value, list | tuple):
        return [to_plain(item) for item in value]
    if isinstance(value, Enum):
        return value.name.lower()
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value
