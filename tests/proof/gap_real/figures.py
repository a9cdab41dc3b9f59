"""Figures of the flights of others."""

from __future__ import annotations

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from inclined_landing.eval.base.style import (
    BLUE,
    GREEN,
    INK,
    MUTED,
    ORANGE,
    PURPLE,
    legend_below,
    literal,
    styled,
)
from inclined_landing.models.effects import LIBRARY
from tests.proof.gap_real.halves import Fleet, Stability
from tests.proof.gap_real.pads import NORMAL
from tests.proof.gap_real.thrust import REFERENCE_PWM, REFERENCE_VOLTAGE, Law

_VOLTS = 0.05  # V, width of the bins of the battery's voltage
STEPS = (PURPLE, BLUE, "#56b4e9", "#8a8f98", "#c9b458", MUTED, "#7a5c3e")


def fleet(s: Fleet) -> Figure:
    """Error against horizon as effects are added, and every parameter of both halves."""
    with styled():
        figure = Figure(figsize=(9.6, 4.6), layout="constrained")
        left, right = figure.subplots(1, 2, width_ratios=(1.0, 1.15))
        draw_horizon(left, s)
        draw_stability(right, s.stability)
    return figure


def draw_horizon(axes, s: Fleet) -> None:
    curves = s.diagnosis.horizon
    last = len(curves) - 1
    for k, curve in enumerate(curves):
        colour = ORANGE if k == 0 else GREEN if k == last else STEPS[(k - 1) % len(STEPS)]
        text = "model as it was" if k == 0 else curve.label.replace("_", " ")
        axes.plot(curve.horizon, 100.0 * curve.error, color=colour, label=text)
    axes.plot(curves[-1].horizon, 100.0 * curves[-1].floor, color=INK, ls=":", label="noise alone")
    axes.set(yscale="log", xlabel="time predicted ahead [s]", ylabel="position error [cm]", xlim=(0, None))
    axes.set_title(f"{literal(s.title.replace('_', ' '))}: error on flights left out of the fit", loc="left")
    axes.grid(axis="y")
    legend_below(axes)


def draw_stability(axes, rows: list[Stability]) -> None:
    """Distances from neutral in units of the effect's largest, fitted to all flights (grey line)."""
    rows = [row for row in rows if not LIBRARY[row.effect].parameter(row.parameter).is_reference]
    sizes: dict[str, float] = {}
    for row in rows:
        sizes[row.effect] = max(sizes.get(row.effect, 0.0), abs(row.all[0] - row.neutral))
    for k, row in enumerate(rows):
        size = sizes[row.effect]
        axes.plot([(row.all[0] - row.neutral) / size] * 2, [k - 0.3, k + 0.3], color=MUTED, lw=1.0)
        for value, offset, colour in ((row.first, -0.15, BLUE), (row.second, 0.15, ORANGE)):
            axes.errorbar(
                (value[0] - row.neutral) / size,
                k + offset,
                xerr=value[1] / size,
                fmt="o",
                ms=4,
                color=colour,
                capsize=2,
                lw=1.4,
            )
    axes.axvline(0.0, color=INK, lw=0.8)
    axes.set_yticks(range(len(rows)), [_name(r) for r in rows], fontsize=8)
    axes.set(ylim=(len(rows) - 0.5, -0.5), xlim=(-2.0, 2.0))
    axes.set_xlabel("distance from no effect (1: the effect's largest value, fitted to all flights)")
    axes.plot([], [], color=MUTED, lw=1.0, label="fitted to all (the number at the left)")
    axes.plot([], [], "o-", color=BLUE, ms=4, lw=1.4, label="first halves, 95 % interval")
    axes.plot([], [], "o-", color=ORANGE, ms=4, lw=1.4, label="second halves, 95 % interval")
    legend_below(axes)
    axes.set_title("The same effects, fitted to halves of the flights", loc="left")


def _name(row: Stability) -> str:
    name = row.effect.replace("_", " ")
    if len(LIBRARY[row.effect].parameters) > 1:
        name += f" {row.parameter}"
    unit = "" if row.unit == "1" else f" {row.unit}"
    return f"{name} {row.all[0]:.3g}{unit}"


