"""Vehicle parameters that a policy observes with the task option `observe_vehicle` (privileged observation).

They are six numbers in SI units, appended to the observation and its history and constant during a flight:

| number | unit | value for the Crazyflie 2.1 | definition |
|---|---|---|---|
| thrust to weight | 1 | 1.76 | highest PWM command over the one that hovers, effects included |
| thrust lag | s | 0.065 | 1 over the lag's rate |
| attitude lag | s | 0.204 | mean delay of the roll and pitch loop: damping (time constant + 1/bandwidth) |
| attitude gain | 1 | 1.11 | steady angle over the commanded one |
| drag rate | 1/s | 0.2 | sideways in hover: linear drag over mass |
| reach | m | 0.056 | outermost point of a rotor along x and y |

They describe the vehicle file, without effects that it does not contain.
"""

from __future__ import annotations

import numpy as np

from inclined_landing.models.forces import pack, rotor_speed_sum, settled_hover
from inclined_landing.models.vehicle import Vehicle

NAMES = ("thrust to weight", "thrust lag", "attitude lag", "attitude gain", "drag rate", "reach")
UNITS = ("1", "s", "s", "1", "1/s", "m")
# What a policy network subtracts and divides by: about the middle and the spread of quadrotors up to 0.5 kg.
CENTRE = np.array([2.0, 0.07, 0.2, 1.0, 0.4, 0.1])
SCALE = np.array([0.5, 0.03, 0.1, 0.2, 0.3, 0.1])


def vehicle_parameters(vehicle: Vehicle) -> np.ndarray:
    """Return the parameters (6,) of NAMES, float32."""
    v = vehicle
    drag = -v.drag_coefficients[0] * rotor_speed_sum(v.weight, pack(v)[0])
    return np.array(
        [
            v.command_pwm_range[1] / settled_hover(v),
            1.0 / v.thrust_lag_rate,
            v.attitude_damping * (v.attitude_time_constant + 1.0 / v.attitude_bandwidth),
            v.attitude_gain,
            drag / (v.body_mass + v.effects_load_mass),
            v.rotor_arm + v.rotor_radius,
        ],
        np.float32,
    )
