"""Inverse sensor models: what an observation says about a cell, as log-odds.

Every model starts from a prior and adds independent evidence (Elfes 1989; Thrun, Burgard, Fox 2005,
ch. 9): l = l0 + sum(logit(p_i) - l0). A model is a frozen dataclass; its fields are its parameters.
Observations of one cell are not independent, and sums of thousands are surer than any sensor is; so
a model may bound the result, as OctoMap's clamping thresholds do (Hornung et al. 2013), though only
when a map is rendered: evidence stays whole, and adds up in any order.

The quadratic model is p = (1 + O - V) / 2, where V falls from 1 at the sensor to 0 where the hit
begins, and O rises to 1 at the measured range r and falls again. The depth of a hit is epsilon to
either side of r. Where both are 0 a beam says nothing. Its functions are tabulated for the kernels.
"""

from dataclasses import asdict, dataclass, fields
from functools import partial
from typing import Any, ClassVar, Protocol, runtime_checkable

import numpy as np

from occmap.cells import Decision, to_log_odds
from occmap.choices import Form, check_bounds, option
from occmap.errors import UsageError, require
from occmap.plugins import list_plugins, load_plugin, load_plugins, suggest
from occmap.types import Float64


class Model(Protocol):
    """What every model has."""

    name: ClassVar[str]
    description: ClassVar[str]

    @property
    def prior(self) -> float:
        """Probability of a cell that nothing observed."""


@runtime_checkable
class CountModel(Model, Protocol):
    """A model that needs to know only how often a cell was hit and how often missed."""

    def log_odds(self, hits: Float64, misses: Float64) -> Float64:
        """Log-odds of being occupied, in the shape of the counts."""


@runtime_checkable
class RadialModel(Model, Protocol):
    """A model whose evidence depends on the distance between a cell and the measured range."""

    def depth(self, resolution: float) -> float:
        """How far before and behind the range the hit reaches (m)."""

    def free(self, u: Float64) -> Float64:
        """Probability of a cell before the hit; u = (d / (r - depth))^2 in [0, 1)."""

    def hit(self, w: Float64) -> Float64:
        """Probability of a cell about the range; w = |d - r| / depth in [0, 1]."""


SensorModel = CountModel | RadialModel

NO_CLAMP = {"clamp_min": 0.0, "clamp_max": 1.0}
"""Bounds that bound nothing."""
UNSAID = {"cut": 0.5, "spread": 0.0, **NO_CLAMP}
"""What holds where a model has no such parameter"""
NEUTRAL = {**NO_CLAMP, "repeat_from": 0.0}
"""Values that change nothing, which no text names."""
PARAMETERS = {
    "p_hit": ("P", "simple: probability of occupied, given one hit."),
    "p_miss": ("P", "simple: probability of occupied, given one miss."),
    "epsilon": ("M", "quadratic: half the depth of a hit."),
    "p_min": ("P", "quadratic: keep each observation within [P, 1 - P]."),
    "prior": ("P", "Probability of occupied before any observation."),
    "cut": ("P", "A cell is occupied above this probability, or share of hits, free below."),
    "spread": ("SHARE", "How much of a hit counts for each cell beside it."),
    "clamp_min": ("P", "Lowest probability of an observed cell."),
    "clamp_max": ("P", "Highest probability of an observed cell."),
}
"""Those that can be typed as flags of their own: what stands for the value, and the help"""

SUREST = 1 - 2**-53
"""The largest chance below 1 that a float64 holds"""

probability = partial(option, bounds=(1e-9, 1 - 1e-6))
share = partial(option, bounds=(0, 1))
weight = partial(option, bounds=(1e-6, 1e6))
low_clamp = partial(option, NO_CLAMP["clamp_min"], bounds=(0, 0.499))
high_clamp = partial(option, NO_CLAMP["clamp_max"], bounds=(0.501, 1))
"""The kinds of parameters that models have; weights are in observations"""


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


