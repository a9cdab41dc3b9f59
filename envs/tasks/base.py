"""What a task is: observation, action map, starts and judgement, for n vehicles at once.

A task holds no vehicle state and steps nothing. `BatchEnv` owns the plant and the episodes and asks
the task; every function here takes and returns arrays whose first axis is the vehicle.
"""

from __future__ import annotations

import dataclasses
from typing import Protocol

import numpy as np

from inclined_landing.models.attitude import LAG, STATE_SIZE
from inclined_landing.models.errors import UserError
from inclined_landing.models.parameters import Vehicle
from inclined_landing.models.plants import Contacts


@dataclasses.dataclass
class Start:
    """Where k new episodes begin, and under which conditions."""

    state: np.ndarray  # (k, 13)
    inclination: np.ndarray  # (k,) rad
    present: np.ndarray  # (k,) bool: is there a platform
    goal_size: np.ndarray  # (k,) d of the goal box; NaN for tasks without one
    contact: dict[str, np.ndarray] | None = None  # arguments (k,) of the plant's set_contact


@dataclasses.dataclass
class Judgement:
    """What a task says of one step; the reward is the sum of the terms."""

    terms: dict[str, np.ndarray]  # name -> (n,)
    success: np.ndarray  # (n,) bool
    terminated: np.ndarray  # (n,) bool
    cut: np.ndarray  # (n,) bool: a training aid ends the episode (as a truncation)
    holding: np.ndarray | None = None  # (n,) bool: where the task wants it, this moment counts as held

    @property
    def reward(self) -> np.ndarray:
        """(n,) sum of the terms."""
        return sum(self.terms.values())


class Task(Protocol):
    """The interface; `options` is what `make_task(name, **options)` needs to build it again."""

    name: str
    vehicle: Vehicle
    observation_names: tuple[str, ...]
    observation_scale: np.ndarray  # typical size of each observation
    action_names: tuple[str, ...]
    max_steps: int
    options: dict

    def sample(self, rng: np.random.Generator, k: int) -> Start:
        """k random starts."""

    def start(self, state: np.ndarray) -> Start:
        """Starts from given states (k, 13)."""

    def commands(self, actions: np.ndarray) -> np.ndarray:
        """Plant commands (n, 4) for actions (n, a) in [-1, 1]."""

    def observe(self, state: np.ndarray, feet: np.ndarray | None = None) -> np.ndarray:
        """Observations (n, o), float32, of states (n, 13); feet (n,): do the feet touch the slab."""

    def judge(
        self, state, actions, contacts: Contacts, start: Start, length, in_contact, held=None
    ) -> Judgement:
        """Reward terms, success and end of the step that led to `state`.

        length, in_contact (n,): steps of this episode so far, this one included, and those of them
        in contact with the platform. held (n,): steps in a row, before this one, that were held.
        """


def resolve_pwm_centre(centre, vehicle: Vehicle) -> float:
    """PWM at action 0: a number, "paper" (42 000) or "hover" (the true hover of the equations)."""
    if centre == "paper":
        return vehicle.command_pwm_centre
    if centre == "hover":
        return vehicle.hover_pwm
    low, high = vehicle.command_pwm_range
    if isinstance(centre, (int, float)) and low <= centre <= high:
        return float(centre)
    raise UserError(f"pwm_centre must be 'paper', 'hover' or a PWM from {low:g} to {high:g}, not {centre!r}")


def hover_states(positions: np.ndarray, vehicle: Vehicle) -> np.ndarray:
    """States (k, 13) at rest, level, thrust settled at hover, at positions (k, 3) [m]."""
    state = np.zeros((len(positions), STATE_SIZE))
    state[:, :3] = positions
    state[:, LAG] = vehicle.hover_lag
    return state
