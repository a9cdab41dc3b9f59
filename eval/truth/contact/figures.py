"""Figures of contact measurements; `DRAW[key](data)` takes the data of a section."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes

from inclined_landing.eval.base.style import BLUE, GREEN, INK, MUTED, ORANGE, PURPLE, legend_below
from inclined_landing.eval.truth.report import panels

_COLOURS = (BLUE, ORANGE, GREEN, PURPLE, INK)
_DASHED: dict[str, Any] = {"color": MUTED, "lw": 1.2, "ls": (0, (5, 2))}


def _curves(axes: Axes, x: Sequence[float], curves: Mapping[str, Sequence[float]], **labels: Any) -> None:
    """Draw curves by name over x; labels: labels and limits of the axes."""
    for (name, values), colour in zip(curves.items(), _COLOURS):
        axes.plot(x, values, "o-", color=colour, ms=3.5, lw=1.2, label=name)
    axes.set(**labels)


@panels(2, 3.8)
def rest(data: dict, force: Axes, creep: Axes) -> None:
    """Draw forces at rest over inclination, and creep over restitution."""
    slope, weight = np.radians(data["degrees"]), data["expected"][0, 0]
    _curves(force, data["degrees"], {name: data[name] for name in ("normal", "tangential")},
            xlabel="inclination [deg]", ylabel="force at rest [N]", ylim=(-0.01, 1.15 * weight))  # fmt: skip
    force.plot(data["degrees"], weight * np.cos(slope), **_DASHED, label="m g cos, m g sin")
    force.plot(data["degrees"], weight * np.sin(slope), **_DASHED)
    _curves(creep, data["restitution"], {"measured": 1e3 * data["creep_of_restitution"]},
            xlabel="restitution setting", ylabel="creep, default slope [mm/s]", yscale="log")  # fmt: skip
    creep.axhline(0.2, **_DASHED, label="required: below 0.2 mm/s")
    for axes in (force, creep):
        legend_below(axes, ncols=3)


@panels(1, 5.0)
def slip(data: dict, axes: Axes) -> None:
    """Draw acceleration around the friction angle."""
    curves = {f"friction {mu:g}": values for mu, values in zip(data["friction"], data["acceleration"])}
    _curves(axes, data["around"], curves,
            xlabel="inclination - atan(friction) [deg]", ylabel="acceleration [m/s²]")  # fmt: skip
    legend_below(axes, ncols=3)


@panels(2, 3.8)
def restitution(data: dict, times: Axes, speeds: Axes) -> None:
    """Draw measured over set restitution, by contact time and by drop speed."""
    by_time = zip(data["contact_time"], data["measured at 1 m/s"])
    by_speed = {f"{speed:g} m/s": data[f"measured at {speed:g} m/s"][-1] for speed in data["speeds"]}
    _curves(times, data["set"], {f"{1e3 * t:g} ms": values for t, values in by_time})
    _curves(speeds, data["set"], by_speed)
    times.set_title("drops at 1 m/s, by contact time", loc="left")
    speeds.set_title("contact time 20 ms, by drop speed", loc="left")
    for axes in (times, speeds):
        axes.plot([0, 0.6], [0, 0.6], **_DASHED, zorder=1, label="setting")
        axes.set(xlabel="restitution setting", ylabel="measured restitution")
        legend_below(axes, ncols=4)


DRAW = {draw.__name__: draw for draw in (rest, slip, restitution)}
