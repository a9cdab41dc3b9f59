"""What the attributes of a task may be: of its class, and of the task itself, which may have others."""

from __future__ import annotations

import inspect
import re
import types
import typing
from collections.abc import Callable, Iterable, Mapping
from typing import Any

import numpy as np

from inclined_landing.envs.tasks.base import ACTIONS, ScoreCurve, Task, Training
from inclined_landing.models.errors import shown

_NAME = re.compile("[a-z][a-z0-9_-]{0,40}")
_MOST_STEPS = 1_000_000
_LARGEST = 1e6  # of a number that has no limits of its own


def complaint(task: Task | type[Task]) -> str | None:
    """What is wrong with the attributes of a task or of its class, in words after its name; None: nothing."""
    for name, (fits, takes) in _RULES.items():
        if isinstance(task, type) and hasattr(inspect.getattr_static(task, name), "__get__"):
            continue  # a property, which each task answers for itself
        value = getattr(task, name)
        if not fits(value):
            return f"has {name} {said(value)}; it takes {takes}"
    scale = task.observation_scale
    numbers = _numbers(scale.tolist() if isinstance(scale, np.ndarray) else scale)
    if numbers is None or len(numbers) != len(task.observation_names):
        return "has not one observation_scale for each of its observation_names"
    if not all(number > 0.0 for number in numbers):
        return "has an observation_scale that is not a finite number above 0"
    for name, hint in typing.get_type_hints(Training).items():
        kinds = typing.get_args(hint) or (hint,)
        value = getattr(task.training, name)
        if not any(_KINDS[kind][0](value) for kind in kinds):
            takes = " or ".join(_KINDS[kind][1] for kind in kinds if kind in _KINDS)
            return f"has {name} {said(value)} in its training; it takes {takes}"
    return None


def said(value: object) -> str:
    """A value in a sentence."""
    if isinstance(value, type):
        return f"the class {shown(value.__name__, 40)}"
    text = repr(value)
    return f"of type {type(value).__name__}" if " at 0x" in text or "<class" in text else shown(text, 40)


def is_whole(value: Any, low: int = 1, high: int = 10**9) -> bool:
    """Is it a whole number between these; True and False are none."""
    return isinstance(value, (int, np.integer)) and not isinstance(value, bool) and low <= value <= high


def _is_real(value: Any) -> bool:
    kinds = (int, float, np.integer, np.floating)
    return isinstance(value, kinds) and not isinstance(value, bool) and abs(value) <= _LARGEST


def _numbers(value: Any) -> list | None:
    """Finite numbers as a list; None for anything else."""
    return list(value) if isinstance(value, (list, tuple)) and all(map(_is_real, value)) else None


def _are_names(value: Any) -> bool:
    if not isinstance(value, (list, tuple)) or not all(isinstance(name, str) and name for name in value):
        return False
    return 0 < len(value) == len(set(value))


def _among(known: Iterable[str]) -> Callable[[Any], bool]:
    return lambda value: _are_names(value) and set(value) <= set(known)


def _are_points(value: Any) -> bool:
    return isinstance(value, (list, tuple)) and len(value) > 0 and all(map(_numbers, value))


def _or_none(fits: Callable[[Any], bool]) -> Callable[[Any], bool]:
    return lambda value: value is None or fits(value)


def _is_positive(value: Any) -> bool:
    return _is_real(value) and value > 0


def _is_bool(value: Any) -> bool:
    return isinstance(value, (bool, np.bool_))


_KINDS: dict[Any, tuple[Callable[[Any], Any], str]] = {
    int: (lambda value: is_whole(value, 0, 2**63), "a whole number"),
    float: (_is_real, "a number"),
    str: (lambda value: isinstance(value, str), "text"),
    types.NoneType: (lambda value: value is None, "None"),
}
# By attribute: what fits, and what that is called.
_RULES: dict[str, tuple[Callable[[Any], Any], str]] = {
    "name": (
        lambda value: isinstance(value, str) and _NAME.fullmatch(value),
        "small letters and digits",
    ),
    "observation_names": (_are_names, "a tuple of different names"),
    "action_names": (_among(ACTIONS), f"some of {', '.join(ACTIONS)}"),
    "max_steps": (lambda value: is_whole(value, 1, _MOST_STEPS), f"a whole number from 1 to {_MOST_STEPS}"),
    "goal_size": (_or_none(_is_positive), "a number above 0, or None"),
    "idle_action": (_or_none(_is_real), "a number, or None"),
    "judged_after": (_or_none(_is_positive), "seconds above 0, or None"),
    **{name: (_is_bool, "True or False") for name in ("has_platform", "cut_at_success", "shipped")},
    "table": (lambda value: isinstance(value, str), "a name"),
    "training": (lambda value: isinstance(value, Training), "a Training(...)"),
    "curricula": (_are_names, "a tuple of different names"),
    "score_curve": (lambda value: isinstance(value, ScoreCurve), "a ScoreCurve(...)"),
    "start_axes": (_among("xyz"), "some of x, y, z"),
    "film_starts": (_are_points, "a tuple of points, each a tuple of metres"),
    "figure_starts": (
        lambda value: isinstance(value, Mapping) and all(map(_numbers, value.values())),
        "a dictionary of points, each a tuple of metres",
    ),
}
