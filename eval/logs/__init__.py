"""Flight logs: one form in memory, readers for several kinds of file, and checks in words."""

from inclined_landing.eval.logs.checks import check_log
from inclined_landing.eval.logs.log import FlightLog
from inclined_landing.eval.logs.read import read_log, write_log

__all__ = ["FlightLog", "check_log", "read_log", "write_log"]
