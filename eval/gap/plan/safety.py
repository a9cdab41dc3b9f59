"""Safety of a planned flight: set-points within limits, and flights simulated under every set of effects.

What is simulated is the closed loop that `landing-eval fly --plan` flies: the pilot's controller on a
measured position, on top of the commands of the plan, which are those of the nominal vehicle.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping, Sequence

import numpy as np
from scipy.interpolate import CubicSpline

from inclined_landing.envs.hover import TOLERANCE
from inclined_landing.eval.flying.fence import beyond_fence
from inclined_landing.eval.flying.tracking import Tracker
from inclined_landing.eval.gap.plan.information import NoiseLevels
from inclined_landing.eval.gap.plan.pieces import MARGIN, RATE, Setpoints, Space, measured_log
from inclined_landing.eval.logs import FlightLog
from inclined_landing.models.attitude import LAG, PITCH, ROLL, STATE_SIZE, VX, YAW, X, Z, rotations
from inclined_landing.models.base.errors import UserError
from inclined_landing.models.geometry import reach_below
from inclined_landing.models.parameters import check_vehicle
from inclined_landing.models.plants import MujocoPlant
from inclined_landing.models.surface import normal_of
from inclined_landing.models.threads import two_at_a_time
from inclined_landing.models.vehicle import Vehicle

SPEED = 3.0  # m/s, at most
FENCE = 0.15  # m kept beside the pilot's stopping distance in a plan; simulated flights have the pilot's own
ASTRAY = 0.4  # m off the plan, at most, in simulated flights: the pilot ends them at more
TILT = 0.8  # of the attitude limit, at most, in a plan; simulated flights may use all of it
THRUST_MARGIN = 0.05  # of the PWM range, kept at both ends in a plan
CLEAR, CLEAR_NEAR = 0.15, 0.03  # m, least clearance in simulated flights; in pieces near a surface
LEAST_VOLTAGE = 3.0  # V under load, at the end
# Parameter uncertainty of the vehicle beside the effects: every simulated copy has another sample.
COPIES = 4
UNCERTAINTY = {"thrust": 0.03, "lag": 0.2, "drag": 0.3, "gain": 0.05, "time_constant": 0.15, "mass": 0.01}


@dataclasses.dataclass(frozen=True)
class Violation:
    """The first violation of a safety limit."""

    time: float  # s
    text: str


def plan_violation(points: Setpoints, space: Space) -> Violation | None:
    """Return the first safety limit that the set-points violate; None if none."""
    v, path = space.vehicle, points.path
    speed = np.linalg.norm(points.velocity, axis=1)
    inside = np.minimum(path.position - space.low, space.high - path.position)
    inside = np.where(path.near[:, None], 1.0, inside).min(axis=1)
    low, high = v.command_pwm_range
    spare = THRUST_MARGIN * (high - low)
    pwm = np.minimum(points.command[:, 0] - low - spare, high - spare - points.command[:, 0])
    limit = v.command_angle_limit
    tilt = np.abs(points.attitude[:, :2]).max(axis=1)
    commanded = np.abs(points.command[:, 1:3]).max(axis=1)
    surface = clearance(path.position, points.attitude, space)
    needed = np.where(path.near, CLEAR_NEAR + 0.02, CLEAR)
    return _first(
        ("leaves the free space", inside < -1e-9),
        (f"is faster than {SPEED:g} m/s", speed > SPEED),
        (f"tilts beyond {math.degrees(TILT * limit):.0f} deg", tilt > TILT * limit),
        ("needs more tilt than can be commanded", commanded > 0.95 * limit),
        ("needs thrust at the end of its range", pwm < 0.0),
        ("comes too close to a surface", surface < needed),
        ("comes too close to the fence", beyond_fence(path.position, points.velocity, v, FENCE)),
    )


def battery_voltage(vehicle: Vehicle, seconds: float) -> float:
    """Return the voltage under hover load [V] of the vehicle file's battery after so many seconds."""
    v = vehicle
    drop = v.effects_voltage_drop * v.hover_pwm
    return v.effects_voltage_open - drop - v.effects_voltage_discharge * seconds


