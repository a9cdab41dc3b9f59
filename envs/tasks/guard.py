"""Tasks of one's own, guarded: what their code does wrong is one sentence that names the method.

`guarded` derives a class whose methods call those of the task. Whatever one of them raises becomes a sentence
with its line; what `sample`, `observe` and `evaluate` return is checked for shapes, types and NaN. The
package's own tasks have tests instead.
"""

from __future__ import annotations

import dataclasses
import functools
import inspect
import re
import sys
import traceback
import types
from collections.abc import Callable
from typing import Any

import numpy as np

from inclined_landing.envs.tasks.base import ACTIONS, FARTHEST, Evaluation, Start, StepContext, Task, Training
from inclined_landing.models.attitude import STATE_NAMES, STATE_SIZE
from inclined_landing.models.errors import UserError, shown

_NAME = re.compile("[a-z][a-z0-9_-]{0,40}")
_NEEDED = ("name", "observation_names", "observation_scale", "action_names")


class TaskError(UserError):
    """The code of a task of one's own is wrong."""


class _Wrong(Exception):
    """What a method returned; the words after "TASK: METHOD"."""


def guarded(kind: type[Task], path: str) -> type[Task]:
    """Return the task class with methods that raise TaskError for what goes wrong in them.

    path: how sentences call it. Raises UserError for a class that lacks what every task must have.
    """
    what = f"task {shown(path, 60)}"
    if complaint := _complaint(kind):
        raise UserError(f"{what} {complaint}")
    made = types.new_class(kind.__name__, (kind,))
    made.__module__, made.__qualname__, made.__doc__ = kind.__module__, kind.__qualname__, kind.__doc__
    for name, default in vars(Task).items():
        found = inspect.getattr_static(kind, name)
        if inspect.isfunction(default) and (name == "__init__" or not name.startswith("_")):
            like = found if inspect.isfunction(found) else default
            setattr(made, name, _method(made, kind, name, like, what))
    return made


def _complaint(kind: type[Task]) -> str | None:
    """Return what a class lacks, in words after its name; None: nothing."""
    lacking = sorted(getattr(kind, "__abstractmethods__", ()))
    if lacking := lacking or [name for name in _NEEDED if not hasattr(kind, name)]:
        return f"lacks {' and '.join(lacking)}"
    if not (isinstance(kind.name, str) and _NAME.fullmatch(kind.name)):
        return f"has name {shown(repr(kind.name), 40)}; it takes small letters and digits"
    names: Any
    for what, names in (("observation_names", kind.observation_names), ("action_names", kind.action_names)):
        listed = isinstance(names, (list, tuple)) and all(isinstance(name, str) for name in names)
        if not listed or not 0 < len(names) == len(set(names)):
            return f"has {what} {shown(repr(names), 40)}; it takes a tuple of different names"
    if not set(kind.action_names) <= set(ACTIONS):
        return f"has action_names {shown(repr(kind.action_names), 40)}; it takes some of {', '.join(ACTIONS)}"
    if not isinstance(kind.training, Training):
        return f"has training {shown(repr(kind.training), 40)}; it takes a Training"
    if isinstance(kind.observation_scale, property):
        return None
    scale = np.asarray(kind.observation_scale)
    if scale.shape != (len(kind.observation_names),) or scale.dtype.kind not in "fiu":
        return "has not one observation_scale for each of its observation_names"
    if not (np.isfinite(scale) & (scale > 0.0)).all():
        return "has an observation_scale that is not a finite number above 0"
    return None


def _method(made: type, kind: type, name: str, like: Callable, what: str) -> Callable:
    """Return the method `name` of the task as the guarded class has it."""
    check = _CHECKS.get(name)

    @functools.wraps(like)
    def method(self, *given, **named):
        try:
            value = getattr(super(made, self), name)(*given, **named)
            return value if check is None else check(self, value, *given, **named)
        except (UserError, MemoryError):
            raise
        except _Wrong as error:
            raise TaskError(f"{what}: {name} {error}") from None
        except (Exception, SystemExit) as error:  # whatever the code does
            raise TaskError(f"{what}: {name} {_raised(error, kind)}") from error

    return method


def _raised(error: BaseException, kind: type) -> str:
    """Return what was raised, and in which line of the task's file."""
    file = getattr(sys.modules.get(kind.__module__), "__file__", None)
    lines = [frame.lineno for frame in traceback.extract_tb(error.__traceback__) if frame.filename == file]
    words = f": {shown(str(error), 120)}" if str(error) else ""
    return f"raised {type(error).__name__}{words}{f' (line {lines[-1]})' if lines else ''}"


def _numbers(value, shape: tuple[int, ...], what: str, names=(), kind=float, most=np.inf, nan=False):
    """Return an array of finite numbers up to `most`, or, where they may be, NaN; names: of its columns."""
    try:
        array = np.asarray(value)
    except ValueError:  # rows of several lengths
        raise _Wrong(f"returned {what} that is no array") from None
    if array.shape != shape:
        raise _Wrong(f"returned {what} of shape {array.shape}, not {shape}")
    if array.dtype.kind not in ("b" if kind is bool else "fiub"):
        wanted = "true and false" if kind is bool else "numbers"
        raise _Wrong(f"returned {what} of {array.dtype}, not of {wanted}")
    if kind is bool:
        return array
    with np.errstate(over="ignore"):
        array = array.astype(kind, copy=False)
    wrong = ~(np.abs(array) <= min(most, np.finfo(kind).max)) & ~(nan & np.isnan(array))
    if wrong.any():
        where = tuple(np.argwhere(wrong)[0])
        column = f" for {names[where[1]]}" if len(names) and len(where) == 2 else ""
        number = "NaN" if np.isnan(array[where]) else f"{array[where]:g}"
        raise _Wrong(f"returned {number} in {what}{column}")
    return array


def _is(value: Any, kind: type, hint: str = "") -> None:
    if not isinstance(value, kind):
        said = "nothing" if value is None else shown(repr(value), 40)
        article = "an" if kind.__name__[0] in "AEIOU" else "a"
        raise _Wrong(f"returned {said}, not {article} {kind.__name__}{hint}")


def _start(task: Task, value: Any, rng: np.random.Generator, k: int) -> Start:
    _is(value, Start, "; self.start(states) makes one")
    return dataclasses.replace(
        value,
        state=_numbers(value.state, (k, STATE_SIZE), "states", STATE_NAMES, most=FARTHEST),
        inclination=_numbers(value.inclination, (k,), "inclinations", most=np.pi),
        present=_numbers(value.present, (k,), "present", kind=bool),
        goal_size=_numbers(value.goal_size, (k,), "goal sizes", nan=True),
    )


def _observation(task: Task, value: Any, context: StepContext) -> np.ndarray:
    names = task.observation_names
    return _numbers(value, (len(context.state), len(names)), "observations", names, np.float32)


def _evaluation(task: Task, value: Any, context: StepContext) -> Evaluation:
    _is(value, Evaluation)
    _is(value.terms, dict, " of terms")
    shape = (len(context.state),)
    terms = {name: _numbers(term, shape, f"the term {shown(name, 40)}") for name, term in value.terms.items()}
    flags = ("success", "terminated", "cut", *(["holding"] if value.holding is not None else []))
    return dataclasses.replace(
        value, terms=terms, **{name: _numbers(getattr(value, name), shape, name, kind=bool) for name in flags}
    )


_CHECKS: dict[str, Callable] = {"sample": _start, "observe": _observation, "evaluate": _evaluation}
