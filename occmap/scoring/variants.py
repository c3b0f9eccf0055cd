"""What is compared: combinations of an update and a sensor model."""

from collections.abc import Sequence
from dataclasses import dataclass, fields
from itertools import product

from occmap.evidence.manifest import describe_profile
from occmap.sensor.models import SensorModel, make_model, parse_model
from occmap.types import Update

DEFAULT_MODELS = ("counting", "simple", "quadratic")


@dataclass(frozen=True)
class Variant:
    """One way to make a map."""

    update: Update
    model: SensorModel

    @property
    def name(self) -> str:
        """The update, the model, and the parameters that are not at their defaults."""
        return f"{self.update} {shorten_model(self.model)}"

    @property
    def evidence(self) -> str:
        """Equal for variants that differ only in what they make of the same evidence."""
        return f"{self.update} {describe_profile(self.model) or 'counts'}"


def shorten_model(model: SensorModel) -> str:
    """Write a model as --model takes it, without the parameters that are at their defaults."""
    default = make_model(model.name, {})
    changed = [
        f"{field.name}={getattr(model, field.name):g}"
        for field in fields(model)  # type: ignore[arg-type]  # a dataclass
        if getattr(model, field.name) != getattr(default, field.name)
    ]
    return model.name + (":" + ",".join(changed) if changed else "")


def combine(updates: Sequence[Update], models: Sequence[SensorModel]) -> list[Variant]:
    """Combine every update with every model, each once; where none is given, with the usual ones.

    Raises
    ------
    UsageError
        A model does not load.
    """
    models = models or [parse_model(text) for text in DEFAULT_MODELS]
    pairs = product(updates or list(Update), models)
    return list({each.name: each for each in (Variant(*pair) for pair in pairs)}.values())
