"""The sensor model that a command line asks for."""

from collections.abc import Mapping
from dataclasses import fields
from typing import Any

from occmap.command import MODEL_PARAMETERS, spell_flag
from occmap.errors import UsageError
from occmap.evidence import Described, read_model
from occmap.sensor.models import SensorModel, describe_model, parse_model

Values = Mapping[str, Any]
"""What click has read, by the names of the options."""


def collect_model(values: Values, usual: SensorModel) -> SensorModel:
    """Make the sensor model; a shorthand such as --p-hit goes before what --model says.

    `usual` is the one to take where --model says nothing.

    Raises
    ------
    UsageError
        No such model, or a parameter that it does not have or allow.
    """
    text = values["model"] or describe_model(usual)
    name = text.partition(":")[0]
    given = {key: values[key] for key in MODEL_PARAMETERS if values[key] is not None}
    known = [field.name for field in fields(parse_model(name))]  # type: ignore[arg-type]  # a dataclass
    flags = ", ".join(spell_flag(key) for key in MODEL_PARAMETERS if key in known)
    for key in given:
        if key not in known:
            raise UsageError(
                f"{spell_flag(key)} does not go with the model {name}",
                fix=f"it has {flags}; see `occmap models` for --model",
            )
    pairs = [text.partition(":")[2], *(f"{key}={value!r}" for key, value in given.items())]
    return parse_model(f"{name}:{','.join(filter(None, pairs))}")


def choose_saved_model(evidence: Described, values: Values) -> SensorModel | None:
    """Make the model that the user wants, if any; a shorthand changes the one of the evidence.

    Raises
    ------
    UsageError
        No such model, or a parameter that it does not have or allow.
    """
    if all(values.get(name) is None for name in ("model", *MODEL_PARAMETERS)):
        return None
    return collect_model(values, read_model(evidence))
