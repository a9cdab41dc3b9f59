"""The stroboscopic figure of a flight: the way above, PWM and pitch commands below."""

from __future__ import annotations

import numpy as np
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle
from matplotlib.transforms import ScaledTranslation

from inclined_landing.envs.rendering.stamp import StampMaker
from inclined_landing.envs.tasks.landing import GOAL_SIZE
from inclined_landing.eval.figures.scene import TARGET, draw_air, draw_platform, draw_vehicle
from inclined_landing.eval.figures.style import BLUE, GREEN, MUTED, ORANGE, panel, styled, time_colours
from inclined_landing.eval.flights import Flight
from inclined_landing.models.attitude import PITCH, PITCH_COMMAND, PWM, X, Z
from inclined_landing.models.errors import UserError
from inclined_landing.models.parameters import Vehicle, load_vehicle

_WIDTH, _LEFT, _RIGHT = 7.0, 0.78, 0.16  # in
_SCENE, _PWM, _PITCH = 3.05, 0.80, 1.20  # heights of the panels, in
_TURN = 0.12  # m; how much path a turn of one radian counts when copies are spread
_LABELS = -0.46 / (_WIDTH - _LEFT - _RIGHT)  # of the vertical axes
_MARGIN = 0.27  # m around the flight
_LOW = 0.85  # m; the scene is cut off here unless the flight goes lower


def trajectory_figure(flight: Flight, *, copies: int = 11, vehicle: Vehicle | None = None) -> Figure:
    """Figure of one flight: vehicles in time order along the way, PWM and pitch over time.

    copies: how many vehicles are drawn at most. Raises UserError for a flight of less than two samples
    or with states that are not finite.
    """
    if len(flight.t) < 2 or not np.isfinite(flight.state).all():
        raise UserError("a trajectory figure needs a flight of at least two samples with finite states")
    vehicle = vehicle or load_vehicle()
    chosen = spread_copies(flight.state, copies)
    gap, foot = 0.33, 0.50
    middle = foot + _PITCH + gap
    scene = middle + _PWM + 0.74
    with styled():
        figure = Figure(figsize=(_WIDTH, scene + _SCENE + 0.14))
        width = _WIDTH - _LEFT - _RIGHT
        _draw_scene(panel(figure, _LEFT, scene, width, _SCENE), flight, chosen, vehicle, width / _SCENE)
        pitch = panel(figure, _LEFT, foot, width, _PITCH)
        pwm = panel(figure, _LEFT, middle, width, _PWM, sharex=pitch)
        _draw_commands(pwm, pitch, flight, chosen, vehicle)
    return figure


def spread_copies(state: np.ndarray, copies: int) -> np.ndarray:
    """Samples, first and last included, evenly spread along the way of states (T, 13), turns counted."""
    step = np.linalg.norm(np.diff(state[:, :3], axis=0), axis=1) + _TURN * np.abs(np.diff(state[:, PITCH]))
    way = np.concatenate([[0.0], np.cumsum(step)])
    count = int(np.clip(way[-1] / 0.17, 1, max(copies - 1, 1)))
    samples = np.searchsorted(way, np.linspace(0.0, way[-1], count + 1) - 1e-9)
    return np.unique(np.minimum(samples, len(state) - 1))


def _draw_scene(axes, flight: Flight, chosen, vehicle: Vehicle, ratio: float) -> None:
    state, goal = flight.state, np.asarray(flight.goal, float)
    landing = flight.inclination is not None
    target = np.zeros(13)
    if len(goal) == 5:
        target[[X, Z, PITCH]] = goal[[0, 1, 4]]
    else:
        target[[0, 1, 2, 6, 7]] = goal[[0, 1, 2, 6, 7]]
    shown = np.vstack([state[:, [X, Z]], target[[X, Z]], [[-0.45, 1.15], [0.45, 1.35]] * landing])
    draw_air(axes, *_window(shown, ratio))
    axes.yaxis.set_label_coords(_LABELS, 0.5)
    if landing:
        draw_platform(axes, flight.inclination, vehicle)
    maker = StampMaker(vehicle)
    colours = time_colours(flight.t / flight.t[-1])
    way = np.stack([state[:-1][:, [X, Z]], state[1:][:, [X, Z]]], axis=1)
    axes.add_collection(
        LineCollection(way, colors=colours[:-1], lw=1.6, capstyle="round", zorder=3, gid="way"), autolim=False
    )
    draw_vehicle(axes, maker, target, colour=TARGET, alpha=0.75, zorder=2.5, gid="target")
    if landing:
        d = GOAL_SIZE
        box = Rectangle((target[X] - d, target[Z] - d), 2 * d, 2 * d, fill=False, gid="goal box")
        box.set(edgecolor=GREEN, linewidth=1.0, linestyle=(0, (3, 2)), zorder=2.6)
        axes.add_patch(box)
    for order, k in enumerate(chosen):
        above = 4.0 + 0.01 * order
        draw_vehicle(axes, maker, state[k], colour=colours[k], alpha=0.92, zorder=above, gid=f"copy {k}")
    note = "quadrotor drawn at 3× size; green: target pose"
    note += f" and goal box (±{100 * GOAL_SIZE:.0f} cm)" if landing else ""
    axes.text(0.012, 0.975, note, transform=axes.transAxes, va="top", size=8.5, color=MUTED)


