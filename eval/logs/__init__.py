"""Flight logs: one representation in memory, readers for several file formats, and checks."""

from typing import TYPE_CHECKING

from inclined_landing.models.base.imports import at_first_use

if TYPE_CHECKING:
    from inclined_landing.eval.logs.checks import check_log
    from inclined_landing.eval.logs.log import FlightLog
    from inclined_landing.eval.logs.read import read_log, write_log

__all__ = ["FlightLog", "check_log", "read_log", "write_log"]

_MODULES = {"FlightLog": "log", "check_log": "checks", "read_log": "read", "write_log": "read"}
__getattr__ = at_first_use(__name__, _MODULES)
