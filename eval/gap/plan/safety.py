"""Safety of a planned flight: set-points within limits, and flights simulated under every set of effects.

The simulated pilot tracks the set-points with PID feedback of the measured position beside the feed-forward
commands of the plan, which are those of the nominal vehicle.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor

import numpy as np

from inclined_landing.eval.gap.plan.information import NoiseLevels
from inclined_landing.eval.gap.plan.pieces import MARGIN, RATE, Space
from inclined_landing.eval.gap.plan.setpoints import Setpoints, thrust_and_angles
from inclined_landing.models.attitude import LAG, PITCH, ROLL, STATE_SIZE, VX, YAW, X, Z, rotations
from inclined_landing.models.geometry import reach_below
from inclined_landing.models.parameters import Vehicle
from inclined_landing.models.plants import MujocoPlant
from inclined_landing.models.surface import normal_of

SPEED = 3.0  # m/s, at most
TILT = 0.8  # of the attitude limit, at most, in a plan; simulated flights may use all of it
THRUST_MARGIN = 0.05  # of the PWM range, kept at both ends in a plan
CLEAR, CLEAR_NEAR = 0.15, 0.02  # m, least clearance in simulated flights; in pieces near a surface
LEAST_VOLTAGE = 3.0  # V under load, at the end
# Parameter uncertainty of the vehicle beside the effects: every simulated copy has another sample.
COPIES = 4
UNCERTAINTY = {"thrust_scale": 0.03, "lag_scale": 0.2, "drag_change": 0.3, "gain_scale": 0.05,
    "time_constant_scale": 0.15, "mass_scale": 0.01}  # fmt: skip
# Gains of the pilot: proportional, derivative, integral; of the heading proportional.
SIDEWAYS, UPWARD, HEADING = (4.0, 3.2, 1.0), (8.0, 5.0, 3.0), 1.5  # 1/s2, 1/s, 1/s3; 1/s


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
        ("leaves the space that is free", inside < -1e-9),
        (f"is faster than {SPEED:g} m/s", speed > SPEED),
        (f"tilts beyond {math.degrees(TILT * limit):.0f} deg", tilt > TILT * limit),
        ("asks for more tilt than can be commanded", commanded > 0.95 * limit),
        ("asks for thrust at the end of its range", pwm < 0.0),
        ("comes too close to a surface", surface < needed),
    )


def battery_voltage(vehicle: Vehicle, seconds: float) -> float:
    """Return the voltage under hover load [V] of the vehicle file's battery after so many seconds."""
    v = vehicle
    drop = v.effects_voltage_drop * v.hover_pwm
    return v.effects_voltage_open - drop - v.effects_voltage_discharge * seconds


def simulate_plan(
    points: Setpoints, vehicles: Sequence[Vehicle], space: Space, noise_levels: NoiseLevels, seed: int = 0
) -> tuple[Violation | None, list[np.ndarray]]:
    """Return the first violation when each of `vehicles`, with its uncertainty, flies the plan.

    Also the states (COPIES, m, 13) of every one at the control rate. noise_levels: measurement noise of the
    pilot's feedback, and disturbance.
    """
    with ThreadPoolExecutor(2) as pool:
        states_of_all = list(
            pool.map(lambda k: fly(points, vehicles[k], space, noise_levels, (seed, k)), range(len(vehicles)))
        )
    violations = [
        w for states in states_of_all if (w := _simulation_violation(states, points, space)) is not None
    ]
    return min(violations, key=lambda w: w.time, default=None), states_of_all


def fly(points: Setpoints, vehicle: Vehicle, space: Space, noise_levels: NoiseLevels, seed) -> np.ndarray:
    """Return the states (COPIES, m, 13) of a vehicle flown along the plan in MuJoCo; NaN after a contact."""
    rng = np.random.default_rng(seed)
    plant = MujocoPlant(COPIES, noise_levels.disturbed(vehicle), threads=1, disturbance=rng)
    drawn = {n: rng.uniform(-s, s, COPIES) * (np.arange(COPIES) > 0) for n, s in UNCERTAINTY.items()}
    plant.perturb(**{n: x if n == "drag_change" else 1.0 + x for n, x in drawn.items()})
    plant.set_platform(np.arange(COPIES), vehicle.platform_inclination, space.platform)
    start = np.zeros((COPIES, STATE_SIZE))
    start[:, X : Z + 1], start[:, YAW] = points.path.position[0], points.path.yaw[0]
    start[:, LAG] = space.vehicle.hover_lag
    plant.reset(np.arange(COPIES), start)
    stride = max(1, round(plant.control_period * RATE))
    rows = np.arange(0, len(points.path.yaw), stride)
    states, integral = np.full((len(rows), COPIES, STATE_SIZE), np.nan), np.zeros((COPIES, 3))
    for i, row in enumerate(rows):
        measured = plant.measurement.copy()
        measured[:, X : Z + 1] += noise_levels.noise[:3] * rng.standard_normal((COPIES, 3))
        command = _pilot(points, row, measured, integral, plant.control_period, space.vehicle)
        plant.advance(command)
        if plant.diverged.any() or plant.contacts.touch.any():
            break
        states[i] = plant.state
    return states.swapaxes(0, 1)


def _pilot(points: Setpoints, row: int, measured: np.ndarray, integral: np.ndarray, dt: float, v: Vehicle):
    """Return the commands (n, 4) for measured states (n, 13); integral (n, 3) is updated in place."""
    # a = a_d + Kp (x_d - x) + Kd (v_d - v) + Ki int (x_d - x) dt,  inverted to thrust, roll and pitch
    error = points.path.position[row] - measured[:, X : Z + 1]
    integral += dt * np.clip(error, -0.5, 0.5)
    gains = np.array([SIDEWAYS, SIDEWAYS, UPWARD]).T
    acceleration = points.acceleration[row] + gains[0] * error
    acceleration = (
        acceleration + gains[1] * (points.velocity[row] - measured[:, VX : VX + 3]) + gains[2] * integral
    )
    acceleration[:, 2] = np.maximum(acceleration[:, 2], 2.0 - v.environment_gravity)
    size, angles = thrust_and_angles(acceleration, measured[:, YAW], v.environment_gravity)
    turn = points.path.yaw[row] - measured[:, YAW]
    turn = HEADING * np.arctan2(np.sin(turn), np.cos(turn))
    limit, rate_limit = v.command_angle_limit, v.command_yaw_rate_limit
    return np.column_stack(
        [
            np.clip(v.hover_pwm * size / v.environment_gravity + points.lead[row, 0], *v.command_pwm_range),
            np.clip(angles / v.attitude_gain + points.lead[row, 1:], -limit, limit),
            np.clip(points.command[row, 3] + turn, -rate_limit, rate_limit),
        ]
    )


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
    return _first(
        ("touches something", lost),
        ("leaves the arena", outside > -0.5 * MARGIN),
        (f"is faster than {1.1 * SPEED:g} m/s", speed > 1.1 * SPEED),
        ("tilts beyond the attitude limit", tilt > v.command_angle_limit),
        ("comes too close to a surface", surface < np.where(near, CLEAR_NEAR, CLEAR)),
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
    return np.minimum(floor, np.maximum(above, beside.max(axis=-1) - space.shapes.reach))


def _first(*checks: tuple[str, np.ndarray], step: float = 1.0 / RATE) -> Violation | None:
    """Return the earliest row at which one of the checks (text, (m,) bool) is violated."""
    found = [
        Violation(float(np.argmax(violations)) * step, text)
        for text, violations in checks
        if violations.any()
    ]
    return min(found, key=lambda v: v.time, default=None)