@dataclass(frozen=True)
class SimpleModel:
    """Each hit and each miss counts the same, wherever it was made."""

    name: ClassVar[str] = "simple"
    description: ClassVar[str] = "end cell occupied, cells before it free, each at a fixed odds"

    p_hit: float = probability(0.7)
    """Probability that a cell is occupied, given one hit"""
    p_miss: float = probability(0.4)
    """Probability that a cell is occupied, given one miss"""
    prior: float = probability(0.5)
    cut: float = probability(0.5)
    """A cell is called occupied where its probability is above this, free where it is below"""
    spread: float = share(0.08)
    """The share of a hit that counts for each of the four cells beside it; its square at corners"""
    clamp_min: float = low_clamp()
    clamp_max: float = high_clamp()

    def __post_init__(self) -> None:
        check_bounds(self)
        fix = "a hit must speak more for occupied than a miss: try `p_hit=0.7` `p_miss=0.4`"
        found = f"p_miss {self.p_miss} is not below p_hit {self.p_hit}"
        require(self.p_miss < self.p_hit, found, fix)
        check_prior(self.prior, ("p_miss", self.p_miss), ("p_hit", self.p_hit))

    def log_odds(self, hits: Float64, misses: Float64) -> Float64:
        """l0 + hits (logit(p_hit) - l0) + misses (logit(p_miss) - l0)."""
        prior = to_log_odds(self.prior)
        hit, miss = to_log_odds(self.p_hit) - prior, to_log_odds(self.p_miss) - prior
        return prior + hits * hit + misses * miss


@dataclass(frozen=True)
class CountingModel:
    """How often a cell stopped a beam of all the times that it was looked at."""

    name: ClassVar[str] = "counting"
    description: ClassVar[str] = "share of hits among all observations (Beta posterior mean)"

    prior: float = probability(0.5)
    strength: float = weight(0.02)
    """How many observations the prior weighs; the fewer, the more the first ones are believed"""
    hit_weight: float = weight(1.0)
    """How many misses a hit weighs: above 1 keeps walls that beams graze"""
    cut: float = probability(0.32)
    """A cell is called occupied where its share of hits is above this: a wall that is missed costs
    more than one that is not there, so one hit outweighs two misses"""
    spread: float = share(0.08)
    """The share of a hit that counts for each of the four cells beside it; its square at corners"""
    clamp_min: float = low_clamp()
    clamp_max: float = high_clamp()
    ceiling: float = option(0.8, bounds=(1e-6, 1))
    """The chance that a beam stops in a cell which stopped all beams before it; see `calibrate`"""
    doubt: float = share(0.02)
    """A share of hits as small as this means half of what it says, and a smaller one less"""
    repeat_from: float = option(NEUTRAL["repeat_from"], bounds=(0, 1e6))
    """From so many looks at a cell one hit is not believed, and from five times as many two are
    not; 0: every hit is"""

    def __post_init__(self) -> None:
        check_bounds(self)

    def log_odds(self, hits: Float64, misses: Float64) -> Float64:
        """Log-odds of what `calibrate` makes of (w hits + s prior) / (w hits + misses + s).

        w is the weight of a hit, s the strength of the prior; without calibration that is the
        posterior mean.
        """
        if self.repeat_from:
            looks = hits + misses
            alone = (looks >= self.repeat_from) & (hits < 2)
            alone |= (looks >= 5 * self.repeat_from) & (hits < 3)
            hits, misses = np.where(alone, 0, hits), np.where(alone, looks, misses)
        occupied = self.hit_weight * hits + self.strength * self.prior
        free = misses + self.strength * (1 - self.prior)
        if self.ceiling == 1 and self.doubt == 0:
            return np.log(occupied / free)
        chance = self.calibrate(occupied / (occupied + free))
        return np.log(chance / (1 - chance))

    def calibrate(self, share: Float64) -> Float64:
        """The chance that the next beam stops in a cell: ceiling share (1 + d) share / (share + d).

        d is the doubt. Looks at a cell are not independent, and poses are off by part of a cell, so
        that a share of hits is too sure. Both numbers were learned from every fifth scan of nine
        logs. The chance grows with the share, so that it changes no class.
        """
        believed = (1 + self.doubt) * share / (share + self.doubt)
        return np.minimum(self.ceiling * share * believed, SUREST)


