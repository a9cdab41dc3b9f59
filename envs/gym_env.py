"""Gymnasium's view of the tasks: a single environment and a vector environment.

Both are thin shells over `BatchEnv`; the reward terms stand in `info["reward_terms"]` and sum to the
reward. Options of both constructors:

| option | default | meaning |
|---|---|---|
| `plant` | "mujoco" | "mujoco" or "analytic" |
| `plant_options` | {} | arguments of the plant, such as `{"integrator": "implicitfast"}` |
| `vehicle` | shipped | a `Vehicle`, or the path of a vehicle file |
| others | | arguments of the task, such as `inclination` or `pwm_centre` |

`reset(options={"state": array})` starts from given states, (13,) or (n, 13).
"""

from __future__ import annotations

import sys
from pathlib import Path

import gymnasium as gym
import numpy as np
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space

from inclined_landing.envs.batch import BatchEnv
from inclined_landing.envs.spaces import action_space, observation_space
from inclined_landing.envs.tasks import TASKS, Task, make_task
from inclined_landing.models import geometry
from inclined_landing.models.errors import UserError
from inclined_landing.models.parameters import load_vehicle
from inclined_landing.models.plants import make_plant

_HISTORY = "\nVersion history: v0.\n"
_METADATA = {"render_modes": ["rgb_array"], "render_fps": 50}


def _batch(task: str, n: int, plant: str, plant_options, vehicle, options) -> BatchEnv:
    if vehicle is None or isinstance(vehicle, (str, Path)):
        vehicle = load_vehicle(vehicle)
    built = make_task(task, vehicle, **options)
    return BatchEnv(built, make_plant(plant, n, vehicle, **(plant_options or {})))


def _given_states(options, n: int):
    state = (options or {}).get("state")
    return None if state is None else np.reshape(np.asarray(state, float), (n, -1))


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
            raise UserError(f"render_mode must be 'rgb_array' or None, not {render_mode!r}")
        self.batch = _batch(self.task_name, 1, plant, plant_options, vehicle, task_options)
        self.task = self.batch.task
        self.observation_space = observation_space(self.task)
        self.action_space = action_space(self.task)
        self.render_mode = render_mode
        self._picture = {"width": width, "height": height, "camera": camera}
        self._backend = render_backend
        self._renderer = None

    def reset(self, *, seed: int | None = None, options: dict | None = None):
        """(observation, info) of a new episode, at random or from `options["state"]`."""
        super().reset(seed=seed)
        self.batch.rng = self.np_random
        return self.batch.reset(state=_given_states(options, 1))[0], {}

    def step(self, action):
        """(observation, reward, terminated, truncated, info); see the class docstring."""
        step = self.batch.step(np.asarray(action, float)[None])
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
        self.num_envs = num_envs
        self.render_mode = None
        self.batch = _batch(self.task_name, num_envs, plant, plant_options, vehicle, task_options)
        self.task = self.batch.task
        self.single_observation_space = observation_space(self.task)
        self.single_action_space = action_space(self.task)
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)

    def reset(self, *, seed: int | None = None, options: dict | None = None):
        """(observations, info); `options["reset_mask"]` (n,) resets some vehicles only."""
        super().reset(seed=seed)
        if seed is not None:
            self.batch.rng = self.np_random
        mask = (options or {}).get("reset_mask")
        ids = np.arange(self.num_envs) if mask is None else np.flatnonzero(mask)
        self.batch.reset(ids, _given_states(options, len(ids)))
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
