"""The tasks, by name: the one place that lists them. Their Gymnasium ids and environments follow."""

from inclined_landing.envs.tasks.base import Moment, Task
from inclined_landing.envs.tasks.landing import InclinedLanding
from inclined_landing.envs.tasks.setpoint import Setpoint
from inclined_landing.envs.tasks.touchdown import InclinedTouchdown
from inclined_landing.models.errors import UserError

TASKS: dict[str, type[Task]] = {task.name: task for task in (InclinedLanding, Setpoint, InclinedTouchdown)}

__all__ = ["TASKS", "InclinedLanding", "InclinedTouchdown", "Moment", "Setpoint", "Task", "make_task"]


def task_class(name: str) -> type[Task]:
    """The class of a task by name; raises UserError for an unknown one."""
    if not isinstance(name, str) or name not in TASKS:
        raise UserError(f"unknown task {name!r}; known are {', '.join(TASKS)}")
    return TASKS[name]


def make_task(name: str, vehicle=None, **options) -> Task:
    """A task by name with the options of its class."""
    kind = task_class(name)
    try:
        return kind(vehicle, **options)
    except TypeError as error:
        raise UserError(f"task {name}: {error}") from error
