"""Manoeuvres ("pieces"): hover, turns, doublets, runs, climbs, low passes ... each smooth, from rest to rest.

A piece is a kind with a value for each of its parameters, within bounds. Pieces are joined by moves from rest
to rest; the whole is a `Path`, from which the set-points and feed-forward commands of a vehicle follow
(differential flatness).
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Mapping, Sequence

import numpy as np
import scipy  # whose submodules are imported when they are used
from scipy.ndimage import gaussian_filter1d

from inclined_landing.eval.flying.tracking import Trajectory, thrust_and_angles
from inclined_landing.eval.logs import FlightLog
from inclined_landing.models.base.errors import UserError
from inclined_landing.models.geometry import Shapes, shapes_of
from inclined_landing.models.scene import compile_scene
from inclined_landing.models.vehicle import Vehicle

RATE = 100.0  # rows per second
LEAD_IN = 1.0  # s of hover before the first piece
MARGIN = 0.3  # m, clearance of paths to walls, floor, ceiling and slab
SMOOTHING = 0.02  # s, standard deviation of the filter over steps of a command
MOVE_SPEED, MOVE_ACCELERATION, TURN_RATE = 1.2, 3.0, 1.0  # m/s, m/s2, rad/s, at most, between pieces
# Peak speed and acceleration of `_minimum_snap` over unit length in unit time.
_PEAK_SPEED, _PEAK_ACCELERATION = 35.0 / 16.0, 84.0 / (5.0 * math.sqrt(5.0))

Way = tuple[np.ndarray, np.ndarray]  # position (m, 3) [m], heading (m,) [rad] at RATE


@dataclasses.dataclass(frozen=True)
class Space:
    """Free space: the arena within margins [m], and what stands in it."""

    low: np.ndarray  # (3,)
    high: np.ndarray  # (3,)
    home: np.ndarray  # (3,) where a flight begins: beside the slab, on its larger side
    vehicle: Vehicle
    platform: bool
    shapes: Shapes  # of the vehicle

    @staticmethod
    def of(vehicle: Vehicle, platform: bool) -> Space:
        """Return the free space in the vehicle file's arena. Raises UserError when there is no room."""
        ends = np.array([vehicle.arena_x, vehicle.arena_y, vehicle.arena_z], float)
        low, high = ends[:, 0] + MARGIN, ends[:, 1] - MARGIN
        free_low, free_high = low.copy(), high.copy()
        if platform:
            edge = 0.5 * vehicle.platform_width + MARGIN
            if -edge - low[0] >= high[0] - edge:
                free_high[0] = min(high[0], -edge)
            else:
                free_low[0] = max(low[0], edge)
        if (free_high - free_low < 1.0).any():
            room = " x ".join(f"{max(0.0, x):.1f}" for x in free_high - free_low)
            raise UserError(f"the arena leaves {room} m to fly in; at least 1 m each way is needed")
        home = 0.5 * (free_low + free_high)
        home[2] = min(max(1.2, low[2] + 0.3), high[2] - 0.3)
        return Space(low, high, home, vehicle, platform, shapes_of(compile_scene(vehicle)))


@dataclasses.dataclass(frozen=True)
class Kind:
    """A kind of piece: its parameters and trajectory."""

    template: str  # {parameter} stands for its value, angles in degrees
    bounds: Mapping[str, tuple[float, float]]
    make: Callable[..., Way]  # of the space and the parameters
    near: bool = False  # goes closer to a surface than MARGIN


@dataclasses.dataclass(frozen=True)
class Piece:
    """A kind with its parameters, as shares (k,) of their bounds, 0 to 1."""

    kind: str
    shares: tuple[float, ...]

    @property
    def parameters(self) -> dict[str, float]:
        """Return the parameter values, SI units."""
        bounds = KINDS[self.kind].bounds
        return {n: a + u * (b - a) for (n, (a, b)), u in zip(bounds.items(), self.shares)}

    @property
    def near(self) -> bool:
        """Return whether the piece goes closer to a surface than MARGIN."""
        return KINDS[self.kind].near

    @property
    def height(self) -> float:
        """Return the height [m] above the surface that a piece is close to."""
        return self.parameters["height"]

    def at_height(self, share: float) -> Piece:
        """Return the piece, one close to a surface, at another share of the bounds of its height."""
        names = list(KINDS[self.kind].bounds)
        return Piece(self.kind, tuple(share if n == "height" else x for n, x in zip(names, self.shares)))

    @property
    def steady(self) -> Piece | None:
        """Return the piece with the nose at heading 0 throughout; None for a turn."""
        if self.kind == "turn":
            return None
        still = {"heading": 0.5, "nose": 0.0}  # shares of their bounds
        names = KINDS[self.kind].bounds
        return Piece(self.kind, tuple(still.get(n, x) for n, x in zip(names, self.shares)))

    @property
    def text(self) -> str:
        """Return a description of the piece as part of a sentence."""
        angles = ("heading", "direction", "angle", "tilt", "rate")
        values = self.parameters.items()
        shown = {n: f"{math.degrees(x):.0f}" if n in angles else f"{x:.2g}" for n, x in values}
        return KINDS[self.kind].template.format(**shown)

    def trajectory(self, space: Space) -> Way:
        """Return the trajectory of the piece."""
        return KINDS[self.kind].make(space, **self.parameters)


