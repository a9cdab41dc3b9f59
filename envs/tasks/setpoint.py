"""`Setpoint`: fly to a point and stay there, the paper's three-dimensional task.

Observation, float32, unbounded:

| index | quantity | unit |
|---|---|---|
| 0, 1, 2 | x, y, z | m |
| 3, 4, 5 | vx, vy, vz | m/s |
| 6 | roll, positive accelerates -y | rad |
| 7 | pitch, positive accelerates +x | rad |

Action, float32, from -1 to 1; the yaw-rate command is zero:

| index | command | at action a | MuJoCo actuator |
|---|---|---|---|
| 0 | thrust | PWM as in `InclinedLanding` | `thrust` |
| 1 | roll | 30 deg times a | `roll` |
| 2 | pitch | 30 deg times a | `pitch` |

Reward: -e_p - 0.2 e_v - 0.1 e_att - 0.1 a_att^2 / max(e_p, 0.001), with e_p [m] the distance to the
goal (0, 0, 1.2), e_v [m/s] the speed, e_att [rad] the norm of (roll, pitch) and a_att the norm of the
two attitude actions.
Episodes are truncated after 300 steps and never terminated; `success` is e_p < 5 cm.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from inclined_landing.envs.tasks.base import Judgement, Start, hover_states, resolve_pwm_centre
from inclined_landing.models.attitude import PITCH, PITCH_COMMAND, PWM, ROLL, ROLL_COMMAND, VX, VZ
from inclined_landing.models.parameters import Vehicle, load_vehicle

_COLUMNS = [0, 1, 2, 3, 4, 5, ROLL, PITCH]
EFFORT_FLOOR = 0.001  # m
MAX_STEPS = 300
GOAL = (0.0, 0.0, 1.2)  # m
START_BOX = ((-2.5, 2.5), (-1.3, 1.3), (0.2, 2.2))  # m
TOLERANCE = 0.05  # m


@dataclasses.dataclass(frozen=True)
class Conditions:
    """What a curriculum may ease. The default is the task."""

    effort_floor: float = EFFORT_FLOOR  # smallest e_p in the effort term, m
    episode_limit: int = MAX_STEPS  # truncate after this many steps


class Setpoint:
    """The task for vehicles of one kind; there is no platform."""

    name = "setpoint"
    observation_names = ("x", "y", "z", "vx", "vy", "vz", "roll", "pitch")
    observation_scale = np.array([1.0, 1.0, 1.0, 2.0, 2.0, 2.0, 0.5, 0.5])
    observation_centre = np.array([*GOAL, 0.0, 0.0, 0.0, 0.0, 0.0])
    action_names = ("thrust", "roll", "pitch")
    max_steps = MAX_STEPS

    def __init__(self, vehicle: Vehicle | None = None, *, pwm_centre: float | str = "paper"):
        self.vehicle = vehicle or load_vehicle()
        self.pwm_centre = resolve_pwm_centre(pwm_centre, self.vehicle)
        self.options = {"pwm_centre": pwm_centre}
        self.conditions = Conditions()

    def sample(self, rng: np.random.Generator, k: int) -> Start:
        """k starts at rest, uniform over START_BOX."""
        low, high = np.array(START_BOX).T
        return self.start(hover_states(rng.uniform(low, high, (k, 3)), self.vehicle))

    def start(self, state: np.ndarray) -> Start:
        """Starts from given states (k, 13)."""
        k = len(state)
        return Start(state, np.zeros(k), np.zeros(k, bool), np.full(k, np.nan))

    def commands(self, actions: np.ndarray) -> np.ndarray:
        """Plant commands (n, 4) for actions (n, 3) in [-1, 1]."""
        v = self.vehicle
        u = np.zeros((len(actions), 4))
        u[:, PWM] = np.clip(self.pwm_centre + v.command_pwm_span * actions[:, 0], *v.command_pwm_range)
        u[:, ROLL_COMMAND] = v.command_angle_limit * actions[:, 1]
        u[:, PITCH_COMMAND] = v.command_angle_limit * actions[:, 2]
        return u

    def observe(self, state: np.ndarray, feet: np.ndarray | None = None) -> np.ndarray:
        """[x y z vx vy vz roll pitch] (n, 8), float32."""
        return state[:, _COLUMNS].astype(np.float32)

    def position_error(self, state: np.ndarray) -> np.ndarray:
        """(n,) distance to the goal [m]."""
        return np.linalg.norm(state[:, :3] - GOAL, axis=1)

    def judge(self, state, actions, contacts, start: Start, length, in_contact, held=None) -> Judgement:
        """See the module's docstring; the arguments are those of `Task.judge`."""
        e_p = self.position_error(state)
        effort = (actions[:, 1:] ** 2).sum(axis=1)
        terms = {
            "position": -e_p,
            "velocity": -0.2 * np.linalg.norm(state[:, VX : VZ + 1], axis=1),
            "attitude": -0.1 * np.linalg.norm(state[:, [ROLL, PITCH]], axis=1),
            "effort": -0.1 * effort / np.maximum(e_p, self.conditions.effort_floor),
        }
        never = np.zeros(len(state), bool)
        return Judgement(terms, e_p < TOLERANCE, never, length >= self.conditions.episode_limit)
