"""From what evidence keeps of a build's options back to the options: `write_value` undone."""

from dataclasses import fields, is_dataclass
from types import NoneType
from typing import Any, TypeVar, get_args, get_origin, get_type_hints

from occmap.errors import MapError, OccmapError
from occmap.keywords import drop_none
from occmap.options import BuildOptions
from occmap.sensor.models import parse_model

Value = TypeVar("Value")


def recall_options(plain: dict[str, Any], where: str) -> BuildOptions:
    """Turn what `describe_build` wrote of the options of a build back into options.

    What changes nothing about the evidence (threads, what was resumed) is at its default; a
    trajectory file is a name without its folder. An option that was not there yet has its default.

    Parameters
    ----------
    where
        The evidence file, for errors.

    Raises
    ------
    MapError
        This occmap does not know an option, or a value of it.
    """
    model_text = plain.get("model")
    try:
        chosen = {name: value for name, value in plain.items() if name != "model"}
        return make_group(BuildOptions, chosen, model=parse_model(str(model_text)))
    except (OccmapError, TypeError, ValueError, AttributeError, OverflowError) as error:
        raise MapError(
            f"the options of a build in it cannot be read ({error})",
            where=where,
            fix="use the occmap that built it, or build it again",
        ) from None


def make_group(group: type[Value], plain: dict[str, Any], **others: Any) -> Value:
    """Make a group of options from values of JSON; `others` are taken as they are.

    Raises
    ------
    TypeError, ValueError, AttributeError, UsageError
        It has no option of such a name, or none that takes such a value.
    """
    kinds = get_type_hints(group)
    unknown = sorted(plain.keys() - {field.name for field in fields(group)})  # type: ignore[arg-type]  # dataclass
    if unknown:
        raise ValueError(f"no option is called {unknown[0]!r}")
    made = {name: make_value(kinds[name], value) for name, value in plain.items()}
    return group(**made, **others)


def make_value(kind: Any, plain: Any) -> Any:
    """Turn a value of JSON back into one of a type.

    Raises
    ------
    TypeError, ValueError, AttributeError, UsageError
        It is not of that type.
    """
    if is_dataclass(kind) and isinstance(kind, type):
        return make_group(kind, plain)
    if plain is None and NoneType in get_args(kind):
        return None
    kind = drop_none(kind)
    if get_origin(kind) is tuple:
        return make_tuple(get_args(kind), plain)
    if issubclass(kind, tuple):  # a NamedTuple
        return kind(*make_tuple(tuple(get_type_hints(kind).values()), plain))
    return kind(plain)


def make_tuple(kinds: tuple[Any, ...], plain: list[Any]) -> tuple[Any, ...]:
    """Make a tuple, of one type repeated or with a type for each of its values.

    Raises
    ------
    ValueError
        It is longer or shorter; or as `make_value`.
    """
    if kinds[1:] == (Ellipsis,):
        return tuple(make_value(kinds[0], each) for each in plain)
    return tuple(make_value(kind, each) for kind, each in zip(kinds, plain, strict=True))
