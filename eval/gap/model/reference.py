"""The posterior of an identified vehicle: mean and covariance of its errors, stored next to its file.

A vehicle file holds point estimates. Their joint covariance holds which combinations the reference flights
left uncertain; functions of logged quantities describe the residual common to these flights.
"""

from __future__ import annotations

import dataclasses
import hashlib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Literal

import numpy as np
from msgspec import Struct, ValidationError
from scipy.linalg import block_diag

from inclined_landing.eval.gap.measured.landings import LandingReference
from inclined_landing.eval.gap.model.columns import (
    ALONE,
    Candidates,
    Column,
    ParameterColumn,
    slab_covariance,
)
from inclined_landing.eval.gap.model.prediction import POSE_CHANNELS
from inclined_landing.eval.gap.result import ReferenceErrors, from_plain, plain
from inclined_landing.models.base import storage
from inclined_landing.models.base.errors import UserError
from inclined_landing.models.effects import LIBRARY, Effect
from inclined_landing.models.parameters import Constant, constants, load_vehicle, locate_vehicle
from inclined_landing.models.vehicle import Vehicle

SUFFIX = ".posterior.json"
VERSION: Literal[5] = 5
_NORMAL = 1.96  # half-width of a 95 % interval in standard deviations
TARGETS = (*POSE_CHANNELS, "forward", "left")
FEATURES = 24  # random Fourier features of a function
KNOTS = 7  # radial basis functions along every input
TIME_SPACING = 0.5  # s between those along the flight time
FARTHEST = 4.0  # standard deviations from the mean: inputs further off count as these
TIME = "flight time"
# One-parameter functions of single inputs, each along the target that it should not act on.
LINEAR = {"roll command": "pitch", "pitch command": "roll"}


@dataclasses.dataclass(frozen=True)
class Basis:
    """Features of some inputs: radial basis functions of each, random Fourier features of all.

    Without knots the inputs themselves.
    """

    centre: np.ndarray  # (k,)
    scale: np.ndarray  # (k,)
    knots: tuple[np.ndarray, ...]  # of k, in scaled inputs

    def __post_init__(self):
        count = len(self.knots) or len(self.centre)
        if not len(self.centre) == len(self.scale) == count or min(self.scale) <= 0.0:
            raise ValueError("as many scales above zero as inputs")

    @property
    def count(self) -> int:
        """Return the number D of features."""
        return self(np.zeros((1, len(self.centre)))).shape[1]

    @staticmethod
    def of(seen: np.ndarray, name: str) -> Basis:
        """Return the basis of the inputs called `name`, scaled to those `seen` (m, k)."""
        centre, scale = seen.mean(axis=0), np.maximum(seen.std(axis=0), 1e-9)
        if name in LINEAR:
            return Basis(centre, scale, ())
        z, count = (seen - centre) / scale, KNOTS
        if name == TIME:  # oscillations in time need a finer basis
            count = max(KNOTS, round(float(np.ptp(seen)) / TIME_SPACING))
        return Basis(centre, scale, tuple(np.quantile(c, np.linspace(0, 1, count)) for c in z.T))

    def __call__(self, x: np.ndarray) -> np.ndarray:
        """Return the features (m, D) of inputs (m, k)."""
        # Radial: exp(-(z - knot)^2 / (2 width^2));  Fourier: sqrt(2 / D) cos(w'z + phase), w ~ N(0, 1 / k)
        z = np.clip((x - self.centre) / self.scale, -FARTHEST, FARTHEST)
        parts = [] if self.knots else [z]
        for column, knots in zip(z.T, self.knots):
            width = max(float(np.ptp(knots)) / (len(knots) - 1), 1e-6)
            parts.append(np.exp(-0.5 * ((column[:, None] - knots) / width) ** 2))
        if len(self.knots) > 1:
            rng = np.random.default_rng(0)
            turns = rng.standard_normal((len(self.knots), FEATURES)) / np.sqrt(len(self.knots))
            phase = rng.uniform(0.0, 2.0 * np.pi, FEATURES)
            parts.append(np.sqrt(2.0 / FEATURES) * np.cos(z @ turns + phase))
        return np.hstack(parts)


@dataclasses.dataclass(frozen=True)
class ReferenceResidual:
    """Functions fitted to the residual of the reference flights."""

    bases: Mapping[str, Basis]  # of quantities
    weights: Mapping[str, Mapping[str, np.ndarray]]  # quantity -> target -> (D,)


