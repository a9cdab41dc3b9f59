"""An effect: a named physical cause that the paper's equations omit or describe inaccurately."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from inclined_landing.models.parameters import load_vehicle
from inclined_landing.models.vehicle import Vehicle


@dataclasses.dataclass(frozen=True)
class FittedConstant:
    """A constant of the vehicle that a parameter changes, which `landing-eval identify` reports."""

    name: str  # the word in reports
    _: dataclasses.KW_ONLY
    field: str  # of Vehicle
    unit: str = "1"  # of the number reported
    share: bool = False  # reported is the parameter itself
    inverse: bool = False  # reported is 1 over the field
    also: tuple[str, ...] = ()  # fields that scale with it
    offset: bool = False  # the parameter is added to what is reported, else this is rescaled
    parts: tuple[int, ...] = ()  # indices of the field's numbers that it changes; (): all

    def number(self, vehicle: Vehicle, value: float) -> float:
        """Return the number that is reported for a vehicle whose parameter is `value`."""
        if self.share:
            return value
        constant = getattr(vehicle, self.field)
        constant = constant[self.parts[0]] if self.parts else constant
        if self.offset:
            return value + (1.0 / constant if self.inverse else constant)
        return value / constant if self.inverse else value * constant

    def unit_of(self, vehicle: Vehicle) -> float:
        """Return the change [unit] of the number when the factor increases by 1; 1 for a share."""
        if self.unit == "s":
            return self.number(vehicle, 2.0) - self.number(vehicle, 1.0)
        if self.parts:
            return float(np.mean([abs(getattr(vehicle, self.field)[k]) for k in self.parts])) + 1e-12
        return 1.0


AIR_DENSITY = 1.2  # kg/m3
# A centre of mass that the motors are asked to hold may well be this many times as far off as one that makes
# the vehicle stand askew: a deck of 3 g at an arm moves it by 3 mm.
HELD = 2.5
OFF = 8.0  # negligible sizes by which the reference of an effect may well be off


def mass(vehicle: Vehicle) -> float:
    """Return a vehicle's mass [kg]."""
    return vehicle.body_mass


def hover_inflow(vehicle: Vehicle) -> float:
    """Return the induced velocity [m/s] of the rotors in hover, by momentum theory."""
    # v_h = sqrt(m g / (2 rho A)),  A = 4 pi r^2
    weight = vehicle.body_mass * vehicle.environment_gravity
    return math.sqrt(weight / (8.0 * math.pi * AIR_DENSITY)) / vehicle.rotor_radius


def heavy_rotor_drag(vehicle: Vehicle) -> float:
    """Return the drag coefficient [kg/rad] at which the drag at the hover inflow equals the weight."""
    # k = m g / (v_h n w),  w = d P + e of each motor at a P^2 + b P + c = m g / n
    weight, n = vehicle.body_mass * vehicle.environment_gravity, vehicle.motor_count
    a, b, c = vehicle.motor_pwm_to_force
    d, e = vehicle.motor_pwm_to_speed
    pwm = (math.sqrt(b * b + 4.0 * a * max(0.0, weight / n - c)) - b) / (2.0 * a)
    return weight / (hover_inflow(vehicle) * n * (d * pwm + e))


# Units of parameters whose sizes are those of the shipped vehicle times a power of a quantity of the vehicle.
_SCALED_UNITS: dict[str, tuple[Callable[[Vehicle], float], float]] = {
    **dict.fromkeys(("N", "kg"), (mass, 1.0)),
    "kg/m": (mass, 2.0 / 3.0),  # drag goes with the cross-section
    **{"m/s": (hover_inflow, 1.0), "s/m": (hover_inflow, -1.0), "s2/m2": (hover_inflow, -2.0)},
    "1/m": (lambda vehicle: vehicle.rotor_radius, -1.0),
}


