"""Order of convergence of every integrator: halving the step divides the error by 2^order."""

from __future__ import annotations

import dataclasses
from functools import partial

import numpy as np
from matplotlib.axes import Axes

from inclined_landing.eval.base.claims import Claim, Section, Table
from inclined_landing.eval.base.style import legend_below
from inclined_landing.eval.truth.equivalence import flying
from inclined_landing.eval.truth.equivalence.flying import ATTITUDES, WORDS, engine, equations
from inclined_landing.eval.truth.figures import curves, panels
from inclined_landing.models.plants import Attitude, Plant
from inclined_landing.models.vehicle import Vehicle

STEPS_MS = (10.0, 5.0, 2.5, 1.25)
ORDERS = {"RK4": 4, "implicitfast": 1, "Euler": 1, "equations, RK4": 4}
SUBSTEPS = (2, 4, 8, 16)  # of the equations' own RK4, the same steps
REFERENCE = 160  # RK4 steps in a control period, 0.125 ms
CONTROL_STEPS = 50
MARGIN = 0.35


@dataclasses.dataclass(frozen=True)
class Convergence:
    """Errors of one integrator and one attitude mode."""

    integrator: str
    attitude: Attitude
    errors: np.ndarray  # (steps,) m, largest at the end of the flights

    @property
    def order(self) -> float:
        """Return the order between the two finest steps: log2 of the ratio of their errors."""
        return float(np.log2(self.errors[:-1] / self.errors[1:])[-1])

    def claim(self) -> Claim:
        """Return the claim on the order."""
        expected, mode = ORDERS[self.integrator], self.attitude.replace("_", " ")
        bounds = expected - MARGIN, expected + MARGIN
        return WORDS.claim("convergence", "order", self.order, bounds, name=f"{self.integrator}, {mode}")


def measure(vehicle: Vehicle, commands: np.ndarray) -> list[Convergence]:
    """Return the convergence of every integrator in both modes over a second of commands (steps, n, 4)."""
    commands = commands[:CONTROL_STEPS]
    n, result = commands.shape[1], []
    for attitude in ATTITUDES:
        fine = flying.fly(equations(n, attitude, REFERENCE, vehicle), commands)[-1]
        for name in ORDERS:
            plants: list[Plant] = [
                equations(n, attitude, substeps, vehicle)
                if name == "equations, RK4"
                else engine(n, attitude, vehicle, integrator=name, timestep=h / 1e3)
                for h, substeps in zip(STEPS_MS, SUBSTEPS)
            ]
            ends = [flying.fly(plant, commands)[-1] for plant in plants]
            errors = np.array([flying.position_gap(end, fine).max() for end in ends])
            result.append(Convergence(name, attitude, errors))
    return result


@panels(2, 4.6, 4.0)
def draw(found: list[Convergence], *axes: Axes) -> None:
    """Plot the error against the step size for every integrator and both modes."""
    for axis, attitude in zip(axes, ATTITUDES):
        errors = {f"{c.integrator}: order {c.order:.2f}": c.errors for c in found if c.attitude == attitude}
        curves(axis, STEPS_MS, errors, title=attitude.replace("_", " ").capitalize(),
               xlabel="step [ms]", ylabel="position error after 1 s [m]",
               xscale="log", yscale="log", ylim=(3e-11, 0.3))  # fmt: skip
        legend_below(axis)


def section(vehicle: Vehicle, commands: np.ndarray) -> Section:
    """Return the section."""
    found = measure(vehicle, commands)
    rows = [(c.attitude.replace("_", " "), c.integrator, *c.errors, c.order) for c in found]
    heads = ("mode", "integrator", *(f"{h:g} ms [m]" for h in STEPS_MS), "order")
    default = next(c for c in found if c.integrator == "implicitfast" and c.attitude == "rate_loop")
    filling = {"count": commands.shape[1], "centimetres": 100 * default.errors[STEPS_MS.index(5.0)]}
    tables = [Table("Position error", heads, rows)]
    claims = [c.claim() for c in found]
    return WORDS.section("convergence", claims, filling, tables=tables, draw=partial(draw, found))
