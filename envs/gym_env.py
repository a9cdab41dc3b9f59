"""Gymnasium's view of the tasks: a single environment and a vector environment.

Both are thin shells over `BatchEnv`; the reward terms stand in `info["reward_terms"]` and sum to the
reward. Options of both constructors:

| option | default | meaning |
|---|---|---|
| `plant` | "mujoco" | "mujoco", "hybrid" or "analytic" |
| `plant_options` | {} | arguments of the plant: `{"integrator": "implicitfast"}`, `{"unrest": 0}` ... |
| `vehicle` | shipped | a `Vehicle`, or the path of a vehicle file |
| others | | arguments of the task, such as `inclination`, `pwm_centre` or `history` |

`reset(options={"state": array})` starts from given states, (13,) or (n, 13). What is not of these names,
types and sizes is a UserError, a ValueError with one sentence.
"""

from __future__ import annotations

import inspect
import sys
import typing
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space

from inclined_landing.envs.batch import BatchEnv, check_seed, is_whole, numbers
from inclined_landing.envs.spaces import action_space, observation_space
from inclined_landing.envs.tasks import TASKS, Task, make_task, task_class
from inclined_landing.models import geometry
from inclined_landing.models.errors import UserError, shown
from inclined_landing.models.parameters import Vehicle, load_vehicle
from inclined_landing.models.plants import PLANTS, make_plant

_HISTORY = "\nVersion history: v0.\n"
_RESET = ("state", "reset_mask")  # options of the vector environment's reset
_METADATA: dict[str, Any] = {"render_modes": ["rgb_array"], "render_fps": 50}


MOST_VEHICLES = 100_000  # of one environment
# What numbers among the options of a plant may be.
_PLANT_LIMITS = {
    **{"threads": (0, 1024), "substeps": (1, 1000), "keep_out": (0.0, 1.0)},
    **{"timestep": (1e-5, 1.0), "control_period": (1e-5, 1.0)},
}


def _batch(task: str, n: int, plant: str, plant_options, vehicle, options) -> BatchEnv:
    if not (is_whole(n) and 1 <= n <= MOST_VEHICLES):
        raise UserError(
            f"num_envs must be a whole number from 1 to {MOST_VEHICLES}, not {shown(repr(n), 40)}"
        )
    if vehicle is None or isinstance(vehicle, (str, Path)):
        vehicle = load_vehicle(vehicle)
    if not isinstance(vehicle, Vehicle):
        raise UserError(f"vehicle must be a Vehicle or the path of a file, not {shown(repr(vehicle), 40)}")
    if not isinstance(plant, str) or plant not in PLANTS:
        raise UserError(f"unknown plant {shown(repr(plant), 40)}; known are {', '.join(PLANTS)}")
    if not isinstance(plant_options or {}, dict):
        raise UserError(f"plant_options must be a dictionary, not {shown(repr(plant_options), 40)}")
    _check_options(plant_options or {}, PLANTS[plant], f"the {plant} plant")
    for name, (low, high) in _PLANT_LIMITS.items():
        value = (plant_options or {}).get(name)
        if value is not None and not low <= value <= high:
            raise UserError(
                f"{name} of the {plant} plant must be from {low:g} to {high:g}, not {shown(repr(value), 40)}"
            )
    _check_options(options, task_class(task), f"the task {task}")
    built = make_task(task, vehicle, **options)
    return BatchEnv(built, make_plant(plant, n, vehicle, **(plant_options or {})))


def _check_options(given: dict, kind: Any, what: str) -> None:
    """Raise UserError for an option that the constructor of `kind` lacks, or that is of another type."""
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
        return value in typing.get_args(kind)
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
    return " or ".join(names.get(one, repr(one)) for one in typing.get_args(kind) or (kind,))


def _reset_option(options, name: str, known: tuple[str, ...]):
    """The entry `name` of what `reset` was given, or None; raises UserError for entries that are none."""
    if not isinstance(options or {}, dict):
        raise UserError(f"the options of reset must be a dictionary, not {shown(repr(options), 40)}")
    for key in options or {}:
        if key not in known:
            raise UserError(f"reset has no option {shown(repr(key), 40)}; it has {' and '.join(known)}")
    return (options or {}).get(name)


