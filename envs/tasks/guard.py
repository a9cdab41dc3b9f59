"""Tasks of one's own, guarded: what their code does wrong is one sentence that names class and method.

`guarded` derives a class whose methods call those of the task, and check what these return where everything
else relies on it: shapes, types, and that numbers are finite. The package's own tasks have tests instead.
"""

from __future__ import annotations

import dataclasses
import functools
import inspect
import math
import sys
import traceback
import types
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from inclined_landing.envs.tasks.attributes import complaint, is_whole, said
from inclined_landing.envs.tasks.base import FARTHEST, Channel, Judgement, Moment, Start, Task
from inclined_landing.models.attitude import COMMAND_NAMES, COMMAND_SIZE, STATE_NAMES, STATE_SIZE
from inclined_landing.models.errors import UserError, shown
from inclined_landing.models.motion import Motion


class TaskError(UserError):
    """The code of a task of one's own is wrong."""


class _Wrong(Exception):
    """What a method returned; the words after "TASK: METHOD"."""


def guarded(kind: type[Task], path: str) -> type[Task]:
    """The task class, whose methods raise TaskError for what goes wrong in them or with what they return.

    path: how sentences call it.
    """
    what = f"task {shown(path, 60)}"
    made = types.new_class(kind.__name__, (kind,))
    made.__module__, made.__qualname__, made.__doc__ = kind.__module__, kind.__qualname__, kind.__doc__

    def call(name: str, ask: Callable[[Task], Any]) -> Callable:
        check = _CHECKS.get(name)

        def asked(self, *given, **named):
            try:
                value = ask(self, *given, **named)
                return value if check is None else check(self, value, *given, **named)
            except (UserError, MemoryError):
                raise
            except _Wrong as error:
                raise TaskError(f"{what}: {name} {error}") from None
            except (Exception, SystemExit) as error:  # whatever the code does
                raise TaskError(f"{what}: {name} {_raised(error, kind)}") from error

        return asked

    for name, own in vars(Task).items():
        found = inspect.getattr_static(kind, name)
        if inspect.isfunction(own) and (name == "__init__" or not name.startswith("_")):

            def method(self, *given, _name=name, **named):
                return getattr(super(made, self), _name)(*given, **named)

            like = found if inspect.isfunction(found) else own
            setattr(made, name, functools.wraps(like)(call(name, method)))
        elif isinstance(own, property) and hasattr(found, "__get__"):

            def value(self, _name=name):
                return getattr(super(made, self), _name)

            setattr(made, name, property(call(name, value), doc=own.__doc__))
    return made


def _raised(error: BaseException, kind: type) -> str:
    """What was raised, and in which line of the task's file."""
    file = getattr(sys.modules.get(kind.__module__), "__file__", None)
    lines = [frame.lineno for frame in traceback.extract_tb(error.__traceback__) if frame.filename == file]
    words = error.strerror if isinstance(error, OSError) and error.strerror else str(error)
    words = f": {shown(words, 120)}" if words else ""
    return f"raised {type(error).__name__}{words}{f' (line {lines[-1]})' if lines else ''}"


def _kind(value) -> str:
    """What a method returned, where it is not what it should be."""
    return "nothing" if value is None else said(value)


def _array(value, shape: tuple[int, ...], what: str) -> np.ndarray:
    try:
        array = np.asarray(value)
    except ValueError:  # rows of several lengths
        raise _Wrong(f"returned {what} that is no array") from None
    if array.shape != shape:
        raise _Wrong(f"returned {what} of shape {array.shape}, not {shape}")
    return array


def _numbers(value, shape: tuple[int, ...], what: str, names=(), kind=float, most=math.inf, nan=False):
    """An array of numbers up to `most`, or, where they may be, NaN; names: of its columns."""
    array = _array(value, shape, what)
    if array.dtype.kind not in "fiub":
        raise _Wrong(f"returned {what} of {array.dtype}, not of numbers")
    with np.errstate(over="ignore"):
        array = array.astype(kind, copy=False)
    good = np.abs(array) <= min(most, np.finfo(kind).max)
    if not (good | np.isnan(array) if nan else good).all():
        where = np.argwhere(~good)[0]
        column = f" for {names[where[1]]}" if len(names) and len(where) == 2 else ""
        number = "NaN" if np.isnan(array[tuple(where)]) else f"{array[tuple(where)]:g}"
        raise _Wrong(f"returned {number} in {what}{column}")
    return array


def _flags(value, shape: tuple[int, ...], what: str) -> np.ndarray:
    array = _array(value, shape, what)
    if array.dtype != bool:
        raise _Wrong(f"returned {what} of {array.dtype}, not of true and false")
    return array


