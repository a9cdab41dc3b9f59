"""The figures of the report."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.axes import Axes

from inclined_landing.eval.base.style import BLUE, GREEN, INK, MUTED, ORANGE, PURPLE, RULE, legend_below
from inclined_landing.eval.truth.equivalence import flying
from inclined_landing.eval.truth.equivalence.bandwidth import Gap, with_bandwidth
from inclined_landing.eval.truth.equivalence.closed_loop import (
    EXTENDED,
    KINEMATIC,
    PAPER,
    VEHICLE,
    quantities,
)
from inclined_landing.eval.truth.equivalence.convergence import STEPS_MS, Convergence
from inclined_landing.eval.truth.equivalence.flying import FAMILIES
from inclined_landing.eval.truth.equivalence.inconsistencies import Drag
from inclined_landing.eval.truth.equivalence.levels import FLIGHT_LIMITS, Gaps
from inclined_landing.eval.truth.equivalence.motor import quoted
from inclined_landing.eval.truth.report import panels
from inclined_landing.models.attitude import PITCH, PITCH_COMMAND, PWM
from inclined_landing.models.plants import Attitude
from inclined_landing.models.vehicle import Vehicle

_COLOURS = dict(zip(FAMILIES, (BLUE, GREEN, ORANGE, PURPLE)))
_MODES = {"kinematic": "Kinematic – paper's equations", "rate_loop": "Rate loop – extended equations"}


def _name(axis: Axes, title: str, x: str, y: str = "", **limits) -> None:
    axis.set(title=title, xlabel=x, ylabel=y, **limits)


@panels(2, 4.6, 4.0)
def levels(vehicle: Vehicle, drawn: dict[Attitude, tuple[Gaps, Gaps]], *axes: Axes) -> None:
    """Draw the position difference over 6 s in both modes."""
    t = vehicle.command_control_period * np.arange(1, len(drawn["kinematic"][1].position) + 1)
    for axis, (attitude, (_, flight)) in zip(axes, drawn.items()):
        for k, label in enumerate(flight.labels):
            family, dimension = label.rsplit(", ", 1)
            largest = flight.position[:, flight.group == k].max(axis=1)
            style = {"ls": "-", "label": family} if dimension == "3-D" else {"ls": "--"}
            axis.semilogy(t, np.maximum(largest, 1e-13), color=_COLOURS[family], lw=1.4, **style)
        limit = FLIGHT_LIMITS[attitude][0]
        axis.axhline(limit, color=INK, lw=1, ls=":")
        axis.annotate("tolerance", (6, limit), ha="right", va="bottom", fontsize=8)
        _name(axis, _MODES[attitude], "time [s]", xlim=(0, 6), ylim=(1e-11, 1e-3))
        axis.plot([], [], color=MUTED, lw=1.4, ls="--", label="the same in 2-D")
        legend_below(axis)
    axes[0].set_ylabel("largest position difference [m]")


@panels(2, 4.6, 4.0)
def convergence(found: list[Convergence], *axes: Axes) -> None:
    """Draw the error over the step for every integrator and both modes."""
    looks = {"RK4": (BLUE, "o", "-"), "implicitfast": (ORANGE, "s", "-"), "Euler": (GREEN, "^", "--")}
    looks["equations, RK4"] = MUTED, "x", "-"
    steps = np.array(STEPS_MS)
    for axis, attitude in zip(axes, flying.ATTITUDES):
        for c in (c for c in found if c.attitude == attitude):
            look = dict(zip(("color", "marker", "ls"), looks[c.integrator]), ms=5, lw=1.4)
            axis.loglog(steps, c.errors, label=f"{c.integrator}: order {c.order:.2f}", **look)
        axis.set_xticks(steps, [f"{h:g}" for h in steps])
        axis.minorticks_off()
        _name(axis, attitude.replace("_", " ").capitalize(), "step [ms]", ylim=(3e-11, 0.3))
        legend_below(axis)
    axes[0].set_ylabel("position error after 1 s [m]")


@panels(2, 4.6, 4.0)
def bandwidth(v: Vehicle, gaps: list[Gap], left: Axes, right: Axes) -> None:
    """Draw the gap over the bandwidth, and a pitch step at some bandwidths."""
    b = np.array([g.bandwidth for g in gaps])
    for g in gaps:
        left.plot(np.full(len(g.paper), g.bandwidth), g.paper, ".", color=BLUE, alpha=0.3, ms=5)
    rms = np.array([g.rms for g in gaps])
    left.loglog(b, rms, "-o", color=BLUE, ms=5, label="paper's equations, rms (dots: each flight)")
    left.loglog(b, rms[-1] * b[-1] / b, "--", color=MUTED, lw=1, label="proportional to 1/B")
    extended = [g.extended for g in gaps]
    left.loglog(b, extended, "-s", color=ORANGE, ms=5, label="equations extended with B")
    left.axvline(v.attitude_bandwidth, color=INK, lw=1, ls=":")
    left.annotate(" default", (v.attitude_bandwidth, 2e-3), fontsize=8)
    left.set_xticks(b, [f"{x:g}" for x in b])
    left.minorticks_off()
    title = "Distance over 6 s of full steps, 3-D"
    _name(left, title, "bandwidth B [1/s]", "distance [m]", ylim=(1e-7, 3e2))
    legend_below(left, ncols=1)
    commands = np.zeros((40, 1, 4))
    commands[..., PWM] = v.hover_pwm
    commands[5:, 0, PITCH_COMMAND] = v.command_angle_limit
    t = v.command_control_period * np.arange(-4, 37)

    def pitch(plant):
        flown = flying.fly(plant, commands)[:, 0, PITCH]
        return np.degrees(np.concatenate([[0.0], flown]))

    for value, colour in zip((25.0, 50.0, 100.0), (ORANGE, PURPLE, GREEN)):
        plant = flying.engine(1, "rate_loop", with_bandwidth(v, value))
        right.plot(t, pitch(plant), color=colour, lw=1.4, label=f"MuJoCo, B = {value:g} 1/s")
    paper = pitch(flying.equations(1, "kinematic", vehicle=v))
    right.plot(t, paper, color=INK, lw=1.4, label="paper's equations")
    delay = 1 / v.attitude_bandwidth
    right.plot(t + delay, paper, color=INK, lw=1.1, ls=":", label=f"the same, {1e3 * delay:.0f} ms later")
    _name(right, "A full pitch step", "time [s]", "pitch [deg]", xlim=(-0.02, 0.5), ylim=(-1, 36))
    legend_below(right)


@panels(4, 2.3, 3.4)
def closed_loop(flown: dict, *axes: Axes) -> None:
    """Draw time to land and final state of the paper's equations and the vehicle."""
    looks = {
        PAPER: (BLUE, "-", 1.8),
        KINEMATIC: (INK, ":", 1.2),
        VEHICLE: (ORANGE, "-", 1.8),
        EXTENDED: (INK, "--", 1.0),
    }
    for name, (colour, line, width) in looks.items():
        landed = [f for f in flown[name] if f.success]
        if not landed:
            continue
        q = quantities(landed)
        share = 100 * np.arange(1, len(q) + 1) / len(q)
        look: dict[str, Any] = {"color": colour, "ls": line, "lw": width, "where": "post", "label": name}
        for axis, column in ((axes[0], 0), (axes[3], 5)):
            axis.step(np.sort(q[:, column]), share, **look)
        if name in (PAPER, VEHICLE):
            axes[1].plot(q[:, 1], q[:, 2], ".", color=colour, ms=4, alpha=0.5)
            axes[2].plot(q[:, 3], q[:, 4], ".", color=colour, ms=4, alpha=0.5)
    _name(axes[0], "Time to land", "time [s]", "share of landings [%]", ylim=(0, 100))
    _name(axes[1], "Final position", "x [m]", "z [m]")
    _name(axes[2], "Final velocity", "vx [m/s]", "vz [m/s]")
    _name(axes[3], "Final pitch", "pitch [deg]", "share of landings [%]", ylim=(0, 100))
    handles, labels = axes[0].get_legend_handles_labels()
    axes[0].figure.legend(handles, labels, loc="outside lower center", ncols=4)


