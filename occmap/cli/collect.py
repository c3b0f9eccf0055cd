"""From the values of a command line to the options of the pipeline, group by group."""

from collections.abc import Mapping, Sequence
from dataclasses import fields
from difflib import get_close_matches
from pathlib import Path
from typing import Any

from occmap.command import MODEL_PARAMETERS, spell_flag
from occmap.errors import UsageError
from occmap.keywords import take
from occmap.options import DEFAULT_UPDATE, BuildOptions, choose_model
from occmap.sensor.models import SensorModel, describe_model, parse_model
from occmap.types import Update

Values = Mapping[str, Any]
"""What click has read, by the names of the options."""


def collect_options(update: Update, values: Values) -> BuildOptions:
    """Gather all that a user chose about a map.

    Raises
    ------
    UsageError
        A value is out of its range, or does not fit another.
    """
    model = collect_model(values, choose_model(update))
    return take(BuildOptions, {**values, "update": update, "model": model})


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
    known = [field.name for field in fields(parse_model(name))]  # type: ignore[arg-type]  # as above
    flags = ", ".join(spell_flag(key) for key in MODEL_PARAMETERS if key in known)
    for key in given:
        if key not in known:
            raise UsageError(
                f"{spell_flag(key)} does not go with the model {name}",
                fix=f"it has {flags}; see `occmap models` for --model",
            )
    pairs = [text.partition(":")[2], *(f"{key}={value!r}" for key, value in given.items())]
    return parse_model(f"{name}:{','.join(filter(None, pairs))}")


def split_words(words: Sequence[str]) -> tuple[Update, list[Path]]:
    """Tell the update, where one is named, from the logs.

    Raises
    ------
    UsageError
        There is no log, or the first word looks like a mistyped update.
    """
    updates = [update.value for update in Update]
    update = DEFAULT_UPDATE
    if words and words[0] in updates:
        update, words = Update(words[0]), words[1:]
    elif words and words[0].isalpha() and not Path(words[0]).exists():
        close = get_close_matches(words[0].lower(), updates, n=1)
        if close:
            found = f"{words[0]!r} is neither a log nor an update"
            raise UsageError(found, fix=f"did you mean {close[0]!r}?")
    if not words:
        raise UsageError("no log is given", fix="type: occmap build LOG -o map.pgm")
    return update, [Path(word) for word in words]
