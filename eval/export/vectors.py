"""Test vectors: the expected outputs of an export, computed by the policy itself.

They form one sequence: the policy receives the observations in order, so that its history is tested too. Most
states come from flights of the policy; the others are drawn from a wider distribution, in which inputs and
actions reach their limits.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from inclined_landing.envs.batch import BatchEnv
from inclined_landing.envs.history import History
from inclined_landing.envs.policy import Policy
from inclined_landing.envs.tasks.base import COLUMNS
from inclined_landing.models.attitude import STATE_SIZE
from inclined_landing.models.base.errors import UserError
from inclined_landing.models.plants import make_plant

TOLERANCE = 1e-5  # of actions: 167 half units in the last place of float32 at 1
_FLIGHTS, _FLOWN, _WIDE = 4, 12, 16  # flights, vectors of each, vectors drawn wide
_SPREAD = 4.0  # of these, in scales of the observation


@dataclasses.dataclass(frozen=True)
class Vectors:
    """Test vectors of m successive steps."""

    states: np.ndarray  # (m, 13)
    observations: np.ndarray  # (m, o) float32
    inputs: np.ndarray  # (m, i) float32: observations with their history
    actions: np.ndarray  # (m, a) float32
    commands: np.ndarray  # (m, 4)

    def table(self) -> dict:
        """Return the test vectors in the form of vectors.json."""
        return {
            "tolerance": TOLERANCE,
            "about": "successive steps of one flight, as far as a history is concerned",
            **{field.name: getattr(self, field.name) for field in dataclasses.fields(self)},
        }


def sequence(policy: Policy, states: np.ndarray, observations: np.ndarray) -> Vectors:
    """Return the policy's actions for a sequence of observations (m, o) of states (m, 13)."""
    task, past = policy.task, History(policy.task, 1)
    inputs, actions = [], []
    for k, observation in enumerate(observations.astype(np.float32)):
        row = observation[None]
        if k == 0:
            past.reset(slice(None), row)
        inputs.append(past.stack(row)[0])
        actions.append(policy.predict(inputs[-1]))
        past.record(row, actions[-1][None])
    answers = np.array(actions)
    commands = task.commands(answers.astype(float))
    return Vectors(states, observations.astype(np.float32), np.array(inputs), answers, commands)


def record(policy: Policy, seed: int = 0) -> Vectors:
    """Return the test vectors of a policy. Raises UserError if its task cannot be flown."""
    flights, wide = _sample_flights(policy, seed), _sample_wide(policy, np.random.default_rng(seed))
    states, observations = (np.concatenate(pair) for pair in zip(flights, wide))
    return sequence(policy, states, observations)


def _sample_flights(policy: Policy, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Return states and observations of flights from random starts, evenly spaced in time."""
    task = policy.task
    env = BatchEnv(task, make_plant("hybrid", _FLIGHTS, task.vehicle, **task.plant_options), seed)
    observation = env.reset()
    states, observations, length = [], [], np.full(_FLIGHTS, task.max_steps - 1)
    try:
        for k in range(task.max_steps):
            states.append(env.plant.state.copy())
            observations.append(observation[:, : len(task.observation_names)].copy())
            step = env.step(policy.predict(observation), length > k)
            observation = step.observation
            length[step.terminated & (length > k)] = k
            if (length <= k).all():
                break
    except FloatingPointError as error:
        raise UserError(f"policy {policy.path} cannot be flown for test vectors: {error}") from error
    rows = np.linspace(0, length, _FLOWN).astype(int)  # (_FLOWN, _FLIGHTS)
    flights = np.arange(_FLIGHTS)
    return tuple(
        np.array(x)[rows, flights].swapaxes(0, 1).reshape(rows.size, -1) for x in (states, observations)
    )


def _sample_wide(policy: Policy, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Return normally distributed observations around the network's centre, wider than in flight, with
    states.
    """
    task = policy.task
    noise = rng.normal(size=(_WIDE, len(task.observation_names)))
    observations = task.observation_centre + _SPREAD * task.observation_scale * noise
    states = np.zeros((_WIDE, STATE_SIZE))
    for k, name in enumerate(task.observation_names):
        if name in COLUMNS:
            states[:, COLUMNS[name]] = observations[:, k]
    return states, observations.astype(np.float32)
