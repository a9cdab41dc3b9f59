"""References of ordinary flights: hover, climbs, fast lateral, attitude steps, circles, yaw, low passes."""

from __future__ import annotations

import math

import numpy as np

from . import control
from .vehicle import PILOT_RATE


class Path:
    """A reference written piece by piece: rows (k, REF_SIZE) at the pilot's rate."""

    def __init__(self, position, yaw: float = 0.0):
        self.position = np.array(position, float)
        self.yaw = yaw
        self._rows: list[np.ndarray] = []

    @property
    def seconds(self) -> float:
        return sum(map(len, self._rows)) / PILOT_RATE

    def rows(self, seconds: float | None = None) -> np.ndarray:
        """The rows so far, cut or held to `seconds`."""
        if seconds is not None and self.seconds < seconds:
            self.hold(seconds - self.seconds)
        rows = np.vstack(self._rows)
        return rows if seconds is None else rows[: round(seconds * PILOT_RATE)]

    def _piece(self, seconds: float) -> tuple[np.ndarray, np.ndarray]:
        n = max(1, round(seconds * PILOT_RATE))
        rows = np.zeros((n, control.REF_SIZE))
        rows[:, :3] = self.position
        rows[:, control.REF_YAW] = self.yaw
        self._rows.append(rows)
        return rows, (np.arange(n) + 1) / n

    def hold(self, seconds: float) -> Path:
        self._piece(seconds)
        return self

    def move(self, to, seconds: float, turn: float = 0.0) -> Path:
        """Go to `to` and turn by `turn` rad, with a quintic in time."""
        rows, u = self._piece(seconds)
        way = np.asarray(to, float) - self.position
        s, ds, dds = _quintic(u)
        rows[:, :3] = self.position + np.outer(s, way)
        rows[:, 3:6] = np.outer(ds / seconds, way)
        rows[:, 6:9] = np.outer(dds / seconds**2, way)
        rows[:, control.REF_YAW] = self.yaw + turn * s
        rows[:, control.REF_YAW_RATE] = turn * ds / seconds
        self.position = self.position + way
        self.yaw += turn
        return self

    def ellipse(self, first, second, rate: float, turns: float) -> Path:
        """Ride position + first (1 - cos a) + second sin a, a from rest to rest."""
        first, second = np.asarray(first, float), np.asarray(second, float)
        total = 2 * math.pi * turns
        ramp = 1.0
        seconds = total / rate + ramp
        rows, u = self._piece(seconds)
        t = u * seconds
        speed = rate * np.clip(np.minimum(t, seconds - t) / ramp, 0, 1)
        gain = np.where(t < ramp, rate / ramp, np.where(t > seconds - ramp, -rate / ramp, 0.0))
        a = np.cumsum(speed) / PILOT_RATE
        a *= total / a[-1]
        sin, cos = np.sin(a)[:, None], np.cos(a)[:, None]
        speed, gain = speed[:, None], gain[:, None]
        rows[:, :3] = self.position + first * (1 - cos) + second * sin
        rows[:, 3:6] = (first * sin + second * cos) * speed
        rows[:, 6:9] = (first * cos - second * sin) * speed**2 + (first * sin + second * cos) * gain
        return self

    def kick(self, roll: float, pitch: float, seconds: float) -> Path:
        """Commanded angles: there, twice as long back, there again, so that the vehicle ends up slow."""
        for sign, part in ((1, seconds), (-1, 2 * seconds), (1, seconds)):
            rows, _ = self._piece(part)
            rows[:, control.REF_MODE] = control.STEP
            rows[:, control.REF_ROLL], rows[:, control.REF_PITCH] = sign * roll, sign * pitch
        return self

    def push(self, pwm: float, seconds: float) -> Path:
        """PWM added on top of the pilot's: up, down twice as long, up."""
        for sign, part in ((1, seconds), (-1, 2 * seconds), (1, seconds)):
            rows, _ = self._piece(part)
            rows[:, control.REF_PWM] = sign * pwm
        return self

    def land(self, to, velocity, acceleration, seconds, surface, tilt, cut_height, lead=0.2) -> Path:
        """Be at `to` with `velocity` and `acceleration` after `seconds`, cut the motors, and wait a second.

        The pilot tilts `lead` seconds ahead of the path, as the attitude loop lags. surface, tilt: where the
        pilot believes the surface to be (see `control.py`); cut_height: above it [m].
        """
        rows, u = self._piece(seconds)
        way = np.asarray(to, float) - self.position
        p, v, _ = _arrive(u, way, np.asarray(velocity, float), np.asarray(acceleration, float), seconds)
        rows[:, :3], rows[:, 3:6] = self.position + p, v
        ahead = np.minimum(u + lead / seconds, 1.0)
        rows[:, 6:9] = _arrive(ahead, way, np.asarray(velocity), np.asarray(acceleration), seconds)[2]
        self.position = self.position + way
        rest, u = self._piece(1.6)
        t = (u * 1.6)[:, None]
        rest[:, :3] += np.asarray(velocity) * t
        rest[:, 3:6], rest[:, 6:9] = velocity, acceleration
        for piece in (rows, rest):
            piece[:, control.REF_MODE] = control.LAND
            piece[:, control.REF_SURFACE], piece[:, control.REF_TILT] = surface, tilt
            piece[:, control.REF_CUT_HEIGHT] = cut_height
        return self


