"""Air, external forces, and commands and poses that are late or wrong, added to a simulator by others.

Worlds hold arrays (n,) here, one entry for each flight of a batch.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from tests.validation.simulator import Build, Constants, World
from tests.validation.simulator.flight import correlated

RATE = 250  # Hz, of the flight controller and of the integration


def received(command: np.ndarray, w: World):
    """Return roll, pitch and yaw rate, each (n,), that the vehicle receives for commands (n, 4)."""
    angles = command[:, 1:3].copy()
    angles[np.abs(angles) < w.dead_zone[:, None]] = 0.0
    step = np.where(w.quantum > 0.0, w.quantum, 1.0)[:, None]
    angles = np.where(w.quantum[:, None] > 0.0, step * np.round(angles / step), angles)
    roll, pitch = angles[:, 0], angles[:, 1] + w.cross_coupling * angles[:, 0]
    gain = w.attitude_gain_scale
    return gain * (roll + w.trim_roll), gain * (pitch + w.trim_pitch), command[:, 3]


def wind(x: np.ndarray, w: World) -> np.ndarray:
    """Return the steady wind (n, 3) at positions x (n, 3), with a rising column."""
    squared = (x[:, 0] - w.updraft_x) ** 2 + (x[:, 1] - w.updraft_y) ** 2
    return np.column_stack([w.wind_x, w.wind_y, w.updraft * np.exp(-squared / (2.0 * w.updraft_radius**2))])


def forces(q: np.ndarray, time: float, c: Constants, w: World) -> np.ndarray:
    """Return external accelerations (n, 3) [m/s2]: bias of thrust, a fan, a force with the heading."""
    push = Rotation.from_quat(q).apply([0.0, 0.0, 1.0]) * (w.thrust_bias / (c.mass * w.mass_scale))[:, None]
    swing = w.swing * np.sin(2.0 * np.pi * time / w.swing_period)
    heading = 2.0 * angles(q)[:, 2]
    push[:, 0] += swing * np.cos(w.swing_direction) + w.heading_force * np.cos(heading)
    push[:, 1] += swing * np.sin(w.swing_direction) + w.heading_force * np.sin(heading)
    return push


def disturbance(rng, shape: tuple[int, int, int], b: Build) -> np.ndarray:
    """Return accelerations [m/s2] and angular accelerations [rad/s2] (ticks, n, 6) of a build's air."""
    size = np.array([*b.disturbance, *b.disturbance_torque])
    return size * correlated(rng, shape, b.disturbance_time, RATE)


def late(history: np.ndarray, k, delay: np.ndarray) -> np.ndarray:
    """Return rows of history (ticks, n, m), `delay` (n,) [s] before period k (one, or (n,)), interpolated."""
    at = np.maximum(k - delay * RATE, 0.0)
    before = np.floor(at + 1e-9).astype(int)
    part, flight = np.maximum(at - before, 0.0)[:, None], np.arange(len(delay))
    after = np.minimum(before + 1, np.maximum(k, before))
    return (1.0 - part) * history[before, flight] + part * history[after, flight]


def times(p: np.ndarray, q: np.ndarray) -> np.ndarray:
    """Return the product of quaternions (n, 4), scalar last."""
    return (Rotation.from_quat(p) * Rotation.from_quat(q)).as_quat()


def turn(yaw, roll, pitch) -> np.ndarray:
    """Return the quaternion (n, 4) of Rz(yaw) Rx(roll) Ry(pitch)."""
    return Rotation.from_euler("ZXY", np.column_stack([yaw, roll, pitch])).as_quat()


def angles(q: np.ndarray) -> np.ndarray:
    """Return roll, pitch, yaw (n, 3) of Rz Rx Ry."""
    return Rotation.from_quat(q).as_euler("ZXY")[:, [1, 2, 0]]
