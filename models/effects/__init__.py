"""Library of named physical effects that the equations may lack compared with a real Crazyflie.

A corrected model is the nominal vehicle with effects applied. Each effect maps its parameters to a
changed `Vehicle`, which all plants understand and a vehicle file stores:

    vehicle = LIBRARY["battery_sag"].apply(load_vehicle(), {"sag": 0.15, "reference": 34100.0})

The terms are those of `forces.py`, `attitude_loops.py` and the plugins' attributes (`plugin/README.md`).
docs/guides/extend.md explains how to add an effect.
"""

from collections.abc import Mapping

from inclined_landing.models.base.errors import UserError, choices
from inclined_landing.models.effects import (
    air,
    attitude,
    battery,
    body,
    delays,
    motor,
    rotors,
    touchdown,
)
from inclined_landing.models.effects import thrust as _thrust
from inclined_landing.models.effects.effect import CHANNELS, REGIMES, Effect, Parameter
from inclined_landing.models.vehicle import Vehicle

_FAMILIES = (_thrust, battery, motor, rotors, body, air, delays, attitude, touchdown)
LIBRARY: dict[str, Effect] = {effect.name: effect for family in _FAMILIES for effect in family.EFFECTS}


def apply(vehicle: Vehicle, effects: Mapping[str, Mapping[str, float]]) -> Vehicle:
    """Return the vehicle with several effects, {effect: {parameter: value}}, applied one after the other.

    Raises UserError for an unknown effect or parameter.
    """
    for name, values in effects.items():
        if name not in LIBRARY:
            raise UserError(f"unknown effect {name!r}; {choices(LIBRARY, name)}")
        known = [p.name for p in LIBRARY[name].parameters]
        for parameter in values:
            if parameter not in known:
                raise UserError(
                    f"effect {name} has no parameter {parameter!r}; choose from {', '.join(known)}"
                )
        vehicle = LIBRARY[name].apply(vehicle, values)
    return vehicle


__all__ = ["CHANNELS", "LIBRARY", "REGIMES", "Effect", "Parameter", "apply"]
