"""Environments: every option, reset, seed and action is taken or refused in one sentence."""

import functools
import inspect
from functools import partial

import numpy as np

from inclined_landing.envs import gym_env
from inclined_landing.envs.batch import BatchEnv
from inclined_landing.envs.sb3 import BatchVecEnv
from inclined_landing.envs.tasks import TASKS, StepContext, make_task
from inclined_landing.envs.tasks.base import hover_states
from inclined_landing.eval.moving.controllers import _Told
from inclined_landing.models.parameters import load_vehicle
from inclined_landing.models.plants import PLANTS, make_plant
from tests.campaign.judge import EVIL, Case, Wrong, judge, parametrised

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


def options():
    """Every option of the faces, tasks and plants times every evil value."""
    face = gym_env.SetpointEnv
    for evil, value in EVERY.items():
        for task in TASKS.values():
            own = getattr(gym_env, f"{task.__name__}Env")
            for option in keywords(task):
                given = {option: value}
                yield case(f"{task.name} {option} {evil}", partial(own, **given), flies, option)
        for option in keywords(face):
            if (option, evil) != ("vehicle", "long text"):  # a path, which is repeated as it is
                make = partial(face, **SMALL | {option: value})
                yield case(f"face {option} {evil}", make, flies, CALLED.get(option, option))
        for plant, kind in PLANTS.items():
            for option in keywords(kind):
                make = partial(face, plant=plant, plant_options={option: value})
                yield case(f"{plant} {option} {evil}", make, flies, option.split("_")[0])
        many = partial(gym_env.InclinedLandingVectorEnv, value, plant="analytic")
        yield case(f"num_envs {evil}", many, flies, "num_envs")
        scaled = lambda v=value: BatchVecEnv(landings(), reward_scale=v)  # noqa: E731
        yield case(f"reward_scale {evil}", scaled, named="reward_scale")


@functools.cache
def landings() -> BatchEnv:
    return BatchEnv(make_task("landing"), make_plant("analytic", 2))


@functools.cache
def env(kind: str):
    """One environment of each kind for all inputs."""
    return gym_env.InclinedLandingEnv() if kind == "Env" else gym_env.InclinedLandingVectorEnv(2)


def inputs():
    """Resets, seeds and actions."""
    for evil, value in EVERY.items():
        for kind in ("Env", "VectorEnv"):
            for named, given in {
                "seed": {"seed": value},
                "reset": {"options": value},
                "state": {"options": {"state": value}},
            }.items():
                take = lambda kind=kind, given=given: env(kind).reset(**given)  # noqa: E731
                yield case(f"{kind} {named} {evil}", take, named=named)
            yield case(f"{kind} action {evil}", partial(acted, kind, value), named="action")
        mask = {"options": {"reset_mask": value}}
        yield case(f"mask {evil}", lambda mask=mask: env("VectorEnv").reset(**mask), named="reset_mask")
        for column in range(len(STATE)) if isinstance(value, (int, float, complex)) else ():
            state = STATE.astype(object)
            state[column] = value

            def flown(state=state):
                env("Env").reset(options={"state": state})
                acted("Env", [0.0, 0.0])

            yield case(f"state {column} {evil}", flown, named="state")


ANSWERS = {
    "rows": np.zeros((2, 4)),
    "three columns": np.zeros((2, 3)),
    "one row": np.zeros((1, 4)),
    "complex rows": np.zeros((2, 4), complex),
    "rows of text": np.full((2, 4), "1"),
    "rows of dates": np.full((2, 4), "2020-01-01", "datetime64[D]"),
    "rows of nan": np.full((2, 4), np.nan),
}


def answers():
    """What a controller of others answers with."""
    for evil, value in (EVERY | ANSWERS).items():
        yield case(f"answer {evil}", partial(answered, value), named="controller mine at 0.00 s")


def answered(value):
    controller = _Told(lambda t, state, deck: value, "mine", load_vehicle())
    commands = controller(0.0, StepContext(np.stack([STATE, STATE]), None, deck=np.zeros((2, 12))))
    assert commands.shape == (2, 4) and np.isfinite(commands).all()


def acted(kind, action):
    env(kind).reset(seed=0) if env(kind).unwrapped.batch.length.any() else None
    observation, *_ = env(kind).step(action)
    if not np.isfinite(observation).all():
        raise Wrong("an observation is not finite")


@parametrised(options, inputs, answers, each=4)
def test_environments_fly_or_refuse(case, tmp_path):
    judge(case, tmp_path)
