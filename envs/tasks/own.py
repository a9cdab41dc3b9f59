"""Custom tasks: a class derived from `Task`, named as `module:Class` or `file.py:Class`."""

from __future__ import annotations

from typing import TypeGuard

from inclined_landing.envs.shared.user_code import import_named
from inclined_landing.envs.tasks.base import Task
from inclined_landing.envs.tasks.guard import check_class
from inclined_landing.models.base.errors import UserError, shown


def is_path(name: object) -> TypeGuard[str]:
    """Return whether `name` is the path of a class instead of the name of a task."""
    return isinstance(name, str) and ":" in name


def import_class(path: str) -> type[Task]:
    """Return the class that `path` names, imported; raises UserError if it is not a task."""
    what = f"task {shown(path, 60)}"
    kind = import_named(path, "task", "Class")
    if not (isinstance(kind, type) and issubclass(kind, Task)):
        source, _, name = path.rpartition(":")
        raise UserError(f"{what}: {source} has no class {name} derived from inclined_landing.envs.tasks.Task")
    check_class(kind, what)
    return kind
