"""Import of custom tasks, named as `module:Class` or `file.py:Class`, and checks of class and first step.

The package's own tasks have tests instead. Later exceptions in custom code are reported in one sentence at
the end of a command (`envs.shared.user_code.blame`); `BatchEnv` refuses rewards that are not finite.
"""

from __future__ import annotations

import re
from typing import Any, TypeGuard

import numpy as np

from inclined_landing.envs.shared.user_code import import_named
from inclined_landing.envs.tasks.base import ACTIONS, FARTHEST, Evaluation, Start, StepContext, Task, Training
from inclined_landing.models.attitude import STATE_SIZE
from inclined_landing.models.base.errors import UserError, shown
from inclined_landing.models.plants import Contacts

_NAME = re.compile("[a-z][a-z0-9_-]{0,40}")
_NEEDED = ("name", "observation_names", "observation_scale", "action_names")


class TaskError(UserError):
    """The code of a custom task is wrong."""


def is_path(name: object) -> TypeGuard[str]:
    """Return whether `name` is the path of a class instead of the name of a task."""
    return isinstance(name, str) and ":" in name


def import_class(path: str) -> type[Task]:
    """Return the class that `path` names, imported; raises UserError if it is not a task."""
    what = f"task {shown(path, 60)}"
    kind = import_named(path)
    if not (isinstance(kind, type) and issubclass(kind, Task)):
        source, _, name = path.rpartition(":")
        raise UserError(f"{what}: {source} has no class {name} derived from inclined_landing.envs.tasks.Task")
    check_class(kind, what)
    return kind


def check_class(kind: type[Task], what: str) -> None:
    """Raise TaskError for a class that lacks a required attribute. what: its name in the message."""
    lacking = sorted(getattr(kind, "__abstractmethods__", ()))
    if lacking := lacking or [name for name in _NEEDED if not hasattr(kind, name)]:
        raise TaskError(f"{what} lacks {' and '.join(lacking)}")
    if not (isinstance(kind.name, str) and _NAME.fullmatch(kind.name)):
        raise TaskError(f"{what} has name {shown(repr(kind.name), 40)}; use lowercase letters and digits")
    names: Any
    for title, names in (("observation_names", kind.observation_names), ("action_names", kind.action_names)):
        listed = isinstance(names, (list, tuple)) and all(isinstance(name, str) for name in names)
        if not listed or not 0 < len(names) == len(set(names)):
            wrong = shown(repr(names), 40)
            raise TaskError(f"{what} has {title} {wrong}; it must be a tuple of distinct names")
    if not set(kind.action_names) <= set(ACTIONS):
        raise TaskError(f"{what} has action_names {kind.action_names}; choose from {', '.join(ACTIONS)}")
    if not isinstance(kind.training, Training):
        raise TaskError(f"{what} has training {shown(repr(kind.training), 40)}; it must be a Training")
    if not isinstance(kind.observation_scale, property):
        scale = _numbers(kind.observation_scale, (len(kind.observation_names),), f"{what}: observation_scale")
        if not (scale > 0.0).all():
            raise TaskError(f"{what} has an observation_scale that is not positive")


def check_step(task: Task) -> None:
    """Raise TaskError unless two starts, their observations and the evaluation of a step are valid."""
    what, n = f"task {task.name}", 2
    start = task.sample(np.random.default_rng(0), n)
    if not isinstance(start, Start):
        raise TaskError(f"{what}: sample returned {shown(repr(start), 40)}, not a Start")
    state = _numbers(start.state, (n, STATE_SIZE), f"{what}: sample's states")
    if (np.abs(state) > FARTHEST).any():
        raise TaskError(f"{what}: states of sample are beyond {FARTHEST:g}")
    for name in ("inclination", "present"):
        _numbers(getattr(start, name), (n,), f"{what}: sample's {name}")
    nowhere = np.zeros((n, 3, 3), bool)
    untouched = Contacts(nowhere, nowhere, np.zeros((n, 3, 3)))
    context = StepContext(
        *(state, untouched, np.zeros((n, len(task.action_names))), start),
        *(np.ones(n, int), np.zeros(n, int), np.zeros(n, int), start.platforms(task.vehicle)),
    )
    _numbers(task.observe(context), (n, len(task.observation_names)), f"{what}: what observe returned")
    found = task.evaluate(context)
    if not (isinstance(found, Evaluation) and isinstance(found.terms, dict)):
        raise TaskError(f"{what}: evaluate returned {shown(repr(found), 40)}, not an Evaluation of terms")
    for name, term in found.terms.items():
        _numbers(term, (n,), f"{what}: evaluate's term {shown(name, 40)}")
    for name in ("success", "terminated", "truncated", *(["holding"] if found.holding is not None else [])):
        if _numbers(getattr(found, name), (n,), f"{what}: evaluate's {name}").dtype != bool:
            raise TaskError(f"{what}: evaluate's {name} must be boolean")


def _numbers(value: object, shape: tuple[int, ...], what: str) -> np.ndarray:
    """Return an array; raises TaskError unless it has this shape and finite numbers."""
    try:
        array = np.asarray(value)
        wrong = array.dtype.kind not in "fiub" or not np.isfinite(array).all()
    except ValueError:  # rows of several lengths
        raise TaskError(f"{what} is not an array") from None
    if array.shape != shape:
        raise TaskError(f"{what} must have shape {shape}, not {array.shape}")
    if wrong:
        raise TaskError(f"{what} must be finite")
    return array