@dataclasses.dataclass(frozen=True)
class Flown:
    """Simulated flights of one vehicle with its uncertainty along a plan."""

    states: np.ndarray  # (COPIES, m, 13) at the control rate; NaN after a contact
    commands: np.ndarray  # (COPIES, m, 4)
    period: float  # s, of a control step

    def log(self, noise: np.ndarray) -> FlightLog:
        """Return the first copy's flight, that of the set's own values, measured at RATE with noise (6,)."""
        given = np.arange(self.states.shape[1]) * self.period
        t = np.arange(round(given[-1] * RATE) + 1) / RATE
        pose = np.hstack([self.states[0, :, X : Z + 1], np.unwrap(self.states[0, :, ROLL : YAW + 1], axis=0)])
        # Rows of states are those at the end of their control step, after the command of the row.
        pose = CubicSpline(given + self.period, pose)(t)
        command = self.commands[0, np.minimum((t / self.period + 1e-6).astype(int), len(given) - 1)]
        return measured_log("simulated", t, pose, command, noise)


def simulate_plan(
    points: Setpoints, vehicles: Sequence[Vehicle], space: Space, noise_levels: NoiseLevels
) -> tuple[Violation | None, list[Flown]]:
    """Return the first violation when each of `vehicles`, with its uncertainty, flies the plan; the flights.

    noise_levels: measurement noise of the pilot's feedback, and disturbance.
    """
    seeds = [(0, k) for k in range(len(vehicles))]
    flown = two_at_a_time(lambda v, seed: fly(points, v, space, noise_levels, seed), vehicles, seeds)
    violations = [w for one in flown if (w := _simulation_violation(one.states, points, space)) is not None]
    return min(violations, key=lambda w: w.time, default=None), flown


def fly(points: Setpoints, vehicle: Vehicle, space: Space, noise_levels: NoiseLevels, seed) -> Flown:
    """Return COPIES flights of a vehicle along the plan in MuJoCo; all end at the first contact.

    The first copy is the vehicle itself. The others begin as far off as the pilot hands over.
    """
    rng = np.random.default_rng(seed)
    everyone, other = np.arange(COPIES), np.arange(COPIES) > 0
    factors = {n: 1.0 + rng.uniform(-s, s, COPIES) * other for n, s in UNCERTAINTY.items()}
    model = noise_levels.disturbed(vehicle)
    pool = [_varied(model, {name: float(x[k]) for name, x in factors.items()}) for k in everyone[1:]]
    plant = MujocoPlant(COPIES, model, threads=1, disturbance=rng, pool=pool)
    plant.assign(everyone, everyone)
    plant.set_platform(everyone, vehicle.platform_inclination, space.platform)
    start = np.zeros((COPIES, STATE_SIZE))
    off = rng.normal(size=(COPIES, 3))
    off *= TOLERANCE * other[:, None] / np.linalg.norm(off, axis=1, keepdims=True)
    start[:, X : Z + 1], start[:, YAW] = points.position[0] + off, points.path.yaw[0]
    start[:, LAG] = space.vehicle.hover_lag * factors["lag"]
    plant.reset(everyone, start)
    period, tracker = plant.control_period, Tracker(points, space.vehicle, COPIES)
    steps = math.ceil(points.path.seconds / period)
    states, commands = np.full((steps, COPIES, STATE_SIZE), np.nan), np.zeros((steps, COPIES, 4))
    for k in range(steps):
        measured = plant.measurement.copy()
        measured[:, X : Z + 1] += noise_levels.noise[:3] * rng.standard_normal((COPIES, 3))
        commands[k] = tracker.command(k * period, measured, period)
        plant.advance(commands[k])
        if plant.diverged.any() or plant.contacts.touch.any():
            break
        states[k] = plant.state
    return Flown(states.swapaxes(0, 1), commands.swapaxes(0, 1), period)


