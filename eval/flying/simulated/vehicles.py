"""Vehicles that a simulated Crazyflie may be: the nominal one, one with hidden gaps, or a vehicle file."""

from __future__ import annotations

import math

from inclined_landing.models.effects import apply
from inclined_landing.models.parameters import load_vehicle
from inclined_landing.models.vehicle import Vehicle

# Gaps of the hidden vehicle, unknown to every policy: the thrust of the paper's flights, an attitude
# estimate levelled on a table that was not, and what a radio and firmware queues add in delay.
HIDDEN = {
    "thrust_scale": {"scale": 0.88},
    "level_calibration": {"roll": math.radians(0.6), "pitch": math.radians(-1.0)},
    "thrust_delay": {"delay": 0.015},
    "attitude_delay": {"delay": 0.015},
}


def named_vehicle(name: str) -> Vehicle:
    """Return the vehicle "nominal", "hidden" (HIDDEN applied to the nominal one), or that of a vehicle file.

    Raises UserError for a file that cannot be read.
    """
    if name == "nominal":
        return load_vehicle()
    return apply(load_vehicle(), HIDDEN) if name == "hidden" else load_vehicle(name)
