"""The sensors of a simulated vehicle: attitude, rates, forces, voltage, position.

The position is that of `stateEstimate`, in the arena's frame. The sizes of the errors are estimates, see
Taffanel et al., "Lighthouse Positioning System: Dataset, Accuracy, and Precision for UAV Research", 2021.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from inclined_landing.eval.flying.simulated.body import Body, firmware_attitude
from inclined_landing.eval.flying.simulated.firmware import PERIOD, Firmware
from inclined_landing.models.attitude import VX, VZ, X, Z
from inclined_landing.models.effects import LIBRARY

# Angles in deg, pitch inverted; position in m, the filter's variance of the velocity in m2/s2; specific force
# in g, voltage in V; supervisor.info are the bits of cflib's `Supervisor`.
LOGGED = (
    *(f"stateEstimate.{name}" for name in ("roll", "pitch", "yaw", "x", "y", "z")),
    *(f"kalman.{name}" for name in ("varPX", "varPY", "varPZ")),
    *("acc.z", "pm.vbat", "supervisor.info"),
)
_SEEN = 0.03  # m/s, standard deviation of the velocity that the filter shows while its deck sees
SAG_RATE, FLAT = 0.5, 2.8  # V/s by which a failing battery falls, down to this voltage


# Errors of the onboard estimate: standard deviations of offset [m] and scale of each axis, for a flight;
# noise of the position [m] and its correlation time [s]; lag behind the motion [s]; error of the acceleration
# once the deck sees nothing [m/s2].
OFFSET, SCALE, NOISE, NOISE_TIME, LATE, BLIND = 0.01, 0.01, 0.002, 0.1, 0.01, 0.3


class Lighthouse:
    """The deck's estimate in one flight. blind: it receives nothing, so the filter only integrates."""

    def __init__(self, body: Body, random: np.random.Generator):
        self.blind = False
        self._body, self._random = body, random
        self._scale = 1.0 + random.normal(0.0, SCALE, 3)
        self._offset = random.normal(0.0, OFFSET, 3)
        self._lean = random.normal(0.0, BLIND, 3)
        self._time = body.time
        self._noise = np.zeros(3)
        self._blind_error, self._blind_speed, self._blind_since = np.zeros(3), np.zeros(3), 0.0

    def estimate(self, time: float) -> tuple[np.ndarray, float]:
        """Return position (3,) [m] and variance of the velocity [m2/s2] at a time within the last step."""
        dt = max(0.0, time - self._time)
        self._time = max(self._time, time)
        state = self._body.state_at(time)
        # Ornstein-Uhlenbeck process: x <- x exp(-dt / T) + s sqrt(1 - exp(-2 dt / T)) n
        keep = math.exp(-dt / NOISE_TIME)
        drawn = self._random.standard_normal(3)
        self._noise = keep * self._noise + NOISE * math.sqrt(1.0 - keep * keep) * drawn
        position = self._scale * (state[X : Z + 1] - LATE * state[VX : VZ + 1]) + self._offset
        variance = _SEEN**2
        if self.blind:
            self._blind_since += dt
            self._blind_speed = self._blind_speed + dt * self._lean
            self._blind_error = self._blind_error + dt * self._blind_speed
            variance += (BLIND * self._blind_since) ** 2
        return position + self._noise + self._blind_error, variance


class OnboardSensors:
    """The vehicle's own measurements. sign: -1 for inverted roll and pitch.

    The yaw of the onboard estimate is 0 at the heading at which the vehicle was switched on, unless it has a
    Lighthouse deck. Without a deck its position is 0.
    """

    angle_noise = 0.1  # deg, standard deviation
    voltage_noise = 0.01  # V

    def __init__(
        self,
        body: Body,
        firmware: Callable[[], Firmware],
        random: np.random.Generator,
        deck: Lighthouse | None,
    ):
        self.sign = 1.0
        self.failing = False
        self._body, self._firmware, self._random = body, firmware, random
        self._deck = deck
        self._heading = 0.0 if deck is not None else body.estimate_at(0.0)[2]
        self.voltage = body.voltage

    def look(self) -> None:
        """Measure the battery voltage; once per period of the supervisor."""
        self.voltage = self._body.voltage + self._random.normal(0.0, self.voltage_noise)
        if self.failing and self._body.voltage > FLAT:
            self._body.voltage_drop += SAG_RATE * PERIOD
            sensitivity = LIBRARY["battery_voltage"].parameters[0].plausible
            share = max(0.0, 1.0 - sensitivity * self._body.voltage_drop)
            self._body.plant.set_thrust_scale(share)

    def values(self, time: float) -> dict[str, float]:
        """Return the log variables LOGGED at a time [s] within the last step."""
        body, firmware = self._body, self._firmware()
        roll, pitch, yaw = body.estimate_at(time)
        angles = firmware_attitude(self.sign * roll, self.sign * pitch, yaw - self._heading)
        angles = np.add(angles, self._random.normal(0.0, self.angle_noise, 3)).tolist()
        position, variance = (np.zeros(3), 0.0) if self._deck is None else self._deck.estimate(time)
        shown = [*angles, *position.tolist(), *[variance] * 3]
        return dict(zip(LOGGED, [*shown, body.specific_force[2], self.voltage, firmware.info]))