def _varied(v: Vehicle, factor: Mapping[str, float]) -> Vehicle:
    """Return a vehicle with the quantities of UNCERTAINTY multiplied by `factor`; v if that is impossible.

    A slower lag has a proportionally larger state under the same command.
    """
    thrust, lag = factor["thrust"], factor["lag"]
    varied = v.changed(
        thrust_lag_rate=v.thrust_lag_rate / lag,
        thrust_state_gain=v.thrust_state_gain * thrust / lag,
        thrust_direct_gain=v.thrust_direct_gain * thrust,
        drag_coefficients=tuple(factor["drag"] * k for k in v.drag_coefficients),
        attitude_gain=factor["gain"] * v.attitude_gain,
        attitude_time_constant=factor["time_constant"] * v.attitude_time_constant,
        body_mass=factor["mass"] * v.body_mass,
    )
    try:
        check_vehicle(varied)
    except UserError:
        return v
    return varied


def _simulation_violation(states: np.ndarray, points: Setpoints, space: Space) -> Violation | None:
    """Return the first safety limit that simulated states (COPIES, m, 13) violate; None if none."""
    v = space.vehicle
    stride = max(1, round(len(points.path.yaw) / states.shape[1]))
    near = points.path.near[::stride][: states.shape[1]]
    lost = ~np.isfinite(states).all(axis=(0, 2))
    with np.errstate(invalid="ignore"):
        position = states[..., X : Z + 1]
        ends = np.array([v.arena_x, v.arena_y, v.arena_z], float)
        outside = np.maximum(ends[:, 0] - position, position - ends[:, 1])
        outside[..., 2] = position[..., 2] - ends[2, 1]  # the floor is a surface
        outside = outside.max(axis=(0, 2))
        speed = np.linalg.norm(states[..., VX : VX + 3], axis=2).max(axis=0)
        tilt = np.abs(states[..., [ROLL, PITCH]]).max(axis=(0, 2))
        surface = clearance(position, states[..., ROLL : YAW + 1], space).min(axis=0)
        fence = beyond_fence(position, states[..., VX : VX + 3], v).any(axis=0)
        planned = points.position[::stride][: states.shape[1]]
        astray = np.linalg.norm(position - planned, axis=2).max(axis=0)
    return _first(
        ("touches something", lost),
        ("leaves the arena", outside > -0.5 * MARGIN),
        (f"is faster than {1.1 * SPEED:g} m/s", speed > 1.1 * SPEED),
        ("tilts beyond the attitude limit", tilt > v.command_angle_limit),
        ("comes too close to a surface", surface < np.where(near, CLEAR_NEAR, CLEAR)),
        ("comes too close to the fence", fence),
        (f"strays more than {ASTRAY:g} m from the plan", astray > ASTRAY),
        step=stride / RATE,
    )


def clearance(position: np.ndarray, attitude: np.ndarray, space: Space) -> np.ndarray:
    """Return a lower bound (...,) [m] of the clearance to the floor and, where it stands, the slab.

    position (..., 3) of its centre, attitude (..., 3): roll, pitch, yaw.
    """
    v, z = space.vehicle, position[..., 2]
    rotation = rotations(attitude.reshape(-1, 3)).reshape(*attitude.shape, 3)
    floor = z - reach_below(space.shapes, rotation[..., 2, :])
    if not space.platform:
        return floor
    normal = normal_of(v.platform_inclination)
    above = (position - [0.0, 0.0, v.platform_surface_height]) @ normal
    above = above - reach_below(space.shapes, np.einsum("...ij,i->...j", rotation, normal))
    beside = np.abs(position[..., :2]) - 0.5 * np.array([v.platform_width, v.platform_depth])
    return np.minimum(floor, np.maximum(above, beside.max(axis=-1) - space.shapes.reach[0]))


def _first(*checks: tuple[str, np.ndarray], step: float = 1.0 / RATE) -> Violation | None:
    """Return the earliest row at which one of the checks (text, (m,) bool) is violated."""
    found = [Violation(float(np.argmax(rows)) * step, text) for text, rows in checks if rows.any()]
    return min(found, key=lambda v: v.time, default=None)
