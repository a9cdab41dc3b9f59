"""Frames and normals of an inclined surface. Inclinations are those of the platform, in rad.

`heading_frame` returns a vehicle's state relative to a surface, along level axes with the surface's yaw.
"""

from __future__ import annotations

import math

import numpy as np

from inclined_landing.models.attitude import (
    PITCH,
    PITCH_COMMAND,
    ROLL,
    ROLL_COMMAND,
    VX,
    VZ,
    WX,
    YAW,
    X,
    Z,
    rotation_entries,
    rotations,
    sine_cosine,
    to_body,
    to_world,
)
from inclined_landing.models.compiled import inlined, kernel

# Columns of `heading_frame` that follow those of a vehicle's state up to its pitch.
SLOPE_ROLL, SLOPE_PITCH = PITCH + 1, PITCH + 2
HEADING_SIZE = SLOPE_PITCH + 1
_QUARTER = 0.5 * math.pi
_NO_TURN = 1e-15  # rad: what rounding leaves of one, and of the angles


def turned(state: np.ndarray, angle) -> np.ndarray:
    """Return states (n, 13) rotated about the vertical axis through the origin by angle (n,) [rad]."""
    state, sin, cos = state.copy(), np.sin(angle), np.cos(angle)
    for first in (X, VX):
        x, y = state[:, first].copy(), state[:, first + 1].copy()
        state[:, first], state[:, first + 1] = cos * x - sin * y, sin * x + cos * y
    state[:, YAW] += angle
    return state


def normal_of(inclination) -> np.ndarray:
    """Return the unit normal (..., 3) of surfaces inclined by `inclination` (...)."""
    a = np.asarray(inclination, float)
    return np.stack([np.sin(a), np.zeros_like(a), np.cos(a)], axis=-1)


def downhill_of(inclination) -> np.ndarray:
    """Return the unit vector (..., 3) along the surface towards -x: downhill at a negative inclination."""
    a = np.asarray(inclination, float)
    return np.stack([-np.cos(a), -np.zeros_like(a), np.sin(a)], axis=-1)


def split(vector: np.ndarray, inclination) -> tuple[np.ndarray, np.ndarray]:
    """Return the normal component of vectors (..., 3), positive outward, and the tangential part's norm."""
    normal = normal_of(inclination)
    away = (vector * normal).sum(axis=-1)
    return away, np.linalg.norm(vector - away[..., None] * normal, axis=-1)


@inlined
def yaw_turned(roll, pitch, turn):
    """Return roll and pitch [rad] for the same thrust axis and a yaw smaller by `turn` [rad]."""
    if abs(turn) < _NO_TURN and max(abs(roll), abs(pitch)) < _QUARTER:
        return roll, pitch
    # Thrust axis without the yaw: (sin theta, -sin phi cos theta, cos phi cos theta), turned about z
    (sin, cos), (sr, cr), (ahead, flat) = sine_cosine(turn), sine_cosine(roll), sine_cosine(pitch)
    left, up = -sr * flat, cr * flat
    ahead, left = cos * ahead - sin * left, sin * ahead + cos * left
    return math.atan2(-left, up), math.asin(min(1.0, max(-1.0, ahead)))


@inlined
def in_heading_frame(s, d, out):
    """Write `heading_frame` of one vehicle (13,) over a platform (12,) into `out` (10,)."""
    sin, cos = sine_cosine(d[YAW])
    x, y = s[X] - d[X], s[X + 1] - d[X + 1]
    out[X], out[X + 1] = cos * x + sin * y, cos * y - sin * x
    x, y = s[VX] - d[VX], s[VX + 1] - d[VX + 1]
    out[VX], out[VX + 1] = cos * x + sin * y, cos * y - sin * x
    out[Z], out[VZ] = s[Z] - d[Z], s[VZ] - d[VZ]
    out[ROLL], out[PITCH] = yaw_turned(s[ROLL], s[PITCH], s[YAW] - d[YAW])
    out[SLOPE_ROLL], out[SLOPE_PITCH] = d[ROLL], d[PITCH]


