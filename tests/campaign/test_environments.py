"""Environments: every option, reset, seed and action is taken or refused in one sentence."""

import inspect
import itertools

import numpy as np

from campaign.judge import EVIL, Case, Wrong, judge, parametrised
from inclined_landing.envs import gym_env
from inclined_landing.envs.batch import BatchEnv
from inclined_landing.envs.sb3 import BatchVecEnv
from inclined_landing.envs.tasks import TASKS, make_task
from inclined_landing.envs.tasks.base import hover_states
from inclined_landing.models.parameters import load_vehicle
from inclined_landing.models.plants import PLANTS, make_plant

STATE = hover_states(np.array([[1.0, 0.0, 1.8]]), load_vehicle())[0]
ARRAYS = {"object array": np.array([None]), "complex": 1j, "bytes": b"x", "none in a list": [None]}
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


def options():
    """Every option of the faces, tasks and plants times every evil value."""
    for task in TASKS.values():
        face = getattr(gym_env, f"{task.__name__}Env")
        for option, (evil, value) in itertools.product(keywords(task), EVERY.items()):
            given = {option: value}
            yield case(f"{task.name} {option} {evil}", lambda f=face, g=given: f(**g), flies, option)
    face = gym_env.SetpointEnv
    for option, (evil, value) in itertools.product(keywords(face), EVERY.items()):
        if (option, evil) == ("vehicle", "long text"):
            continue  # a path, which is repeated as it is
        given = SMALL | {option: value}
        yield case(f"face {option} {evil}", lambda g=given: face(**g), flies, CALLED.get(option, option))
    for plant, kind in PLANTS.items():
        for option, (evil, value) in itertools.product(keywords(kind), EVERY.items()):
            given = {"plant": plant, "plant_options": {option: value}}
            yield case(f"{plant} {option} {evil}", lambda g=given: face(**g), flies, option.split("_")[0])
    for evil, value in EVERY.items():
        many = gym_env.InclinedLandingVectorEnv
        yield case(f"num_envs {evil}", lambda v=value, m=many: m(v, plant="analytic"), flies, "num_envs")
        batch = BatchEnv(make_task("landing"), make_plant("analytic", 2))
        make = lambda v, b=batch: BatchVecEnv(b, reward_scale=v)  # noqa: E731
        yield case(f"reward_scale {evil}", lambda v=value, m=make: m(v), named="reward_scale")


def inputs():
    """Resets, seeds and actions."""
    single, vector = gym_env.InclinedLandingEnv(), gym_env.InclinedLandingVectorEnv(2)
    for env, (evil, value) in itertools.product((single, vector), EVERY.items()):
        size = type(env).__name__.removeprefix("InclinedLanding")
        yield case(f"{size} seed {evil}", lambda e=env, v=value: e.reset(seed=v), named="seed")
        yield case(f"{size} options {evil}", lambda e=env, v=value: e.reset(options=v), named="reset")
        state = {"options": {"state": value}}
        yield case(f"{size} state {evil}", lambda e=env, g=state: e.reset(**g), named="state")
        yield case(f"{size} action {evil}", lambda e=env, v=value: acted(e, v), named="action")
    for evil, value in EVERY.items():
        mask = {"options": {"reset_mask": value}}
        yield case(f"mask {evil}", lambda g=mask: vector.reset(**g), named="reset_mask")
        if not isinstance(value, (int, float)):
            continue
        for column in range(len(STATE)):
            state = STATE.astype(object)
            state[column] = value
            flown = lambda s=state: (single.reset(options={"state": s}), acted(single, [0.0, 0.0]))  # noqa: E731
            yield case(f"state {column} {evil}", flown, named="state")


def acted(env, action):
    env.reset(seed=0) if env.unwrapped.batch.length.any() else None
    observation, *_ = env.step(action)
    if not np.isfinite(observation).all():
        raise Wrong("an observation is not finite")


@parametrised(options(), sample=25)
def test_options_are_flown_or_refused(case, tmp_path):
    judge(case, tmp_path)


@parametrised(inputs(), sample=40)
def test_inputs_are_flown_or_refused(case, tmp_path):
    judge(case, tmp_path)