def midpoint(kind: str) -> Piece:
    """Return the piece of a kind with every parameter at the middle of its bounds."""
    return Piece(kind, (0.5,) * len(KINDS[kind].bounds))


def draw(kind: str, rng: np.random.Generator) -> Piece:
    """Return a random piece of a kind, parameters uniform within their bounds."""
    return Piece(kind, tuple(rng.random(len(KINDS[kind].bounds))))


def perturbed(piece: Piece, rng: np.random.Generator, step: float) -> Piece:
    """Return the piece with every parameter perturbed by a normal step [share of its bounds], clipped."""
    shares = np.array(piece.shares) + step * rng.standard_normal(len(piece.shares))
    return Piece(piece.kind, tuple(np.clip(shares, 0.0, 1.0)))


@dataclasses.dataclass(frozen=True)
class Span:
    """The time interval [s] of a piece in a path."""

    piece: Piece
    start: float
    stop: float


@dataclasses.dataclass(frozen=True)
class Path:
    """A reference path, sampled at RATE."""

    position: np.ndarray  # (m, 3) m
    yaw: np.ndarray  # (m,) rad, continuous
    spans: tuple[Span, ...]

    @property
    def t(self) -> np.ndarray:
        """Return the time (m,) [s] from the start."""
        return np.arange(len(self.yaw)) / RATE

    @property
    def seconds(self) -> float:
        """Return the duration."""
        return len(self.yaw) / RATE

    @property
    def near(self) -> np.ndarray:
        """Return (m,) bool: rows of pieces close to a surface."""
        result = np.zeros(len(self.yaw), bool)
        for span in self.spans:
            if span.piece.near:
                result[round(span.start * RATE) : round(span.stop * RATE)] = True
        return result


def joined_path(pieces: Sequence[Piece], space: Space, seconds: float | None = None) -> Path:
    """Return the pieces in sequence from a hover at home, extended by a hover to `seconds`."""
    ways, spans, rows = [_hold(space.home, 0.0, LEAD_IN)], [], 0
    rows = len(ways[0][1])
    for piece in pieces:
        position, yaw = piece.trajectory(space)
        before = ways[-1]
        # The equivalent heading nearest to the one before, whole turns apart.
        yaw = yaw + 2.0 * math.pi * round((before[1][-1] - yaw[0]) / (2.0 * math.pi))
        ways.append(_line(before[0][-1], position[0], before[1][-1], yaw[0]))
        rows += len(ways[-1][1])
        ways.append((position, yaw))
        spans.append(Span(piece, rows / RATE, (rows + len(yaw)) / RATE))
        rows += len(yaw)
    if seconds is not None and rows < round(seconds * RATE):
        end = ways[-1]
        ways.append(_hold(end[0][-1], end[1][-1], seconds - rows / RATE))
    position, yaw = (np.concatenate(x) for x in zip(*ways))
    return Path(position, yaw, tuple(spans))


def single_path(piece: Piece, space: Space) -> Path:
    """Return a path of one piece with a short hover before and after it."""
    position, yaw = piece.trajectory(space)
    ways = [_hold(position[0], yaw[0], 0.3), (position, yaw), _hold(position[-1], yaw[-1], 0.3)]
    position, yaw = (np.concatenate(x) for x in zip(*ways))
    return Path(position, yaw, (Span(piece, 0.0, len(yaw) / RATE),))


