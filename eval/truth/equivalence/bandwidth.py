"""What the rate loop costs against the paper's equations, as a function of its bandwidth."""

from __future__ import annotations

import dataclasses
import itertools

import numpy as np

from inclined_landing.eval.base.claims import Claim, Section, Table, number
from inclined_landing.eval.truth.equivalence import flying
from inclined_landing.eval.truth.equivalence.flying import angle_gap, engine, equations, position_gap
from inclined_landing.eval.truth.equivalence.sequences import Sequences
from inclined_landing.models.attitude import PITCH_COMMAND, ROLL_COMMAND, YAW_RATE_COMMAND
from inclined_landing.models.parameters import Vehicle

BANDWIDTHS = (25.0, 50.0, 100.0, 200.0, 400.0)  # 1/s
_LARGEST_BH = 0.2  # B times the engine's step; the default vehicle has 50 x 4 ms


@dataclasses.dataclass(frozen=True)
class Gap:
    """The engine's rate loop at one bandwidth, 6 s."""

    bandwidth: float
    rms: float  # m, distance to the paper's equations, root of the mean square over time and sequences
    paper: np.ndarray  # (n,) m, largest of each sequence
    angle: float  # deg, largest difference to them
    extended: float  # m, largest distance to the equations extended with the same bandwidth


def with_bandwidth(v: Vehicle, bandwidth: float) -> Vehicle:
    """The vehicle with this roll and pitch bandwidth [1/s]; the yaw's keeps its share of it."""
    share = v.attitude_yaw_bandwidth / v.attitude_bandwidth
    return dataclasses.replace(v, attitude_bandwidth=bandwidth, attitude_yaw_bandwidth=share * bandwidth)


