"""The tasks, by name."""

from inclined_landing.envs.tasks.base import Task
from inclined_landing.envs.tasks.landing import InclinedLanding
from inclined_landing.envs.tasks.setpoint import Setpoint
from inclined_landing.envs.tasks.touchdown import InclinedTouchdown
from inclined_landing.models.errors import UserError

TASKS = {task.name: task for task in (InclinedLanding, Setpoint, InclinedTouchdown)}

__all__ = ["TASKS", "InclinedLanding", "InclinedTouchdown", "Setpoint", "Task", "make_task"]


def make_task(name: str, vehicle=None, **options) -> Task:
    """A task by name ("landing", "setpoint" or "touchdown") with the options of its class."""
    if name not in TASKS:
        raise UserError(f"unknown task {name!r}; known are {', '.join(TASKS)}")
    try:
        return TASKS[name](vehicle, **options)
    except TypeError as error:
        raise UserError(f"task {name}: {error}") from error