@panels(2, 4.6, 3.6)
def inconsistencies(v: Vehicle, drag: Drag, left: Axes, right: Axes) -> None:
    """Draw both thrust maps with hover points, and the effect of the public code's drag."""
    pwm = np.linspace(0, v.command_pwm_range[1], 200)
    a, b, c = v.motor_pwm_to_force
    left.plot(pwm / 1e3, v.motor_count * (a * pwm**2 + b * pwm + c), color=ORANGE, label="static map")
    left.plot(pwm / 1e3, v.thrust_per_pwm * pwm, color=BLUE, label="motor function, steady")
    weight = v.body_mass * v.environment_gravity
    left.axhline(weight, color=INK, lw=1, ls=":")
    left.annotate("weight", (1, weight), va="bottom", fontsize=8)
    small: dict[str, Any] = {"textcoords": "offset points", "fontsize": 8}
    for x, colour, side, shift in (
        (v.hover_pwm, BLUE, "right", (-5, 5)),
        (v.static_hover_pwm, ORANGE, "left", (2, -12)),
    ):
        left.plot([x / 1e3], [weight], "o", color=colour, ms=5)
        left.annotate(f"{x:.0f}", (x / 1e3, weight), shift, ha=side, color=colour, **small)
    flight = quoted("hover", "flight_pwm")
    left.plot([flight / 1e3], [weight], "D", color=INK, ms=4)
    left.annotate("real flights", (flight / 1e3, weight), (4, -12), **small)
    _name(left, "Where it hovers", "PWM [10³]", "total thrust [N]", xlim=(0, 60), ylim=(0, None))
    legend_below(left)
    apart = drag.apart
    t = v.command_control_period * np.arange(1, len(apart) + 1)
    right.fill_between(t, 0, apart, color=RULE)
    right.plot(t, apart, color=BLUE)
    title = "Public code against the paper, same commands"
    _name(right, title, "time [s]", "median distance [m]", xlim=(0, t[-1]), ylim=(0, None))
