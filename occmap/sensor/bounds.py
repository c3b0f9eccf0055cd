"""Which parameters a sensor model can have, and what a model may say about the finished map."""

from dataclasses import fields
from typing import Any, Protocol, runtime_checkable

from occmap.errors import require

LEAST_WEIGHT, MOST_WEIGHT = 1e-6, 1e6
"""In observations."""
NO_CLAMP = {"clamp_min": 0.0, "clamp_max": 1.0}
"""Bounds that bound nothing."""


@runtime_checkable
class Clamped(Protocol):
    """A model of any kind that bounds what a finished map says of observed cells."""

    @property
    def clamp_min(self) -> float:
        """No cell is less probably occupied than this; 0: no bound."""

    @property
    def clamp_max(self) -> float:
        """No cell is more probably occupied than this; 1: no bound."""


@runtime_checkable
class Deciding(Protocol):
    """A model that says from what probability on a cell is called occupied, and below it free."""

    @property
    def cut(self) -> float:
        """Strictly between 0 and 1; models without one decide at even odds."""


@runtime_checkable
class Spreading(Protocol):
    """A model of counts that lets a hit speak for the cells around it as well."""

    @property
    def spread(self) -> float:
        """The share of a hit that counts for each of the cells beside it; its square at corners."""


def check_spread(spread: float) -> None:
    """Refuse a share by which a hit would say more of its neighbours than of its own cell.

    Raises
    ------
    UsageError
        It does not lie between 0 and 1.
    """
    found = f"spread {spread} is not a share of a hit"
    require(0 <= spread <= 1, found, "give 0 to 1, such as 0.1")


def check_probabilities(model: Any) -> None:
    """Refuse a model whose probabilities are not strictly between 0 and 1.

    Raises
    ------
    UsageError
        Naming the first such parameter.
    """
    for field in fields(model):
        value = getattr(model, field.name)
        if field.name in ("prior", "cut") or field.name.startswith("p_"):
            found = f"{field.name} {value} is not a probability between 0 and 1"
            require(0 < value < 1, found, f"give a value such as `{field.name}={field.default}`")


def check_prior(prior: float, free: tuple[str, float], occupied: tuple[str, float]) -> None:
    """Refuse a prior beyond what evidence says: seeing a cell free would make it occupied.

    Parameters
    ----------
    free, occupied
        The names of what says that a cell is so, and its probability of being occupied.

    Raises
    ------
    UsageError
        The prior does not lie between the two.
    """
    (low_name, low), (high_name, high) = free, occupied
    found = f"prior {prior} does not lie between {low_name} {low:g} and {high_name} {high:g}"
    fix = "a miss must lower a cell and a hit raise it: give a prior between the two"
    require(low <= prior <= high, f"{found}: evidence would turn round", fix)


def check_clamp(model: Clamped) -> None:
    """Refuse bounds that leave a cell nothing to be.

    Raises
    ------
    UsageError
        They are not on either side of 0.5, or not probabilities.
    """
    low, high = model.clamp_min, model.clamp_max
    found = f"clamp_min {low} and clamp_max {high} do not lie on either side of 0.5, from 0 to 1"
    require(0 <= low < 0.5 < high <= 1, found, "try `clamp_max=0.97`, or leave them out")


def check_weight(name: str, weight: float) -> None:
    """Refuse a weight that no sum of observations can be taken with.

    Raises
    ------
    UsageError
        It is not positive, or extreme.
    """
    fix = f"give {LEAST_WEIGHT:g} to {MOST_WEIGHT:g}, such as `model=counting:{name}=1`"
    require(LEAST_WEIGHT <= weight <= MOST_WEIGHT, f"{name} {weight} is not possible", fix)
