"""Figures of contact measurements; each takes the data of one `Finding` of eval/truth/contact_truth."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from inclined_landing.eval.base.style import BLUE, GREEN, INK, MUTED, ORANGE, PURPLE, styled

_COLOURS = (BLUE, ORANGE, GREEN, PURPLE, INK)


def _panels(count: int, width: float = 3.5, height: float = 2.7):
    figure = Figure(figsize=(width * count, height), layout="constrained")
    axes = figure.subplots(1, count, squeeze=False)[0]
    for a in axes:
        a.grid(True)
    return figure, axes


def rest(data: dict) -> Figure:
    """Forces over the inclination, creep over inclination and restitution."""
    with styled():
        figure, (force, creep, springy) = _panels(3)
        fine = np.radians(np.linspace(0, 50, 101))
        weight = data["expected"][0, 0]
        for name, values, curve, colour in (
            ("normal", data["normal"], np.cos(fine), BLUE),
            ("tangential", data["tangential"], np.sin(fine), ORANGE),
        ):
            force.plot(np.degrees(fine), weight * curve, color=colour, lw=1.2)
            force.plot(data["degrees"], values, "o", color=colour, ms=4.5, label=name)
        force.set(xlabel="inclination [deg]", ylabel="force at rest [N]", ylim=(-0.01, 1.15 * weight))
        force.legend(loc="lower left", bbox_to_anchor=(0.0, 0.3))
        creep.plot(data["degrees"], 1e3 * data["creep"], "o-", color=BLUE, ms=4)
        creep.axhline(0.2, color=MUTED, lw=1.2, ls=(0, (5, 2)))
        creep.annotate("asked for: 0.2 mm/s", (1, 0.2), xytext=(0, 3), textcoords="offset points", size=8.5)
        creep.set(xlabel="inclination [deg]", ylabel="creep [mm/s]", ylim=(0, 0.25))
        springy.plot(data["restitution"], 1e3 * data["creep_of_restitution"], "o-", color=PURPLE, ms=4)
        springy.axhline(0.2, color=MUTED, lw=1.2, ls=(0, (5, 2)))
        springy.set(xlabel="restitution set", ylabel="creep on the default slope [mm/s]", yscale="log")
    return figure


def slip(data: dict) -> Figure:
    """Acceleration around the angle of friction, and the angle of onset over friction."""
    with styled():
        figure, (gain, onset) = _panels(2, 3.8)
        for mu, values, colour in zip(data["friction"], data["acceleration"], _COLOURS):
            gain.plot(data["around"], values, "o-", color=colour, ms=3, lw=1.2, label=f"friction {mu:g}")
        gain.set(xlabel="inclination - atan(friction) [deg]", ylabel="acceleration [m/s²]")
        gain.legend()
        fine = np.linspace(0.1, 1.1, 50)
        onset.plot(fine, np.degrees(np.arctan(fine)), color=MUTED, lw=1.2, label="atan(friction)")
        onset.plot(data["friction"], data["onset"], "o", color=BLUE, ms=5, label="measured onset")
        onset.set(xlabel="friction", ylabel="onset of sliding [deg]")
        onset.legend()
    return figure


def restitution(data: dict) -> Figure:
    """Measured against set restitution: by contact time, and by drop speed."""
    with styled():
        figure, (times, speeds, pushed) = _panels(3)
        wanted, middle = np.array(data["set"]), -1
        for t, values, scatter, colour in zip(
            data["contact_time"], data["measured at 1 m/s"], data["scatter"], _COLOURS
        ):
            times.errorbar(
                wanted, values, scatter, color=colour, marker="o", ms=3.5, lw=1.2, label=f"{1e3 * t:g} ms"
            )
        times.legend(title="drops at 1 m/s", title_fontsize=8.5)
        for speed, colour in zip(data["speeds"], _COLOURS):
            values = data[f"measured at {speed:g} m/s"][middle]
            speeds.plot(wanted, values, "o-", color=colour, ms=3.5, lw=1.2, label=f"{speed:g} m/s")
        speeds.legend(title="contact time 20 ms", title_fontsize=8.5)
        for axes in (times, speeds):
            axes.plot([0, 0.6], [0, 0.6], color=MUTED, lw=1, ls=(0, (5, 2)), zorder=1)
            axes.set(
                xlabel="restitution set",
                ylabel="restitution measured",
                xlim=(-0.02, 0.64),
                ylim=(-0.03, 0.68),
            )
        for t, values, colour in zip(data["contact_time"], data["pushed"], _COLOURS):
            pushed.axhline(1e3 * t, color=colour, lw=1, ls=(0, (5, 2)))
            pushed.plot(wanted, 1e3 * values, "o", color=colour, ms=4)
        pushed.set(xlabel="restitution set", ylabel="contact time measured [ms]", ylim=(0, 24))
    return figure


def impulse(data: dict) -> Figure:
    """Error of the impulse summed from sampled forces, over the step."""
    with styled():
        figure, (axes, peaks) = _panels(2, 3.8)
        for setting, label, colour in (("default", "default", BLUE), ("0.6", "restitution 0.6", ORANGE)):
            rows = [row for row in data["rows"] if row["setting"] == setting]
            steps = [1e3 * row["step"] for row in rows]
            axes.plot(
                steps, [100 * row["worst"] for row in rows], "o-", color=colour, ms=4, label=f"{label}, worst"
            )
            axes.plot(
                steps,
                [100 * max(abs(row["mean"]), 1e-4) for row in rows],
                "o--",
                color=colour,
                ms=4,
                lw=1.1,
                mfc="white",
                label=f"{label}, mean",
            )
            peaks.plot(steps, [row["peak"] for row in rows], "o-", color=colour, ms=4, label=label)
        axes.axhline(2, color=MUTED, lw=1.2, ls=(0, (5, 2)))
        axes.annotate("2 %", (0.5, 2), xytext=(0, 2), textcoords="offset points", size=8.5)
        axes.set(
            xlabel="step [ms]", ylabel="error of the impulse [%]", xscale="log", yscale="log", ylim=(0.01, 40)
        )
        axes.legend(fontsize=7.5, ncols=2, loc="lower center", bbox_to_anchor=(0.5, 1.0))
        peaks.set(xlabel="step [ms]", ylabel="largest logged force, mean [N]", xscale="log", ylim=(0, 8))
        peaks.legend()
        for a in (axes, peaks):
            a.set_xticks([0.5, 1, 2, 4], ["0.5", "1", "2", "4"])
            a.minorticks_off()
    return figure


def penetration(data: dict) -> Figure:
    """Deepest penetration over speed."""
    with styled():
        figure, (axes,) = _panels(1, 6.2)
        axes.plot(data["speeds"], 1e3 * data["default"], "o-", color=INK, ms=4, label="default")
        for t, values, colour in zip(data["contact_time"], data["depth"].T, _COLOURS):
            axes.plot(
                data["speeds"],
                1e3 * values,
                "o-",
                color=colour,
                ms=4,
                lw=1.2,
                label=f"contact time {1e3 * t:g} ms",
            )
        axes.plot([1.0], [5.0], "x", color=MUTED, ms=7, mew=1.8, label="asked for: below 5 mm at 1 m/s")
        axes.axhline(10, color=MUTED, lw=1.2, ls=(0, (5, 2)))
        axes.annotate("middle of the slab", (0.2, 10), xytext=(0, 3), textcoords="offset points", size=8.5)
        axes.set(
            xlabel="normal speed [m/s]", ylabel="deepest penetration [mm]", xlim=(0.15, 2.1), ylim=(0, 12)
        )
        axes.legend(loc="center left", bbox_to_anchor=(1.02, 0.5))
    return figure


def convergence(data: dict) -> Figure:
    """Scatter of rebounds and error of the depth over the step."""
    with styled():
        figure, (scatter, depth) = _panels(2, 3.8)
        steps = 1e3 * np.array(data["steps"])
        for k, (name, colour) in enumerate((("restitution 0.3", BLUE), ("restitution 0.6", ORANGE))):
            scatter.plot(steps, data["scatter"][:, k], "o-", color=colour, ms=4, label=name)
        scatter.plot(
            steps,
            data["scatter"][0, 0] * steps / steps[0],
            color=MUTED,
            lw=1.1,
            ls=(0, (5, 2)),
            label="first order",
        )
        scatter.set(xlabel="step [ms]", ylabel="scatter of the rebound")
        error = 1e3 * np.abs(data["depth"][:-1] - data["depth"][-1])
        depth.plot(steps[:-1], error, "o-", color=BLUE, ms=4, label="against 0.25 ms")
        depth.plot(
            steps[:-1],
            error[0] * steps[:-1] / steps[0],
            color=MUTED,
            lw=1.1,
            ls=(0, (5, 2)),
            label="first order",
        )
        depth.set(xlabel="step [ms]", ylabel="error of the penetration [mm]")
        for axes in (scatter, depth):
            axes.set(xscale="log", yscale="log")
            axes.set_xticks([0.25, 0.5, 1, 2, 4], ["0.25", "0.5", "1", "2", "4"])
            axes.minorticks_off()
            axes.legend()
    return figure


def tumbling(data: dict) -> Figure:
    """Energy of drops over time, and the share of drops that gain energy."""
    with styled():
        figure, (energy, share) = _panels(2, 3.8)
        history = 1e3 * data["history"]
        time = 0.02 * np.arange(len(history))
        energy.plot(time, history, color=BLUE, lw=0.6, alpha=0.5)
        energy.set(xlabel="time [s]", ylabel="energy [mJ]", title="default contact, 1 m/s")
        for setting, values, colour in zip(data["settings"], data["share"], _COLOURS):
            label = setting if setting == "default" else f"restitution {setting:g}"
            share.plot(data["speeds"], 100 * values, "o-", color=colour, ms=4, label=label)
        share.set(xlabel="speed [m/s]", ylabel="drops that gain over 1 % [%]", ylim=(-1, None))
        share.legend()
    return figure


def torque(data: dict) -> Figure:
    """Pitch after half a second over the thrust, for both torque limits."""
    with styled():
        figure, (axes,) = _panels(1, 6.2)
        for row, colour in zip(data["rows"], _COLOURS):
            axes.plot(
                data["share"], row["pitch"], "o-", color=colour, ms=3, lw=1.2,
                label=f"torque up to {1e3 * row['limit']:g} mN m",
            )  # fmt: skip
            axes.axvline(row["predicted"], color=colour, lw=1.2, ls=(0, (5, 2)))
        axes.plot([], [], color=MUTED, lw=1.2, ls=(0, (5, 2)), label="statics")
        axes.set(xlabel="thrust over weight", ylabel="pitch after 0.5 s [deg]")
        axes.legend(loc="center left", bbox_to_anchor=(1.02, 0.5))
    return figure


def touchdowns(data: dict) -> Figure:
    """Measured and simulated heights of every touchdown, in millimetres above the touch."""
    fits = data["fits"]
    columns = 4
    rows = -(-len(fits) // columns)
    with styled():
        figure = Figure(figsize=(2.6 * columns, 0.3 + 2.0 * rows), layout="constrained")
        grid = figure.subplots(rows, columns, sharex=True, sharey=True, squeeze=False)
        for axes, row in zip(grid.ravel(), fits):
            axes.grid(True)
            time = 1e3 * row["time"]
            axes.plot(time, 1e3 * row["measured"], "o", color=INK, ms=3, label="measured")
            axes.plot(time, 1e3 * row["simulated"], color=ORANGE, lw=1.5, label="simulated")
            title = row["flight"].removeprefix("nb_").replace("_", " ")
            axes.set_title(f"{title}\n{row['restitution']:.2f}, {1e3 * row['contact_time']:.0f} ms", size=8.5)
        for axes in grid.ravel()[len(fits) :]:
            axes.set_visible(False)
        for axes in grid[-1]:
            axes.set_xlabel("time after the touch [ms]")
        for axes in grid[:, 0]:
            axes.set_ylabel("height [mm]")
        grid[0, 0].legend(fontsize=7.5, loc="upper center")
    return figure


DRAW = {
    "rest": rest,
    "slip": slip,
    "restitution": restitution,
    "impulse": impulse,
    "penetration": penetration,
    "convergence": convergence,
    "tumbling": tumbling,
    "torque": torque,
    "touchdowns": touchdowns,
}