@dataclasses.dataclass(frozen=True)
class Setpoints(Trajectory):
    """The trajectory of a path, with the feed-forward commands that track it with the nominal vehicle."""

    path: Path

    def log(self, name: str, noise: np.ndarray) -> FlightLog:
        """Return the flight as tracked perfectly and measured with noise (6,) [m, rad]."""
        return measured_log(name, self.t, np.hstack([self.position, self.attitude]), self.command, noise)


def measured_log(
    name: str, t: np.ndarray, pose: np.ndarray, command: np.ndarray, noise: np.ndarray
) -> FlightLog:
    """Return the log of a simulated flight whose pose (m, 6) is measured with noise (6,) [m, rad], seed 0."""
    pose = pose + noise * np.random.default_rng(0).standard_normal(pose.shape)
    return FlightLog(name, t, pose[:, :3], pose[:, 3:], command, contact=np.zeros(len(t), bool))


def setpoints(path: Path, vehicle: Vehicle) -> Setpoints:
    """Return the path with the feed-forward commands of `vehicle`: lags and delays inverted, drag ignored."""
    # Thrust lag (first order):  u = PWM + dPWM/dt / rate.  Attitude loop (second order, gain k):
    #   u = [angle + 2 zeta (tau + 1/B) / 2 d(angle)/dt + tau/B d2(angle)/dt2] / k
    v, dt = vehicle, 1.0 / RATE
    velocity = np.gradient(path.position, dt, axis=0)
    acceleration = np.gradient(velocity, dt, axis=0)
    size, angles = thrust_and_angles(acceleration, path.yaw, v.environment_gravity)
    rates = np.gradient(angles, dt, axis=0)
    second_rates = np.gradient(rates, dt, axis=0)
    tau, bandwidth = v.attitude_time_constant, v.attitude_bandwidth
    lag = v.attitude_damping * (tau + 1.0 / bandwidth)
    lead = (lag * rates + tau / bandwidth * second_rates) / v.attitude_gain
    pwm = v.hover_pwm * size / v.environment_gravity
    lag_compensation = np.gradient(pwm, dt) / v.thrust_lag_rate
    angle_commands = _ahead(angles / v.attitude_gain + lead, v.effects_attitude_delay)
    turn = np.gradient(path.yaw, dt)
    turn = turn + np.gradient(turn, dt) / v.attitude_yaw_bandwidth
    limit, rate_limit = v.command_angle_limit, v.command_yaw_rate_limit
    command = np.column_stack(
        [
            np.clip(_ahead(pwm + lag_compensation, v.effects_thrust_delay), *v.command_pwm_range),
            np.clip(angle_commands, -limit, limit),
            np.clip(_ahead(turn, v.effects_attitude_delay), -rate_limit, rate_limit),
        ]
    )
    attitude = np.column_stack([angles, path.yaw])
    return Setpoints(path.t, path.position, attitude, command, velocity, acceleration, path)


def _ahead(values: np.ndarray, delay: float) -> np.ndarray:
    """Return rows (m, ...) advanced by `delay` s, the last ones held."""
    rows = round(delay * RATE)
    return values[np.minimum(np.arange(len(values)) + rows, len(values) - 1)]


def _rows(seconds: float) -> int:
    """Return the number of rows at RATE."""
    return max(1, round(seconds * RATE))


def _minimum_snap(seconds: float) -> np.ndarray:
    """Return the minimum-snap polynomial (n,) from 0 to 1, at rest at both ends."""
    # s(u) = 35 u^4 - 84 u^5 + 70 u^6 - 20 u^7
    u = (np.arange(_rows(seconds)) + 1) / _rows(seconds)
    return u**4 * (35 - 84 * u + 70 * u**2 - 20 * u**3)


def _hold(position, yaw: float, seconds: float) -> Way:
    """Return a hover."""
    n = _rows(seconds)
    return np.tile(np.asarray(position, float), (n, 1)), np.full(n, yaw)


def _line(a, b, yaw: float = 0.0, turned: float | None = None, speed: float = MOVE_SPEED) -> Way:
    """Return a straight minimum-snap move from a to b within a peak speed [m/s] and MOVE_ACCELERATION."""
    a, b = np.asarray(a, float), np.asarray(b, float)
    turned = yaw if turned is None else turned
    length, turn = float(np.linalg.norm(b - a)), abs(turned - yaw)
    slow = max(MOVE_ACCELERATION, speed**2)
    seconds = max(
        0.3 if length + turn > 1e-9 else 0.01,
        _PEAK_SPEED * length / speed,
        math.sqrt(_PEAK_ACCELERATION * length / slow),
        _PEAK_SPEED * turn / TURN_RATE,
    )
    s = _minimum_snap(seconds)
    return a + np.outer(s, b - a), yaw + s * (turned - yaw)


