"""Results as JSON values, and the types that describe them.

`occmap schema` works out a JSON Schema from such types, and takes descriptions from the text below
each field.
"""

import ast
import inspect
import math
import sys
import textwrap
from dataclasses import fields, is_dataclass
from enum import Enum
from typing import Annotated, Any, TypeAlias, get_type_hints, is_typeddict

Count: TypeAlias = Annotated[int, ("minimum", 0)]
Share: TypeAlias = Annotated[float, ("minimum", 0), ("maximum", 1)]
Finite: TypeAlias = Annotated[float, ("type", ("number", "null"))]
"""A number that becomes null where it is infinite or not a number."""

HIDDEN = {"printed": ""}
"""Metadata of a dataclass field that is not part of what is printed"""
IN_PLACE = {"printed": "*"}
"""Metadata of a dataclass field whose own fields are printed in its place"""


def printed_as(name: str) -> dict[str, str]:
    """Make the metadata of a dataclass field that is printed by another name."""
    return {"printed": name}


class Printed:
    """What a command finds, and prints: its fields, but for the HIDDEN ones."""

    def to_json(self) -> dict[str, Any]:
        """Give it as values that JSON has; a number that is not finite becomes None."""
        plain: dict[str, Any] = to_plain(self)
        return plain


def list_printed(kind: Any) -> dict[str, str]:
    """List the fields of a dataclass that are printed, and by which names."""
    names = {each.name: each.metadata.get("printed", each.name) for each in fields(kind)}
    return {name: printed for name, printed in names.items() if printed}


def to_plain(value: Any) -> Any:
    """Turn a result into JSON values; a number that is not finite becomes None."""
    if is_dataclass(value):
        parts: dict[str, Any] = {}
        for name, printed in list_printed(value).items():
            part = to_plain(getattr(value, name))
            parts |= part if printed == "*" else {printed: part}
        return parts
    if isinstance(value, tuple) and hasattr(value, "_asdict"):
        value = value._asdict()
    if isinstance(value, dict):
        return {str(key): to_plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [to_plain(item) for item in value]
    if isinstance(value, Enum):
        return value.name.lower()
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value


def read_texts(kind: Any) -> dict[str, str]:
    """Read the text below each field of a type and of those that it extends.

    An install without sources has no texts: there each is the name of the field.
    """
    try:
        (tree,) = ast.parse(textwrap.dedent(inspect.getsource(kind))).body
    except OSError:
        return {name: name for name in get_type_hints(kind)}
    assert isinstance(tree, ast.ClassDef)
    known = vars(sys.modules[kind.__module__])
    texts: dict[str, str] = {}
    for base in (known.get(ast.unparse(base)) for base in tree.bases):
        if is_typeddict(base) or is_dataclass(base):
            texts |= read_texts(base)
    for field, text in zip(tree.body, tree.body[1:], strict=False):
        if isinstance(field, ast.AnnAssign) and isinstance(text, ast.Expr):
            texts[ast.unparse(field.target)] = " ".join(ast.literal_eval(text.value).split())
    return texts