def _arrive(u, way, velocity, acceleration, seconds):
    """Position, velocity, acceleration (n, 3) of the quintic from rest to `way` with given end values."""
    v, a = velocity * seconds, acceleration * seconds**2
    cubic, quartic, quintic = 10 * way - 4 * v + a / 2, -15 * way + 7 * v - a, 6 * way - 3 * v + a / 2
    u = np.asarray(u)[:, None]
    return (
        u**3 * (cubic + u * (quartic + u * quintic)),
        u**2 * (3 * cubic + u * (4 * quartic + u * 5 * quintic)) / seconds,
        u * (6 * cubic + u * (12 * quartic + u * 20 * quintic)) / seconds**2,
    )


def _quintic(u):
    return (u**3 * (10 + u * (-15 + 6 * u)), 30 * u**2 * (1 - u) ** 2, 60 * u * (1 - u) * (1 - 2 * u))


def ordinary(kind: str, rng: np.random.Generator, seconds: float = 20.0, lowest: float = 0.0) -> np.ndarray:
    """Reference (k, REF_SIZE) of one ordinary flight of a kind of KINDS; `lowest` keeps it off the floor."""
    u = rng.uniform
    path = Path([u(-0.4, 0.4), u(-0.4, 0.4), u(0.9, 1.3)], yaw=u(-0.4, 0.4))
    path.hold(u(0.4, 1.0))
    while path.seconds < seconds:
        _PIECES[kind](path, u, lowest)
    return path.rows(seconds)


def landing(rng: np.random.Generator, surface: float, tilt: float, foot_height: float) -> np.ndarray:
    """Reference (k, REF_SIZE) of a landing on the plane through (0, 0, surface) with `tilt` [rad].

    The vehicle comes uphill and lets the slope brake it; speeds and alignment differ from one to the next.
    """
    u = rng.uniform
    normal = np.array([math.sin(tilt), 0.0, math.cos(tilt)])
    uphill = np.array([math.cos(tilt), 0.0, -math.sin(tilt)]) * (-1.0 if tilt > 0 else 1.0)
    side = np.array([0.0, 1.0, 0.0])
    spot = np.array([0.0, 0.0, surface]) + u(-0.08, 0.08) * uphill + u(-0.08, 0.08) * side
    end = spot + (foot_height + 0.01) * normal
    velocity = -u(0.25, 0.8) * normal + u(-0.3, 0.6) * uphill + u(-0.35, 0.35) * side
    lean = tilt + u(-0.12, 0.12)
    thrust = u(0.65, 0.95) * 9.81
    acceleration = thrust * np.array([math.sin(lean), u(-0.08, 0.08), math.cos(lean)]) - [0.0, 0.0, 9.81]
    seconds = u(1.1, 1.4)
    # Where a vehicle at rest can start from so that the way is natural: constant acceleration to the end.
    start = end - 0.36 * velocity * seconds + 0.06 * acceleration * seconds**2
    start[2] = max(start[2], surface + 0.25)
    path = Path(start, yaw=u(-0.1, 0.1)).hold(0.3)
    return path.land(end, velocity, acceleration, seconds, surface, tilt, foot_height + u(0.0, 0.035)).rows()


def _across(path: Path, u, distance: float) -> np.ndarray:
    """A point at the same height, `distance` m on, in a direction that stays inside 1.3 m."""
    for _ in range(20):
        a = u(-math.pi, math.pi)
        to = path.position + distance * np.array([math.cos(a), math.sin(a), 0.0])
        if np.all(np.abs(to[:2]) < 1.3):
            return to
    return np.array([0.0, 0.0, path.position[2]])


def _height(path: Path, z: float) -> np.ndarray:
    return np.array([path.position[0], path.position[1], z])


