"""What is compared: combinations of an update and a sensor model."""

from collections.abc import Sequence
from dataclasses import dataclass, fields

from occmap.evidence.manifest import describe_profile
from occmap.options import choose_model
from occmap.sensor.models import SensorModel, make_model, parse_model
from occmap.types import Update

DEFAULT_MODELS = ("simple", "quadratic")
"""Beside the one that an update is used with"""


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
    """Write a model as `model` takes it, without the parameters that are at their defaults."""
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
    others = models or [parse_model(text) for text in DEFAULT_MODELS]
    variants = [
        Variant(update, model)
        for update in updates or list(Update)
        for model in ([] if models else [choose_model(update)]) + list(others)
    ]
    return list({each.name: each for each in variants}.values())
