"""The stroboscopic figure of a flight: the path above, PWM and pitch commands below."""

from __future__ import annotations

import numpy as np
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle
from matplotlib.transforms import ScaledTranslation

from inclined_landing.envs.flights import Flight
from inclined_landing.envs.rendering.sprite import SpriteRenderer
from inclined_landing.eval.base.colours import BLUE, GREEN, MUTED, ORANGE, PURPLE
from inclined_landing.eval.base.style import panel, styled, time_colours
from inclined_landing.eval.pictures.figures.scene import (
    GOAL_COLOUR,
    draw_background,
    draw_platform,
    draw_vehicle,
)
from inclined_landing.eval.pictures.path import path_share, select_copies
from inclined_landing.models.attitude import PITCH, PITCH_COMMAND, PWM, ROLL, ROLL_COMMAND, YAW, Z
from inclined_landing.models.base.errors import UserError
from inclined_landing.models.vehicle import Vehicle

_WIDTH, _LEFT, _RIGHT = 7.0, 0.78, 0.16  # in
_SCENE, _PWM, _PITCH = 3.05, 0.80, 1.20  # heights of the panels, in
_SPACING = 0.18  # m; copies are at least about this apart
_TURN = 0.12  # m; how much path a turn of one radian counts when copies are spread
_SLOPE = ((-0.45, 1.15), (0.45, 1.35))  # m; is always shown of the platform
_MARGIN = 0.27  # m around the flight
_LOWEST = 0.85  # m; the scene is cut off here unless the flight goes lower


def trajectory_figure(flight: Flight) -> Figure:
    """Return a figure of one flight: copies of the vehicle along its path, PWM and attitude over time.

    Raises UserError for a flight with fewer than two samples or states that are not finite, and for one over
    a moving platform.
    """
    if len(flight.t) < 2 or not np.isfinite(flight.state).all():
        raise UserError("a trajectory figure needs a flight of at least two samples with finite states")
    if flight.motion is not None:
        raise UserError("a trajectory figure cannot show a moving platform; use landing-eval picture")
    vehicle, landing = flight.task.vehicle, flight.inclination is not None
    chosen = select_copies(flight.state, 11 if landing else 8, _SPACING, _TURN)
    gap, foot = 0.33, 0.50
    middle = foot + _PITCH + gap
    scene = middle + _PWM + 0.74
    with styled():
        figure = Figure(figsize=(_WIDTH, scene + _SCENE + 0.14))
        width = _WIDTH - _LEFT - _RIGHT
        if landing:
            axes = panel(figure, _LEFT, scene, width, _SCENE)
            _draw_scene(axes, flight, chosen, SpriteRenderer(vehicle), width / _SCENE)
        else:
            half = 0.5 * (width - 0.25)
            side = panel(figure, _LEFT, scene, half, _SCENE)
            front = panel(figure, _LEFT + half + 0.25, scene, half, _SCENE, sharey=side)
            for across, axes in enumerate((side, front)):
                _draw_scene(axes, flight, chosen, SpriteRenderer(vehicle, across=across), half / _SCENE)
            front.tick_params(labelleft=False)
            front.set_ylabel("")
        pitch = panel(figure, _LEFT, foot, width, _PITCH)
        pwm = panel(figure, _LEFT, middle, width, _PWM, sharex=pitch)
        _draw_commands(pwm, pitch, flight, chosen, vehicle)
    return figure


def _draw_scene(axes, flight: Flight, chosen, sprites: SpriteRenderer, ratio: float) -> None:
    """Draw the flight in the view of the sprites: x or y to the right, z up."""
    state, landing, plane = flight.state, flight.inclination is not None, [sprites.across, Z]
    target, d = flight.task.goal_state, flight.task.goal_size
    points, widest = state[:, plane], state[:, :2]
    if target is not None:
        points, widest = np.vstack([points, target[plane]]), np.vstack([widest, target[:2]])
    if landing:
        window = _window(np.vstack([points, _SLOPE]), ratio, floor=_LOWEST)
    else:  # both views get the same scale
        window = _window(points, ratio, least=(np.ptp(widest, axis=0).max() + 2.0 * _MARGIN) / ratio)
    draw_background(axes, *window, name="xy"[sprites.across])
    _align_label(axes)
    if flight.inclination is not None:
        draw_platform(axes, flight.inclination, sprites.vehicle)
    colours = time_colours(path_share(state, _TURN))
    segments = np.stack([state[:-1][:, plane], state[1:][:, plane]], axis=1)
    axes.add_collection(
        LineCollection(segments, colors=colours[:-1], lw=1.6, capstyle="round", zorder=3, gid="way"),
        autolim=False,
    )
    if target is not None:
        draw_vehicle(axes, sprites, target, colour=GOAL_COLOUR, alpha=0.75, zorder=2.5, gid="target")
    if target is not None and d is not None:
        box = Rectangle(target[plane] - d, 2 * d, 2 * d, fill=False, gid="goal box")
        box.set(edgecolor=GREEN, linewidth=1.0, linestyle=(0, (3, 2)), zorder=2.6)
        axes.add_patch(box)
    sprites.prepare([(state[k, ROLL : YAW + 1], colours[k]) for k in chosen])
    for order, k in enumerate(chosen):
        above = 4.0 + 0.01 * order
        draw_vehicle(axes, sprites, state[k], colour=colours[k], alpha=0.92, zorder=above, gid=f"copy {k}")
    if sprites.across:
        return
    note = f"quadrotor drawn at {sprites.scale:g}× size"
    note += "; green: target pose" if target is not None else ""
    note += f" and goal box (±{100 * d:.0f} cm)" if target is not None and d is not None else ""
    note += "\ncolours: time, as below"
    axes.text(0.012, 0.975, note, transform=axes.transAxes, va="top", size=8.5, color=MUTED)