def _instance(task: Task, value, *given, **named) -> None:
    """What a task is after __init__."""
    if not hasattr(task, "observe_vehicle"):
        raise _Wrong("does not call that of the class it is derived from")
    if wrong := complaint(task):
        raise _Wrong(f"leaves a task that {wrong}")


def _start(task: Task, value, rng, k: int) -> Start:
    if not isinstance(value, Start):
        raise _Wrong(f"returned {_kind(value)}, not a Start; self.start(states) makes one")
    fixed = {
        "state": _numbers(value.state, (k, STATE_SIZE), "states", STATE_NAMES, most=FARTHEST),
        "inclination": _numbers(value.inclination, (k,), "inclinations", most=math.pi),
        "present": _flags(value.present, (k,), "present"),
        "goal_size": _numbers(value.goal_size, (k,), "goal sizes", nan=True),
    }
    if value.azimuth is not None:
        fixed["azimuth"] = _numbers(value.azimuth, (k,), "azimuths")
    if not (value.contact is None or isinstance(value.contact, Mapping)):
        raise _Wrong(f"returned {_kind(value.contact)} as contact, not a dictionary")
    if not (value.motion is None or isinstance(value.motion, Motion)):
        raise _Wrong(f"returned {_kind(value.motion)} as motion, not a Motion")
    return dataclasses.replace(value, **fixed)


def _observation(task: Task, value, moment: Moment) -> np.ndarray:
    names = task.observation_names
    shape = (len(moment.state), len(names))
    return _numbers(value, shape, "observations", names, np.float32)


def _judgement(task: Task, value, moment: Moment) -> Judgement:
    if not isinstance(value, Judgement):
        raise _Wrong(f"returned {_kind(value)}, not a Judgement")
    if not isinstance(value.terms, Mapping):
        raise _Wrong(f"returned {_kind(value.terms)} as terms, not a dictionary")
    shape = (len(moment.state),)
    terms = {name: _numbers(term, shape, f"the term {shown(name, 40)}") for name, term in value.terms.items()}
    flags = {name: _flags(getattr(value, name), shape, name) for name in ("success", "terminated", "cut")}
    if value.holding is not None:
        flags["holding"] = _flags(value.holding, shape, "holding")
    return dataclasses.replace(value, terms=terms, **flags)


def _commands(task: Task, value, actions, *others) -> np.ndarray:
    return _numbers(value, (len(actions), COMMAND_SIZE), "commands", COMMAND_NAMES)


def _states(task: Task, value, points) -> np.ndarray:
    return _numbers(value, (len(points), STATE_SIZE), "states", STATE_NAMES, most=FARTHEST)


def _score(task: Task, value, flights) -> dict[str, float]:
    if not isinstance(value, Mapping) or "score" not in value:
        raise _Wrong(f'returned {_kind(value)}, not a dictionary with "score"')
    return {str(name): float(_numbers(number, (), shown(name, 40))) for name, number in value.items()}


def _words(task: Task, value, *given) -> str:
    if not isinstance(value, str):
        raise _Wrong(f"returned {_kind(value)}, not text")
    return value


def _steps(task: Task, value) -> int | None:
    if not (value is None or is_whole(value, 1, int(task.max_steps))):
        raise _Wrong(f"returned {_kind(value)}, not a whole number from 1 to max_steps, or None")
    return value


def _options(task: Task, value) -> dict[str, Any]:
    if not isinstance(value, Mapping) or not all(isinstance(name, str) for name in value):
        raise _Wrong(f"returned {_kind(value)}, not a dictionary of options")
    return dict(value)


def _channels(task: Task, value) -> tuple[Channel, ...]:
    if not isinstance(value, (tuple, list)) or not all(isinstance(channel, Channel) for channel in value):
        raise _Wrong(f"returned {_kind(value)}, not a tuple of Channel(...)")
    return tuple(value)


def _truth(task: Task, value) -> bool:
    if not isinstance(value, (bool, np.bool_)):
        raise _Wrong(f"returned {_kind(value)}, not True or False")
    return bool(value)


def _observed(task: Task, value) -> np.ndarray | None:
    return None if value is None else _numbers(value, (len(task.observation_names),), "numbers")


_CHECKS: dict[str, Callable] = {
    "__init__": _instance,
    **dict.fromkeys(("sample", "evaluation_starts"), _start),
    "observe": _observation,
    "judge": _judgement,
    **dict.fromkeys(("commands", "headed"), _commands),
    "states_at": _states,
    "score": _score,
    **dict.fromkeys(("score_words", "flight_words", "start_words"), _words),
    **dict.fromkeys(("observation_centre", "goal", "goal_half_widths"), _observed),
    "judged_steps": _steps,
    "plant_options": _options,
    "channels": _channels,
    "own_hover": _truth,
}
