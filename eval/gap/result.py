"""The results of a diagnosis as plain records: the report and `report.json` are made from these alone."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping, Sequence
from typing import Literal, NamedTuple, TypeVar

import msgspec
import numpy as np

from inclined_landing.eval.gap import thresholds
from inclined_landing.models import effects
from inclined_landing.models.base.schema import Real, Share, Table
from inclined_landing.models.vehicle import Vehicle

T = TypeVar("T")
Verdict = Literal["effects", "nothing", "unknown", "undecided"]
VERSION = 1  # of report.json
HORIZON = 1.0  # s, after which the simulation of a log restarts at the measured state
_NOT_IN_REPORT = {"corrected", "growth"}  # a vehicle file, and the curves of a figure
REFERENCE = "reference/vehicle.toml"  # in a report's folder: the vehicle diagnosed, if not shipped


def plain(record: object) -> dict:
    """Return a record as dicts, lists, strings and numbers."""
    return msgspec.to_builtins(record, enc_hook=lambda one: one.tolist())


def from_plain(table: object, kind: type[T]) -> T:
    """Return the record of `plain`, with finite arrays. Raises ValidationError for another table."""
    return msgspec.convert(table, kind, dec_hook=_finite)


def _finite(kind: type, values: object) -> np.ndarray:
    result = np.array(values, float)
    if kind is not np.ndarray or not np.isfinite(result).all():
        raise ValueError("expected a list of finite numbers")
    return result


class Quantity(NamedTuple):
    """A quantity with its 95 % interval."""

    value: float
    ci95: tuple[float, float]


@dataclasses.dataclass(frozen=True)
class Estimate:
    """A fitted parameter."""

    value: float
    unit: str
    ci95: tuple[float, float]
    neutral: float
    bounds: tuple[float, float]
    at_bound: bool
    is_shown: bool = True  # False: the flights show only another parameter, which is relative to it

    @property
    def differs(self) -> bool:
        """Return whether the interval excludes neutral."""
        return not self.ci95[0] <= self.neutral <= self.ci95[1]

    @property
    def firm(self) -> bool:
        """Return whether it differs from neutral and does not lie at a bound."""
        return self.differs and not self.at_bound


@dataclasses.dataclass(frozen=True)
class NamedEffect:
    """An effect that the diagnosis names."""

    name: str
    members: tuple[str, ...]  # its equivalence class: itself, then the effects confounded with it
    probability: float  # marginal probability of the class
    parameters: dict[str, Estimate]
    gain: float  # share of the closable squared error that is lost without it; NaN: of contact, not known
    remedy: str
    cost: float = math.nan  # m, position error one second ahead that it alone makes
    doubt: str = ""  # a sentence: why it is not sure, whatever its probability
    # Effect -> parameter -> value of the effects of which the flights show only the sum; then the parameter
    # above is a size of that sum.
    parts: Mapping[str, Mapping[str, float]] = dataclasses.field(default_factory=dict)

    @property
    def sure(self) -> bool:
        """Return whether the probability is at least SURE: few such names were wrong on other families.

        One of its sizes must differ from neutral by its interval, and not end at a bound, where the flights
        would need more of it than there can be. No doubted name is sure.
        """
        firm = any(p.firm for p in self.sizes)
        return self.probability >= thresholds.SURE and firm and not self.doubt

    @property
    def sizes(self) -> tuple[Estimate, ...]:
        """Return its parameters without what they are relative to, as the length of a string."""
        about = {p.name for p in effects.LIBRARY[self.name].parameters if p.is_reference}
        return tuple(p for name, p in self.parameters.items() if name not in about)

    @property
    def fitted(self) -> dict[str, dict[str, float]]:
        """Return the fitted values of its parameters, or of its parts: effect -> parameter -> value."""
        own = {self.name: {name: p.value for name, p in self.parameters.items()}}
        return {name: dict(values) for name, values in (self.parts or own).items()}


@dataclasses.dataclass(frozen=True)
class Dependence:
    """A function of logged quantities that predicts the residual of one channel on flights left out."""

    channel: str  # x, y, z, roll, pitch, yaw, forward, left (of the heading)
    on: str  # place, velocity, commands, ...: the inputs of the function
    displacement: float  # m, root mean square displacement by it within a second
    displacement_ci95: tuple[float, float]


@dataclasses.dataclass(frozen=True)
class ResidualAnalysis:
    """The residual under the most probable set: its dependence on logged quantities."""

    p_value: float  # of the largest gain of all functions (permutation test)
    depends_on: tuple[Dependence, ...]  # significant functions, one per channel, most significant first


@dataclasses.dataclass(frozen=True)
class Touchdowns:
    """The residual of the motion after contact, under the most probable set."""

    landings: int
    unexplained: bool  # whether the landings' common residual is significant
    p_value: float  # of the most significant common residual


@dataclasses.dataclass(frozen=True)
class Disturbance:
    """Noise and disturbance of one channel."""

    noise: float  # m, rad: standard deviation of the measurement
    size: float  # m/s2, rad/s2
    size_ci95: tuple[float, float]
    time: float  # s, correlation time
    time_ci95: tuple[float, float]
    unit: str


@dataclasses.dataclass(frozen=True)
class ReferenceErrors:
    """The residual of an identified vehicle on flights held out, or its own, each left out in turn."""

    error: float  # m, open-loop position error one second ahead
    floor: float  # m, that of the measurement noise alone
    disturbance: Mapping[str, Disturbance]  # channel -> noise and disturbance


class ScoredSet(Table, frozen=True):
    """A set of effects with its posterior probability; the empty set: nothing is missing."""

    effects: tuple[str, ...]
    probability: Share
    values: Mapping[str, Mapping[str, Real]] = {}
    standard_errors: Mapping[str, Mapping[str, Real]] = {}  # empty: not known

    @property
    def names(self) -> frozenset[str]:
        """Return the effects in no order."""
        return frozenset(self.effects)


def marginal(sets: Sequence[ScoredSet], names: Sequence[str]) -> float:
    """Return the marginal probability that at least one of some effects is missing."""
    return sum(s.probability for s in sets if not set(names).isdisjoint(s.effects))


@dataclasses.dataclass(frozen=True)
class Difference:
    """Contrast of an effect between groups of flights: its values in a model of the others."""

    effect: str
    confounded_with: tuple[str, ...]
    swapped: bool  # the values are those of the others in a model of the flights
    values: dict[str, float]
    ci95: dict[str, tuple[float, float]]  # of the values that differ


@dataclasses.dataclass(frozen=True)
class SetAside:
    """A flight that cannot be used, and the reason."""

    flight: str
    reason: str  # a sentence


@dataclasses.dataclass(frozen=True)
class InconsistentFlights:
    """A group of flights that is inconsistent with the others."""

    flights: tuple[str, ...]
    others: tuple[str, ...]
    differences: tuple[Difference, ...]  # the surest first
    p_value: float  # of the most significant difference, corrected for multiple testing


@dataclasses.dataclass(frozen=True)
class PlantGap:
    """Open-loop position error [m] one second ahead in one plant, RMS over flights not fitted."""

    before: float
    after: float
    floor: float
    windows: int


@dataclasses.dataclass(frozen=True)
class ErrorGrowth:
    """How the open-loop position error grows with the horizon on flights not fitted, as effects are added.

    Every error is (h,) in m, root mean square over windows. The first is that of the vehicle diagnosed, and
    the last that of the corrected one.
    """

    horizon: np.ndarray  # (h,) s
    errors: dict[str, np.ndarray]  # by what is added: "" for nothing, then effects, then "all others"
    floor: np.ndarray  # of noise alone


@dataclasses.dataclass(frozen=True)
class Remaining:
    """How much of the position error one second ahead that the names leave repeats from flight to flight.

    The first of these lines that holds says which names are in doubt, whatever their probability. The errors
    are those before and after the correction, and that of the reference flights:

        after > MUCH_LARGER reference                         every name
        repeating^2 <= MOSTLY after^2                         none
        after <= reference, reference^2 <= MATERIAL before^2  those that cost up to repeating / sqrt(MOSTLY)
        otherwise                                             every name

    In the third, what repeats may be the identified vehicle's own error.
    """

    residual: ResidualAnalysis
    gap: PlantGap | None  # None: not measured
    reference: ReferenceErrors | None

    @property
    def functions(self) -> list[Dependence]:
        """Return the significant functions that surely move the vehicle, by MATERIAL of the squared error.

        Those of the heading never do; where the error was not measured, all others do.
        """
        found = [one for one in self.residual.depends_on if one.channel != "yaw"]
        if not math.isfinite(self.error):
            return found
        least = thresholds.MATERIAL * self.error**2
        return [one for one in found if one.displacement_ci95[0] > 0.0 and one.displacement**2 >= least]

    @property
    def error(self) -> float:
        """Return the error [m] that remains, root mean square; NaN if it was not measured."""
        return self.gap.after if self.gap else math.nan

    @property
    def repeating(self) -> float:
        """Return the displacement [m] within a second by the largest material function; 0 for none."""
        return max((one.displacement for one in self.functions), default=0.0)

    @property
    def is_mostly_chance(self) -> bool:
        """Return whether at most a share MOSTLY of the squared error repeats; if not measured, nothing."""
        return self.repeating**2 <= thresholds.MOSTLY * self.error**2 if self.gap else not self.functions

    @property
    def within_reference(self) -> bool:
        """Return whether it does not exceed the error of the reference flights."""
        return self.reference is not None and self.error <= self.reference.error

    def exceeds_reference(self, times: float) -> bool:
        """Return whether it is more than so many times the error of the reference flights."""
        if self.gap is None or self.reference is None:
            return False
        return self.error > times * max(self.reference.error, self.gap.floor)

    def doubts(self, cost: float) -> bool:
        """Return whether it casts doubt on a name that accounts for an error `cost` [m]; inf: on all."""
        if self.exceeds_reference(thresholds.MUCH_LARGER):
            return True
        if self.is_mostly_chance:
            return False
        if self.gap and self.reference and self.within_reference:
            # Both thresholds are shares of a squared error, so that their roots are shares of an error.
            if self.reference.error <= math.sqrt(thresholds.MATERIAL) * self.gap.before:
                return not cost > self.repeating / math.sqrt(thresholds.MOSTLY)
        return True


@dataclasses.dataclass(frozen=True)
class Diagnosis:
    """The answer of `diagnose`; `apply` adds what the flights show to a vehicle."""

    effects: tuple[NamedEffect, ...]
    # The vehicle diagnosed with the named effects; of an identified one all constants may be estimated again.
    corrected: Vehicle
    sets: tuple[ScoredSet, ...]  # most probable first; with effects of contact where there are landings
    disturbance: dict[str, Disturbance]  # channel -> noise and disturbance
    residual: ResidualAnalysis
    gap: dict[str, PlantGap]  # "analytic", "mujoco"; empty where no flight has a usable second
    platform: bool  # the slab stood in the arena
    flights: tuple[str, ...]  # names of the flights fitted
    heldout: tuple[str, ...]  # names of the flights whose errors decide: held out, or left out in turn
    notes: tuple[str, ...]  # what limits this diagnosis, in sentences
    touchdowns: Touchdowns | None = None  # None: too few to name effects of contact
    inconsistent_flights: tuple[InconsistentFlights, ...] = ()  # flights that contradict the others
    set_aside: tuple[SetAside, ...] = ()  # flights that cannot be used
    # Values of all effects that were estimated again; empty where none was.
    estimated: Mapping[str, Mapping[str, float]] = dataclasses.field(default_factory=dict)
    # Fields of the vehicle that these change, with half-widths of their 95 % intervals.
    half_widths: Mapping[str, float | tuple[float, ...]] = dataclasses.field(default_factory=dict)
    reference: ReferenceErrors | None = None  # of the identified vehicle's own flights
    # Effect that was not named -> displacement [m] within a second, by its size in the best set with it.
    displacements: Mapping[str, float] = dataclasses.field(default_factory=dict)
    thrust_over_weight: Quantity | None = None  # at the usual command, over the modelled one; None: as that
    growth: ErrorGrowth | None = None  # None: no flight has a usable second

    def values(self) -> dict[str, dict[str, float]]:
        """Return the fitted parameter values: effect -> parameter -> value."""
        return {name: values for e in self.effects for name, values in e.fitted.items()}

    @property
    def verdict(self) -> Verdict:
        """Return the verdict: the first of these that holds.

        - `unknown`: the landings repeat an error, or the flights a larger one than the names explain. Where
          no more is left than in the reference flights, most must repeat: less may be the reference's own.
        - With names, `unknown` if they leave so much that none can be sure, else `effects`.
        - `undecided`: one of the effects that matter is probably missing.
        - `unknown`: the error exceeds that of the reference flights.
        - `nothing`.
        """
        landings_repeat = self.touchdowns is not None and self.touchdowns.unexplained
        left = self.remaining
        may_be_the_references = left.within_reference and left.is_mostly_chance
        if landings_repeat or (left.repeating > self.explained and not may_be_the_references):
            return "unknown"
        if self.effects:
            return "unknown" if left.doubts(math.inf) else "effects"
        if self.undecided:
            return "undecided"
        return "unknown" if self.larger_error else "nothing"

    @property
    def ahead(self) -> PlantGap | None:
        """Return the position errors one second ahead by the equations; None: no flight has such a second."""
        return self.gap.get("analytic")

    @property
    def remaining(self) -> Remaining:
        """Return how much of the error one second ahead that the names leave repeats."""
        return Remaining(self.residual, self.ahead, self.reference)

    @property
    def explained(self) -> float:
        """Return the error [m] one second ahead that the named effects account for."""
        g = self.ahead
        return math.sqrt(max(0.0, g.before**2 - g.after**2)) if g and self.effects else 0.0

    @property
    def undecided(self) -> dict[str, float]:
        """Return the possible effects with their probabilities if one of them is probably missing."""
        return self.possible if self.probability(*self.possible) >= thresholds.UNDECIDED else {}

    @property
    def larger_error(self) -> bool:
        """Return whether the error that remains exceeds that of the reference flights."""
        return self.remaining.exceeds_reference(thresholds.LARGER_ERROR)

    def probability(self, *names: str) -> float:
        """Return the marginal probability that at least one of some effects is missing."""
        return marginal(self.sets, names)

    @property
    def nothing(self) -> float:
        """Return the probability that no effect of a size that matters is missing."""
        return sum(s.probability for s in self.sets if self.immaterial.issuperset(s.effects))

    @property
    def immaterial(self) -> frozenset[str]:
        """Return the effects not named whose sizes make up less than a share MATERIAL of the squared error.

        They are directions in which the flights show little.
        """
        least = thresholds.MATERIAL * self.remaining.error**2
        return frozenset(name for name, moved in self.displacements.items() if moved**2 < least)

    @property
    def possible(self) -> dict[str, float]:
        """Return the effects not named that may matter, with their probabilities, most probable first."""
        named = {name for effect in self.effects for name in effect.members}
        others = {name for one in self.sets for name in one.effects} - named - self.immaterial
        ranked = sorted((-self.probability(name), name) for name in others)
        return {name: -negative for negative, name in ranked if -negative >= thresholds.POSSIBLE}

    def apply(self, vehicle: Vehicle) -> Vehicle:
        """Return `vehicle` with the named effects added, and the others as they were estimated again."""
        shown = {**self.values(), **self.estimated}
        return effects.apply(vehicle, {name: shown[name] for name in effects.LIBRARY if name in shown})

    def to_json(self) -> dict:
        """Return the contents of report.json: VERSION, fields, and properties that follow from them."""
        record = plain({name: value for name, value in vars(self).items() if name not in _NOT_IN_REPORT})
        for entry, effect in zip(record["effects"], self.effects):
            entry["sure"] = effect.sure
        error, functions = self.remaining.error, self.remaining.functions
        record["residual"] |= {"error": error, "unexplained": bool(functions)}
        for entry, one in zip(record["residual"]["depends_on"], self.residual.depends_on):
            entry["material"] = one in functions
        head = {"version": VERSION, "verdict": self.verdict, "nothing": self.nothing}
        return head | {"possible": self.possible, "immaterial": sorted(self.immaterial)} | record
