"""Which class a task becomes with its options: the rules of its own class over one of the `VARIANTS`."""

from __future__ import annotations

import functools
import types
from collections.abc import Mapping
from typing import Any

from inclined_landing.envs.tasks.base import Task
from inclined_landing.envs.tasks.landing import InclinedLanding
from inclined_landing.envs.tasks.moving import MovingLanding
from inclined_landing.envs.tasks.slopes import SlopeLanding
from inclined_landing.envs.tasks.space import SpaceLanding

VARIANTS = (SlopeLanding, SpaceLanding, MovingLanding)


def variant(kind: type[Task], options: Mapping[str, Any]) -> type[Task]:
    """Return the class of the task with these options: for landings that are not planar, not `kind`."""
    if not issubclass(kind, InclinedLanding):
        return kind
    if options.get("dimensions") == 3:
        return _combined(kind, SpaceLanding if options.get("fastest") is None else MovingLanding)
    return kind if options.get("steepest") is None else _combined(kind, SlopeLanding)


@functools.cache
def _combined(kind: type[InclinedLanding], part: type[InclinedLanding]) -> type[Task]:
    """Return `kind` with platform, observations and actions of `part`.

    In the method resolution order come kind's methods, then those of the part, then the planar landing's.
    """
    if issubclass(kind, part):
        return kind
    if kind is InclinedLanding:
        return part
    made = types.new_class(f"{kind.__name__}{part.__name__}", (kind, part))
    made.__module__, made.__doc__ = kind.__module__, kind.__doc__
    return made
