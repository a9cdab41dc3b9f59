"""Figures of contact measurements; `DRAW[key](data)` takes the data of a section."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import LogLocator

from inclined_landing.eval.base.style import BLUE, GREEN, INK, MUTED, ORANGE, PURPLE, legend_below
from inclined_landing.eval.truth.report import panels

_COLOURS = (BLUE, ORANGE, GREEN, PURPLE, INK)
_DASHED: dict[str, Any] = {"color": MUTED, "lw": 1.2, "ls": (0, (5, 2))}


def _level(axes: Axes, value: float, text: str, x: float) -> None:
    """Draw a dashed line at a height, with text above it from x on."""
    axes.axhline(value, **_DASHED)
    axes.annotate(text, (x, value), xytext=(0, 3), textcoords="offset points", size=8.5)


def _logarithmic(axes: Axes, ticks: list[float]) -> None:
    """Set a logarithmic x axis with these ticks."""
    axes.set_xscale("log")
    axes.set_xticks(ticks, [f"{tick:g}" for tick in ticks])
    axes.minorticks_off()


@panels(3)
def rest(data: dict, force: Axes, creep: Axes, springy: Axes) -> None:
    """Draw forces at rest over inclination, and creep over inclination and restitution."""
    fine = np.linspace(0, 50, 101)
    weight = data["expected"][0, 0]
    for name, share, colour in (("normal", np.cos, BLUE), ("tangential", np.sin, ORANGE)):
        force.plot(fine, weight * share(np.radians(fine)), color=colour, lw=1.2)
        force.plot(data["degrees"], data[name], "o", color=colour, label=name)
    force.set(xlabel="inclination [deg]", ylabel="force at rest [N]", ylim=(-0.01, 1.15 * weight))
    force.plot([], [], color=MUTED, lw=1.2, label="m g cos, m g sin")
    legend_below(force, ncols=3)
    creep.plot(data["degrees"], 1e3 * data["creep"], "o-", color=BLUE)
    _level(creep, 0.2, "asked for: 0.2 mm/s", 1)
    creep.set(xlabel="inclination [deg]", ylabel="creep [mm/s]", ylim=(0, 0.25))
    springy.plot(data["restitution"], 1e3 * data["creep_of_restitution"], "o-", color=PURPLE)
    _level(springy, 0.2, "asked for: 0.2 mm/s", 0.33)
    springy.set(xlabel="restitution set", ylabel="creep on the default slope [mm/s]", yscale="log")


@panels(2, 3.8)
def slip(data: dict, gain: Axes, onset: Axes) -> None:
    """Draw acceleration around the friction angle, and the angle of sliding onset over friction."""
    for mu, values, colour in zip(data["friction"], data["acceleration"], _COLOURS):
        gain.plot(data["around"], values, "o-", color=colour, ms=3, lw=1.2, label=f"friction {mu:g}")
    gain.set(xlabel="inclination less atan(friction) [deg]", ylabel="acceleration [m/s²]")
    fine = np.linspace(0.1, 1.1, 50)
    onset.plot(fine, np.degrees(np.arctan(fine)), color=MUTED, lw=1.2, label="atan(friction)")
    onset.plot(data["friction"], data["onset"], "o", color=BLUE, label="measured onset")
    onset.set(xlabel="friction", ylabel="onset of sliding [deg]")
    legend_below(gain, ncols=3)
    legend_below(onset)


@panels(3)
def restitution(data: dict, times: Axes, speeds: Axes, pushed: Axes) -> None:
    """Draw measured over set restitution, by contact time (bars: scatter) and drop speed; contact times."""
    nominal = np.array(data["set"])
    rows = zip(data["contact_time"], data["measured at 1 m/s"], data["scatter"], data["pushed"], _COLOURS)
    for t, values, scatter, contact, colour in rows:
        times.errorbar(nominal, values, scatter, color=colour, marker="o", lw=1.2, label=f"{1e3 * t:g} ms")
        pushed.axhline(1e3 * t, **_DASHED | {"color": colour})
        pushed.plot(nominal, 1e3 * contact, "o", color=colour)
    times.set_title("drops at 1 m/s, by contact time", loc="left")
    for speed, colour in zip(data["speeds"], _COLOURS):
        values = data[f"measured at {speed:g} m/s"][-1]
        speeds.plot(nominal, values, "o-", color=colour, lw=1.2, label=f"{speed:g} m/s")
    speeds.set_title("contact time 20 ms, by drop speed", loc="left")
    for axes in (times, speeds):
        axes.plot([0, 0.6], [0, 0.6], **_DASHED, zorder=1, label="as set")
        axes.set(xlabel="restitution set", xlim=(-0.02, 0.64))
        axes.set(ylabel="restitution measured", ylim=(-0.03, 0.68))
        legend_below(axes, ncols=4)
    pushed.plot([], [], "o", color=MUTED, label="measured")
    pushed.plot([], [], **_DASHED, label="as set")
    pushed.set_title("drops at 1 m/s", loc="left")
    pushed.set(xlabel="restitution set", ylabel="contact time measured [ms]", ylim=(0, 24))
    legend_below(pushed)


@panels(2, 3.8)
def impulse(data: dict, errors: Axes, peaks: Axes) -> None:
    """Draw the error of the impulse from sampled forces over the time step, and the largest force."""
    for setting, label, colour in (("default", "default", BLUE), ("0.6", "restitution 0.6", ORANGE)):
        rows = [row for row in data["rows"] if row["setting"] == setting]
        steps = [1e3 * row["step"] for row in rows]
        worst, mean = ([100 * max(abs(row[key]), 1e-4) for row in rows] for key in ("worst", "mean"))
        errors.plot(steps, worst, "o-", color=colour, label=f"{label}, worst")
        errors.plot(steps, mean, "o--", color=colour, lw=1.1, mfc="white", label=f"{label}, mean")
        peaks.plot(steps, [row["peak"] for row in rows], "o-", color=colour, label=label)
    _level(errors, 2, "2 %", 0.5)
    errors.set(xlabel="step [ms]", ylabel="error of the impulse [%]", yscale="log", ylim=(0.01, 40))
    legend_below(errors)
    peaks.set(xlabel="step [ms]", ylabel="largest logged force, mean [N]", ylim=(0, 8))
    legend_below(peaks)
    for axes in (errors, peaks):
        _logarithmic(axes, [0.5, 1, 2, 4])


@panels(1, 6.2)
def penetration(data: dict, axes: Axes) -> None:
    """Draw the deepest penetration of the feet over the normal velocity."""
    axes.plot(data["speeds"], 1e3 * data["default"], "o-", color=INK, label="default")
    for t, values, colour in zip(data["contact_time"], data["depth"].T, _COLOURS):
        label = f"contact time {1e3 * t:g} ms"
        axes.plot(data["speeds"], 1e3 * values, "o-", color=colour, lw=1.2, label=label)
    axes.plot([1.0], [5.0], "x", color=MUTED, ms=7, mew=1.8, label="asked for: below 5 mm at 1 m/s")
    _level(axes, 10, "middle of the slab", 0.2)
    axes.set(xlabel="normal speed [m/s]", xlim=(0.15, 2.1), ylabel="deepest penetration [mm]", ylim=(0, 12))
    legend_below(axes, ncols=3)


@panels(2, 3.8)
def convergence(data: dict, scatter: Axes, depth: Axes) -> None:
    """Draw the scatter of rebounds and the error of penetration over the time step."""
    steps = 1e3 * np.array(data["steps"])
    error = 1e3 * np.abs(data["depth"][:-1] - data["depth"][-1])
    scatter.plot(steps, data["scatter"][:, 0], "o-", color=BLUE, label="restitution 0.3")
    scatter.plot(steps, data["scatter"][:, 1], "o-", color=ORANGE, label="restitution 0.6")
    scatter.plot(steps, data["scatter"][0, 0] * steps / steps[0], **_DASHED, label="first order")
    depth.plot(steps[:-1], error, "o-", color=BLUE, label="against 0.25 ms")
    depth.plot(steps[:-1], error[0] * steps[:-1] / steps[0], **_DASHED, label="first order")
    scatter.set(xlabel="step [ms]", ylabel="scatter of the rebound", yscale="log")
    depth.set(xlabel="step [ms]", ylabel="error of the penetration [mm]", yscale="log")
    for axes in (scatter, depth):
        _logarithmic(axes, [0.25, 0.5, 1, 2, 4])
        axes.yaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
        axes.yaxis.set_major_formatter("{x:g}")
        legend_below(axes, ncols=3)


@panels(2, 3.8)
def tumbling(data: dict, energy: Axes, share: Axes) -> None:
    """Draw the energy of drops over time, and the share of drops that gain energy over their speed."""
    history = 1e3 * data["history"]
    energy.plot(0.02 * np.arange(len(history)), history, color=BLUE, lw=0.6, alpha=0.5)
    energy.set(xlabel="time [s]", ylabel="energy [mJ]", title="default contact, 1 m/s, one line a drop")
    marks = zip(data["settings"], data["share"], _COLOURS, ("o", "s", "^", "D", "v"))
    for k, (setting, values, colour, mark) in enumerate(marks):
        label = setting if setting == "default" else f"restitution {setting:g}"
        size, width = 9 - 2 * k, 3.2 - 0.8 * k  # some lines lie on each other
        share.plot(data["speeds"], 100 * values, label=label, color=colour, marker=mark, ms=size, lw=width)
    share.set(xlabel="speed [m/s]", ylabel="drops that gain over 1 % [%]", ylim=(-1, None))
    legend_below(share, ncols=3)


@panels(1, 6.2)
def torque(data: dict, axes: Axes) -> None:
    """Draw pitch after half a second over thrust, for two torque limits; dashed: statics."""
    for row, colour in zip(data["rows"], _COLOURS):
        label = f"torque up to {1e3 * row['limit']:g} mN m"
        axes.plot(data["share"], row["pitch"], "o-", color=colour, ms=3, lw=1.2, label=label)
        axes.axvline(row["predicted"], **_DASHED | {"color": colour})
    axes.plot([], [], **_DASHED, label="statics")
    axes.set(xlabel="thrust over weight", ylabel="pitch after 0.5 s [deg]")
    legend_below(axes, ncols=3)


DRAW = {
    draw.__name__: draw
    for draw in (rest, slip, restitution, impulse, penetration, convergence, tumbling, torque)
}