def _climb(path, u, lowest):
    z = u(1.6, 2.1) if path.position[2] < 1.2 else u(0.4, 0.8)
    z = max(z, lowest)
    path.move(_height(path, z), abs(z - path.position[2]) / u(0.55, 1.1) + 0.4).hold(u(0.3, 1.5))


def _lateral(path, u, lowest):
    distance = u(0.9, 1.8)
    path.move(_across(path, u, distance), math.sqrt(5.8 * distance / u(1.8, 3.6))).hold(u(0.1, 0.7))


def _steps(path, u, lowest):
    size = np.radians(u(4, 9)) * (1 if u(0, 1) < 0.5 else -1)
    both = u(0, 1)
    roll, pitch = (size, 0.0) if both < 0.4 else (0.0, size) if both < 0.8 else (0.7 * size, -0.7 * size)
    path.kick(roll, pitch, u(0.25, 0.45)).hold(u(1.0, 1.8))


def _circle(path, u, lowest):
    radius, rate = u(0.4, 0.8), u(1.2, 2.2) * (1 if u(0, 1) < 0.5 else -1)
    a = math.atan2(-path.position[1], -path.position[0]) + u(-0.4, 0.4)
    inward = radius * np.array([math.cos(a), math.sin(a), 0.0])
    side = radius * np.array([-math.sin(a), math.cos(a), 0.0]) * math.copysign(1, rate)
    path.ellipse(inward, side, abs(rate), 1 + round(u(0, 1))).hold(u(0.3, 0.8))


def _yaw(path, u, lowest):
    turn = u(1.2, 3.0) * (1 if u(0, 1) < 0.5 else -1)
    path.move(path.position, abs(turn) / u(0.6, 1.2), turn).hold(u(0.3, 0.8))
    path.move(_across(path, u, u(0.5, 1.0)), u(1.2, 1.8))


def _low_pass(path, u, lowest):
    z = max(u(0.06, 0.11), lowest)
    distance = path.position[2] - z
    path.move(_height(path, z + 0.1), max(1.2, 1.9 * distance / u(0.8, 1.2)))
    path.move(_height(path, z), 0.7)
    for _ in range(2):
        path.move(_across(path, u, u(0.6, 1.1)), u(1.5, 2.4))
    path.hold(u(0.2, 0.6)).move(_height(path, u(0.6, 1.0)), u(1.2, 1.8)).hold(u(0.2, 0.5))


def _thrust(path, u, lowest):
    path.push(u(2500, 5500) * (1 if u(0, 1) < 0.5 else -1), u(0.16, 0.3)).hold(u(0.8, 1.5))
    z = max(u(0.6, 1.8), lowest)
    path.move(_height(path, z), max(0.9, abs(z - path.position[2]) / u(0.7, 1.1)))


def _waypoints(path, u, lowest):
    to = np.array([u(-1.1, 1.1), u(-1.1, 1.1), max(u(0.4, 1.9), lowest)])
    distance = float(np.linalg.norm(to - path.position))
    path.move(to, max(0.8, math.sqrt(5.8 * distance / u(1.5, 3.0))), u(-0.5, 0.5)).hold(u(0.0, 0.6))


def _loop(path, u, lowest):
    a, radius = u(-math.pi, math.pi), u(0.35, 0.6)
    out = -np.sign(path.position[0] * math.cos(a) + path.position[1] * math.sin(a)) or 1.0
    side = out * radius * np.array([math.cos(a), math.sin(a), 0.0])
    up = np.array([0.0, 0.0, radius if path.position[2] < 1.2 else -0.5 * radius])
    path.ellipse(up, side, u(1.3, 2.0), 1).hold(u(0.2, 0.6))
    path.move(_across(path, u, u(0.3, 0.8)), u(1.0, 1.5))


def _low_hover(path, u, lowest):
    for z in (u(0.2, 0.4), u(0.06, 0.085), u(0.09, 0.15)):
        z = max(z, lowest)
        path.move(_height(path, z), max(1.0, 1.9 * abs(path.position[2] - z) / u(0.5, 0.9))).hold(u(0.7, 1.6))
    path.move(_across(path, u, u(0.3, 0.7)), u(1.2, 2.0))
    path.move(_height(path, u(0.5, 1.2)), u(1.2, 2.0))


_PIECES = {
    piece.__name__.removeprefix("_"): piece
    for piece in (
        *(_climb, _lateral, _steps, _circle, _yaw, _low_pass, _thrust, _waypoints, _loop, _low_hover),
    )
}
KINDS = tuple(_PIECES)
