"""Environments: every option, reset, seed and action is taken or refused in one sentence."""

import functools
import inspect
from functools import partial

import hypothesis.strategies as st
import numpy as np
import pytest
from hypothesis import given

from inclined_landing.envs import gym_env
from inclined_landing.envs.batch import BatchEnv
from inclined_landing.envs.sb3 import BatchVecEnv
from inclined_landing.envs.tasks import TASKS, StepContext, make_task
from inclined_landing.envs.tasks.base import hover_states
from inclined_landing.eval.moving.controllers import _Told
from inclined_landing.models.parameters import load_vehicle
from inclined_landing.models.plants import PLANTS, make_plant
from tests.campaign.judge import EVIL, Case, Wrong, examples, judged

STATE = hover_states(np.array([[1.0, 0.0, 1.8]]), load_vehicle())[0]
ARRAYS = {"object array": np.array([None]), "complex": 1j, "bytes": b"x", "none in a list": [None]}
ARRAYS |= {"complex array": np.zeros(2, complex), "text array": np.array(["1", "2"])}
EVERY = EVIL | ARRAYS
CALLED = {"width": "pixels", "height": "pixels", "render_backend": "backend", "plant_options": "plant"}
SMALL = {"render_mode": "rgb_array", "width": 32, "height": 32, "render_backend": "ray"}


def keywords(kind) -> list[str]:
    """The options of a constructor."""
    parameters = inspect.signature(kind).parameters.values()
    return [p.name for p in parameters if p.kind is p.KEYWORD_ONLY]


def flies(env):
    """An episode begins and three steps of it are finite."""
    observation, _ = env.reset(seed=0)
    for _ in range(3):
        observation, *_ = env.step(env.action_space.sample())
    if not np.isfinite(observation).all():
        raise Wrong("an observation is not finite")


def case(name, take, works=lambda result: None, named=""):
    return Case(name, lambda folder: folder, lambda folder: take(), works, named=named)


def option(of: str, option: str, evil: str) -> Case:
    """An option of a task, of the environments or of a plant."""
    given = {option: EVERY[evil]}
    if of in TASKS:
        make = partial(getattr(gym_env, f"{TASKS[of].__name__}Env"), **given)
    elif of in PLANTS:
        make, option = partial(FACE, plant=of, plant_options=given), option.split("_")[0]
    else:
        make, option = partial(FACE, **SMALL | given), CALLED.get(option, option)
    # A path is repeated as it is.
    named = "" if (option, evil) == ("vehicle", "long text") else option
    return case(f"{of} {option} {evil}", make, flies, named)


@functools.cache
def landings() -> BatchEnv:
    return BatchEnv(make_task("landing"), make_plant("analytic", 2))


@functools.cache
def env(kind: str):
    """One environment of each kind for all inputs."""
    return gym_env.InclinedLandingEnv() if kind == "Env" else gym_env.InclinedLandingVectorEnv(2)


def entered(kind: str, named: str, evil: str) -> Case:
    """A reset, seed, state, mask or action."""
    value = EVERY[evil]
    if named == "action":
        return case(f"{kind} action {evil}", partial(acted, kind, value), named="action")
    if named == "reset_mask":
        kind = "VectorEnv"
    given = {"seed": value} if named == "seed" else {"options": value if named == "reset" else {named: value}}
    return case(f"{kind} {named} {evil}", lambda: env(kind).reset(**given), named=named)


def state(column: int, evil: str) -> Case:
    """A state with one wrong number."""

    def flown() -> None:
        state = STATE.astype(object)
        state[column] = EVERY[evil]
        env("Env").reset(options={"state": state})
        acted("Env", [0.0, 0.0])

    return case(f"state {column} {evil}", flown, named="state")


ANSWERS = {
    "rows": np.zeros((2, 4)),
    "three columns": np.zeros((2, 3)),
    "one row": np.zeros((1, 4)),
    "complex rows": np.zeros((2, 4), complex),
    "rows of text": np.full((2, 4), "1"),
    "rows of dates": np.full((2, 4), "2020-01-01", "datetime64[D]"),
    "rows of nan": np.full((2, 4), np.nan),
}


def answered(value):
    controller = _Told(lambda t, state, platform: value, "mine", load_vehicle())
    commands = controller(0.0, StepContext(np.stack([STATE, STATE]), None, platform=np.zeros((2, 12))))
    assert commands.shape == (2, 4) and np.isfinite(commands).all()


def acted(kind, action):
    env(kind).reset(seed=0) if env(kind).unwrapped.batch.length.any() else None
    observation, *_ = env(kind).step(action)
    if not np.isfinite(observation).all():
        raise Wrong("an observation is not finite")


FACE = gym_env.SetpointEnv
OPTIONS = [
    (of, option)
    for of, kind in [*TASKS.items(), *PLANTS.items(), ("face", FACE)]
    for option in keywords(kind)
]
EVILS = st.sampled_from(list(EVERY))
NUMBERS = st.sampled_from([e for e, value in EVERY.items() if isinstance(value, (int, float, complex))])
ENTRIES = st.sampled_from(("seed", "reset", "state", "reset_mask", "action"))
KINDS = {
    "options": st.builds(lambda o, evil: option(*o, evil), st.sampled_from(OPTIONS), EVILS),
    "vectors": EVILS.map(
        lambda evil: case(
            f"num_envs {evil}",
            partial(gym_env.InclinedLandingVectorEnv, EVERY[evil], plant="analytic"),
            *(flies, "num_envs"),
        )
    )
    | EVILS.map(
        lambda evil: case(
            f"reward_scale {evil}",
            lambda: BatchVecEnv(landings(), reward_scale=EVERY[evil]),
            named="reward_scale",
        )
    ),
    "inputs": st.builds(entered, st.sampled_from(("Env", "VectorEnv")), ENTRIES, EVILS)
    | st.builds(state, st.integers(0, len(STATE) - 1), NUMBERS),
    "answers": st.sampled_from(list(EVERY | ANSWERS)).map(
        lambda evil: case(
            f"answer {evil}",
            partial(answered, (EVERY | ANSWERS)[evil]),
            named="controller mine at 0.00 s",
        )
    ),
}


@pytest.mark.parametrize("kind", KINDS)
@examples(5)
@given(data=st.data())
def test_environments_fly_or_refuse(kind, data):
    judged(data.draw(KINDS[kind]))
