"""Tasks, environments and rendering.

Importing this package registers every task with Gymnasium, under the name of its class:

    gymnasium.make("inclined_landing.envs:InclinedLanding-v0")
    gymnasium.make_vec("inclined_landing.envs:InclinedLanding-v0", num_envs=64)
"""

from gymnasium.envs.registration import register

from inclined_landing.envs.tasks import TASKS

_FACES = "inclined_landing.envs.gym_env"

for _task in TASKS.values():
    register(
        f"{_task.__name__}-v0",
        entry_point=f"{_FACES}:{_task.__name__}Env",
        vector_entry_point=f"{_FACES}:{_task.__name__}VectorEnv",
    )
