"""Tasks, environments, policies, their recorded flights, and rendering.

`import inclined_landing` registers every task with Gymnasium under the name of its class (`ids.py`). If an id
begins with a package, as in `inclined_landing:InclinedLanding-v0`, Gymnasium imports that package first:

    gymnasium.make("InclinedLanding-v0")
    gymnasium.make_vec("InclinedLanding-v0", num_envs=64)

The options are in `gym_env.py`. Public: `make_for` (a policy with its environment), `make_batch` and
`BatchEnv` (n vehicles, one call per step), `BatchVecEnv` (the same for Stable-Baselines3), `Task`,
`make_task` and `import_task`, `load_policy`, `save_policy`, `record_flights`.
"""

from typing import TYPE_CHECKING

from inclined_landing.models.base.imports import at_first_use

if TYPE_CHECKING:
    from inclined_landing.envs.batch import BatchEnv
    from inclined_landing.envs.flights import record_flights
    from inclined_landing.envs.make import make_batch, make_for
    from inclined_landing.envs.policy import load_policy
    from inclined_landing.envs.save import save_policy
    from inclined_landing.envs.sb3 import BatchVecEnv
    from inclined_landing.envs.tasks import Task, import_task, make_task

__all__ = [
    "BatchEnv",
    "BatchVecEnv",
    "Task",
    "import_task",
    "load_policy",
    "make_batch",
    "make_for",
    "make_task",
    "record_flights",
    "save_policy",
]

_MODULES = {  # what takes time to import, or is not installed with the environments alone
    "BatchEnv": "batch",
    "BatchVecEnv": "sb3",
    "Task": "tasks",
    "import_task": "tasks",
    "load_policy": "policy",
    "make_batch": "make",
    "make_for": "make",
    "make_task": "tasks",
    "record_flights": "flights",
    "save_policy": "save",
}
__getattr__ = at_first_use(__name__, _MODULES)