def _concatenated(*ways: Way) -> Way:
    """Return trajectories in sequence."""
    position, yaw = zip(*ways)
    return np.concatenate(position), np.concatenate(yaw)


def _horizontal(direction: float) -> np.ndarray:
    """Return the horizontal unit vector (3,) of a direction [rad]."""
    return np.array([math.cos(direction), math.sin(direction), 0.0])


def _doublet(seconds: float, *lags: float) -> np.ndarray:
    """Return a 1-2-1 doublet (n,) of unit size through first-order lags [s].

    An acceleration of this form leaves velocity and position unchanged.
    """
    rest = 5.0 * max(lags)
    parts = [(0.0, 0.1), (1.0, seconds), (-1.0, 2 * seconds), (1.0, seconds), (0.0, rest)]
    steps = np.concatenate([np.full(_rows(s), x) for x, s in parts])
    steps = gaussian_filter1d(steps, SMOOTHING * RATE, mode="nearest")
    for lag in lags:
        keep = math.exp(-1.0 / (lag * RATE))
        steps = scipy.signal.lfilter([1.0 - keep], [1.0, -keep], steps)
    return steps


def _integrated(start, acceleration: np.ndarray, yaw: float) -> Way:
    """Return the trajectory from rest at `start` under an acceleration (m, 3) whose integral ends at zero."""
    speed = np.cumsum(acceleration, axis=0) / RATE
    speed = speed - np.linspace(0.0, 1.0, len(speed))[:, None] * speed[-1]  # rounding of the durations
    return start + np.cumsum(speed, axis=0) / RATE, np.full(len(speed), yaw)


def _hover(space: Space, heading: float, seconds: float) -> Way:
    return _hold(space.home, heading, seconds)


def _turn(space: Space, angle: float, rate: float) -> Way:
    s = _minimum_snap(_PEAK_SPEED * angle / rate)
    return np.tile(space.home, (len(s), 1)), angle * s


def _tilts(space: Space, tilt: float, seconds: float, direction: float, heading: float) -> Way:
    v = space.vehicle
    angle = v.attitude_gain * tilt * _doublet(seconds, v.attitude_time_constant, 1.0 / v.attitude_bandwidth)
    size = v.environment_gravity * np.tan(angle)
    return _integrated(space.home, np.outer(size, _horizontal(direction)), heading)


def _thrusts(space: Space, size: float, seconds: float) -> Way:
    v = space.vehicle
    up = size * v.environment_gravity * _doublet(seconds, 1.0 / v.thrust_lag_rate)
    return _integrated(space.home, np.outer(up, [0.0, 0.0, 1.0]), 0.0)


def _climb(space: Space, height: float, speed: float) -> Way:
    low, high = space.home - [0, 0, 0.5 * height], space.home + [0, 0, 0.5 * height]
    return _concatenated(_line(low, high, speed=speed), _hold(high, 0.0, 0.2), _line(high, low, speed=speed))


def _heave(space: Space, height: float, frequency: float) -> Way:
    """Return two and a half vertical oscillations, tapered at both ends."""
    t = np.arange(_rows(2.5 / frequency)) / RATE
    fade = np.sin(np.pi * np.clip(np.minimum(t, t[-1] - t) * frequency, 0.0, 0.5)) ** 2
    z = 0.5 * height * fade * np.sin(2 * np.pi * frequency * t)
    return space.home + np.outer(z, [0.0, 0.0, 1.0]), np.zeros(len(t))


def _run(space: Space, distance: float, speed: float, direction: float, heading: float) -> Way:
    a, b = (space.home + side * 0.5 * distance * _horizontal(direction) for side in (-1, 1))
    there, back = _line(a, b, heading, speed=speed), _line(b, a, heading, speed=speed)
    return _concatenated(there, _hold(b, heading, 0.2), back)


def _circle(space: Space, radius: float, speed: float, seconds: float, nose: float) -> Way:
    """Return a circle around home from rest to rest; nose 0: constant heading, 1: tangential heading."""
    rate = np.convolve(np.ones(_rows(seconds)), np.diff(_minimum_snap(1.0), prepend=0.0))
    angle = np.cumsum(rate) / RATE * speed / radius
    around = np.stack([np.cos(angle), np.sin(angle), 0.0 * angle], axis=1)
    return space.home + radius * around, nose * angle