@kernel
def _heading_frame(state, platform, out):
    for i in range(len(state)):
        in_heading_frame(state[i], platform[i], out[i])
    return out


def heading_frame(state: np.ndarray, platform: np.ndarray) -> np.ndarray:
    """Return states (n, 10) relative to the vehicles' surfaces, along level axes with the surfaces' yaw.

    state (n, 13), platform (n, 12): see `Plant.platform`. Columns: position x, y, z [m] from the surface's
    centre and velocity vx, vy, vz [m/s] relative to it, along axes turned by the platform's yaw about the
    vertical; the roll and pitch [rad] of a vehicle with this yaw and the same thrust axis; and those of one
    at rest on the surface. They depend neither on the surface's azimuth nor on the vehicle's yaw.
    """
    return _heading_frame(state, platform, np.empty((len(state), HEADING_SIZE)))


@kernel
def turn_commands(commands, gain, limit, state, platform):
    """Turn roll and pitch of commands (n, 4) from the heading frames to the vehicles' yaw.

    gain: steady attitude over the command that leads to it; limit [rad]: of each command. state (n, 13),
    platform (n, 12).
    """
    for i in range(len(commands)):
        turn = platform[i, YAW] - state[i, YAW]
        roll, pitch = commands[i, ROLL_COMMAND], commands[i, PITCH_COMMAND]
        roll, pitch = yaw_turned(gain * roll, gain * pitch, turn)
        roll, pitch = roll / gain, pitch / gain
        commands[i, ROLL_COMMAND] = min(limit, max(-limit, roll))
        commands[i, PITCH_COMMAND] = min(limit, max(-limit, pitch))


def platform_motion(platform: np.ndarray) -> np.ndarray:
    """Return velocity [m/s] and rates [rad/s] (n, 6) of platforms (n, 12) along the axes of
    `heading_frame`.
    """
    out = np.empty((len(platform), 6))
    _platform_motions(platform, out)
    return out


@kernel
def _platform_motions(platform, out):
    for i in range(len(platform)):
        _write_platform_motion(platform[i], out[i])


@inlined
def _write_platform_motion(d, out):
    """Write `platform_motion` of one platform (12,) into `out` (6,)."""
    yaw = sin, cos = sine_cosine(d[YAW])
    out[0], out[1] = cos * d[VX] + sin * d[VX + 1], cos * d[VX + 1] - sin * d[VX]
    out[2] = d[VZ]
    a, b, c = d[WX], d[WX + 1], d[WX + 2]
    if a != 0.0 or b != 0.0 or c != 0.0:
        r = rotation_entries(sine_cosine(d[ROLL]), sine_cosine(d[PITCH]), yaw)
        wx, wy, out[5] = to_world(r, a, b, c)
        out[3], out[4] = cos * wx + sin * wy, cos * wy - sin * wx
    else:
        out[3] = out[4] = out[5] = 0.0


@kernel
def observe(state, platform, columns, out):
    """Write `columns` (c,) of `heading_frame` to `out` (n, c or more), followed by `platform_motion`.

    The motion is written if `out` has enough columns for it.
    """
    seen, motion, count = np.empty(HEADING_SIZE), np.empty(6), len(columns)
    moves = out.shape[1] > count
    for i in range(len(state)):
        in_heading_frame(state[i], platform[i], seen)
        for k in range(count):
            out[i, k] = seen[columns[k]]
        if moves:
            _write_platform_motion(platform[i], motion)
            for k in range(6):
                out[i, count + k] = motion[k]


def on_platform(state: np.ndarray, platform: np.ndarray) -> np.ndarray:
    """Return positions (n, 3) [m] of vehicles in the frames of platforms (n, 12), z along the normal."""
    frames = rotations(np.ascontiguousarray(platform[:, ROLL : YAW + 1]))
    return np.einsum("nji,nj->ni", frames, state[:, : Z + 1] - platform[:, : Z + 1])