@dataclasses.dataclass(frozen=True)
class Parameter:
    """One number of an effect."""

    name: str
    _: dataclasses.KW_ONLY
    unit: str = "1"
    neutral: float = 0.0  # with this value the effect changes nothing, bit for bit
    bounds: tuple[float, float]  # limits of a fit
    plausible: float  # a value that a real vehicle may well have
    negligible: float  # distance from neutral, in the unit, that nobody needs to correct
    one_signed: bool = False  # below neutral lies no physical cause, only room for the noise of a fit
    # Field of Vehicle to which the size is added (`field.k`: to its number k). A one-signed effect may also
    # be negative, as far as that field stays positive.
    adds_to: str = ""
    is_reference: bool = False  # the point about which another parameter acts; any value is neutral
    # For a reference: one size about a value between its bounds acts like two sizes, one about each bound.
    linear: bool = True
    constant: FittedConstant | None = None
    along_the_arm: bool = False  # a length that goes with the vehicle's arms
    times: float = 1.0  # factor on its sizes relative to the shipped vehicle

    @property
    def is_factor(self) -> bool:
        """Return whether the parameter multiplies (neutral is 1) instead of adding (neutral is 0)."""
        return self.neutral == 1.0 and not self.is_reference

    @property
    def possible(self) -> tuple[float, float]:
        """Return the bounds of physically possible values.

        The bounds of a reference are narrow: with a distant reference the effect would be a constant scale of
        the thrust, and no longer identifiable together with it.
        """
        low, high = self.bounds
        if self.is_reference:
            low, high = self.either_side(1.5)
        return (self.neutral, high) if self.one_signed else (low, high)

    def either_side(self, times: float = 1.0) -> tuple[float, float]:
        """Return the lowest and highest plausible value of a reference, or values `times` as far from it."""
        low, high = self.bounds
        away = times * OFF * self.negligible
        return max(low, self.neutral - away), min(high, self.neutral + away)

    def sized_for(self, vehicle: Vehicle) -> Parameter:
        """Return the parameter with the bounds and sizes that apply to `vehicle`.

        An effect that the vehicle already has may also decrease, down to zero. Sizes of a factor on a time
        are absolute: as many ms as for the shipped vehicle, not the same share. Forces, masses and drag
        coefficients scale with the vehicle's mass, air speeds with the induced velocity of its rotors in
        hover.
        """
        scale, power = (
            (lambda v: v.rotor_arm, 1.0) if self.along_the_arm else _SCALED_UNITS.get(self.unit, (None, 1.0))
        )
        if scale is None:
            return self._on_top_of(vehicle)
        return self._scaled((scale(vehicle) / scale(load_vehicle())) ** power)._on_top_of(vehicle)

    def _scaled(self, times: float) -> Parameter:
        """Return the parameter with all sizes multiplied by `times`."""
        return dataclasses.replace(
            self,
            bounds=(self.bounds[0] * times, self.bounds[1] * times),
            plausible=self.plausible * times,
            negligible=self.negligible * times,
            times=self.times * times,
        )

    def _on_top_of(self, vehicle: Vehicle) -> Parameter:
        """Return the parameter with bounds that account for the size that the vehicle already has."""
        if self.constant and self.constant.offset and self.constant.inverse:
            # A lag added to 1 / field: of a quicker vehicle's there is less that may be missing.
            less = self.constant.number(load_vehicle(), 0.0) - self.constant.number(vehicle, 0.0)
            return dataclasses.replace(
                self, bounds=(min(self.neutral, self.bounds[0] + less), self.bounds[1])
            )
        field, _, part = self.adds_to.partition(".")
        present = 0.0
        if field:
            present = float(getattr(vehicle, field)[int(part)] if part else getattr(vehicle, field))
        if self.is_reference and present > 0.0:
            return dataclasses.replace(self, neutral=present)
        if self.one_signed and present > 0.0:
            bounds = self.neutral - present, self.bounds[1]
            return dataclasses.replace(self, bounds=bounds, one_signed=False)
        if not self.is_factor or self.constant is None:
            return self
        times = self.constant.unit_of(load_vehicle()) / self.constant.unit_of(vehicle)
        if self.constant.field == "drag_coefficients":
            times *= heavy_rotor_drag(vehicle) / heavy_rotor_drag(load_vehicle())
        times = float(np.clip(times, 0.1, 20.0))
        plausible = 1.0 + (self.plausible - 1.0) * times
        return dataclasses.replace(
            self,
            # No quicker than of the shipped vehicle: an engine's step could not follow.
            bounds=(
                min(0.8, self.bounds[0] * max(1.0, times)),
                1.0 + (self.bounds[1] - 1.0) * max(1.0, times),
            ),
            plausible=plausible if plausible > self.bounds[0] else 2.0 - plausible,
            negligible=self.negligible * times,
            times=self.times * times,
        )

    def size(self, value: float) -> float:
        """Return the distance of a value from neutral; 0 for a reference."""
        return 0.0 if self.is_reference else value - self.neutral

    @property
    def is_ratio(self) -> bool:
        """Return whether the parameter is fitted in its logarithm, as for a factor that is never zero."""
        return self.is_factor and self.bounds[0] > 0.0

    def coordinate(self, value: float) -> float:
        """Return the coordinate in which a value is fitted: its distance from neutral, or a ratio's log."""
        return math.log(value) if self.is_ratio else value - self.neutral

    def value_at(self, coordinate: float) -> float:
        """Return the value at a coordinate."""
        return math.exp(min(coordinate, 50.0)) if self.is_ratio else self.neutral + coordinate

    def bounded(self, coordinate: float) -> float:
        """Return the value at a coordinate, clipped to the bounds."""
        return float(np.clip(self.value_at(coordinate), *self.bounds))

    def slope(self, value: float) -> float:
        """Return the derivative [unit] of the value by its coordinate."""
        return value if self.is_ratio else 1.0


