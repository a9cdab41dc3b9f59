"""What flights of a vehicle leave uncertain of it: the posterior that `identify` writes beside its vehicle."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from inclined_landing.eval.gap.search.evidence import Column, Problem
from inclined_landing.eval.gap.search.posterior import Local, between_flights, looks_alike
from inclined_landing.eval.gap.search.residual import Left, Repeating


@dataclasses.dataclass(frozen=True)
class Reference:
    """How far a vehicle may be off along every column of the library and of the base model's errors."""

    columns: tuple[Column, ...]
    mean: np.ndarray  # (P,) in the units of the parameters
    covariance: np.ndarray  # (P, P) in the units of the parameters
    repeating: Repeating  # what repeats in its flights that no effect explains

    def along(self, columns: Sequence[Column]) -> tuple[np.ndarray, np.ndarray]:
        """Mean (Q,) and covariance (Q, Q) of other columns; nothing of those it does not know."""
        place = {column: k for k, column in enumerate(self.columns)}
        share = np.zeros((len(columns), len(place)))
        for i, column in enumerate(columns):
            if column in place:
                share[i, place[column]] = 1.0
        return share @ self.mean, share @ self.covariance @ share.T

    @staticmethod
    def of(problem: Problem, size: np.ndarray, inflation: np.ndarray) -> Reference:
        """The posterior of the vehicle of `problem`, every effect as free as real vehicles are.

        size (6,) of the disturbance, inflation (6,): of the fit that made the vehicle.
        """
        columns = problem.columns(problem.library) + problem.form_columns({})
        near = problem.linearise({}, columns, inflation)
        problem.alike = looks_alike(near)
        problem.between = between_flights(problem, near)
        local = Local.of(problem, near, {})
        mean, covariance = local.fit(frozenset(problem.library))
        left = Left.by(problem, local, frozenset(problem.library), {}, size, inflation)
        known = covariance * np.outer(local.unit, local.unit)
        return Reference(tuple(columns), mean * local.unit, known, Repeating.of(problem, left))
