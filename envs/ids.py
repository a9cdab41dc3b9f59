"""Names of tasks and shipped policies, and Gymnasium ids, registered in every process that imports both.

Neither Gymnasium nor a task is imported here, so that `import inclined_landing`, and `import mujoco`, which
loads the plugins, take no time, and command lines can list their options. If Gymnasium is imported later, the
ids are registered then.
"""

from __future__ import annotations

from importlib import resources
from pathlib import Path
from types import ModuleType

from inclined_landing.models.base import imports

# A task's name, which is that of its module in `tasks/`, and its class.
TASK_CLASSES = {"landing": "InclinedLanding", "setpoint": "Setpoint", "touchdown": "InclinedTouchdown"}
IDS = tuple(f"{name}-v0" for name in TASK_CLASSES.values())
SHIPPED_FOLDER = Path(str(resources.files("inclined_landing.envs") / "shipped"))
_FILES = sorted(file.stem for file in SHIPPED_FOLDER.glob("*.zip"))
# Names of the shipped policies: first those called like their task.
SHIPPED = tuple(dict.fromkeys([*(name for name in TASK_CLASSES if name in _FILES), *_FILES]))
DESCENT = "descent"  # in place of a policy in --from: the feedback law of train/descent.py

_ENVIRONMENTS = "inclined_landing.envs.gym_env"


def announce() -> None:
    """Register the ids with Gymnasium, now or when it is imported; do nothing the second time.

    This is the first thing done at `import inclined_landing`; it also installs the workarounds for MuJoCo and
    numba (`models.base.imports`).
    """
    imports.adapt()
    imports.around_import("gymnasium.envs.registration", _register)


def _register(execute: imports.Execute, registration: ModuleType) -> None:
    execute(registration)
    for name in TASK_CLASSES.values():
        if f"{name}-v0" not in registration.registry:
            registration.register(
                f"{name}-v0",
                entry_point=f"{_ENVIRONMENTS}:{name}Env",
                vector_entry_point=f"{_ENVIRONMENTS}:{name}VectorEnv",
            )
