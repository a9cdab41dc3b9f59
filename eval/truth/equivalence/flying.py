"""Command sequences of 6 s, flown in both plants far from every surface, and differences of the flights."""

from __future__ import annotations

import dataclasses

import numpy as np

from inclined_landing.envs.batch import BatchEnv
from inclined_landing.envs.policy import Policy
from inclined_landing.envs.tasks import frozen, hover_states
from inclined_landing.eval.truth.report import Words
from inclined_landing.models.attitude import (
    LAG,
    PITCH_COMMAND,
    ROLL,
    ROLL_COMMAND,
    YAW,
    YAW_RATE_COMMAND,
    Z,
)
from inclined_landing.models.parameters import load_vehicle
from inclined_landing.models.plants import AnalyticPlant, Attitude, MujocoPlant, make_plant, recorder
from inclined_landing.models.vehicle import Vehicle

WORDS = Words(__package__)  # of the page, with the tolerances
STEPS = 300  # control steps of 0.02 s
FAMILIES = ("full steps", "smooth", "recorded")
HEIGHT = 500.0  # m; full thrust up or none at all moves 6 s x up to 60 m/s
FINE = 20  # RK4 steps in a control period, 1 ms each: the equations solved to 1e-8 m
UNLIMITED = {
    "attitude_torque_limit": 100.0,
    "attitude_yaw_torque_limit": 100.0,
}  # N m, largest of their ranges
MODES: dict[Attitude, str] = {"kinematic": "kinematic", "rate_loop": "rate loop"}  # of attitude, in words


def engine(n: int, attitude: Attitude, vehicle: Vehicle | None = None, **options) -> MujocoPlant:
    """Return the MuJoCo vehicle without torque limits and contacts, which the equations do not have."""
    unlimited = (vehicle or load_vehicle()).changed(**UNLIMITED)
    return MujocoPlant(n, unlimited, attitude=attitude, contacts=False, **options)


def equations(
    n: int, attitude: Attitude, substeps: int = FINE, vehicle: Vehicle | None = None
) -> AnalyticPlant:
    """Return the paper's equations (kinematic), or those extended with the rate loop."""
    return AnalyticPlant(n, vehicle, attitude=attitude, substeps=substeps)


def start_states(n: int, yaw=0.0, vehicle: Vehicle | None = None) -> np.ndarray:
    """Return (n, 13) states in hover at HEIGHT, heading `yaw` (n,) [rad]."""
    state = np.zeros((n, 13))
    state[:, Z], state[:, YAW] = HEIGHT, yaw
    state[:, LAG] = (vehicle or load_vehicle()).hover_lag
    return state


def side_by_side(v: Vehicle, sequences: list[Sequences]) -> tuple[np.ndarray, np.ndarray]:
    """Return commands (steps, n, 4) and start states (n, 13) of all the sequences together."""
    yaw = np.concatenate([s.yaw for s in sequences])
    return np.concatenate([s.commands for s in sequences], axis=1), start_states(len(yaw), yaw, v)


def fly(plant, commands: np.ndarray, starts: np.ndarray | None = None) -> np.ndarray:
    """Return the states (steps, n, 13) after each of `commands` (steps, n, 4), without platform.

    starts: (n, 13), by default hovering.
    """
    everyone = np.arange(plant.n)
    plant.set_platform(everyone, plant.vehicle.platform_inclination, False)
    plant.reset(everyone, start_states(plant.n, vehicle=plant.vehicle) if starts is None else starts)
    return recorder.fly(plant, commands)[1:]


