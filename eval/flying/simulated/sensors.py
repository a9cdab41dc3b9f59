"""The sensors of a simulated vehicle: attitude, specific force, voltage."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from inclined_landing.eval.flying.simulated.body import Body, firmware_attitude
from inclined_landing.eval.flying.simulated.firmware import PERIOD, Firmware
from inclined_landing.models.effects import LIBRARY

# Angles in deg, pitch inverted; specific force in g, voltage in V; supervisor.info are the bits of cflib's
# `Supervisor`.
LOGGED = (
    *(f"stateEstimate.{name}" for name in ("roll", "pitch", "yaw")),
    *("acc.z", "pm.vbat", "supervisor.info"),
)
SAG_RATE, FLAT = 0.5, 2.8  # V/s by which a failing battery falls, down to this voltage


class OnboardSensors:
    """The vehicle's own measurements. sign: -1 for inverted roll and pitch.

    The yaw of the onboard estimate is 0 at the heading at which the vehicle was switched on.
    """

    angle_noise = 0.1  # deg, standard deviation
    voltage_noise = 0.01  # V

    def __init__(self, body: Body, firmware: Callable[[], Firmware], random: np.random.Generator):
        self.sign = 1.0
        self.failing = False
        self._body, self._firmware, self._random = body, firmware, random
        self._heading = body.estimate_at(0.0)[2]
        self.voltage = body.voltage

    def look(self) -> None:
        """Measure the battery voltage; once per period of the supervisor."""
        self.voltage = self._body.voltage + self._random.normal(0.0, self.voltage_noise)
        if self.failing and self._body.voltage > FLAT:
            self._body.voltage_drop += SAG_RATE * PERIOD
            sensitivity = LIBRARY["battery_voltage"].parameters[0].plausible
            share = max(0.0, 1.0 - sensitivity * self._body.voltage_drop)
            self._body.plant.perturb(thrust_scale=share)

    def values(self, time: float) -> dict[str, float]:
        """Return the log variables LOGGED at a time [s] within the last step."""
        body, firmware = self._body, self._firmware()
        roll, pitch, yaw = body.estimate_at(time)
        angles = firmware_attitude(self.sign * roll, self.sign * pitch, yaw - self._heading)
        angles = np.add(angles, self._random.normal(0.0, self.angle_noise, 3)).tolist()
        return dict(zip(LOGGED, [*angles, body.specific_force[2], self.voltage, firmware.info]))
