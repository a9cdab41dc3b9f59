"""The tasks by name, as listed in `ids.py`."""

import sys
from collections.abc import Mapping
from importlib import import_module
from typing import Any

from inclined_landing.envs.ids import TASK_CLASSES
from inclined_landing.envs.tasks.base import (
    Evaluation,
    Start,
    StepContext,
    Task,
    Training,
    hover_states,
)
from inclined_landing.envs.tasks.guard import check_step, import_class, is_path
from inclined_landing.envs.tasks.landing import InclinedLanding
from inclined_landing.envs.tasks.moving import MovingLanding
from inclined_landing.envs.tasks.options import TaskOptions, option
from inclined_landing.envs.tasks.setpoint import Setpoint
from inclined_landing.envs.tasks.slopes import SlopeLanding
from inclined_landing.envs.tasks.space import SpaceLanding
from inclined_landing.envs.tasks.touchdown import (
    InclinedTouchdown,
    MovingTouchdown,
    SlopeTouchdown,
    SpaceTouchdown,
)
from inclined_landing.models.base import schema
from inclined_landing.models.base.errors import UserError, shown

TASKS: dict[str, type[Task]] = {
    name: getattr(import_module(f"{__name__}.{name}"), kind) for name, kind in TASK_CLASSES.items()
}
# The classes that a planar task has on slopes, in space and over moving platforms.
FURTHER: dict[type[Task], tuple[type[Task], type[Task], type[Task]]] = {
    InclinedLanding: (SlopeLanding, SpaceLanding, MovingLanding),
    InclinedTouchdown: (SlopeTouchdown, SpaceTouchdown, MovingTouchdown),
}
_OWN: dict[str, type[Task]] = {}  # imported with `import_task`, by path and by name

__all__ = [
    "TASKS",
    "Evaluation",
    "InclinedLanding",
    "InclinedTouchdown",
    "MovingLanding",
    "MovingTouchdown",
    "Setpoint",
    "SlopeLanding",
    "SlopeTouchdown",
    "SpaceLanding",
    "SpaceTouchdown",
    "Start",
    "StepContext",
    "Task",
    "TaskOptions",
    "Training",
    "hover_states",
    "import_task",
    "is_path",
    "make_task",
    "option",
]


def known(name) -> bool:
    """Return whether a task of this name exists or has been imported by this name or path."""
    return isinstance(name, str) and (name in TASKS or name in _OWN)


def task_class(name: str) -> type[Task]:
    """Return the class of a task by name, or by its path if imported; raises UserError for an unknown one."""
    if not known(name):
        raise UserError(f"unknown task {shown(repr(name), 60)}; choose from {', '.join(TASKS)}")
    return TASKS[name] if name in TASKS else _OWN[name]


def import_task(path: str) -> type[Task]:
    """Import a custom task, `module:Class` or `file.py:Class`; it is then known like any other.

    As with modules, a second import of the same path returns the first.
    """
    if isinstance(path, str) and path in _OWN:
        return _OWN[path]
    kind = import_class(path)
    if kind.name in TASKS:
        raise UserError(f"task {shown(path, 60)} is named {kind.name}, as a task of this package; rename it")
    _OWN[path] = _OWN[kind.name] = kind
    return kind


def make_task(name: str, /, vehicle=None, **options) -> Task:
    """Return the task of this name with the options of its class; raises UserError for any other option."""
    kind = task_class(name)
    known = kind.option_names()
    for key in options:
        if key not in known:
            wrong = shown(repr(key), 40)
            raise UserError(f"the task {name} has no option {wrong}; choose from {', '.join(known)}")
    schema.check(options, schema.kinds_of(kind.options_type))
    try:
        task = class_for(kind, options)(vehicle, **options)
    except TypeError as error:
        raise UserError(f"task {name}: {error}") from error
    if name in _OWN:
        check_step(task)
    return task


def class_for(kind: type[Task], options: Mapping[str, Any]) -> type[Task]:
    """Return the class of a task with these options; a custom class is returned unchanged."""
    if kind not in FURTHER:
        return kind
    on_slopes, in_space, over_moving = FURTHER[kind]
    if options.get("dimensions") == 3:
        return in_space if options.get("fastest") is None else over_moving
    return kind if options.get("steepest") is None else on_slopes


def manual(kind: type[Task]) -> str:
    """Return the manual of a task: the docstring of its module, and of those of its variants."""
    kinds = (kind, *FURTHER[InclinedLanding]) if kind is InclinedLanding else (kind,)
    return "\n".join(sys.modules[part.__module__].__doc__ or "" for part in kinds)
