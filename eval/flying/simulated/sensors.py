"""What a simulated vehicle measures of itself: attitude, rates, forces, voltage, and by a deck its position.

The position is what `stateEstimate` shows, in the frame of the deck: of a Lighthouse the arena's, of a Flow
deck that of the place and heading where the vehicle was switched on. The sizes of the errors are estimates;
for the Lighthouse see Taffanel et al., "Lighthouse Positioning System: Dataset, Accuracy, and Precision for
UAV Research", 2021.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable

import numpy as np

from inclined_landing.eval.flying.simulated.body import Body, firmware_attitude
from inclined_landing.eval.flying.simulated.firmware import PERIOD, Firmware
from inclined_landing.models.attitude import VX, VZ, WX, X, Z
from inclined_landing.models.effects import LIBRARY

LIGHTHOUSE, FLOW = "lighthouse", "flow"
DECKS = (LIGHTHOUSE, FLOW)
_SEEN = 0.03  # m/s, standard deviation of the velocity that the filter shows while its deck sees
SAG_RATE, FLAT = 0.5, 2.8  # V/s by which a failing battery falls, down to this voltage


@dataclasses.dataclass(frozen=True)
class DeckQuality:
    """Errors of the onboard estimate."""

    offset: float = 0.01  # m, Lighthouse: standard deviation of the offset on each axis, for a flight
    scale: float = 0.01  # Lighthouse and Flow: of the scale of a distance on each axis, for a flight
    noise: float = 0.002  # m, of the position from one moment to the next
    noise_time: float = 0.1  # s, its correlation time
    drift: float = 0.015  # m/s, Flow: of the velocity's error
    drift_time: float = 2.0  # s, its correlation time
    late: float = 0.01  # s by which the filter follows the motion
    blind: float = 0.3  # m/s2, of the error of the acceleration once the deck sees nothing


class PositioningDeck:
    """The estimate of one flight. blind: from now on the deck sees nothing, and the filter adds up."""

    def __init__(self, kind: str, body: Body, heading: float, random: np.random.Generator):
        self.kind, self.blind = kind, False
        self._quality, self._body, self._random = DeckQuality(), body, random
        q, flow = self._quality, kind == FLOW
        self._scale = 1.0 + random.normal(0.0, q.scale, 3)
        self._offset = np.zeros(3) if flow else random.normal(0.0, q.offset, 3)
        self._lean = random.normal(0.0, q.blind, 3)
        self._time = body.time
        self._noise, self._slip, self._drift = np.zeros(3), np.zeros(3), np.zeros(3)
        self._blind_error, self._blind_speed, self._blind_since = np.zeros(3), np.zeros(3), 0.0
        self._start = body.state_at(body.time)[X : Z + 1].copy() if flow else np.zeros(3)
        c, s = (math.cos(heading), math.sin(heading)) if flow else (1.0, 0.0)
        self._turn = np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])

    def estimate(self, time: float) -> tuple[np.ndarray, float]:
        """Return position (3,) [m] and variance of the velocity [m2/s2] at a time within the last step."""
        q, dt = self._quality, max(0.0, time - self._time)
        self._time = max(self._time, time)
        state = self._body.state_at(time)
        velocity = state[VX : VZ + 1]
        self._noise = self._wander(self._noise, q.noise, q.noise_time, dt)
        self._slip = self._wander(self._slip, q.drift, q.drift_time, dt)
        position = state[X : Z + 1] - q.late * velocity
        if self.kind == FLOW:
            # Of x and y only the velocity is seen: errors add up. Height is that above what is below.
            moving = (self._scale - 1.0) * velocity + self._slip * (np.linalg.norm(velocity) > 0.05)
            self._drift[:2] += dt * moving[:2]
            position = position + self._drift
            position[2] -= self._body.ground_below(state[X : Z + 1])
            position = self._turn @ (position - [*self._start[:2], 0.0])
        else:
            position = self._scale * position + self._offset
        variance = _SEEN**2
        if self.blind:
            self._blind_since += dt
            self._blind_speed = self._blind_speed + dt * self._lean
            self._blind_error = self._blind_error + dt * self._blind_speed
            variance += (q.blind * self._blind_since) ** 2
        return position + self._noise + self._blind_error, variance

    def _wander(self, value: np.ndarray, size: float, time: float, dt: float) -> np.ndarray:
        """Return the next value (3,) of an Ornstein-Uhlenbeck process of a standard deviation."""
        # x <- x exp(-dt / T) + s sqrt(1 - exp(-2 dt / T)) n
        keep = math.exp(-dt / time)
        return keep * value + size * math.sqrt(1.0 - keep * keep) * self._random.standard_normal(3)


class OnboardSensors:
    """The vehicle's own measurements. sign: -1 for inverted roll and pitch.

    The yaw of the onboard estimate is 0 where the vehicle was switched on: it knows no north, but by a
    Lighthouse deck. Without a deck it knows no position: that is 0.
    """

    angle_noise = 0.1  # deg, standard deviation
    voltage_noise = 0.01  # V

    def __init__(
        self,
        body: Body,
        firmware: Callable[[], Firmware],
        random: np.random.Generator,
        deck: PositioningDeck | None,
    ):
        self.sign = 1.0
        self.failing = False
        self._body, self._firmware, self._random = body, firmware, random
        self._deck = deck
        seen = deck is not None and deck.kind == LIGHTHOUSE
        self._heading = 0.0 if seen else body.estimate_at(0.0)[2]
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
        """Return the log variables of crtp.LOGGED."""
        body, firmware = self._body, self._firmware()
        roll, pitch, yaw = body.estimate_at(time)
        angles = firmware_attitude(self.sign * roll, self.sign * pitch, yaw - self._heading)
        angles = np.add(angles, self._random.normal(0.0, self.angle_noise, 3)).tolist()
        position, variance = (np.zeros(3), 0.0) if self._deck is None else self._deck.estimate(time)
        groups = {
            "stateEstimate": zip(("roll", "pitch", "yaw", *"xyz"), [*angles, *position.tolist()]),
            "kalman": zip(("varPX", "varPY", "varPZ"), [variance] * 3),
            "stabilizer": zip(("roll", "pitch", "yaw"), angles),
            "gyro": zip("xyz", np.degrees(body.state_at(time)[WX : WX + 3]).tolist()),
            "acc": zip("xyz", body.specific_force.tolist()),
        }
        return {
            **{f"{group}.{name}": value for group, values in groups.items() for name, value in values},
            "stabilizer.thrust": firmware.thrust,
            "pm.vbat": self.voltage,
            "supervisor.info": firmware.info,
        }
