"""What an effect is: a named physical cause that the paper's equations leave out or may have wrong."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping

from inclined_landing.models.parameters import Vehicle


@dataclasses.dataclass(frozen=True)
class Parameter:
    """One number of an effect."""

    name: str
    unit: str
    neutral: float  # at which the effect changes nothing, bit for bit
    bounds: tuple[float, float]  # what a fit may find
    plausible: float  # a value that a real vehicle may well have
    negligible: float  # distance from neutral, in the unit, that nobody needs to correct


@dataclasses.dataclass(frozen=True)
class Effect:
    """A physical cause with the change of the vehicle that it means, in both plants.

    `apply(vehicle, values)` returns the vehicle with the effect on top of what it has already: scales
    multiply, offsets add. `values` maps parameter names to numbers; a missing name is neutral.
    """

    name: str
    description: str
    formula: str
    source: str
    parameters: tuple[Parameter, ...]
    regimes: tuple[str, ...]  # where it shows: see REGIMES
    confused_with: tuple[str, ...]  # effects that look alike in ordinary flights
    remedy: str  # what a person can do about it
    channels: tuple[str, ...]  # in what it shows: see CHANNELS
    requires: tuple[str, ...]  # log channels without which it cannot be told
    apply: Callable[[Vehicle, Mapping[str, float]], Vehicle]

    @property
    def neutral(self) -> dict[str, float]:
        """The parameter values that change nothing."""
        return {p.name: p.neutral for p in self.parameters}

    @property
    def plausible(self) -> dict[str, float]:
        """Parameter values of a real vehicle that has the effect."""
        return {p.name: p.plausible for p in self.parameters}


REGIMES = ("hover", "climb", "lateral", "attitude_step", "near_surface", "low_battery", "touchdown")
CHANNELS = ("translation", "attitude", "yaw", "touchdown")


def scaled(*fields: str, parameter: str = "scale"):
    """`apply` of an effect that multiplies vehicle fields (numbers or tuples) by its parameter."""

    def apply(vehicle: Vehicle, values: Mapping[str, float]) -> Vehicle:
        factor = values.get(parameter, 1.0)
        changes = {}
        for field in fields:
            old = getattr(vehicle, field)
            changes[field] = tuple(x * factor for x in old) if isinstance(old, tuple) else old * factor
        return dataclasses.replace(vehicle, **changes)

    return apply


def added(field: str, *parameters: str):
    """`apply` of an effect that adds its parameters to a field: a number, or a tuple with one for each."""

    def apply(vehicle: Vehicle, values: Mapping[str, float]) -> Vehicle:
        old = getattr(vehicle, field)
        new = [values.get(name, 0.0) for name in parameters]
        if isinstance(old, tuple):
            return dataclasses.replace(vehicle, **{field: tuple(a + b for a, b in zip(old, new))})
        return dataclasses.replace(vehicle, **{field: old + new[0]})

    return apply
