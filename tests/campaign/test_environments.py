"""Environments with evil options, resets and actions: they fly and stay finite, or refuse in one sentence."""

import functools
import inspect

import hypothesis.strategies as st
import numpy as np
import pytest
from hypothesis import given

from inclined_landing.envs import gym_env
from inclined_landing.envs.tasks import TASKS
from inclined_landing.models.plants import PLANTS
from tests.campaign.damage import EVIL, examples, used_or_refused

EVERY = EVIL | {
    "object array": np.array([None]), "complex": 1j, "bytes": b"x", "none in a list": [None],
    "complex array": np.zeros(2, complex), "text array": np.array(["1", "2"]),
}  # fmt: skip
SMALL = {"render_mode": "rgb_array", "width": 32, "height": 32, "render_backend": "ray"}
KINDS = {**{name: getattr(gym_env, f"{task.__name__}Env") for name, task in TASKS.items()}, **PLANTS}
KINDS["any"] = gym_env.SetpointEnv


def options(name: str) -> list[str]:
    """Return the options of a task, a plant or any environment."""
    parameters = inspect.signature(KINDS[name]).parameters.values()
    return [p.name for p in parameters if p.kind is p.KEYWORD_ONLY]


def made(name: str, option: str, value):
    """Return an environment with an option."""
    if name in TASKS:
        return KINDS[name](**{option: value})
    if name in PLANTS:
        return gym_env.SetpointEnv(plant=name, plant_options={option: value})
    return gym_env.SetpointEnv(**SMALL | {option: value})


def flies(env) -> None:
    """An episode begins and three steps of it are finite."""
    env.reset(seed=0)
    for _ in range(3):
        assert np.isfinite(env.step(env.action_space.sample())[0]).all()


@functools.cache
def env(vector: bool):
    """Return one environment of each kind for all inputs."""
    return gym_env.InclinedLandingVectorEnv(2) if vector else gym_env.InclinedLandingEnv()


def entered(vector: bool, what: str, value):
    """Return an observation after a seed, a state, a mask, options or an action."""
    environment = env(vector)
    if what == "action":
        environment.reset(seed=0)
        return environment.step(value)[0]
    if what == "seed":
        return environment.reset(seed=value)[0]
    return environment.reset(options=value if what == "options" else {what: value})[0]


def finite(observation) -> None:
    assert np.isfinite(observation).all()


@pytest.mark.parametrize("name", KINDS)
@examples(3)
@given(data=st.data())
def test_options_are_used_or_refused(name, data):
    option, evil = data.draw(st.sampled_from(options(name))), data.draw(st.sampled_from(list(EVERY)))
    used_or_refused(None, lambda: made(name, option, EVERY[evil]), flies)


@examples(12)
@given(st.booleans(), st.sampled_from(("seed", "state", "options", "action")), st.data())
def test_resets_and_actions_are_used_or_refused(vector, what, data):
    evil = data.draw(st.sampled_from(list(EVERY)))
    used_or_refused(None, lambda: entered(vector, what, EVERY[evil]), finite)