def _window(points: np.ndarray, ratio: float):
    """Limits of x and z [m] that show all points (k, 2) in a box of width = ratio * height."""
    low, high = points.min(axis=0) - _MARGIN, points.max(axis=0) + _MARGIN
    low[1] = max(min(low[1], _LOW), -0.02)
    height = max(high[1] - low[1] + 0.05, (high[0] - low[0]) / ratio)
    spare = ratio * height - (high[0] - low[0])
    return (low[0] - 0.5 * spare, high[0] + 0.5 * spare), (low[1], low[1] + height)


def _draw_commands(pwm, pitch, flight: Flight, chosen, vehicle: Vehicle) -> None:
    t, end = flight.t, float(flight.t[-1])
    held = {"drawstyle": "steps-post"}
    pwm.plot(t, 1e-3 * flight.commands[:, PWM], color=BLUE, label="PWM command", **held)
    pwm.axhline(1e-3 * vehicle.hover_pwm, color=MUTED, lw=1.0, ls=":", label="hover")
    pwm.set(ylabel="PWM [10³]", ylim=(5, 65), yticks=[10, 30, 50])
    pwm.tick_params(labelbottom=False)
    degrees = np.degrees(flight.state[:, PITCH])
    command = np.degrees(flight.commands[:, PITCH_COMMAND])
    pitch.plot(t, degrees, color=ORANGE, label="pitch")
    pitch.plot(t, command, color=ORANGE, lw=1.2, ls=(0, (4, 1.5)), label="pitch command", **held)
    if flight.inclination is not None:
        pitch.axhline(np.degrees(flight.inclination), color=MUTED, lw=1.2, ls=":", label="inclination")
    reach = max(36.0, 1.08 * np.abs(degrees).max())
    pitch.set(xlabel="time [s]", ylabel="pitch [deg]", ylim=(-reach - 16, reach), yticks=[-30, 0, 30])
    pitch.set_xlim(-0.012 * end, 1.012 * end)
    colours = time_colours(t[chosen] / end)
    for axes in (pwm, pitch):
        axes.grid(True, axis="y")
        axes.vlines(t[chosen], *axes.get_ylim(), color=colours, lw=0.6, alpha=0.35, zorder=1)
        axes.legend(
            loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=3, borderpad=0.25, borderaxespad=0,
            handlelength=1.9, columnspacing=1.6,
        )  # fmt: skip
        axes.yaxis.set_label_coords(_LABELS, 0.5)
    foot = pitch.get_xaxis_transform()
    marks = pitch.vlines(t[chosen], 0.0, 0.12, color=colours, lw=3.2, transform=foot, zorder=3)
    marks.set_gid("copies")
    above = pwm.transAxes + ScaledTranslation(0, 0.045, pwm.figure.dpi_scale_trans)
    colour = GREEN if flight.strict else ORANGE
    pwm.text(1.0, 1.0, _ending(flight), ha="right", va="bottom", transform=above, size=8.5, color=colour)


def _ending(flight: Flight) -> str:
    """How the flight ended, in a few words."""
    end = float(flight.t[-1])
    if flight.inclination is None:
        return f"{'within' if flight.success else 'not within'} 5 cm of the goal at {end:.2f} s"
    arrived = f"goal box reached at {end:.2f} s" if flight.success else f"goal box not reached in {end:.2f} s"
    return arrived + (", platform touched" if flight.touched else "")
