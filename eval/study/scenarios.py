"""The scenarios of the benchmark of moving platforms: their slope, travel and waves (`scenarios.toml`).

The motion of each axis of the platform is the sum over components of amplitude cos(2 pi t / period +
phase_deg + phase), with the last phase drawn for each flight and common to all axes. The direction of the
bow, the platform's +x axis, is drawn too.
"""

from __future__ import annotations

import dataclasses
import functools
import math
import tomllib
from collections.abc import Mapping
from importlib import resources

import numpy as np

from inclined_landing.envs.tasks.base import hover_states
from inclined_landing.envs.tasks.start import Start
from inclined_landing.models.attitude import Z
from inclined_landing.models.motion import MODES, Motion
from inclined_landing.models.vehicle import Vehicle

FLIGHTS = 64  # of each scenario
# m, box of the starts at rest, along the room's axes, from the centre of the platform then
START = ((-2.5, 2.5), (-1.2, 1.2), (0.5, 1.1))


@dataclasses.dataclass(frozen=True)
class Scenario:
    """One scenario."""

    seed: int  # of everything drawn
    inclination_deg: float = 0.0  # mean slope, falling towards the bow
    friction: float = 0.8  # between feet and platform
    speed: float = 0.0  # of steady travel, m/s
    course_deg: float | None = None  # of the travel, from the bow; None: drawn for each flight
    period: tuple[float, ...] = (1.0,)  # s, of the W components of the waves
    # `amplitude` and `phase_deg` (W,) of the axes of motion.MODES that move: along the bow, to port of it, up
    # [m]; about the platform's own axes [deg].
    waves: Mapping[str, Mapping[str, list[float]]] = dataclasses.field(default_factory=dict)

    def components(self) -> tuple[np.ndarray, np.ndarray]:
        """Return amplitudes [m and rad] and phases [rad] (6, W) of the axes of motion.MODES."""
        amplitude, phase = np.zeros((2, len(MODES), len(self.period)))
        for mode, wave in self.waves.items():
            k = MODES.index(mode)
            amplitude[k] = (1.0 if k < 3 else math.pi / 180.0) * np.array(wave["amplitude"])
            phase[k] = np.radians(wave["phase_deg"])
        return amplitude, phase

    def draw(self, vehicle: Vehicle, flights: int | None = None) -> Start:
        """Draw the flights of the scenario; a smaller number gives the first ones.

        Every flight has its own random generator, so that the number of flights does not change them.
        """
        n = FLIGHTS if flights is None else min(FLIGHTS, flights)
        amplitude, axis_phase = self.components()
        w = len(self.period)
        place, phase = np.empty((n, 3)), np.empty((n, w))
        low, high = np.transpose(START)
        azimuth, course = np.empty(n), np.full(n, math.radians(self.course_deg or 0.0))
        for k in range(n):
            draws = np.random.default_rng([self.seed, k]).random(5 + w)
            place[k] = low + draws[:3] * (high - low)
            azimuth[k] = 2.0 * math.pi * draws[3] - math.pi
            if self.course_deg is None:
                course[k] = 2.0 * math.pi * draws[4] - math.pi
            phase[k] = 2.0 * math.pi * draws[5:]
        heading = azimuth + course
        velocity = self.speed * np.column_stack([np.cos(heading), np.sin(heading), np.zeros(n)])
        waves = amplitude * np.exp(1j * (axis_phase + phase[:, None, :]))  # (n, 6, W)
        bow = np.exp(1j * azimuth)[:, None]
        surge, sway = waves[:, 0].copy(), waves[:, 1].copy()
        waves[:, 0] = bow.real * surge - bow.imag * sway
        waves[:, 1] = bow.imag * surge + bow.real * sway
        motion = Motion(
            velocity=velocity,
            amplitude=np.abs(waves),
            frequency=np.broadcast_to(2.0 * math.pi / np.array(self.period), (n, 6, w)),
            phase=np.angle(waves) + 0.5 * math.pi,  # of a sine
        )
        start = Start(
            state=hover_states(place, vehicle),
            inclination=np.full(n, math.radians(self.inclination_deg)),
            present=np.ones(n, bool),
            goal_size=np.zeros(n),
            contact={"friction": np.full(n, self.friction)},
            azimuth=azimuth,
            motion=motion,
        )
        start.state[:, : Z + 1] = place + start.platforms(vehicle)[:, : Z + 1]
        return start


@functools.cache
def scenarios() -> dict[str, Scenario]:
    """Return the scenarios by name, in the order of the tables."""
    text = (resources.files(__package__) / "scenarios.toml").read_text("utf-8")
    return {
        name: Scenario(waves={mode: entry.pop(mode) for mode in MODES if mode in entry}, **entry)
        for name, entry in tomllib.loads(text).items()
    }