def _window(
    points: np.ndarray, ratio: float, *, floor: float | None = None, least: float = 0.0
) -> tuple[tuple[float, float], tuple[float, float]]:
    """Return limits of x (or y) and z [m] that show points (k, 2) in a box of width = ratio * height.

    floor: the lower limit, unless points are lower; without it, the points are centred. least: the smallest
    height.
    """
    low, high = points.min(axis=0) - _MARGIN, points.max(axis=0) + _MARGIN
    if floor is not None:
        low[1] = min(low[1], floor)
    height = max(high[1] - low[1], (high[0] - low[0]) / ratio, least)
    bottom = low[1] if floor is not None else 0.5 * (low[1] + high[1] - height)
    bottom = max(bottom, -0.02)  # the floor
    left = 0.5 * (low[0] + high[0] - ratio * height)
    return (left, left + ratio * height), (bottom, bottom + height)


def _align_label(axes) -> None:
    """Align the vertical axis' label with those of the other panels."""
    inches = axes.get_position().width * axes.figure.get_figwidth()
    axes.yaxis.set_label_coords(-0.48 / inches, 0.5)


def _draw_commands(pwm, pitch, flight: Flight, chosen, vehicle: Vehicle) -> None:
    t, end = flight.t, float(flight.t[-1])
    stepped = {"drawstyle": "steps-post"}
    pwm.plot(t, 1e-3 * flight.commands[:, PWM], color=BLUE, label="PWM command", **stepped)
    pwm.axhline(1e-3 * vehicle.hover_pwm, color=MUTED, lw=1.0, ls=":", label="hover")
    pwm.set(ylabel="PWM [10³]", ylim=(5, 65), yticks=[10, 30, 50])
    pwm.tick_params(labelbottom=False)
    drawn = [("pitch", PITCH, PITCH_COMMAND, ORANGE)]
    if flight.inclination is None:
        drawn.append(("roll", ROLL, ROLL_COMMAND, PURPLE))
    for name, angle, command, colour in drawn:
        degrees, commanded = np.degrees(flight.state[:, angle]), np.degrees(flight.commands[:, command])
        pitch.plot(t, degrees, color=colour, label=name)
        pitch.plot(t, commanded, color=colour, lw=1.2, ls=(0, (4, 1.5)), label=f"{name} command", **stepped)
    if flight.inclination is not None:
        pitch.axhline(np.degrees(flight.inclination), color=MUTED, lw=1.2, ls=":", label="inclination")
    pitch.set_ylabel("pitch [deg]" if len(drawn) == 1 else "attitude [deg]")
    turned = np.degrees(flight.state[:, [angle for _, angle, *_ in drawn]])
    reach = max(36.0, 1.08 * np.abs(turned).max())
    pitch.set(xlabel="time [s]", ylim=(-reach - 16, reach), yticks=[-30, 0, 30])
    pitch.set_xlim(-0.012 * end, 1.012 * end)
    colours = time_colours(path_share(flight.state, _TURN)[chosen])
    for axes in (pwm, pitch):
        axes.grid(True, axis="y")
        axes.vlines(t[chosen], *axes.get_ylim(), color=colours, lw=0.6, alpha=0.35, zorder=1)
        axes.legend(
            loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=4, borderpad=0.25, borderaxespad=0,
            handlelength=1.9, columnspacing=1.6,
        )  # fmt: skip
        _align_label(axes)
    foot = pitch.get_xaxis_transform()
    marks = pitch.vlines(t[chosen], 0.0, 0.12, color=colours, lw=3.2, transform=foot, zorder=3)
    marks.set_gid("copies")
    above = pwm.transAxes + ScaledTranslation(0, 0.045, pwm.figure.dpi_scale_trans)
    outcome, colour = flight.task.flight_words(flight), GREEN if flight.strict else ORANGE
    pwm.text(1.0, 1.0, outcome, ha="right", va="bottom", transform=above, size=8.5, color=colour)