def position_gap(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return the distance [m] between states (..., 13)."""
    return np.linalg.norm(a[..., :3] - b[..., :3], axis=-1)


def angle_gap(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return the largest difference of the three Euler angles [deg] between states (..., 13)."""
    turns = a[..., ROLL : YAW + 1] - b[..., ROLL : YAW + 1]
    return np.degrees(np.abs(np.arctan2(np.sin(turns), np.cos(turns))).max(axis=-1))


def largest_gaps(a: np.ndarray, b: np.ndarray) -> tuple[float, float]:
    """Return (m, deg) largest differences between states (..., 13)."""
    return float(position_gap(a, b).max()), float(angle_gap(a, b).max())


@dataclasses.dataclass(frozen=True)
class Sequences:
    """n command sequences with their initial headings."""

    family: str
    planar: bool
    commands: np.ndarray  # (STEPS, n, 4)
    yaw: np.ndarray  # (n,) rad

    @property
    def label(self) -> str:
        """Return the family and dimension."""
        return f"{self.family}, {'2-D' if self.planar else '3-D'}"


def all_sequences(vehicle: Vehicle, n: int, seed: int, policy: Policy) -> list[Sequences]:
    """Return n sequences of every family in both dimensions; `recorded` are those of the landing policy."""
    result = []
    for k, family in enumerate(FAMILIES):
        for planar in (True, False):
            rng = np.random.default_rng([seed, k, planar])
            if family == "recorded":
                commands = _recorded(vehicle, n, rng, policy, planar)
            else:
                commands = {"full steps": full_steps, "smooth": smooth}[family](vehicle, n, rng)
            yaw = rng.uniform(-np.pi, np.pi, n)
            if planar:
                commands[..., [ROLL_COMMAND, YAW_RATE_COMMAND]] = 0.0
                yaw[:] = 0.0
            result.append(Sequences(family, planar, commands, yaw))
    return result


def bounds(v: Vehicle) -> tuple[np.ndarray, np.ndarray]:
    """Return the lower and upper command bounds (4,)."""
    high = np.array([v.command_pwm_range[1], v.command_angle_limit, v.command_angle_limit,
                     v.command_yaw_rate_limit])  # fmt: skip
    return np.array([v.command_pwm_range[0], *-high[1:]]), high


def full_steps(v: Vehicle, n: int, rng: np.random.Generator) -> np.ndarray:
    """Return (STEPS, n, 4): new commands anywhere within the bounds every ten control steps."""
    return np.repeat(rng.uniform(*bounds(v), (STEPS // 10, n, 4)), 10, axis=0)


def smooth(v: Vehicle, n: int, rng: np.random.Generator) -> np.ndarray:
    """Return (STEPS, n, 4): three sines of 0.1 to 1.5 Hz on every command, together within the bounds."""
    low, high = bounds(v)
    t = v.command_control_period * np.arange(STEPS)[:, None, None, None]
    turns = rng.uniform(0.1, 1.5, (n, 4, 3)) * t + rng.uniform(0, 1, (n, 4, 3))
    wave = np.sin(2 * np.pi * turns).mean(axis=-1)
    return 0.5 * (low + high) + 0.5 * (high - low) * wave


def _recorded(v: Vehicle, n: int, rng, policy: Policy, planar: bool) -> np.ndarray:
    """Return the commands (STEPS, n, 4) of the policy from n of the frozen starts, continued beyond the goal.

    In 3-D the roll commands are the pitch commands of another flight, with a smooth turn in yaw.
    """
    starts = frozen.grid()
    starts = starts[rng.permutation(len(starts))[:n]]
    starts = np.resize(starts, (n, 2))
    env = BatchEnv(policy.task, make_plant("analytic", n, v), seed=0)
    observation = env.reset(state=hover_states(starts, policy.task.vehicle))
    commands = np.empty((STEPS, n, 4))
    for row in commands:
        observation = env.step(policy.predict(observation)).observation
        row[:] = env.commands
    if not planar:
        commands[..., ROLL_COMMAND] = commands[:, rng.permutation(n), PITCH_COMMAND]
        commands[..., YAW_RATE_COMMAND] = smooth(v, n, rng)[..., YAW_RATE_COMMAND]
    return commands
