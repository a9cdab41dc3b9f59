"""Effects fitted again: to all flights, and to all but each one, whose errors then judge the fit."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping, Sequence
from functools import cached_property

from inclined_landing.eval.gap.answer.rollout import RolloutWindows, errors_by_flight
from inclined_landing.eval.gap.flights.windows import MeasuredFlight
from inclined_landing.eval.gap.infer.fit import (
    field_half_widths,
    fit_vehicle,
    leave_one_out_modes,
    vehicles_a_half_width_away,
)
from inclined_landing.eval.gap.infer.sets import SetPosterior, leave_one_out
from inclined_landing.eval.gap.model.columns import FittedValues
from inclined_landing.eval.gap.model.problem import Problem
from inclined_landing.models.base.errors import UserError
from inclined_landing.models.vehicle import Vehicle


@dataclasses.dataclass(frozen=True)
class Refit:
    """Values of effects fitted to the flights of a problem, and those fitted without each flight."""

    problem: Problem
    values: FittedValues
    left_out: Sequence[FittedValues]  # for every flight, fitted to the others

    @cached_property
    def vehicle(self) -> Vehicle:
        """Return the vehicle with the effects."""
        return self.problem.corrected(self.values)

    @cached_property
    def vehicles(self) -> list[Vehicle]:
        """Return for every flight the vehicle fitted to the others."""
        return [self.problem.corrected(values) for values in self.left_out]

    def judged(self, heldout: Sequence[MeasuredFlight]) -> tuple[Sequence[MeasuredFlight], list[Vehicle]]:
        """Return the flights that errors are measured on, each with a vehicle that was not fitted to it.

        They are those held out; without any, the flights fitted.
        """
        if heldout:
            return heldout, [self.vehicle] * len(heldout)
        return self.problem.flights, self.vehicles

    def error_ahead(self) -> float:
        """Return the position error [m] one second ahead on flights left out; infinite if none is so long."""
        try:
            starts = RolloutWindows.of(self.problem.flights)
        except UserError:
            return math.inf
        return float(errors_by_flight(starts, self.vehicles)[0][-1])


@dataclasses.dataclass(frozen=True)
class Correction(Refit):
    """Values of the effects that correct the vehicle: the named ones, or all of an identified vehicle."""

    again: bool = False  # whether the errors of the identified vehicle were estimated again
    # Fields of the vehicle that change with these, and half-widths of their 95 % intervals.
    half_widths: Mapping[str, float | tuple[float, ...]] = dataclasses.field(default_factory=dict)


def corrected(found: SetPosterior, values: FittedValues) -> Correction:
    """Return the correction by the named effects at `values`.

    All effects of an identified vehicle are estimated again where that predicts flights left out better.
    """
    problem, names = found.problem, frozenset(values)
    local = found.local.with_wide_slabs(names)
    named = Correction(problem, values, leave_one_out(problem, local, names, values))
    if not (problem.identified and values):
        return named
    again, local = fit_vehicle(problem, found.spread, values, names)
    moved = vehicles_a_half_width_away(problem, local, names, again)
    widths = field_half_widths(problem.vehicle, problem.corrected(again), moved)
    whole = Correction(problem, again, leave_one_out_modes(problem, local, names), True, widths)
    return min(named, whole, key=Correction.error_ahead)
