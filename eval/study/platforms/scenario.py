"""The scenarios of the benchmark (`scenarios.toml`): slope, travel and waves of a platform.

An axis of the platform moves by the sum over the components of amplitude cos(2 pi t / period + phase_deg +
phase), the last drawn for each flight and common to all axes. The direction that the bow, the platform's own
+x, faces is drawn too.
"""

from __future__ import annotations

import dataclasses
import functools
import math
from importlib import resources
from pathlib import Path

import numpy as np
from msgspec import structs

from inclined_landing.envs.tasks.base import hover_states
from inclined_landing.models.attitude import PITCH, YAW, Z
from inclined_landing.models.base import schema, storage
from inclined_landing.models.base.errors import UserError, choices, shown
from inclined_landing.models.base.schema import Table
from inclined_landing.models.motion import MODES, Motion
from inclined_landing.models.plants.base import PLATFORM_SIZE
from inclined_landing.models.vehicle import Vehicle

FLIGHTS = 64  # of each scenario
# m, box of the starts at rest, along the room's axes, from the centre of the platform then
START = ((-2.5, 2.5), (-1.2, 1.2), (0.5, 1.1))
# At rest is who stands on the feet alone, motors idle, slower than these relative to the platform, for HOLD,
# WITHIN the start.
SPEED, RATE, HOLD, WITHIN = 0.05, 1.0, 0.3, 10.0  # m/s, rad/s, s, s


class Wave(Table, frozen=True):
    """W components of an axis: along the bow, to port of it, up [m]; about the platform's own axes [deg]."""

    amplitude: list[float]
    phase_deg: list[float]


@dataclasses.dataclass(frozen=True)
class Waves:
    """W components of a motion in all six axes; see the module's docstring."""

    period: np.ndarray  # (W,) s
    amplitude: np.ndarray  # (6, W) m and rad, of motion.MODES
    phase: np.ndarray  # (6, W) rad


class Scenario(Table, frozen=True):
    """One scenario."""

    title: str
    source: str  # where the motion comes from
    seed: int  # of everything drawn
    inclination_deg: float = 0.0  # mean slope, falling towards the bow
    friction: float = 0.8  # between feet and platform
    speed: float = 0.0  # of steady travel, m/s
    course_deg: float | None = None  # of the travel, from the bow; None: drawn for each flight
    period: tuple[float, ...] = ()  # s, of the waves
    surge: Wave | None = None
    sway: Wave | None = None
    heave: Wave | None = None
    roll: Wave | None = None
    pitch: Wave | None = None
    yaw: Wave | None = None
    name: str = ""

    @property
    def inclination(self) -> float:
        """Return the mean slope [rad]."""
        return math.radians(self.inclination_deg)

    @property
    def waves(self) -> Waves:
        """Return the platform's motion in SI units."""
        w = max(1, len(self.period))
        amplitude, phase = np.zeros((6, w)), np.zeros((6, w))
        for k, mode in enumerate(MODES):
            wave = getattr(self, mode)
            if wave is not None:
                amplitude[k] = (1.0 if k < 3 else math.pi / 180.0) * np.array(wave.amplitude)
                phase[k] = np.radians(wave.phase_deg)
        return Waves(np.array(self.period or (1.0,)), amplitude, phase)

    def draw(self, vehicle: Vehicle, flights: int | None = None) -> DrawnFlights:
        """Draw the flights of the scenario; fewer are the first ones.

        Every flight has a generator of its own, so that how many are flown changes none.
        """
        n = FLIGHTS if flights is None else min(FLIGHTS, flights)
        made = self.waves
        w = len(made.period)
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
        waves = made.amplitude * np.exp(1j * (made.phase + phase[:, None, :]))  # (n, 6, W)
        bow = np.exp(1j * azimuth)[:, None]
        surge, sway = waves[:, 0].copy(), waves[:, 1].copy()
        waves[:, 0] = bow.real * surge - bow.imag * sway
        waves[:, 1] = bow.imag * surge + bow.real * sway
        motion = Motion(
            velocity=velocity,
            amplitude=np.abs(waves),
            frequency=np.broadcast_to(2.0 * math.pi / made.period, (n, 6, w)),
            phase=np.angle(waves) + 0.5 * math.pi,  # of a sine
        )
        rest = np.zeros((n, PLATFORM_SIZE))
        rest[:, Z], rest[:, PITCH], rest[:, YAW] = vehicle.platform_surface_height, self.inclination, azimuth
        place += motion.platforms(0.0, rest)[:, : Z + 1]
        return DrawnFlights(np.full(n, self.inclination), azimuth, motion, hover_states(place, vehicle))


@dataclasses.dataclass(frozen=True)
class DrawnFlights:
    """n flights of a scenario, in the room."""

    inclination: np.ndarray  # (n,) rad, of the platforms without their waves
    azimuth: np.ndarray  # (n,) rad
    motion: Motion
    start: np.ndarray  # (n, 13)


@functools.cache
def scenarios() -> dict[str, Scenario]:
    """Return the scenarios by name, in the order of the tables."""
    path = Path(str(resources.files("inclined_landing.eval.study.platforms") / "scenarios.toml"))
    read = schema.parse(storage.read_toml(path, "scenarios"), dict[str, Scenario])
    return {name: structs.replace(scenario, name=name) for name, scenario in read.items()}


def scenario_of(name: str) -> Scenario:
    """Return the scenario of a name. Raises UserError for an unknown one."""
    if name not in scenarios():
        raise UserError(f"scenario {shown(name, 60)} does not exist; {choices(scenarios(), name)}")
    return scenarios()[name]