class TaskEnv(gym.Env):
    """One vehicle on one task."""

    metadata = _METADATA
    task_name: str

    def __init__(
        self,
        *,
        plant: str = "mujoco",
        plant_options: dict | None = None,
        vehicle=None,
        render_mode: str | None = None,
        width: int = 640,
        height: int = 480,
        camera: str = "hero",
        render_backend: str = "auto",
        **task_options,
    ):
        if render_mode not in (None, *_METADATA["render_modes"]):
            raise UserError(f"render_mode must be 'rgb_array' or None, not {shown(repr(render_mode), 40)}")
        if render_mode is not None:
            from inclined_landing.envs.rendering import check_look

            check_look(width, height, camera, render_backend)
        self.batch = _batch(self.task_name, 1, plant, plant_options, vehicle, task_options)
        self.task = self.batch.task
        self.observation_space = observation_space(self.task)
        self.action_space = action_space(self.task)
        self.render_mode = render_mode
        self._picture: dict[str, Any] = {"width": width, "height": height, "camera": camera}
        self._backend = render_backend
        self._renderer: Any = None

    def reset(self, *, seed: int | None = None, options: dict | None = None):
        """(observation, info) of a new episode, at random or from `options["state"]`."""
        state = _reset_option(options, "state", ("state",))
        check_seed(seed)
        super().reset(seed=seed)
        self.batch.draw_from(self.np_random)
        if state is not None:
            state = np.atleast_2d(numbers(state, "the start state"))
        return self.batch.reset(state=state)[0], {}

    def step(self, action):
        """(observation, reward, terminated, truncated, info); see the class docstring."""
        step = self.batch.step(numbers(action, "the action")[None])
        info = {
            "reward_terms": {name: float(term[0]) for name, term in step.terms.items()},
            "is_success": bool(step.success[0]),
            "touched": bool(self.batch.touched[0]),
        }
        return (
            step.observation[0],
            float(step.reward[0]),
            bool(step.terminated[0]),
            bool(step.truncated[0]),
            info,
        )

    def render(self) -> np.ndarray | None:
        """The present moment as (height, width, 3) uint8; None without a render mode."""
        if self.render_mode is None:
            return None
        from inclined_landing.envs.rendering import make_renderer
        from inclined_landing.envs.rendering.pose import Pose, qpos_of_state

        if self._renderer is None:
            self._renderer = make_renderer(vehicle=self.task.vehicle, backend=self._backend, **self._picture)
        plant = self.batch.plant
        platform = geometry.platform_poses(plant.inclination, plant.present, self.task.vehicle)
        position, quaternion = (array[0, 0] for array in platform)
        return self._renderer.render(Pose(qpos_of_state(plant.state[0]), position, quaternion))

    def close(self) -> None:
        if self._renderer is not None:
            self._renderer.close()
            self._renderer = None


class TaskVectorEnv(VectorEnv):
    """n vehicles on one task, stepped by one call; autoreset in the same step."""

    metadata = _METADATA | {"autoreset_mode": AutoresetMode.SAME_STEP}
    task_name: str

    def __init__(
        self,
        num_envs: int = 1,
        *,
        plant: str = "mujoco",
        plant_options: dict | None = None,
        vehicle=None,
        render_mode: str | None = None,
        **task_options,
    ):
        if render_mode is not None:
            raise UserError("the vector environment does not render; record a single one")
        self.batch = _batch(self.task_name, num_envs, plant, plant_options, vehicle, task_options)
        self.num_envs = num_envs
        self.render_mode = None
        self.task = self.batch.task
        self.single_observation_space = observation_space(self.task)
        self.single_action_space = action_space(self.task)
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)

    def reset(self, *, seed: int | None = None, options: dict | None = None):
        """(observations, info); `options["reset_mask"]` (n,) resets some vehicles only."""
        state, mask = (_reset_option(options, name, _RESET) for name in _RESET)
        check_seed(seed)
        ids = np.arange(self.num_envs)
        if mask is not None:
            mask = np.asarray(mask)
            if mask.shape != (self.num_envs,) or mask.dtype != bool:
                raise UserError(f"reset_mask must be {self.num_envs} times True or False")
            ids = ids[mask]
        super().reset(seed=seed)
        if seed is not None:
            self.batch.draw_from(self.np_random)
        self.batch.reset(ids, state)
        return self.batch.observe(), {}

    def step(self, actions):
        """Batched step; finished episodes restart at once.

        `info["final_obs"]` (object array, mask `_final_obs`) and `info["final_info"]` describe the
        episodes that ended.
        """
        env = self.batch
        step = env.step(actions)
        info = {
            "reward_terms": step.terms,
            "is_success": step.success,
            "touched": env.touched.copy(),
        }
        done = step.terminated | step.truncated
        observation = step.observation
        if done.any():
            ids = np.flatnonzero(done)
            final = np.full(self.num_envs, None, dtype=object)
            for i in ids:
                final[i] = observation[i].copy()
            info |= {
                "final_obs": final,
                "_final_obs": done,
                "final_info": {
                    "is_success": step.success & done,
                    "_is_success": done,
                    "touched": info["touched"] & done,
                    "_touched": done,
                    "episode_length": np.where(done, env.length, 0),
                    "_episode_length": done,
                },
                "_final_info": done,
            }
            observation[ids] = env.reset(ids)
        return observation, step.reward, step.terminated, step.truncated, info


def _faces(task: type[Task]) -> dict[str, type]:
    """Both environments of a task, by name; their manual is that of the task's module."""
    manual = (sys.modules[task.__module__].__doc__ or "") + _HISTORY
    content = {"__doc__": manual, "__module__": __name__, "task_name": task.name}
    kinds = {f"{task.__name__}Env": TaskEnv, f"{task.__name__}VectorEnv": TaskVectorEnv}
    return {name: type(name, (kind,), content) for name, kind in kinds.items()}


for _task in TASKS.values():
    globals().update(_faces(_task))