def thrust_turning(state: np.ndarray, platform: np.ndarray) -> np.ndarray:
    """Return the rates (n, 3) [1/s] of the vehicles' thrust axes, along the axes of `heading_frame`."""
    frames = rotations(np.ascontiguousarray(state[:, ROLL : YAW + 1]))
    # omega x (0, 0, 1) in the body's axes: (wy, -wx, 0)
    turning = frames[:, :, 0] * state[:, WX + 1, None] - frames[:, :, 1] * state[:, WX, None]
    sin, cos = np.sin(platform[:, YAW]), np.cos(platform[:, YAW])
    x, y, z = turning.T
    return np.column_stack([cos * x + sin * y, cos * y - sin * x, z])


def slope_of(platform: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return inclination (n,) and azimuth (n,) [rad] of slopes with the normals of platforms (n, 12)."""
    x, y, z = normals(platform).T
    flat = np.hypot(x, y)
    return np.arctan2(flat, z), np.arctan2(y, x)


@inlined
def normal_at_rest(roll, pitch):
    """Return the unit normal x, y, z, in the heading frame, of the surface on which a vehicle rests.

    roll, pitch [rad]: of the vehicle at rest.
    """
    (sr, cr), (sp, cp) = sine_cosine(roll), sine_cosine(pitch)
    return sp, -sr * cp, cr * cp


def attitude_at_rest(inclination, turn) -> tuple[np.ndarray, np.ndarray]:
    """Return roll and pitch [rad] of a vehicle at rest on a slope; turn [rad]: azimuth minus yaw."""
    x, _, z = np.moveaxis(normal_of(inclination), -1, 0)
    return np.arctan2(-x * np.sin(turn), z), np.arcsin(x * np.cos(turn))


def normals(platform: np.ndarray) -> np.ndarray:
    """Return the unit normals (n, 3) of platforms (n, 12), columns as `Plant.platform`."""
    return _normals(platform, np.empty((len(platform), 3)))


@kernel
def _normals(platform, out):
    for i in range(len(platform)):
        ahead, left, out[i, 2] = normal_at_rest(platform[i, ROLL], platform[i, PITCH])
        sin, cos = sine_cosine(platform[i, YAW])
        out[i, 0], out[i, 1] = cos * ahead - sin * left, sin * ahead + cos * left
    return out


def relative(state: np.ndarray, platform: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return position, velocity and rates of vehicles (n, 12 or more) relative to their platforms (n, 12).

    Positions (n, 3) [m] from the platforms' centres and velocities (n, 3) [m/s] relative to the platforms'
    points where the vehicles are, both along the world's axes; rates (n, 3) [rad/s] relative to the
    platforms, about the vehicles' axes. A vehicle that is carried by a platform has zero velocity and zero
    rates.
    """
    position, velocity, rate = np.empty((3, len(state), 3))
    _relative(np.asarray(state, float), np.asarray(platform, float), position, velocity, rate)
    return position, velocity, rate


@kernel
def _relative(state, platform, position, velocity, rate):
    for i in range(len(state)):
        s, d, x, v, w = state[i], platform[i], position[i], velocity[i], rate[i]
        for k in range(3):
            x[k], v[k], w[k] = s[k] - d[k], s[VX + k] - d[VX + k], s[WX + k]
        a, b, c = d[WX], d[WX + 1], d[WX + 2]
        if a != 0.0 or b != 0.0 or c != 0.0:
            r = rotation_entries(sine_cosine(d[ROLL]), sine_cosine(d[PITCH]), sine_cosine(d[YAW]))
            a, b, c = to_world(r, a, b, c)  # the platform's rates
            # v - omega x r, r the position from the platform's centre
            v[0] -= b * x[2] - c * x[1]
            v[1] -= c * x[0] - a * x[2]
            v[2] -= a * x[1] - b * x[0]
            r = rotation_entries(sine_cosine(s[ROLL]), sine_cosine(s[PITCH]), sine_cosine(s[YAW]))
            a, b, c = to_body(r, a, b, c)
            w[0], w[1], w[2] = w[0] - a, w[1] - b, w[2] - c