@dataclasses.dataclass(frozen=True)
class VehiclePosterior:
    """Normal posterior of a vehicle's errors along all columns of the library and of the model errors."""

    columns: tuple[Column, ...]
    mean: np.ndarray  # (P,) coordinates of the parameters
    covariance: np.ndarray  # (P, P) of these
    repeating: ReferenceResidual  # functions of the residual common to its flights
    # Effects of the library at its identification. An effect listed here without a column was not excited by
    # the reference flights; the vehicle is taken to have no error in it.
    library: frozenset[str]
    from_flights: bool = True  # or from the uncertainties in a vehicle file
    errors: ReferenceErrors | None = None  # None: not known
    landings: LandingReference | None = None  # None: too few
    # Fingerprints of the flights that it comes from, by their names.
    flights: Mapping[str, tuple[int, ...]] = dataclasses.field(default_factory=dict)

    def along(self, columns: Sequence[Column]) -> tuple[np.ndarray, np.ndarray]:
        """Return the marginal mean (Q,) and covariance (Q, Q) along some columns; 0 where they met none."""
        place = {column: k for k, column in enumerate(self.columns)}
        share = np.zeros((len(columns), len(place)))
        for i, column in enumerate(columns):
            if column in place:
                share[i, place[column]] = 1.0
        return share @ self.mean, share @ self.covariance @ share.T

    def with_new_effects(self, vehicle: Vehicle) -> VehiclePosterior:
        """Return the posterior with the slab priors of the effects that its identification did not know."""
        unknown = {n: e for n, e in free_effects().items() if n not in self.library}
        new = Candidates.for_vehicle(vehicle, unknown)
        columns = new.columns(new.library)
        if not columns:
            return self
        return dataclasses.replace(
            self,
            columns=(*self.columns, *columns),
            mean=np.append(self.mean, np.zeros(len(columns))),
            covariance=block_diag(self.covariance, slab_covariance(new, columns)),
            library=frozenset(free_effects()),
        )

    @staticmethod
    def of_file(path: Path | None, vehicle: Vehicle) -> VehiclePosterior:
        """Return the diagonal covariance of the uncertainties given in a vehicle file."""
        problem = Candidates.for_vehicle(vehicle, free_effects())
        columns = problem.all_columns()
        known = {c.field: c for c in constants(path)}
        deviation = [_deviation(problem, c, known) for c in columns]
        return VehiclePosterior(
            tuple(columns),
            np.zeros(len(columns)),
            np.diag(np.square(deviation)),
            ReferenceResidual({}, {}),
            frozenset(free_effects()),
            from_flights=False,
        )

    def to_json(self, vehicle: Vehicle) -> dict:
        """Return the posterior as plain lists and numbers; `vehicle`: the one identified."""
        return plain(_Stamp(VERSION, digest(vehicle))) | plain(self) | {"library": sorted(self.library)}

    @staticmethod
    def from_json(table: object) -> VehiclePosterior:
        """Return the posterior of `to_json`. Raises ValidationError or ValueError for a damaged one."""
        from_plain(table, _Stamp)
        found = from_plain(table, VehiclePosterior)
        if found.mean.shape != (n := len(found.columns),) or found.covariance.shape != (n, n):
            raise ValueError("as many numbers as columns")
        wide = np.sqrt(np.maximum(found.covariance.diagonal(), 1e-300))
        scaled = found.covariance / np.outer(wide, wide)
        if np.abs(scaled - scaled.T).max() > 1e-9 or np.linalg.eigvalsh(scaled).min() < -1e-6:
            raise ValueError("a covariance")
        for on, functions in found.repeating.weights.items():
            basis = found.repeating.bases.get(on)
            for target, w in functions.items():
                if basis is None or target not in TARGETS or w.shape != (basis.count,):
                    raise ValueError(f"weights of {target} with {on}")
        return found


class _Stamp(Struct, frozen=True):
    """The head of a posterior's file: its format's version, and its vehicle."""

    version: Literal[5]
    vehicle: str  # its digest


def free_effects() -> dict[str, Effect]:
    """Return the effects of the library that free flights can show."""
    return {name: effect for name, effect in LIBRARY.items() if not effect.contact}


def digest(vehicle: Vehicle) -> str:
    """Return a hash of all constants of a vehicle but its disturbance and its neutral effects.

    So it stays what it was when the library grows.
    """
    neutral, idle = load_vehicle(), not (vehicle.effects_attitude_integral or vehicle.effects_attitude_hold)
    values = {
        name: value
        for name, value in vars(vehicle).items()
        if not name.startswith("disturbance")
        and not (name == "attitude_integral_limit" and idle)
        and not (name.startswith("effects_") and value == getattr(neutral, name))
    }
    text = repr(sorted(values.items()))
    return hashlib.sha256(text.encode("utf-8")).hexdigest()


def posterior_path(path: Path) -> Path:
    """Return the path of the posterior of a vehicle file."""
    return path.with_name(path.stem + SUFFIX)


def read_reference(path: Path | None, vehicle: Vehicle) -> tuple[VehiclePosterior, str]:
    """Return the posterior of a vehicle file or shipped name, and a sentence if that next to it was ignored.

    Raises UserError for a posterior that is damaged.
    """
    path = None if path is None else locate_vehicle(path)
    if path is None or not (file := posterior_path(path)).exists():
        return VehiclePosterior.of_file(path, vehicle), ""
    table = storage.read_json(file, "posterior")
    try:
        reference = VehiclePosterior.from_json(table)
    except (ValueError, ValidationError) as error:
        raise UserError(
            f"{file} is damaged ({error}); identify the vehicle again, or remove the file"
        ) from error
    if table["vehicle"] == digest(vehicle):
        return reference.with_new_effects(vehicle), ""
    ignored = f"{file.name} belongs to a different vehicle than {path.name} and was ignored"
    return VehiclePosterior.of_file(path, vehicle), ignored


def _deviation(problem: Candidates, column: Column, vehicle_file: dict[str, Constant]) -> float:
    """Return the prior standard deviation of a column, from the uncertainties of the constants it changes."""
    # Linear propagation: a constant c with the 95 % half-width h gives sigma = h / (1.96 |dc/dx|); the
    # smallest of all that the column changes.
    if not isinstance(column, ParameterColumn):  # without flights confounded with effects: they stay small
        return ALONE * problem.parameter(column).plausible
    if column.fixed:
        return 0.0
    moved, step = problem.one_sided_difference({}, column)
    widths = []
    for f in dataclasses.fields(moved):
        change = np.subtract(getattr(moved, f.name), getattr(problem.vehicle, f.name)) / step
        known = vehicle_file[f.name].uncertainty
        if np.any(change) and not isinstance(known, str):
            wide = np.broadcast_to(known, np.shape(change))[change != 0.0]
            widths.append(float(np.max(wide / np.abs(change[change != 0.0]))) / _NORMAL)
    return min(widths, default=0.0)
