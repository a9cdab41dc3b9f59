"""Order of convergence of every integrator: halving the step divides the error by 2^order."""

from __future__ import annotations

from functools import partial

import numpy as np
from matplotlib.axes import Axes

from inclined_landing.eval.base.claims import Claim, Section, Table
from inclined_landing.eval.base.style import legend_below
from inclined_landing.eval.truth.equivalence import flying
from inclined_landing.eval.truth.equivalence.flying import MODES, WORDS, engine, equations
from inclined_landing.eval.truth.figures import curves, panels
from inclined_landing.models.plants import Attitude, Plant
from inclined_landing.models.vehicle import Vehicle

STEPS_MS = (10.0, 5.0, 2.5, 1.25)
ORDERS = {"RK4": 4, "implicitfast": 1, "Euler": 1, "equations, RK4": 4}
SUBSTEPS = (2, 4, 8, 16)  # of the equations' own RK4, the same steps
REFERENCE = 160  # RK4 steps in a control period, 0.125 ms
CONTROL_STEPS = 50
MARGIN = 0.35
# Of each mode and integrator: (steps,) m, largest error at the end of the flights.
Errors = dict[tuple[Attitude, str], np.ndarray]


def order(errors: np.ndarray) -> float:
    """Return the order between the two finest steps: log2 of the ratio of their errors."""
    return float(np.log2(errors[:-1] / errors[1:])[-1])


def measure(vehicle: Vehicle, commands: np.ndarray) -> Errors:
    """Return the errors of every integrator in both modes over a second of commands (steps, n, 4)."""
    commands = commands[:CONTROL_STEPS]
    n, result = commands.shape[1], dict[tuple[Attitude, str], np.ndarray]()
    for attitude in MODES:
        fine = flying.fly(equations(n, attitude, REFERENCE, vehicle), commands)[-1]
        for name in ORDERS:
            plants: list[Plant] = [
                equations(n, attitude, substeps, vehicle)
                if name == "equations, RK4"
                else engine(n, attitude, vehicle, integrator=name, timestep=h / 1e3)
                for h, substeps in zip(STEPS_MS, SUBSTEPS)
            ]
            ends = [flying.fly(plant, commands)[-1] for plant in plants]
            result[attitude, name] = np.array([flying.position_gap(end, fine).max() for end in ends])
    return result


def claims(found: Errors) -> list[Claim]:
    """Return the claim on each order."""
    result = []
    for (attitude, name), errors in found.items():
        bounds, what = (ORDERS[name] - MARGIN, ORDERS[name] + MARGIN), f"{name}, {MODES[attitude]}"
        result.append(WORDS.claim("convergence", "order", order(errors), bounds, name=what))
    return result


@panels(2, 4.6, 4.0)
def draw(found: Errors, *axes: Axes) -> None:
    """Plot the error against the step size for every integrator and both modes."""
    for axis, attitude in zip(axes, MODES):
        named = {f"{name}: order {order(e):.2f}": e for (mode, name), e in found.items() if mode == attitude}
        curves(axis, STEPS_MS, named, title=MODES[attitude].capitalize(),
               xlabel="step [ms]", ylabel="position error after 1 s [m]",
               xscale="log", yscale="log", ylim=(3e-11, 0.3))  # fmt: skip
        legend_below(axis)


def section(vehicle: Vehicle, commands: np.ndarray) -> Section:
    """Return the section."""
    found = measure(vehicle, commands)
    rows = [(MODES[mode], name, *errors, order(errors)) for (mode, name), errors in found.items()]
    heads = ("mode", "integrator", *(f"{h:g} ms [m]" for h in STEPS_MS), "order")
    default = found["rate_loop", "implicitfast"][STEPS_MS.index(5.0)]
    filling = {"count": commands.shape[1], "centimetres": 100 * default}
    tables = [Table("Position error", heads, rows)]
    return WORDS.section("convergence", claims(found), filling, tables=tables, draw=partial(draw, found))
