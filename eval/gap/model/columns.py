"""Candidate effects of a vehicle, and the columns of the Jacobian: their parameters and model errors."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Mapping, Sequence

import numpy as np

from inclined_landing.eval.gap.model import form
from inclined_landing.models.effects import Effect, Parameter
from inclined_landing.models.effects.effect import OFF
from inclined_landing.models.vehicle import Vehicle

Values = Mapping[str, Mapping[str, float]]  # effect -> parameter -> value
FittedValues = dict[str, dict[str, float]]  # the same, a copy to change

BASE = ""  # in place of the name of an effect: the base model, which has model (form) errors only
SLAB = 1.0  # standard deviation of the slab, in plausible sizes
SHAPE_COVARIANCE = np.array(
    [[0.3125, 0.1875], [0.1875, 0.3125]]
)  # covariance of a unit size at both sides: see `slab_covariance`


@dataclasses.dataclass(frozen=True)
class Column:
    """One column of the Jacobian: a parameter of an effect, or a model error."""

    effect: str
    parameter: str
    fixed: tuple[tuple[str, float], ...] = ()  # other parameters of the effect at which it is taken
    form: str = ""  # name of a model error of the effect (`model.form`), in place of a parameter


class Candidates:
    """A nominal vehicle and the candidate effects of a library."""

    vehicle: Vehicle
    library: dict[str, Effect]

    @staticmethod
    def of(vehicle: Vehicle, library: Mapping[str, Effect]) -> Candidates:
        """Return the effects of a library as candidates for a vehicle."""
        candidates = Candidates()
        candidates.vehicle = vehicle
        candidates.library = {name: effect.sized_for(vehicle) for name, effect in library.items()}
        return candidates

    def corrected(self, values: Values) -> Vehicle:
        """Return the vehicle with effects at `values`, applied in the order of the library."""
        vehicle = self.vehicle
        for name, effect in self.library.items():
            if name in values:
                vehicle = effect.apply(vehicle, values[name])
        return vehicle

    def parameter(self, column: Column) -> Parameter:
        """Return the parameter of a column; of a model error, its weight."""
        if column.effect == BASE:
            sd = form.BASE[column.form]
            return Parameter(
                column.form, bounds=(-9.0, 9.0), plausible=sd, negligible=sd / OFF, manoeuvre=0.5 * sd
            )
        if column.form:
            sd = self.library[column.effect].form
            return Parameter(
                column.form, bounds=(-9.0, 9.0), plausible=0.0, negligible=sd / OFF, is_reference=True
            )
        return self.library[column.effect].parameter(column.parameter)

    def neutral(self, name: str) -> dict[str, float]:
        """Return the neutral values of an effect; for the base model, zero model errors."""
        return dict.fromkeys(form.BASE, 0.0) if name == BASE else self.library[name].neutral

    def sizes(self, name: str, values: Values) -> np.ndarray:
        """Return the distance of every parameter of an effect from neutral."""
        return np.array([p.size(values[name][p.name]) for p in self.library[name].parameters])

    def columns(self, names: Iterable[str]) -> list[Column]:
        """Return the columns of the effects `names`.

        A reference parameter (the load about which a curve bends) is not identifiable while its effect is
        neutral. Such an effect has two columns, its first parameter with the reference at either end: it is
        linear in these two.
        """
        result = []
        for name in names:
            if name == BASE:
                result += [Column(BASE, f, form=f) for f in form.BASE]
                continue
            effect = self.library[name]
            if (about := effect.reference) is not None:
                first = effect.parameters[0].name
                result += [Column(name, first, ((about.name, end),)) for end in about.either_side()]
            else:
                result += [Column(name, p.name) for p in effect.parameters]
        return result

    def one_sided_difference(self, values: Values, column: Column) -> tuple[Vehicle, float]:
        """Return the vehicle of a one-sided finite difference along a column at `values`, and the step."""
        p = self.parameter(column)
        step = p.step or p.negligible
        if column.fixed:  # a second instance of the effect, added to the first
            added = {p.name: p.value_at(step), **dict(column.fixed)}
            return self.library[column.effect].apply(self.corrected(values), added), step
        at = {**self.library[column.effect].neutral, **values.get(column.effect, {})}
        here = p.coordinate(at[p.name])
        step = step if p.value_at(here + step) <= p.possible[1] else -step
        return self.corrected({**values, column.effect: {**at, p.name: p.value_at(here + step)}}), step

    def coordinates(self, values: Values, columns: Sequence[Column]) -> np.ndarray:
        """Return the coordinates (P,) of values along columns; of effects' model errors 0."""
        result = np.zeros(len(columns))
        for k, column in enumerate(columns):
            at = values.get(column.effect)
            if column.effect == BASE:
                result[k] = values.get(BASE, {}).get(column.form, 0.0)
            elif at and not column.form:
                p, effect = self.parameter(column), self.library[column.effect]
                result[k] = p.coordinate(at.get(p.name, p.neutral))
                if column.fixed and (about := effect.reference) is not None:
                    ends = effect.at_ends(result[k], at.get(about.name, about.neutral))
                    result[k] = ends[column.fixed[0][1] == about.either_side()[1]]
        return result

    def values_at(self, names: Iterable[str], columns: Sequence[Column], at: np.ndarray) -> FittedValues:
        """Return the values of the effects `names` at coordinates (P,), clipped to their bounds."""
        result = {}
        for name, effect in self.library.items():
            if name not in names:
                continue
            indices = [k for k, c in enumerate(columns) if c.effect == name and not c.form]
            found = {columns[k].parameter: self.parameter(columns[k]).value_at(at[k]) for k in indices}
            if effect.reference:
                first = effect.parameters[0]
                size, about = effect.from_ends(*at[indices])
                found = {first.name: first.neutral + size, effect.reference.name: about}
            result[name] = {
                p.name: float(np.clip(found.get(p.name, p.neutral), *p.possible)) for p in effect.parameters
            }
        return result

    def central_difference(self, values: Values, column: Column, times: float) -> tuple[list[Vehicle], float]:
        """Return the two vehicles of a central difference along a column, and their distance.

        times: half the distance in negligible sizes, where the bounds allow it.
        """
        p = self.parameter(column)
        at = {**self.library[column.effect].neutral, **values.get(column.effect, {}), **dict(column.fixed)}
        low = max(p.bounds[0], at[p.name] - times * p.negligible)
        high = min(p.bounds[1], at[p.name] + times * p.negligible)
        ends = [self.corrected({**values, column.effect: {**at, p.name: x}}) for x in (low, high)]
        return ends, high - low


def slab_deviations(candidates: Candidates, columns: Sequence[Column]) -> np.ndarray:
    """Return the slabs' standard deviations (P,)."""
    width = []
    for column in columns:
        p = candidates.parameter(column)
        width.append(OFF * p.negligible if p.is_reference else SLAB * abs(p.coordinate(p.plausible)))
    return np.array(width)


def slab_covariance(candidates: Candidates, columns: Sequence[Column]) -> np.ndarray:
    """Return the slabs' covariance (P, P); the two columns of an effect about a reference are correlated."""
    # A size s ~ N(0, w^2) about a reference at the share t ~ N(0, 1/4) from the middle is s (1/2 - t) and
    # s (1/2 + t) along the two columns: E x_i^2 = w^2 (1/4 + 1/16), E x_i x_j = w^2 (1/4 - 1/16).
    width = slab_deviations(candidates, columns)
    shape = np.eye(len(columns))
    for i, one in enumerate(columns):
        for j, other in enumerate(columns):
            if one.fixed and (one.effect, one.parameter) == (other.effect, other.parameter):
                shape[i, j] = SHAPE_COVARIANCE[0, int(i != j)]
    return shape * np.outer(width, width)
