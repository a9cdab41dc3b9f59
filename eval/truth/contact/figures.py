"""Figures of contact measurements; `DRAW[key](data)` takes the data of a section."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes

from inclined_landing.eval.base.colours import INK
from inclined_landing.eval.base.style import legend_below
from inclined_landing.eval.truth.figures import DASHED, curves, panels


@panels(2, 3.8)
def rest(data: dict, force: Axes, creep: Axes) -> None:
    """Draw forces at rest over inclination, and creep over restitution."""
    slope, weight = np.radians(data["degrees"]), data["expected"][0, 0]
    curves(force, data["degrees"], {name: data[name] for name in ("normal", "tangential")},
            xlabel="inclination [deg]", ylabel="force at rest [N]", ylim=(-0.01, 1.15 * weight))  # fmt: skip
    force.plot(data["degrees"], weight * np.cos(slope), **DASHED, label="m g cos, m g sin")
    force.plot(data["degrees"], weight * np.sin(slope), **DASHED)
    curves(creep, data["restitution"], {"measured": 1e3 * data["creep_of_restitution"]},
            xlabel="restitution setting", ylabel="creep, default slope [mm/s]", yscale="log")  # fmt: skip
    creep.axhline(0.2, **DASHED, label="required: below 0.2 mm/s")
    for axes in (force, creep):
        legend_below(axes, ncols=3)


@panels(1, 5.0)
def slip(data: dict, axes: Axes) -> None:
    """Draw acceleration around the friction angle."""
    by_friction = zip(data["friction"], data["acceleration"])
    curves(axes, data["around"], {f"friction {mu:g}": values for mu, values in by_friction},
            xlabel="inclination - atan(friction) [deg]", ylabel="acceleration [m/s²]")  # fmt: skip
    legend_below(axes, ncols=3)


@panels(2, 3.8)
def restitution(data: dict, times: Axes, speeds: Axes) -> None:
    """Draw measured over set restitution, by contact time and by drop speed."""
    by_time = zip(data["contact_time"], data["measured at 1 m/s"])
    by_speed = {f"{speed:g} m/s": data[f"measured at {speed:g} m/s"][-1] for speed in data["speeds"]}
    curves(times, data["set"], {f"{1e3 * t:g} ms": values for t, values in by_time})
    curves(speeds, data["set"], by_speed)
    times.set_title("drops at 1 m/s, by contact time", loc="left")
    speeds.set_title("contact time 20 ms, by drop speed", loc="left")
    for axes in (times, speeds):
        axes.plot([0, 0.6], [0, 0.6], **DASHED, zorder=1, label="setting")
        axes.set(xlabel="restitution setting", ylabel="measured restitution")
        legend_below(axes, ncols=3)


@panels(1, 5.0)
def impulse(data: dict, axes: Axes) -> None:
    """Draw the error of the impulse from sampled forces over the time step."""
    rows = {k: [row for row in data["rows"] if row["setting"] == k] for k in ("default", "0.6")}
    steps = [1e3 * row["step"] for row in rows["default"]]
    names = {"default": "default", "0.6": "restitution 0.6"}
    errors = {
        f"{names[k]}, {key}": [100 * max(abs(row[key]), 1e-4) for row in found]
        for k, found in rows.items()
        for key in ("worst", "mean")
    }
    curves(axes, steps, errors, xlabel="step [ms]", ylabel="error of the impulse [%]",
            xscale="log", yscale="log", ylim=(0.008, 40))  # fmt: skip
    axes.axhline(2, **DASHED, label="2 %")
    legend_below(axes)


@panels(1, 6.2)
def penetration(data: dict, axes: Axes) -> None:
    """Draw the deepest penetration of the feet over the normal velocity."""
    by_time = zip(data["contact_time"], data["depth"].T)
    depths = {f"contact time {1e3 * t:g} ms": 1e3 * values for t, values in by_time}
    curves(axes, data["speeds"], {"default": 1e3 * data["default"]} | depths,
            xlabel="normal speed [m/s]", ylabel="deepest penetration [mm]", ylim=(0, None))  # fmt: skip
    axes.plot([1.0], [5.0], "x", color=INK, ms=9, mew=1.8, zorder=5, label="required: below 5 mm at 1 m/s")
    legend_below(axes, ncols=3)


@panels(2, 3.8)
def convergence(data: dict, scatter: Axes, depth: Axes) -> None:
    """Draw the scatter of rebounds and the error of penetration over the time step."""
    steps = 1e3 * np.array(data["steps"])
    error = 1e3 * np.abs(data["depth"][:-1] - data["depth"][-1])
    scatters = dict(zip(("restitution 0.3", "restitution 0.6"), data["scatter"].T))
    scales = {"xlabel": "step [ms]", "xscale": "log", "yscale": "log"}
    curves(scatter, steps, scatters, ylabel="scatter of the rebound", **scales)
    curves(depth, steps[:-1], {"against 0.25 ms": error}, ylabel="error of the penetration [mm]", **scales)
    for axes, first in ((scatter, data["scatter"][0, 0]), (depth, error[0])):
        axes.plot(steps, first * steps / steps[0], **DASHED, label="first order")
        legend_below(axes, ncols=3)


@panels(1, 5.0)
def tumbling(data: dict, axes: Axes) -> None:
    """Draw the share of drops that gain energy over their speed."""
    names = [s if s == "default" else f"restitution {s:g}" for s in data["settings"]]
    most = 100 * data["share"].max()
    curves(axes, data["speeds"], dict(zip(names, 100 * data["share"])), xlabel="speed [m/s]",
           ylabel="drops that gain over 1 % [%]", ylim=(-0.05, 1.05 * max(1.0, most)))  # fmt: skip
    legend_below(axes, ncols=2)


DRAW = {
    draw.__name__: draw for draw in (rest, slip, restitution, impulse, penetration, convergence, tumbling)
}