def thrust(result: Law) -> Figure:
    """Thrust against battery voltage and against height."""
    level, power = result.level[0], result.voltage[0]
    table = result.samples
    corrected = table.thrust / (table.pwm / REFERENCE_PWM) ** result.pwm[0]
    with styled():
        figure = Figure(figsize=(9.6, 3.9), layout="constrained")
        left, right = figure.subplots(1, 2)
        for _, own in table.assign(corrected=corrected).groupby("flight"):
            bins = own.groupby(pd.cut(own.voltage, np.arange(2.8, 4.3, _VOLTS)), observed=True)
            mean = bins[["voltage", "corrected"]].mean()[bins.size() > 50]
            left.plot(mean.voltage, mean.corrected, "o-", color=BLUE, ms=3, lw=0.8, alpha=0.7)
        left.plot([], [], "o-", color=BLUE, ms=3, lw=0.8, label=f"one flight, means over {_VOLTS:g} V")
        v = np.linspace(table.voltage.quantile(0.001), table.voltage.quantile(0.999), 50)
        law = f"fit to all: voltage to the power of {power:.2f}"
        left.plot(v, level * (v / REFERENCE_VOLTAGE) ** power, color=ORANGE, lw=2.4, label=law)
        reference = f"no voltage dependence (the fit at {REFERENCE_VOLTAGE:g} V)"
        left.axhline(level, color=INK, ls=":", lw=1.0, label=reference)
        left.set_xlabel("battery voltage [V]")
        left.set_ylabel(f"thrust over mass at {REFERENCE_PWM:,.0f} PWM [m/s²]".replace(",", " "))
        left.set_title("NanoBench: thrust over the battery's voltage", loc="left")
        near = result.near
        middle = 50.0 * (near.above + near.below)
        wide = 50.0 * (near.below - near.above)
        look = {"fmt": "o", "color": GREEN, "capsize": 2, "ms": 4}
        seen = "mean over the heights of the bar, 95 % interval"
        right.errorbar(middle, near.ratio, yerr=near.half, xerr=wide, label=seen, **look)
        right.axhline(1.0, color=INK, ls=":", lw=1.0, label="far from the floor")
        right.set(
            xlabel="height above standing on the floor [cm]", ylabel="thrust over that in free flight [1]"
        )
        right.set_title("NanoBench: thrust near the floor", loc="left")
        for axes in (left, right):
            axes.grid(axis="y")
            legend_below(axes, ncols=1)
    return figure


def pads(table: pd.DataFrame) -> Figure:
    """Return the change of the motor commands after known hardware changes."""
    y = np.arange(len(table))
    with styled():
        figure = Figure(figsize=(9.6, 4.6), layout="constrained")
        left, right = figure.subplots(1, 2, sharey=True)
        for axes, quantity, title in (
            (left, "total", "PWM of all four motors, change [%]"),
            (right, "M3", "PWM of motor M3 alone, change [%]"),
        ):
            seen = table[quantity].abs() > table[f"{quantity}_half"]
            for which, colour, mark, words in (
                (seen, GREEN, "o", "95 % interval excludes 0"),
                (~seen, MUTED, "s", "95 % interval includes 0"),
            ):
                error = table[f"{quantity}_half"][which]
                look = {"ls": "", "marker": mark, "color": colour, "capsize": 2, "ms": 4, "lw": 1.6}
                axes.errorbar(table[quantity][which], y[which], xerr=error, label=words, **look)
            axes.axvline(0.0, color=INK, lw=0.8)
            axes.grid(axis="x")
            axes.set_xlabel(title)
        names = [f"{v}: {c.replace('_', ' ')}" for v, c in zip(table.vehicle, table.condition)]
        left.set_yticks(y, names)
        left.set_ylim(len(table) - 0.5, -0.5)
        figure.legend(*left.get_legend_handles_labels(), loc="outside lower center", ncols=2)
        figure.suptitle(
            "CrazyPAD: motor commands in hover after a known change of the hardware, relative to\n"
            f"the {NORMAL.replace('_', ' ')} of the same vehicle (E8, E9: vehicles; M1 to M4: motors; "
            "W1: a weight, W3: a heavier one)",
            size=10, x=0.01, ha="left",
        )  # fmt: skip
    return figure