def measure(v: Vehicle, sequences: Sequences, bandwidths=BANDWIDTHS, tick=lambda: None) -> list[Gap]:
    """The gaps over `sequences`, one per bandwidth; the engine's step follows the bandwidth."""
    commands, starts = sequences.commands, flying.start_states(len(sequences.yaw), sequences.yaw, v)
    n = len(starts)
    paper = flying.fly(equations(n, "kinematic", vehicle=v), commands, starts)
    gaps = []
    for bandwidth in bandwidths:
        vehicle = with_bandwidth(v, bandwidth)
        halvings = max(0, int(np.ceil(np.log2(bandwidth * 0.004 / _LARGEST_BH) - 1e-9)))
        flown = flying.fly(engine(n, "rate_loop", vehicle, timestep=0.004 / 2**halvings), commands, starts)
        substeps = flying.FINE * max(1, 2**halvings // 2)
        extended = flying.fly(equations(n, "rate_loop", substeps, vehicle), commands, starts)
        gaps.append(
            Gap(
                bandwidth,
                float(np.sqrt(np.mean(position_gap(flown, paper) ** 2))),
                position_gap(flown, paper).max(axis=0),
                float(angle_gap(flown, paper).max()),
                float(position_gap(flown, extended).max()),
            )
        )
        tick()
    return gaps


def late_commands(v: Vehicle, sequences: Sequences, bandwidth: float) -> tuple[float, float]:
    """Median gap [m] of the rate loop to the paper's equations, given their commands now and 1/B later.

    The delays, 1/B for the angles and 1/B_yaw for the turn, are rounded to control periods.
    """
    vehicle = with_bandwidth(v, bandwidth)
    late = sequences.commands.copy()
    for column, rate in (
        (ROLL_COMMAND, vehicle.attitude_bandwidth),
        (PITCH_COMMAND, vehicle.attitude_bandwidth),
        (YAW_RATE_COMMAND, vehicle.attitude_yaw_bandwidth),
    ):
        delay = round(1 / (rate * v.command_control_period))
        if delay:
            late[delay:, :, column] = sequences.commands[:-delay, :, column]
            late[:delay, :, column] = 0.0
    starts = flying.start_states(len(sequences.yaw), sequences.yaw, v)
    n = len(starts)
    flown = flying.fly(equations(n, "rate_loop", vehicle=vehicle), sequences.commands, starts)
    return tuple(
        float(
            np.median(
                position_gap(flown, flying.fly(equations(n, "kinematic", vehicle=v), u, starts)).max(axis=0)
            )
        )
        for u in (sequences.commands, late)
    )


def claims(v: Vehicle, gaps: list[Gap]) -> list[Claim]:
    """The gap halves when the bandwidth doubles; the extended equations are met at each bandwidth."""
    result = []
    for slow, fast in itertools.pairwise(g for g in gaps if g.bandwidth >= 50):
        margin = 1 / (with_bandwidth(v, slow.bandwidth).attitude_yaw_bandwidth * v.attitude_time_constant)
        result.append(
            Claim(
                f"gap (rms) at B = {slow.bandwidth:g} over gap at {fast.bandwidth:g} 1/s",
                slow.rms / fast.rms,
                2 + margin,
                "ratio",
                "the gap is c/B (1 + e/(B_yaw τ)) with the slowest of the fast poles, the yaw's: the ratio "
                "is 2 within |e|/(B_yaw τ), |e| ≤ 1",
                low=2 - margin,
            )
        )
    for gap in gaps:
        result.append(
            Claim(
                f"rate loop at B = {gap.bandwidth:g} "
                "1/s against the extended equations, 6 s", gap.extended, 1e-4, "m",
                "the tolerance of the flights at B h = 0.2, which the engine's step keeps here by halving",
            )
        )  # fmt: skip
    return result


def section(v: Vehicle, sequences: Sequences, everyday: Sequences, tick) -> tuple[Section, list[Gap]]:
    """The section and the gaps for its figure; `everyday` are commands as a policy gives them."""
    gaps = measure(v, sequences, tick=tick)
    daily = measure(v, everyday, (v.attitude_bandwidth,), tick=tick)[0]
    plain, late = late_commands(v, sequences, v.attitude_bandwidth)
    nominal = v.attitude_bandwidth
    delay, share = 1e3 / nominal, v.attitude_bandwidth / v.attitude_yaw_bandwidth
    rows = [
        (f"{g.bandwidth:g}", g.rms, float(np.median(g.paper)), float(g.paper.max()), g.angle, g.extended)
        for g in gaps
    ]
    part = Section(
        "bandwidth",
        "The rate loop against the paper's equations",
        [
            "The paper's attitude follows its command through one pole. A vehicle has a rate loop below "
            f"that, here with a second pole at the bandwidth B (yaw: B/{share:g}): the paper's loop with "
            f"its command low-passed at B. {len(sequences.yaw)} sequences of full steps in three "
            "dimensions, 6 s.",
        ],
        claims(v, gaps),
        [
            Table(
                "Distance between the engine's rate loop and the equations",
                (
                    "B [1/s]",
                    "paper, rms [m]",
                    "paper, median [m]",
                    "paper, largest [m]",
                    "paper, angle [deg]",
                    "extended, largest [m]",
                ),
                rows,
            )
        ],
        remarks=[
            f"What this means: with the rate loop every attitude command acts about 1/B = {delay:.0f} ms "
            f"later than in the paper's equations, one control step at the default B = {nominal:g} 1/s. "
            f"Under full steps that adds up to {number(plain)} m in 6 s (median); for {everyday.family} "
            f"commands in the plane, {number(float(np.median(daily.paper)))} m. Giving the paper's "
            f'equations their commands this much later leaves {number(late)} m. Use attitude="kinematic" '
            'to reproduce or check the paper\'s numbers, attitude="rate_loop" to train for a vehicle: it '
            "answers as late as a vehicle does, and it is the only one that feels contact. A policy for "
            "one is flown in the other below.",
        ],
        data={"median_gap_now_m": plain, "median_gap_late_commands_m": late},
    )
    return part, gaps
