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
from collections.abc import Sequence
from types import MappingProxyType
from typing import Any

import numpy as np

from inclined_landing.envs.tasks.base import (
    Evaluation,
    ScoreCurve,
    Start,
    StepContext,
    Task,
    Training,
    hover_states,
)
from inclined_landing.models.attitude import LAG, PITCH, ROLL, VX, VY, VZ, X, Y, Z
from inclined_landing.models.vehicle import Vehicle

EFFORT_FLOOR = 0.001  # m
GOAL = (0.0, 0.0, 1.2)  # m
START_BOX = ((-2.5, 2.5), (-1.3, 1.3), (0.2, 2.2))  # m
TOLERANCE = 0.05  # m


@dataclasses.dataclass(frozen=True)
class SetpointConditions:
    """What a curriculum may ease. The default is the task."""

    effort_floor: float = EFFORT_FLOOR  # smallest e_p in the effort term, m
    episode_limit: int = Task.max_steps  # truncate after this many steps


class Setpoint(Task):
    """The task for vehicles of one kind; there is no platform."""

    name = "setpoint"
    observation_names = ("x", "y", "z", "vx", "vy", "vz", "roll", "pitch")
    observation_scale = np.array([1.0, 1.0, 1.0, 2.0, 2.0, 2.0, 0.5, 0.5])
    action_names = ("thrust", "roll", "pitch")
    judged_after = 3.0
    shipped = True
    table = "error"
    reward_weights = MappingProxyType({"position": -1.0, "velocity": -0.2, "attitude": -0.1, "effort": -0.1})
    training = Training(
        steps=2_000_000,  # after one million, four of ten seeds leave some starts 7 to 9 cm off
        curriculum="effort",
        epochs=8,
        gamma=0.97,
        learning_rate=2e-3,
        rollout=64,
        batch_size=256,
    )
    curricula = ("effort", "none")
    score_curve = ScoreCurve(
        "mean_error",
        "mean error after 3 s [cm]",
        limits=None,
        reference=(100.0 * TOLERANCE, f"tolerance: {100 * TOLERANCE:g} cm"),
        logarithmic=True,
    )

    def __init__(self, vehicle: Vehicle | None = None, **options: Any):
        super().__init__(vehicle, **options)
        self.conditions = SetpointConditions()

    @property
    def goal(self) -> np.ndarray:
        """The observation (8,) at rest, level, in GOAL."""
        return np.array([*GOAL, 0.0, 0.0, 0.0, 0.0, 0.0])

    def sample(self, rng: np.random.Generator, k: int) -> Start:
        """Return k starts at rest, uniform over START_BOX."""
        low, high = np.array(START_BOX).T
        return self.start(hover_states(rng.uniform(low, high, (k, 3)), self.vehicle))

    def position_error(self, state: np.ndarray) -> np.ndarray:
        """Return the distance (n,) to the goal [m]."""
        return np.linalg.norm(state[:, :3] - GOAL, axis=1)

    def shifted(self, state: np.ndarray, goal: np.ndarray) -> np.ndarray:
        """Return states (n, 13) shifted so that `goal`, (3,) or (n, 3) [m], is at GOAL.

        So any point is flown to. Positions outside START_BOX are clipped to it.
        """
        low, high = np.array(START_BOX).T
        shown = state.copy()
        shown[:, X : Z + 1] = np.clip(np.array(GOAL) - (goal - state[:, X : Z + 1]), low, high)
        return shown

    def across(self, state: np.ndarray, y: float | np.ndarray) -> np.ndarray:
        """Return states (n, 13) `shifted` to a goal at y [m], (n,) or a number, at rest except along y.

        The roll that answers them holds a planar flight in its plane.
        """
        shown = np.zeros_like(state)
        shown[:, [VY, ROLL, LAG]] = state[:, [VY, ROLL, LAG]]
        shown[:, Y] = state[:, Y]
        goal = np.zeros((len(state), 3))
        goal[:, Y] = y
        return self.shifted(shown, goal)

    def evaluate(self, context: StepContext) -> Evaluation:
        """Return the paper's reward, see the module's docstring."""
        state, c, weight = context.state, self.conditions, self.reward_weights
        e_p = self.position_error(state)
        effort = (context.actions[:, 1:] ** 2).sum(axis=1)
        terms = {
            "position": weight["position"] * e_p,
            "velocity": weight["velocity"] * np.linalg.norm(state[:, VX : VZ + 1], axis=1),
            "attitude": weight["attitude"] * np.linalg.norm(state[:, [ROLL, PITCH]], axis=1),
            "effort": weight["effort"] * effort / np.maximum(e_p, c.effort_floor),
        }
        never = np.zeros(len(state), bool)
        return Evaluation(terms, e_p < TOLERANCE, never, context.length >= c.episode_limit)

    def score(self, flights: Sequence) -> dict[str, float]:
        """Return the share of the flights that end within 5 cm of the goal, and their mean distance [m]."""
        error = self.position_error(np.array([flight.state[-1] for flight in flights]))
        return {"score": float((error < TOLERANCE).mean()), "mean_error": float(error.mean())}

    def score_words(self, score: dict[str, float]) -> str:
        """Return the mean distance."""
        return f"{100 * score['mean_error']:.1f} cm"

    def flight_words(self, flight) -> str:
        """Return how far from the goal a flight ended."""
        away = self.position_error(flight.state[-1:])[0]
        return f"{100 * away:.1f} cm from the goal after {flight.duration:.2f} s"