@dataclasses.dataclass(frozen=True)
class Effect:
    """A physical cause, with the change that it makes to the vehicle in both plants.

    `apply(vehicle, values)` returns the vehicle with the effect added to those it already has: scales
    multiply, offsets add. `values` maps parameter names to numbers; a missing name is neutral.

    Other effects are referred to by name. `eval/gap/model/fitting.py` defines how an effect is fitted.
    """

    name: str
    description: str
    formula: str
    source: str
    parameters: tuple[Parameter, ...]
    regimes: tuple[str, ...]  # the regimes in which it is visible: see REGIMES
    confused_with: tuple[str, ...]  # effects that ordinary flights do not distinguish from it
    remedy: str  # advice to the user
    channels: tuple[str, ...]  # in what it shows: see CHANNELS
    apply: Callable[[Vehicle, Mapping[str, float]], Vehicle]
    says: str  # part of a sentence; {parameter} stands for its value with unit
    # Log channel (or `yaw_rate_command`) -> least change over the flights for it to be identifiable.
    requires: Mapping[str, float] = dataclasses.field(default_factory=dict)
    of_the_drive: bool = False  # acts between the thrust command and the speed of the rotors
    is_lag: bool = False  # a lag or a delay, confounded with others in flights recorded at a low rate
    scales_thrust: bool = False  # free flight shows the ratio of thrust to mass alone
    # Effects that MuJoCo's contact model changes along with it but real feet do not: they may be as far off.
    couples_with: tuple[str, ...] = ()
    of_the_place: bool = False  # of the surroundings: another value on another day or in another room
    # Whether `identify` fits it; else it stays as it is: a fault of one part, what ordinary flights hide.
    identified: bool = True
    # Where its size follows only with another constant known, flights show a product: the acceleration that
    # it causes in hover. This is the part of a sentence on that product.
    product: str = ""
    told_by: str = ""  # a sentence on how to measure it without a flight; "": by flights

    @property
    def neutral(self) -> dict[str, float]:
        """The parameter values with no effect."""
        return {p.name: p.neutral for p in self.parameters}

    @property
    def is_constant(self) -> bool:
        """Whether it rescales constants that every vehicle has, rather than adding something."""
        return all(p.is_factor and p.constant for p in self.parameters)

    @property
    def plausible(self) -> dict[str, float]:
        """Parameter values of a real vehicle that has the effect."""
        return {p.name: p.plausible for p in self.parameters}

    @property
    def reference(self) -> Parameter | None:
        """The reference value about which the others act, if there is one in which the effect is linear."""
        return next((p for p in self.parameters if p.is_reference and p.linear), None)

    def at_ends(self, value: float, reference: float) -> tuple[float, float]:
        """Return the two sizes, about the lowest and the highest reference, whose sum equals this one."""
        share = self._towards(reference)
        return value * (1.0 - share), value * share

    def from_ends(self, low: float, high: float) -> tuple[float, float]:
        """Return size and reference equivalent to sizes about the lowest and the highest reference."""
        value = low + high
        share = high / value if value else 0.5
        about = self._about
        first, last = about.either_side()
        if about.unit == "PWM":  # 1 - load/reference is linear in 1/reference
            inverse = (1.0 - share) / first + share / last
            return value, 1.0 / inverse if inverse > 0.0 else about.bounds[1]
        return value, first + share * (last - first)

    def _towards(self, reference: float) -> float:
        about = self._about
        first, last = about.either_side()
        if about.unit == "PWM":
            return (1.0 / first - 1.0 / reference) / (1.0 / first - 1.0 / last)
        return (reference - first) / (last - first)

    @property
    def _about(self) -> Parameter:
        return next(p for p in self.parameters if p.is_reference)

    @property
    def contact(self) -> bool:
        """Return whether the effect is visible in touchdowns only."""
        return self.channels == ("touchdown",)

    def seen_in_requests(self) -> Effect:
        """Return the effect for flights whose logs contain the commands of the motors."""
        parameters = (
            dataclasses.replace(
                p,
                plausible=p.plausible * (HELD if p.along_the_arm else 1.0),
                bounds=(p.neutral, p.neutral) if p.adds_to == "effects_attitude_hold" else p.bounds,
            )
            for p in self.parameters
        )
        # A controller that asks for the moment leaves nothing of it, and of taking it over, in the attitude.
        unseen = {"attitude"} if "requests" in self.channels else set()
        channels = tuple(c for c in self.channels if c not in unseen)
        return dataclasses.replace(self, parameters=tuple(parameters), channels=channels)

    def sized_for(self, vehicle: Vehicle) -> Effect:
        """Return the effect with the bounds and sizes that apply to `vehicle`."""
        return dataclasses.replace(self, parameters=tuple(p.sized_for(vehicle) for p in self.parameters))

    def parameter(self, name: str) -> Parameter:
        """Return the parameter called `name`."""
        return next(p for p in self.parameters if p.name == name)


REGIMES = ("hover", "climb", "lateral", "attitude_step", "near_surface", "low_battery", "touchdown")
CHANNELS = ("translation", "attitude", "yaw", "requests", "touchdown")


def scaled(*fields: str):
    """Return the `apply` of an effect that multiplies vehicle fields (numbers or tuples) by its scale."""

    def apply(vehicle: Vehicle, values: Mapping[str, float]) -> Vehicle:
        factor = values.get("scale", 1.0)
        changes: dict[str, Any] = {}
        for field in fields:
            old = getattr(vehicle, field)
            changes[field] = tuple(x * factor for x in old) if isinstance(old, tuple) else old * factor
        return vehicle.changed(**changes)

    return apply


def added(field: str, *parameters: str):
    """Return the `apply` of an effect that adds its parameters to a field, a number or a tuple."""

    def apply(vehicle: Vehicle, values: Mapping[str, float]) -> Vehicle:
        old = getattr(vehicle, field)
        new = [values.get(name, 0.0) for name in parameters]
        if isinstance(old, tuple):
            changed: Any = tuple(a + b for a, b in zip(old, new))
        else:
            changed = old + new[0]
        return vehicle.changed(**{field: changed})

    return apply
