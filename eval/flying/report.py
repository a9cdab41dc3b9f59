"""The outcome of flights: for the caller, for fly.json, and in sentences."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from inclined_landing.eval.flying.plan import FlightPlan
from inclined_landing.eval.flying.safety import Cause
from inclined_landing.models.attitude import X, Z


@dataclasses.dataclass
class FlightReport:
    """The outcome of a flight."""

    outcome: str  # "goal box", "at rest", "plan flown", "dry run", or the name of the cause
    cause: Cause | None = None  # the cause of an early end
    error: str | None = None  # of the cause `error`
    retreat: Cause | None = None  # the cause of a retreat, if there was one
    start: np.ndarray | None = None  # (13,) believed state at hand-over
    goal: np.ndarray | None = None  # (13,) believed state when the motors were cut in the goal box or at rest
    landing_time: float | None = None  # s from hand-over to there
    touched: bool = False  # before that in the landing, hard enough to be seen in the positions
    final: np.ndarray | None = None  # (3,) last position, m
    rests: bool | None = None  # does it lie still and upright on the platform, by its last pose
    astray: float | None = None  # m, the farthest that it was off its plan
    unguarded: bool = False  # was the watchdog process gone

    @property
    def landed(self) -> bool:
        """Whether the landing reached the goal of its task."""
        return self.outcome in ("goal box", "at rest")

    @property
    def succeeded(self) -> bool:
        """Whether the flight reached its purpose."""
        return self.landed or self.outcome == "plan flown"


def summary(report: FlightReport, plan: FlightPlan, log: Path | None) -> dict[str, Any]:
    """Return a report in the form of fly.json."""
    fields = {field.name: getattr(report, field.name) for field in dataclasses.fields(report)}
    for name in ("cause", "retreat"):
        fields[name] = fields[name] and fields[name].name
    start = plan.start_point[[X, Z]].tolist()
    return {**fields, "landed": report.landed, "start_wanted": start, "log": log and log.name}


def describe(report: FlightReport) -> str:
    """Return the outcome of a flight in one line."""
    if report.outcome == "plan flown":
        return f"flown as planned, at most {100 * (report.astray or 0.0):.0f} cm from the plan, and set down"
    if report.landed:
        assert report.goal is not None and report.landing_time is not None
        vx, vz = report.goal[3], report.goal[5]
        rest = {True: "at rest on the slope", False: "not at rest on the slope", None: "not seen afterwards"}
        touched = report.touched and report.outcome == "goal box"
        return (
            f"{report.outcome}{' after touching the platform,' if touched else ''} "
            f"{report.landing_time:.2f} s after hand-over at vx {vx:z.2f}, vz {vz:z.2f} m/s; "
            f"{rest[report.rests]}"
        )
    if report.cause is None:
        return report.outcome
    return f"ended early: {report.cause.name} ({report.cause.when})"


def describe_all(reports: Sequence[FlightReport], purpose: str) -> str:
    """Return the outcome of all flights; purpose: "plan", or the name of the task that was flown."""
    n = f"{len(reports)} flight{'s' * (len(reports) != 1)}"
    rest = sum(bool(report.rests) for report in reports)
    if purpose == "plan":
        return f"{sum(report.succeeded for report in reports)} of {n} followed the plan"
    if purpose == "touchdown":
        return f"of {n}, {rest} came to rest on the slope"
    landed = [report for report in reports if report.landed]
    clean = sum(not report.touched for report in landed)
    return (
        f"of {n}, {len(landed)} reached the goal box ({clean} without touching the platform before) and "
        f"{rest} came to rest on the slope"
    )
