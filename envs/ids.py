"""The tasks' names and Gymnasium ids, known in every process that imports both packages, in either order.

Neither Gymnasium nor a task is imported here: `import inclined_landing`, and `import mujoco`, which loads the
plugins, cost nothing. A Gymnasium that comes later gets the ids at its own import.
"""

from __future__ import annotations

import importlib.util
import sys
from types import ModuleType

# A task's name, which is that of its module in `tasks/`, and its class.
TASK_CLASSES = {"landing": "InclinedLanding", "setpoint": "Setpoint", "touchdown": "InclinedTouchdown"}
IDS = tuple(f"{name}-v0" for name in TASK_CLASSES.values())

_ENVIRONMENTS = "inclined_landing.envs.gym_env"
_REGISTRATION = "gymnasium.envs.registration"


def announce() -> None:
    """Register the ids with Gymnasium, now or when it is imported; do nothing the second time."""
    if _REGISTRATION in sys.modules:
        _register(sys.modules[_REGISTRATION])
    elif not any(isinstance(finder, _Waiting) for finder in sys.meta_path):
        sys.meta_path.insert(0, _Waiting())


def _register(registration: ModuleType) -> None:
    for name in TASK_CLASSES.values():
        if f"{name}-v0" not in registration.registry:
            registration.register(
                f"{name}-v0",
                entry_point=f"{_ENVIRONMENTS}:{name}Env",
                vector_entry_point=f"{_ENVIRONMENTS}:{name}VectorEnv",
            )


class _Waiting:
    """Import hook that registers the ids once Gymnasium's registration has been executed."""

    def find_spec(self, name, path=None, target=None):
        if name != _REGISTRATION or self not in sys.meta_path:
            return None
        sys.meta_path.remove(self)
        spec = importlib.util.find_spec(name)
        if spec is None or spec.loader is None:
            return spec
        execute = spec.loader.exec_module

        def execute_and_register(module: ModuleType) -> None:
            execute(module)
            _register(module)

        spec.loader.exec_module = execute_and_register  # type: ignore[method-assign]
        return spec
