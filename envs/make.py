"""`make_batch`: a task in a plant by name, options checked; `make_for`: a policy with its environment."""

from __future__ import annotations

import inspect
import typing
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from inclined_landing.envs.batch import BatchEnv, is_whole
from inclined_landing.envs.ids import TASK_CLASSES
from inclined_landing.envs.policy import Policy, load_policy
from inclined_landing.envs.tasks import make_task
from inclined_landing.models.errors import UserError, shown
from inclined_landing.models.parameters import as_vehicle
from inclined_landing.models.plants import PLANTS, make_plant
from inclined_landing.models.vehicle import Vehicle

MOST_VEHICLES = 100_000  # of one environment
# What numbers among the options of a plant may be.
_PLANT_LIMITS = {
    **{"threads": (0, 1024), "substeps": (1, 1000), "keep_out": (0.0, 1.0)},
    **{"timestep": (1e-5, 1.0), "control_period": (1e-5, 1.0)},
}


def make_batch(
    task: str,
    n: int = 64,
    *,
    plant: str = "mujoco",
    plant_options: dict | None = None,
    vehicle: Vehicle | str | Path | None = None,
    seed: int | None = None,
    **options,
) -> BatchEnv:
    """Return n vehicles on a task as a `BatchEnv`, which `BatchVecEnv` wraps for Stable-Baselines3.

    task: by name, also of one imported with `import_task`; options: of its class, such as `inclination` or
    `pwm_centre`. plant, plant_options: the physics, {"integrator": "implicitfast"} for example. vehicle: one,
    or the path of a file; by default the shipped one. Raises UserError for what is none of these.
    """
    if not (is_whole(n) and 1 <= n <= MOST_VEHICLES):
        raise UserError(
            f"num_envs must be a whole number from 1 to {MOST_VEHICLES}, not {shown(repr(n), 40)}"
        )
    vehicle = as_vehicle(vehicle)
    if not isinstance(plant, str) or plant not in PLANTS:
        raise UserError(f"unknown plant {shown(repr(plant), 40)}; known are {', '.join(PLANTS)}")
    plant_options = {} if plant_options is None else plant_options
    if not isinstance(plant_options, dict):
        raise UserError(f"plant_options must be a dictionary, not {shown(repr(plant_options), 40)}")
    _check_options(plant_options, PLANTS[plant], f"the {plant} plant")
    for name, (low, high) in _PLANT_LIMITS.items():
        value = plant_options.get(name)
        if value is not None and not low <= value <= high:
            raise UserError(
                f"{name} of the {plant} plant must be from {low:g} to {high:g}, not {shown(repr(value), 40)}"
            )
    built = make_task(task, vehicle, **options)
    return BatchEnv(built, make_plant(plant, n, built.vehicle, **built.plant_options | plant_options), seed)


def make_for(
    policy: str | Path,
    num_envs: int | None = None,
    *,
    vehicle: Vehicle | str | Path | None = None,
    **options,
) -> tuple[Any, Policy]:
    """Return the Gymnasium environment that a policy was trained for, and the policy: (env, policy).

        env, policy = inclined_landing.make_for("landing", render_mode="rgb_array")
        envs, policy = inclined_landing.make_for("runs/landing-0/final.zip", num_envs=64, plant="hybrid")

    policy: a file, or a shipped one by name. num_envs: a vector environment of as many vehicles. vehicle: as
    for `make_batch`. options: of the environment, and of the task where they differ from training's, such as
    `inclination` [rad]. Raises UserError for what is none of these.
    """
    import gymnasium

    vehicle = as_vehicle(vehicle)
    trained = load_policy(policy, vehicle=vehicle).task
    given = {"vehicle": vehicle, **trained.options, **options}
    name = f"{__package__}:{TASK_CLASSES[trained.name]}-v0"
    env: Any
    if num_envs is None:
        env = gymnasium.make(name, **given)
    else:
        env = gymnasium.make_vec(name, num_envs=num_envs, **given)
    return env, load_policy(policy, env.unwrapped.task, inclination=options.get("inclination"))


def _check_options(given: dict, kind: Any, what: str) -> None:
    """Raise UserError for an option that the constructor of `kind` lacks, or of the wrong type."""
    parameters = inspect.signature(kind).parameters.values()
    known = [p.name for p in parameters if p.kind is p.KEYWORD_ONLY]
    types = typing.get_type_hints(kind.__init__)
    for name, value in given.items():
        if name not in known:
            raise UserError(f"{what} has no option {shown(repr(name), 40)}; it has {', '.join(known)}")
        if not _fits(value, types[name]):
            raise UserError(f"{name} of {what} must be {_words(types[name])}, not {shown(repr(value), 40)}")


def _fits(value, kind) -> bool:
    if typing.get_origin(kind) is typing.Literal:
        return isinstance(value, str) and value in typing.get_args(kind)
    if typing.get_origin(kind) is Sequence:
        return isinstance(value, (list, tuple)) and all(_fits(one, typing.get_args(kind)[0]) for one in value)
    if typing.get_args(kind):
        return any(_fits(value, one) for one in typing.get_args(kind))
    if kind is float:
        return (is_whole(value) and abs(value) < 2**63) or isinstance(value, (float, np.floating))
    return is_whole(value) if kind is int else isinstance(value, kind)


def _words(kind) -> str:
    names = {
        float: "a number",
        int: "a whole number",
        str: "a text",
        bool: "True or False",
        type(None): "None",
    }
    if typing.get_origin(kind) is Sequence:
        return f"a list of {' or '.join(one.__name__ for one in typing.get_args(kind))}"
    if typing.get_origin(kind) is typing.Literal:
        return " or ".join(map(repr, typing.get_args(kind)))
    return " or ".join(names.get(one) or f"a {one.__name__}" for one in typing.get_args(kind) or (kind,))
