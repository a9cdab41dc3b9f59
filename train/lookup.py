"""Lookup of functions of `eval` by name: training imports nothing of it, and runs without its packages."""

from __future__ import annotations

import importlib
from collections.abc import Callable
from typing import Any

from inclined_landing.models.base.errors import UserError, not_installed

REPORT = "after_training.report"  # writes the report on a run


def look_up(name: str) -> Callable[..., Any]:
    """Return a function of `eval`, named `module.function`; raises UserError if a package is missing."""
    module_name, _, function = name.rpartition(".")
    try:
        module = importlib.import_module(f"inclined_landing.eval.{module_name}")
    except ModuleNotFoundError as error:
        raise UserError(not_installed(error, "eval")) from error
    return getattr(module, function)
