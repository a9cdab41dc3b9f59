"""The functions of `eval` that training calls, looked up by name: `train` imports nothing of `eval`.

It so runs without the packages that only `eval` needs.
"""

from __future__ import annotations

import importlib
from collections.abc import Callable
from typing import Any

from inclined_landing.models.base.errors import UserError, not_installed

_MODULES = {
    "report": "after_training",  # after a run
    "find": "cli",  # the commands of a recipe
}


def look_up(name: str) -> Callable[..., Any]:
    """Return a function of `eval` by its name; raises UserError if one of its packages is missing."""
    try:
        module = importlib.import_module(f"inclined_landing.eval.{_MODULES[name]}")
    except ModuleNotFoundError as error:
        raise UserError(not_installed(error, "eval")) from error
    return getattr(module, name)