@dataclass(frozen=True)
class QuadraticModel:
    """Elfes' model: p = (1 + O - V) / 2, with quadratic falls of free (V) and occupied (O).

    The range r includes the hit offset (half a cell), as for every model: O peaks there.
    """

    name: ClassVar[str] = "quadratic"
    description: ClassVar[str] = (
        "p = (1 + O - V) / 2: free falls off with distance, hits have depth"
    )

    epsilon: float = option(0.0, bounds=(0, 100))  # m: no wall is thicker
    """Half the depth of a hit (m); 0 means half a cell"""
    p_min: float = option(0.4, bounds=(1e-9, 0.499))
    """The probability of one observation is kept within [p_min, 1 - p_min]"""
    prior: float = probability(0.5)
    cut: float = probability(0.5)
    """A cell is called occupied where its probability is above this, free where it is below"""
    clamp_min: float = low_clamp()
    clamp_max: float = high_clamp()

    def __post_init__(self) -> None:
        check_bounds(self)
        check_prior(self.prior, ("p_min", self.p_min), ("1 - p_min", 1 - self.p_min))

    def depth(self, resolution: float) -> float:
        """Epsilon, or half a cell."""
        return self.epsilon or resolution / 2

    def free(self, u: Float64) -> Float64:
        """(1 - V) / 2, where V = 1 - u, within [p_min, 1 - p_min]."""
        return np.clip(u / 2, self.p_min, 1 - self.p_min)

    def hit(self, w: Float64) -> Float64:
        """(1 + O) / 2, where O = 1 - w^2, within [p_min, 1 - p_min]."""
        return np.clip(1 - w**2 / 2, self.p_min, 1 - self.p_min)


def find_decision(model: SensorModel) -> Decision:
    """Find above what probability a model calls a cell occupied, and below what it is free."""
    cut = get_parameter(model, "cut")
    if calibrate := getattr(model, "calibrate", None):
        cut = float(calibrate(np.array(cut)))
    return Decision(cut, cut)


def get_parameter(model: SensorModel, name: str) -> float:
    """Get a parameter that a model may have: one of `UNSAID`."""
    return float(getattr(model, name, UNSAID[name]))


def make_model(name: str, parameters: dict[str, float]) -> SensorModel:
    """Make an installed model by its name.

    Raises
    ------
    UsageError
        No such model, no such parameter, or a value out of its range.
    """
    if (model_class := load_plugin("occmap.models", name)) is None:
        known = [entry.name for entry in list_plugins("occmap.models")]
        if name in known:
            raise UsageError(f"the model {name} does not load", fix="`occmap models` says why")
        raise UsageError(f"no model is called {name!r}", fix=suggest(name, known, "occmap models"))
    known = list_parameters(model_class)
    for parameter in (each for each in parameters if each not in known):
        loaded, _ = load_plugins("occmap.models")
        owners = [other for other, kind in loaded.items() if parameter in list_parameters(kind)]
        choose = "".join(f"choose `model={owner}`, which has it; " for owner in owners[:1])
        found = f"the model {name} has no parameter {parameter!r}"
        raise UsageError(found, fix=f"{choose}{name} has {', '.join(known)}")
    model: SensorModel = model_class(**parameters)
    found = f"the model {name} has the prior {model.prior}"
    require(0 < model.prior < 1, found, "give one between 0 and 1")
    return model


def list_parameters(model: Any) -> list[str]:
    """Name the parameters of a model or of its class."""
    return [field.name for field in fields(model)]


def describe_model(model: Any) -> str:
    """Write a model as `parse_model` reads it, without values that change nothing."""
    kept = (f"{key}={value}" for key, value in asdict(model).items() if NEUTRAL.get(key) != value)
    return f"{model.name}:{','.join(kept)}"


def shorten_model(model: Any) -> str:
    """Write a model as `parse_model` reads it, without parameters that are at their defaults."""
    usual = asdict(type(model)())
    changed = [f"{name}={value:g}" for name, value in asdict(model).items() if value != usual[name]]
    return f"{model.name}:{','.join(changed)}" if changed else str(model.name)


def parse_model(text: str) -> SensorModel:
    """Make a model from text such as `simple:p_hit=0.8,p_miss=0.3`.

    Raises
    ------
    UsageError
        As `make_model`, or the text is not of that form.
    """
    name, _, rest = text.partition(":")
    parameters = {}
    for pair in filter(None, rest.split(",")):
        key, _, value = pair.partition("=")
        try:
            parameters[key.strip()] = float(value)
        except ValueError:
            found = f"{pair!r} is not a parameter of a model"
            raise UsageError(found, fix="write NAME:KEY=NUMBER,KEY=NUMBER") from None
    return make_model(name.strip(), parameters)


def _read_model(value: Any) -> SensorModel:
    """Make a model of text, or take one as it is; raises TypeError for anything else."""
    if isinstance(value, str):
        return parse_model(value)
    if isinstance(value, type) or not isinstance(value, SensorModel):
        raise TypeError
    return value


MODEL = Form(_read_model, 'text such as "simple:p_hit=0.8", or a model')
"""What is given where an option is a model"""
