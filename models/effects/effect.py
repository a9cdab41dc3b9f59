"""An effect: a named physical cause that the paper's equations omit or describe inaccurately."""

from __future__ import annotations

import dataclasses
import functools
import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from inclined_landing.models.parameters import constants, load_vehicle
from inclined_landing.models.vehicle import Vehicle

AIR_DENSITY = 1.2  # kg/m3
# Ratio of plausible offsets of the centre of mass: those whose moment the motors compensate, such as the 3 mm
# by a deck of 3 g on an arm, over those that tilt the vehicle.
HELD = 2.5
REFERENCE_ERROR = 8.0  # largest plausible error of an effect's reference, in its negligible sizes
# Limits of the ratio by which a factor's sizes change with the vehicle, and a value that its bounds always
# contain. Chosen by hand.
LEAST_TIMES, MOST_TIMES, ROOM_BELOW = 0.1, 20.0, 0.8


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


# Units of parameters whose sizes scale with a power of a property of the vehicle.
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
    plausible: float  # a value that a real vehicle may well have, within the bounds
    negligible: float  # distance from neutral, in the unit, that nobody needs to correct
    one_signed: bool = False  # values below neutral have no physical cause and allow for noise of a fit
    # Fields of Vehicle (`field.k`: the k-th number of one). A factor multiplies them, or divides them if
    # `inverse`; other parameters are added; see `Effect`. A one-signed effect may be negative as long as the
    # first field stays positive.
    fields: tuple[str, ...] = ()
    inverse: bool = False
    # Name under which `landing-eval identify` reports the first field, or its inverse if `inverse`; "": the
    # parameter itself is reported, under the effect's name.
    reported: str = ""
    share: bool = False  # report the factor itself instead of the field that it multiplies
    # Whether this is the operating point about which the effect's first parameter acts. It has no size, and
    # any value is neutral while the first parameter is.
    is_reference: bool = False
    # For a reference: whether a size about any value equals the sum of two sizes about the bounds; see
    # `Effect.at_ends`.
    linear: bool = True
    along_the_arm: bool = False  # its sizes are proportional to the length of the vehicle's arms
    times: float = 1.0  # set by `sized_for`: factor on its sizes relative to the shipped vehicle

    @property
    def is_factor(self) -> bool:
        """Return whether the parameter multiplies (neutral is 1) instead of adding (neutral is 0)."""
        return self.neutral == 1.0 and not self.is_reference

    @property
    def reported_unit(self) -> str:
        """Return the unit of `number`: that of the parameter or, for a factor, of what it multiplies."""
        if not self.reported or self.share or not self.is_factor:
            return self.unit
        return "s" if self.inverse else next(c.unit for c in constants() if c.field == self.fields[0])

    def present_in(self, vehicle: Vehicle) -> float:
        """Return the number of the vehicle that the parameter changes, the first of several."""
        return _number(vehicle, self.fields[0])

    def number(self, vehicle: Vehicle, value: float) -> float:
        """Return the number that is reported for a vehicle whose parameter is `value`."""
        if not self.reported or self.share:
            return value
        present = self.present_in(vehicle)
        if not self.is_factor:
            return value + (1.0 / present if self.inverse else present)
        return value / present if self.inverse else value * present

    def _unit_of(self, vehicle: Vehicle) -> float:
        """Return the change of `number` when the factor increases by 1; 1 for a share of one number."""
        if self.reported_unit == "s":
            return self.number(vehicle, 2.0) - self.number(vehicle, 1.0)
        if "." in self.fields[0]:
            return float(np.mean([abs(_number(vehicle, field)) for field in self.fields])) + 1e-12
        return 1.0

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
        away = times * REFERENCE_ERROR * self.negligible
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
        if self.inverse and not self.is_factor:
            # A lag added to 1 / field: a quicker vehicle has less lag to lose.
            less = self.number(load_vehicle(), 0.0) - self.number(vehicle, 0.0)
            return dataclasses.replace(
                self, bounds=(min(self.neutral, self.bounds[0] + less), self.bounds[1])
            )
        present = self.present_in(vehicle) if self.fields else 0.0
        if self.is_reference and present > 0.0:
            return dataclasses.replace(self, neutral=present)
        if self.one_signed and present > 0.0:
            bounds = self.neutral - present, self.bounds[1]
            return dataclasses.replace(self, bounds=bounds, one_signed=False)
        if not self.is_factor or not self.reported:
            return self
        # A factor f on a time T of the vehicle changes it by as much as f_0 changes that of the shipped one:
        #   (f - 1) T = (f_0 - 1) T_0,   f - 1 = times (f_0 - 1),   times = T_0 / T
        times = self._unit_of(load_vehicle()) / self._unit_of(vehicle)
        if self.fields[0].startswith("drag_coefficients"):
            times *= heavy_rotor_drag(vehicle) / heavy_rotor_drag(load_vehicle())
        times = float(np.clip(times, LEAST_TIMES, MOST_TIMES))
        plausible = 1.0 + (self.plausible - 1.0) * times
        # Bounds are never closer to 1 than those of the shipped vehicle, [l_0, h_0]:
        #   l = min(ROOM_BELOW, l_0 max(1, times)),   h = 1 + (h_0 - 1) max(1, times)
        # At the lower one the time is l T = l_0 T_0: the engine's time step could not resolve a shorter one.
        low = min(ROOM_BELOW, self.bounds[0] * max(1.0, times))
        high = 1.0 + (self.bounds[1] - 1.0) * max(1.0, times)
        return dataclasses.replace(
            self,
            bounds=(low, high),
            # If it is below the bounds, a factor f at the same distance above 1 is as plausible: 1 + (1 - f).
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
    """A physical cause, with the change that it makes to the vehicle in all plants.

    `apply(vehicle, values)` returns the vehicle with the effect added to those it already has. `values` maps
    parameter names to numbers; a missing name is neutral. By default it changes the `fields` of the
    parameters. A parameter without any is added to the entry of the table `effects` that has the effect's
    name, or to one of its numbers where there are several parameters.

    Other effects are referred to by name. `eval/gap/model/columns.py` defines how an effect is fitted.
    """

    name: str
    description: str
    formula: str
    source: str
    parameters: tuple[Parameter, ...]
    regimes: tuple[str, ...]  # the regimes in which it is visible: see REGIMES
    confused_with: tuple[str, ...]  # effects that ordinary flights do not distinguish from it
    remedy: str  # advice to the user
    # The quantities that show it, see CHANNELS. It is a candidate if one of them was logged; an effect on
    # touchdowns alone is diagnosed from touchdowns. An effect on `requests`, the motors' commands, is found
    # in these, not in the attitude, if they were logged, and is in doubt otherwise.
    channels: tuple[str, ...]
    says: str  # part of a sentence; {parameter} stands for its value with unit
    apply: Callable[[Vehicle, Mapping[str, float]], Vehicle] = None  # type: ignore[assignment]
    # Field of `FlightLog` (or `yaw_rate_command`) -> its least change over the flights of a candidate.
    requires: Mapping[str, float] = dataclasses.field(default_factory=dict)
    of_the_drive: bool = False  # from command to rotor speed: no candidate if rotor speeds are measured
    is_lag: bool = False  # a lag or delay: in doubt at a low log rate, no candidate in strong wind
    scales_thrust: bool = False  # free flight shows thrust over mass alone: such effects count as one cause
    changes_hover: bool = False  # thrust of a hover command, or weight: such effects may cancel each other
    of_the_place: bool = False  # depends on the room or the day: not a property of the vehicle
    # False: frozen in `identify` (a fault of a single part, or not excited by ordinary flights).
    identified: bool = True
    told_by: str = ""  # a sentence on how to measure it without a flight; "": by flights

    def __post_init__(self):
        if self.apply is None:
            own = f"effects_{self.name}"
            several = len(self.parameters) > 1
            parameters = tuple(
                p if p.fields else dataclasses.replace(p, fields=(f"{own}.{k}" if several else own,))
                for k, p in enumerate(self.parameters)
            )
            object.__setattr__(self, "parameters", parameters)
            object.__setattr__(self, "apply", functools.partial(_with_fields, parameters))

    @property
    def neutral(self) -> dict[str, float]:
        """The parameter values with no effect."""
        return {p.name: p.neutral for p in self.parameters}

    @property
    def is_constant(self) -> bool:
        """Whether it rescales constants that every vehicle has, rather than adding something."""
        return all(p.is_factor and p.reported for p in self.parameters)

    @property
    def plausible(self) -> dict[str, float]:
        """Parameter values of a real vehicle that has the effect."""
        return {p.name: p.plausible for p in self.parameters}

    @property
    def reference(self) -> Parameter | None:
        """The reference value about which the others act, if there is one in which the effect is linear."""
        return next((p for p in self.parameters if p.is_reference and p.linear), None)

    # A size x about a reference r is the two sizes (1 - t) x about the lowest reference r_0 and t x about the
    # highest, r_1:  f(r) = (1 - t) f(r_0) + t f(r_1),  where f(r), in which the effect is linear, is r, but
    # 1/r for a reference in PWM, because load is relative to it, 1 - load/r.

    def at_ends(self, value: float, reference: float) -> tuple[float, float]:
        """Return the two sizes, about the lowest and the highest reference, whose sum equals this one."""
        about = self._about
        ends = (*about.either_side(), reference)
        first, last, at = (1.0 / x for x in ends) if about.unit == "PWM" else ends
        share = (first - at) / (first - last)
        return value * (1.0 - share), value * share

    def from_ends(self, low: float, high: float) -> tuple[float, float]:
        """Return size and reference equivalent to sizes about the lowest and the highest reference."""
        value = low + high
        share = high / value if value else 0.5
        about = self._about
        first, last = about.either_side()
        if about.unit == "PWM":
            inverse = (1.0 - share) / first + share / last
            return value, 1.0 / inverse if inverse > 0.0 else about.bounds[1]
        return value, first + share * (last - first)

    def values_from_ends(self, low: float, high: float) -> dict[str, float]:
        """Return the values of the first parameter and the reference, by `from_ends`."""
        first, (size, reference) = self.parameters[0], self.from_ends(low, high)
        return {first.name: first.neutral + size, self._about.name: reference}

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
                bounds=(p.neutral, p.neutral) if p.fields == ("effects_attitude_hold",) else p.bounds,
            )
            for p in self.parameters
        )
        # If the controller commands the compensating moment, the attitude shows nothing of it.
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


def _number(vehicle: Vehicle, label: str) -> float:
    """Return the number in a field of the vehicle, `field`, or one of several, `field.k`."""
    field, _, part = label.partition(".")
    return getattr(vehicle, field)[int(part)] if part else getattr(vehicle, field)


def _with_fields(parameters: Sequence[Parameter], vehicle: Vehicle, values: Mapping[str, float]) -> Vehicle:
    """Return the vehicle with the fields of the parameters changed, the default of `Effect.apply`."""
    changes: dict[str, Any] = {}
    for p in parameters:
        value = values.get(p.name, p.neutral)
        for label in p.fields:
            field, _, part = label.partition(".")
            there, k = changes.get(field, getattr(vehicle, field)), int(part or 0)
            old = there[k] if part else there
            new = old + value if not p.is_factor else old / value if p.inverse else old * value
            changes[field] = (*there[:k], new, *there[k + 1 :]) if part else new
    return vehicle.changed(**changes)
