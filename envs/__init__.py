"""Tasks, environments and rendering.

Importing this package registers `InclinedLanding-v0`, `InclinedTouchdown-v0` and `Setpoint-v0`:

    gymnasium.make("inclined_landing.envs:InclinedLanding-v0")
    gymnasium.make_vec("inclined_landing.envs:InclinedLanding-v0", num_envs=64)
"""

from gymnasium.envs.registration import register

_FACES = "inclined_landing.envs.gym_env"

for _task in ("InclinedLanding", "InclinedTouchdown", "Setpoint"):
    register(
        f"{_task}-v0",
        entry_point=f"{_FACES}:{_task}Env",
        vector_entry_point=f"{_FACES}:{_task}VectorEnv",
    )
