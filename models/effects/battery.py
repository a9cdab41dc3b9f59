"""Effects of the battery on the thrust: with the load alone, or through a measured voltage."""

import math

from inclined_landing.models.effects.effect import Effect, Parameter
from inclined_landing.models.parameters import load_vehicle

_SHIPPED = load_vehicle()
_LEAST_REFERENCE = 1e-3  # PWM
_FARTHEST_ZERO = 1e8  # PWM or V


def _line(slope, zero, more, at):
    """Return slope and zero of slope (x - zero) + more (x - at); `zero` itself if there is no slope.

    If the slopes cancel, a constant remains: it is represented by a line with its zero `_FARTHEST_ZERO` away.
    """
    if more == 0.0:
        return slope, zero
    if slope == 0.0:
        return more, at
    total, constant = slope + more, slope * zero + more * at
    least = abs(constant) / _FARTHEST_ZERO
    if abs(total) < least:
        total = math.copysign(least, total)
    return total, zero if total == 0.0 else constant / total


def with_sag(vehicle, sag, reference=None):
    """Return the vehicle with its thrust multiplied by 1 - sag (load/reference - 1)."""
    present, before = vehicle.effects_battery_sag, vehicle.effects_battery_reference
    if sag == 0.0:
        return vehicle
    at = before if reference is None else reference
    if present == 0.0:
        total = sag
    else:  # -sag (load/reference - 1) is a line in the load with slope -sag/reference
        slope, at = _line(-present / before, before, -sag / at, at)
        at = at or _LEAST_REFERENCE  # the line itself, where it is right at no load
        total = -slope * at
    return vehicle.changed(effects_battery_sag=total, effects_battery_reference=at)


def _voltage(vehicle, values):
    sensitivity, reference = _line(
        vehicle.effects_voltage_sensitivity,
        vehicle.effects_voltage_reference,
        values.get("sensitivity", 0.0),
        values.get("reference", vehicle.effects_voltage_reference),
    )
    return vehicle.changed(effects_voltage_sensitivity=sensitivity, effects_voltage_reference=reference)


EFFECTS = (
    Effect(
        name="battery_sag",
        description="The battery's voltage sags under load: the higher the load, the less thrust a PWM "
        "gives. The load is the lagged PWM, so no voltage needs to be logged. The reference is the "
        "load at which the modelled thrust is correct.",
        formula="F_t times (1 - sag (load/reference - 1)),  load = lag_rate Omega",
        source="internal resistance of a one-cell lithium-polymer battery; 0.1 to 0.2 V per 10 000 PWM in "
        "the nanobench flights",
        parameters=(
            Parameter(
                "sag",
                bounds=(-0.03, 0.7),
                plausible=0.15,
                negligible=0.01,
                one_signed=True,
                fields=("effects_battery_sag",),
            ),
            Parameter(
                "reference",
                unit="PWM",
                neutral=_SHIPPED.effects_battery_reference,
                bounds=(5000.0, 65000.0),
                plausible=34100.0,
                negligible=1000.0,
                is_reference=True,
            ),
        ),
        regimes=("hover", "climb", "low_battery"),
        confused_with=("thrust_scale", "thrust_bias", "thrust_curve", "battery_voltage", "thrust_fade"),
        remedy="Use a fresh battery with low internal resistance, or log pm.vbat and scale the thrust "
        "command by nominal over measured voltage.",
        channels=("translation",),
        apply=lambda vehicle, values: with_sag(vehicle, values.get("sag", 0.0), values.get("reference")),
        of_the_drive=True,
        changes_hover=True,
        says="the thrust sags under load (sag {sag}, zero at a load of {reference})",
    ),
    Effect(
        name="battery_voltage",
        description="The thrust follows the measured battery voltage. The reference is the voltage at which "
        "the modelled thrust is correct. In simulation the voltage is the vehicle file's: open - drop load - "
        "discharge t.",
        formula="F_t times (1 + sensitivity (V - reference))",
        source="brushed motors: speed proportional to duty times voltage, so thrust goes with voltage "
        "or its square, 0.27 to 0.54 1/V; PWM times voltage is constant in hover within 1.3 % in the "
        "nanobench flights",
        parameters=(
            Parameter("sensitivity", unit="1/V", bounds=(-0.3, 1.2), plausible=0.4, negligible=0.02),
            Parameter(
                "reference",
                unit="V",
                neutral=_SHIPPED.effects_voltage_reference,
                bounds=(2.8, 4.6),
                plausible=3.8,
                negligible=0.03,
                is_reference=True,
            ),
        ),
        regimes=("hover", "climb", "low_battery"),
        confused_with=("battery_sag", "thrust_fade", "thrust_scale"),
        remedy="Scale the thrust command by reference over measured voltage (pm.vbat), or switch on the "
        "firmware's battery compensation.",
        channels=("translation",),
        apply=_voltage,
        of_the_drive=True,
        says="the thrust changes with the battery voltage by {sensitivity} (modelled thrust at {reference})",
        requires={"voltage": 0.02},
    ),
)
