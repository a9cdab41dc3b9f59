"""The difference of the rate loop from the paper's equations, as a function of its bandwidth."""

from __future__ import annotations

import dataclasses
import itertools
from functools import partial

import numpy as np
from matplotlib.axes import Axes

from inclined_landing.eval.base.claims import Claim, Section, Table
from inclined_landing.eval.base.colours import BLUE, INK
from inclined_landing.eval.base.style import legend_below
from inclined_landing.eval.truth.equivalence import flying
from inclined_landing.eval.truth.equivalence.flying import (
    WORDS,
    Sequences,
    angle_gap,
    engine,
    equations,
    position_gap,
)
from inclined_landing.eval.truth.figures import DASHED, curves, panels
from inclined_landing.models.vehicle import Vehicle

BANDWIDTHS = (25.0, 50.0, 100.0, 200.0, 400.0)  # 1/s
_LARGEST_BHH = 50.0 * 0.004**2  # s, B times the engine's step squared; that of the default vehicle


@dataclasses.dataclass(frozen=True)
class Gap:
    """The error of the engine's rate loop at one bandwidth, over 6 s."""

    bandwidth: float
    rms: float  # m, distance to the paper's equations, root of the mean square over time and sequences
    paper: np.ndarray  # (n,) m, largest of each sequence
    angle: float  # deg, largest difference to them
    extended: float  # m, largest distance to the equations extended with the same bandwidth


def with_bandwidth(v: Vehicle, bandwidth: float) -> Vehicle:
    """Return the vehicle with this roll and pitch bandwidth [1/s]; that of yaw is scaled with it."""
    share = v.attitude_yaw_bandwidth / v.attitude_bandwidth
    return dataclasses.replace(v, attitude_bandwidth=bandwidth, attitude_yaw_bandwidth=share * bandwidth)


def measure(v: Vehicle, sequences: Sequences, bandwidths=BANDWIDTHS) -> list[Gap]:
    """Return the gaps over `sequences`, one per bandwidth; the engine's step follows the bandwidth."""
    commands, starts = flying.side_by_side(v, [sequences])
    n = len(starts)
    paper = flying.fly(equations(n, "kinematic", vehicle=v), commands, starts)
    gaps = []
    for bandwidth in bandwidths:
        vehicle = with_bandwidth(v, bandwidth)
        # The error of RK4 grows with (B h)^4, and over a flight falls with 1/B^2: with (B h^2)^2.
        halvings = max(0, int(np.ceil(0.5 * np.log2(bandwidth * 0.004**2 / _LARGEST_BHH) - 1e-9)))
        flown = flying.fly(engine(n, "rate_loop", vehicle, timestep=0.004 / 2**halvings), commands, starts)
        substeps = flying.FINE * max(1, round(bandwidth / 100.0))
        extended = flying.fly(equations(n, "rate_loop", substeps, vehicle), commands, starts)
        apart, angle = position_gap(flown, paper), float(angle_gap(flown, paper).max())
        rms, beside_extended = float(np.sqrt(np.mean(apart**2))), float(position_gap(flown, extended).max())
        gaps.append(Gap(bandwidth, rms, apart.max(axis=0), angle, beside_extended))
    return gaps


def claims(v: Vehicle, gaps: list[Gap]) -> list[Claim]:
    """Return the claims: doubling the bandwidth halves the gap; the extended equations agree at each."""
    result = []
    for slow, fast in itertools.pairwise(g for g in gaps if g.bandwidth >= 50):
        margin = 1 / (with_bandwidth(v, slow.bandwidth).attitude_yaw_bandwidth * v.attitude_time_constant)
        names = {"slow": slow.bandwidth, "fast": fast.bandwidth}
        ratio, bounds = slow.rms / fast.rms, (2 - margin, 2 + margin)
        result.append(WORDS.claim("bandwidth", "halving", ratio, bounds, **names))
    return result + [WORDS.claim("bandwidth", "extended", g.extended, bandwidth=g.bandwidth) for g in gaps]


@panels(1, 5.5, 4.0)
def draw(v: Vehicle, gaps: list[Gap], axis: Axes) -> None:
    """Draw the gap over the bandwidth."""
    b, rms = np.array([(g.bandwidth, g.rms) for g in gaps]).T
    for g in gaps:
        axis.plot(np.full(len(g.paper), g.bandwidth), g.paper, ".", color=BLUE, alpha=0.3, ms=5)
    distances = {"paper's equations, rms (dots: each flight)": rms}
    distances["equations extended with B"] = [g.extended for g in gaps]
    curves(axis, b, distances, title="Distance over 6 s of full steps, 3-D", xlabel="bandwidth B [1/s]",
           ylabel="distance [m]", xscale="log", yscale="log", ylim=(1e-7, 3e2))  # fmt: skip
    axis.plot(b, rms[-1] * b[-1] / b, **DASHED, label="proportional to 1/B")
    axis.axvline(v.attitude_bandwidth, color=INK, lw=1, ls=":", label="default bandwidth")
    legend_below(axis)


def section(v: Vehicle, sequences: Sequences) -> Section:
    """Return the section."""
    gaps = measure(v, sequences)
    filling = {
        "share": v.attitude_bandwidth / v.attitude_yaw_bandwidth,
        "count": len(sequences.yaw),
        "delay": 1e3 / v.attitude_bandwidth,
        "nominal": v.attitude_bandwidth,
    }
    rows = [
        (f"{g.bandwidth:g}", g.rms, float(np.median(g.paper)), float(g.paper.max()), g.angle, g.extended)
        for g in gaps
    ]
    paper = (f"paper, {what}" for what in ("rms [m]", "median [m]", "largest [m]", "angle [deg]"))
    heads = ("B [1/s]", *paper, "extended, largest [m]")
    tables = [Table("Distance between the engine's rate loop and the equations", heads, rows)]
    return WORDS.section("bandwidth", claims(v, gaps), filling, tables=tables, draw=partial(draw, v, gaps))
