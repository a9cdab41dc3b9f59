"""Gymnasium environments of the tasks: a single environment and a vector environment.

    gymnasium.make("InclinedLanding-v0", inclination=0.3, render_mode="rgb_array")
    gymnasium.make_vec("InclinedLanding-v0", num_envs=64, plant="hybrid")

Both are thin wrappers around `BatchEnv`; the reward terms are in `info["reward_terms"]` and sum to the
reward. Options of both, which are the keyword arguments of `gymnasium.make` and `make_vec`:

| option | default | meaning |
|---|---|---|
| `plant` | "mujoco" | "mujoco", "hybrid" or "analytic" |
| `plant_options` | {} | arguments of the plant: `{"integrator": "implicitfast"}`, `{"disturbance": 0}` ... |
| `vehicle` | shipped | a `Vehicle`, the path of a vehicle file, or the name of a shipped vehicle |
| others | | arguments of the task: `inclination` [rad], `pwm_centre`, `history`, `observe_vehicle` ... |

and of the single environment, the only one that renders:

| option | default | meaning |
|---|---|---|
| `render_mode` | None | "rgb_array": `render` returns images |
| `width`, `height` | 640, 480 | size of the picture in pixels |
| `camera` | "arena" | viewpoint; "arena" shows the whole arena |
| `render_backend` | "ray" | "ray" casts rays on the processor, "gl" is OpenGL |

The vector environment has `num_envs` (1) vehicles, and its episodes restart in the step in which they end.

`reset(options={"state": array})` starts from given states, (13,) or (n, 13). Other names, types and sizes
raise a UserError, a ValueError with a message of one sentence.

`copy.deepcopy` and pickle return an environment that continues identically. A forked process can continue to
use an environment of its parent, except for OpenGL (`render_backend`).
"""

from __future__ import annotations

from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space

from inclined_landing.envs.batch import as_floats, check_seed, reset_state
from inclined_landing.envs.make import make_batch
from inclined_landing.envs.spaces import action_space, observation_space
from inclined_landing.envs.tasks import TASKS, Task, manual
from inclined_landing.models.base.errors import UserError, shown

_HISTORY = "\nVersion history: v0.\n"
_METADATA: dict[str, Any] = {"render_modes": ["rgb_array"], "render_fps": 50}


class TaskEnv(gym.Env):
    """Gymnasium environment of one vehicle on one task."""

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
        camera: str = "arena",
        render_backend: str = "ray",
        **task_options,
    ):
        if not (render_mode is None or (isinstance(render_mode, str) and render_mode == "rgb_array")):
            raise UserError(f"render_mode must be 'rgb_array' or None, not {shown(repr(render_mode), 40)}")
        if render_mode == "rgb_array":
            from inclined_landing.envs.rendering import check_picture_options

            check_picture_options(width, height, camera, render_backend)
        self.batch = make_batch(
            self.task_name, 1, plant=plant, plant_options=plant_options, vehicle=vehicle, **task_options
        )
        self.task = self.batch.task
        self.observation_space = observation_space(self.task)
        self.action_space = action_space(self.task)
        self.render_mode = render_mode
        self._picture: dict[str, Any] = {"width": width, "height": height, "camera": camera}
        self._backend = render_backend
        self._renderer: Any = None

    def reset(self, *, seed: int | None = None, options: dict | None = None):
        """Return (observation, info) of a new episode, at random or from `options["state"]`."""
        state = reset_state(options)
        check_seed(seed)
        super().reset(seed=None if seed is None else int(seed))
        self.batch.draw_from(self.np_random)
        if state is not None:
            state = np.atleast_2d(as_floats(state, "the start state"))
        return self.batch.reset(state=state)[0], {}

    def step(self, action):
        """Return (observation, reward, terminated, truncated, info); see the class docstring."""
        action = as_floats(action, "the action")
        if action.shape != self.action_space.shape:
            raise UserError(f"the action must have shape {self.action_space.shape}, not {action.shape}")
        step = self.batch.step(action[None])
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

    def set_conditions(self, conditions) -> None:
        """Begin the next episodes under the conditions of a curriculum (`train/curriculum.py`)."""
        self.batch.task.conditions = conditions

    def render(self) -> np.ndarray | None:
        """Return the present scene as (height, width, 3) uint8; None without a render mode."""
        if self.render_mode is None:
            return None
        from inclined_landing.envs.rendering import make_renderer, pose_from_state

        if self._renderer is None:
            self._renderer = make_renderer(vehicle=self.task.vehicle, backend=self._backend, **self._picture)
        plant = self.batch.plant
        platform = plant.platform[0].copy() if plant.present[0] else None
        return self._renderer.render(pose_from_state(plant.state[0], platform, has_base=plant.motion is None))

    def __getstate__(self) -> dict:
        """Return the state that a copy shares with this environment, without its renderer."""
        return self.__dict__ | {"_renderer": None}

    def close(self) -> None:
        if self._renderer is not None:
            self._renderer.close()
            self._renderer = None


class TaskVectorEnv(VectorEnv):
    """Gymnasium vector environment of n vehicles on one task, with autoreset in the same step."""

    metadata = _METADATA | {"render_modes": [], "autoreset_mode": AutoresetMode.SAME_STEP}
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
            raise UserError(
                "the vector environment does not render; record a single one, or use make_vec with "
                "vectorization_mode='sync'"
            )
        self.batch = make_batch(
            self.task_name,
            num_envs,
            plant=plant,
            plant_options=plant_options,
            vehicle=vehicle,
            **task_options,
        )
        self.num_envs = num_envs
        self.render_mode = None
        self.task = self.batch.task
        self.single_observation_space = observation_space(self.task)
        self.single_action_space = action_space(self.task)
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)

    def reset(self, *, seed: int | None = None, options: dict | None = None):
        """Return (observations, info) of new episodes, at random or from `options["state"]`."""
        state = reset_state(options)
        check_seed(seed)
        super().reset(seed=None if seed is None else int(seed))
        if seed is not None:
            self.batch.draw_from(self.np_random)
        self.batch.reset(state=state)
        return self.batch.observe(), {}

    def step(self, actions):
        """Step all vehicles; finished episodes restart at once.

        `info["final_obs"]` (object array, mask `_final_obs`) and `info["final_info"]` describe the episodes
        that ended.
        """
        env = self.batch
        step = env.step(actions)
        info = {"reward_terms": step.terms, "is_success": step.success, "touched": env.touched.copy()}
        observation, done = step.observation, step.terminated | step.truncated
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

    def set_conditions(self, conditions) -> None:
        """Begin the next episodes under the conditions of a curriculum (`train/curriculum.py`)."""
        self.batch.task.conditions = conditions


def _environment_classes(task: type[Task]) -> dict[str, type]:
    """Return both environment classes of a task, by name; their docstring is that of the task's module."""
    content = {"__doc__": manual(task) + _HISTORY, "__module__": __name__, "task_name": task.name}
    kinds = {f"{task.__name__}Env": TaskEnv, f"{task.__name__}VectorEnv": TaskVectorEnv}
    return {name: type(name, (kind,), content) for name, kind in kinds.items()}


for _task in TASKS.values():
    globals().update(_environment_classes(_task))