def _low_manoeuvre(
    above: np.ndarray, low: np.ndarray, over: np.ndarray, heading: float, seconds: float
) -> Way:
    """Return a descent from `above` to `low`, a low move to `over`, and a climb."""
    up = over + (above - low)
    return _concatenated(
        _line(above, low, heading, speed=0.5),
        _hold(low, heading, seconds),
        _line(low, over, heading, speed=0.6),
        _line(over, up, heading, speed=0.6),
    )


def _low_hover(space: Space, height: float, seconds: float, heading: float) -> Way:
    low = np.array([*space.home[:2], height])
    return _low_manoeuvre(low + [0.0, 0.0, 0.35], low, low, heading, seconds)


def _low_pass(space: Space, height: float, distance: float, direction: float) -> Way:
    low = np.array([*space.home[:2], height]) - 0.5 * distance * _horizontal(direction)
    return _low_manoeuvre(low + [0, 0, 0.35], low, low + distance * _horizontal(direction), 0.0, 0.3)


def _slope_hover(space: Space, height: float, seconds: float, heading: float) -> Way:
    v = space.vehicle
    up = np.array([math.sin(v.platform_inclination), 0.0, math.cos(v.platform_inclination)])
    low = np.array([0.0, 0.0, v.platform_surface_height]) + height * up
    return _low_manoeuvre(low + [0.0, 0.0, 0.35], low, low, heading, seconds)


_TURN = (-math.pi, math.pi)
# Bounds are those of ordinary flights: unmodelled dynamics grow faster with the excitation than the
# differences between the sets. The least heights are three to four rotor radii of the shipped vehicle.
KINDS: dict[str, Kind] = {
    "hover": Kind("hover for {seconds} s at a heading of {heading} deg",
        {"heading": _TURN, "seconds": (1.2, 3.0)}, _hover),
    "turn": Kind("turn in place by {angle} deg at up to {rate} deg/s",
        {"angle": (1.0, 4.0), "rate": (0.5, 1.2)}, _turn),
    "tilts": Kind("command {tilt} deg of tilt towards {direction} deg and back, {seconds} s each, "
        "at a heading of {heading} deg",
        {"tilt": (0.06, 0.2), "seconds": (0.15, 0.45), "direction": _TURN, "heading": _TURN}, _tilts),
    "thrusts": Kind("raise and lower the thrust in turn by {size} times that of hover, {seconds} s each",
        {"size": (0.06, 0.2), "seconds": (0.12, 0.4)}, _thrusts),
    "climb": Kind("climb and descend by {height} m at up to {speed} m/s",
        {"height": (0.4, 1.5), "speed": (0.4, 1.3)}, _climb),
    "heave": Kind("heave over {height} m at {frequency} Hz",
        {"height": (0.1, 0.4), "frequency": (0.4, 0.9)}, _heave),
    "run": Kind("fly {distance} m towards {direction} deg and back at up to {speed} m/s, "
        "at a heading of {heading} deg",
        {"distance": (0.8, 3.0), "speed": (0.5, 2.2), "direction": _TURN, "heading": _TURN}, _run),
    "circle": Kind("circle with a radius of {radius} m at {speed} m/s for {seconds} s",
        {"radius": (0.3, 0.9), "speed": (0.5, 1.7), "seconds": (1.5, 4.0), "nose": (0.0, 1.0)}, _circle),
    "low_hover": Kind("hover {height} m above the floor for {seconds} s at a heading of {heading} deg",
        {"height": (0.07, 0.25), "seconds": (1.2, 6.0), "heading": _TURN}, _low_hover, near=True),
    "low_pass": Kind("fly {distance} m towards {direction} deg, {height} m above the floor",
        {"height": (0.07, 0.25), "distance": (0.5, 1.5), "direction": _TURN}, _low_pass, near=True),
    "slope_hover": Kind("hover {height} m above the slope for {seconds} s at a heading of {heading} deg",
        {"height": (0.09, 0.3), "seconds": (1.2, 6.0), "heading": _TURN}, _slope_hover, near=True),
}  # fmt: skip


def kinds(space: Space) -> tuple[str, ...]:
    """Return the kinds of pieces that are possible in a space."""
    return tuple(name for name in KINDS if space.platform or name != "slope_hover")
