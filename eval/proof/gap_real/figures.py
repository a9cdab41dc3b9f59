"""Figures of the flights of others."""

from __future__ import annotations

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from inclined_landing.eval.base.style import BLUE, GREEN, INK, MUTED, ORANGE, PURPLE
from inclined_landing.eval.proof.gap_real.halves import Fleet, Stability
from inclined_landing.eval.proof.gap_real.pads import NORMAL
from inclined_landing.eval.proof.gap_real.thrust import REFERENCE_PWM, REFERENCE_VOLTAGE, Law
from inclined_landing.models.effects import LIBRARY

STEPS = (PURPLE, BLUE, "#56b4e9", "#8a8f98", "#c9b458", MUTED, "#7a5c3e")


def fleet(s: Fleet) -> Figure:
    """Error against horizon as effects are added, and every parameter of both halves."""
    figure = Figure(figsize=(9.6, 3.5), layout="constrained")
    left, right = figure.subplots(1, 2, width_ratios=(1.0, 1.15))
    draw_horizon(left, s)
    draw_stability(right, s.stability)
    return figure


def draw_horizon(axes, s: Fleet) -> None:
    curves = s.diagnosis.horizon
    last = len(curves) - 1
    for k, curve in enumerate(curves):
        colour = ORANGE if k == 0 else GREEN if k == last else STEPS[(k - 1) % len(STEPS)]
        text = "nominal" if k == 0 else curve.label.replace("_", " ")
        axes.plot(curve.horizon, 100.0 * curve.error, color=colour, label=text)
    axes.plot(curves[-1].horizon, 100.0 * curves[-1].floor, color=INK, ls=":", label="noise alone")
    axes.set(yscale="log", xlabel="seconds ahead", ylabel="position error (cm)", xlim=(0, None))
    axes.set_ylim(0.001, None)
    axes.set_title(f"{s.title.replace('_', ' ')}: error on flights left out", loc="left")
    axes.grid(axis="y")
    axes.legend(fontsize=6.5, ncols=2, loc="lower right", handlelength=1.2, columnspacing=1.0)


def draw_stability(axes, rows: list[Stability]) -> None:
    """Distances from neutral in units of the effect's largest, fitted to all flights (grey)."""
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
    axes.set(ylim=(len(rows) - 0.5, -1.1), xlim=(-2.0, 2.0))
    axes.set_xlabel("distance from neutral (1: the effect's largest, all flights)")
    axes.plot([], [], color=MUTED, lw=1.0, label="all")
    axes.plot([], [], "o", color=BLUE, ms=4, label="first halves")
    axes.plot([], [], "o", color=ORANGE, ms=4, label="second halves")
    axes.legend(fontsize=7.5, loc="upper center", ncols=3)
    axes.set_title("the same effects, fitted to halves (95 %)", loc="left")


def _name(row: Stability) -> str:
    name = row.effect.replace("_", " ")
    if len(LIBRARY[row.effect].parameters) > 1:
        name += f" {row.parameter}"
    unit = "" if row.unit == "1" else f" {row.unit}"
    return f"{name} {row.all[0]:.3g}{unit}"


def thrust(result: Law) -> Figure:
    """Thrust against battery voltage and against height."""
    figure = Figure(figsize=(9.6, 3.3), layout="constrained")
    left, right = figure.subplots(1, 2)
    level, power = result.level[0], result.voltage[0]
    table = result.samples
    corrected = table.thrust / (table.pwm / REFERENCE_PWM) ** result.pwm[0]
    for k, (_, own) in enumerate(table.assign(corrected=corrected).groupby("flight")):
        bins = own.groupby(pd.cut(own.voltage, np.arange(2.8, 4.3, 0.05)), observed=True)
        mean = bins[["voltage", "corrected"]].mean()[bins.size() > 50]
        left.plot(mean.voltage, mean.corrected, "o-", color=(BLUE, PURPLE, MUTED)[k % 3], ms=3, lw=0.8)
    v = np.linspace(table.voltage.quantile(0.001), table.voltage.quantile(0.999), 50)
    left.plot(v, level * (v / REFERENCE_VOLTAGE) ** power, color=ORANGE, label=f"V to the {power:.2f}")
    left.axhline(level, color=INK, ls=":", lw=1.0, label="no influence")
    left.set(xlabel="battery voltage (V)", ylabel="thrust/mass at 55 000 PWM (m/s²)")
    left.set_title("nanobench: thrust follows the battery", loc="left")
    left.legend()
    near = result.near
    middle = 50.0 * (near.above + near.below)
    wide = 50.0 * (near.below - near.above)
    right.errorbar(middle, near.ratio, yerr=near.half, xerr=wide, fmt="o", color=GREEN, capsize=2, ms=4)
    right.axhline(1.0, color=INK, ls=":", lw=1.0)
    right.set(xlabel="height above where it stands (cm)", ylabel="measured / free-flight thrust")
    right.set_title("nanobench: near the floor", loc="left")
    return figure


def pads(table: pd.DataFrame) -> Figure:
    """Known hardware changes: what the motors were asked for."""
    figure = Figure(figsize=(9.6, 3.6), layout="constrained")
    left, right = figure.subplots(1, 2, sharey=True)
    y = np.arange(len(table))
    for axes, quantity, title in (
        (left, "total", "all motors: change of the request (%)"),
        (right, "M3", "motor M3: change of the request (%)"),
    ):
        seen = table[quantity].abs() > table[f"{quantity}_half"]
        for which, colour in ((seen, GREEN), (~seen, MUTED)):
            axes.errorbar(
                table[quantity][which],
                y[which],
                xerr=table[f"{quantity}_half"][which],
                fmt="o",
                color=colour,
                capsize=2,
                ms=4,
            )
        axes.axvline(0.0, color=INK, lw=0.8)
        axes.set_xlabel(title)
    names = [f"{v} {c.replace('_', ' ')}" for v, c in zip(table.vehicle, table.condition)]
    left.set_yticks(y, names, fontsize=8)
    left.set_ylim(len(table) - 0.5, -0.5)
    figure.suptitle(
        f"crazypad hover against the {NORMAL.replace('_', ' ')} of the same vehicle (grey: not told apart)",
        fontsize=10,
        x=0.01,
        ha="left",
    )
    return figure
