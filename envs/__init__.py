"""Tasks, environments and rendering.

Importing this package registers every task with Gymnasium, under the name of its class:

    gymnasium.make("inclined_landing.envs:InclinedLanding-v0")
    gymnasium.make_vec("inclined_landing.envs:InclinedLanding-v0", num_envs=64)

Public: `make_batch` and `BatchEnv` (n vehicles, one call a step), `BatchVecEnv` (the same for
Stable-Baselines3), `Task`, `make_task` and `import_task`, `load_policy`, `save_policy`, `record_flights`.
"""

from importlib import import_module
from typing import TYPE_CHECKING

from gymnasium.envs.registration import register

from inclined_landing.envs.tasks import TASKS, Task, import_task, make_task

if TYPE_CHECKING:
    from inclined_landing.envs.batch import BatchEnv
    from inclined_landing.envs.flights import record_flights
    from inclined_landing.envs.make import make_batch
    from inclined_landing.envs.policy import load_policy
    from inclined_landing.envs.sb3 import BatchVecEnv, save_policy

__all__ = [
    "BatchEnv",
    "BatchVecEnv",
    "Task",
    "import_task",
    "load_policy",
    "make_batch",
    "make_task",
    "record_flights",
    "save_policy",
]

_FACES = "inclined_landing.envs.gym_env"
_AT_FIRST_USE = {  # what takes time to import, or is not installed with the environments alone
    "BatchEnv": "batch",
    "BatchVecEnv": "sb3",
    "load_policy": "policy",
    "make_batch": "make",
    "record_flights": "flights",
    "save_policy": "sb3",
}

for _task in TASKS.values():
    register(
        f"{_task.__name__}-v0",
        entry_point=f"{_FACES}:{_task.__name__}Env",
        vector_entry_point=f"{_FACES}:{_task.__name__}VectorEnv",
    )


def __getattr__(name: str):
    if name not in _AT_FIRST_USE:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_AT_FIRST_USE[name]}"), name)
