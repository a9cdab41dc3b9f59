"""Frames and signs between this package and a Crazyflie.

This package: world z up, angles of R = Rz(yaw) Rx(roll) Ry(pitch), positive pitch accelerates +x, positive
roll -y.

Crazyflie: angles of R = Rz(yaw) Ry(pitch) Rx(roll), in degrees. cflib's `send_setpoint` packs -pitch, and the
firmware keeps pitch inverted in its attitude loop and in the log variable `stateEstimate.pitch`
(stabilizer.c, the legacy body frame): in `send_setpoint` positive pitch accelerates the vehicle forward, in
the log it is a backward tilt. A positive yaw rate of `send_setpoint` turns clockwise (crtp_commander_rpyt.c).

A command defines the direction of the thrust in the frame of the arena. It is rotated by the vehicle's
heading, so that a policy that does not observe a heading can fly a vehicle with any.
"""

from __future__ import annotations

import math

import numpy as np

from inclined_landing.models.attitude import PITCH_COMMAND, PWM, ROLL_COMMAND, YAW_RATE_COMMAND

LARGEST_THRUST = 60000  # of the firmware's commander; more counts as this


def thrust_direction(roll: float, pitch: float) -> np.ndarray:
    """Return the unit vector (3,) of the thrust at the project's roll and pitch [rad] and heading 0."""
    return np.array([math.sin(pitch), -math.sin(roll) * math.cos(pitch), math.cos(roll) * math.cos(pitch)])


def tilt(direction: np.ndarray) -> tuple[float, float]:
    """Return the project's roll and pitch [rad] at heading 0 for a thrust along the unit vector (3,)."""
    # Inverse of b = (sin p, -sin r cos p, cos r cos p): r = atan2(-y, z), p = asin x.
    x, y, z = direction
    return math.atan2(-y, z), math.asin(min(1.0, max(-1.0, x)))


def about_z(angle: float) -> np.ndarray:
    """Return the rotation (3, 3) about z by an angle [rad]."""
    c, s = math.cos(angle), math.sin(angle)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def angle_between(a: np.ndarray, b: np.ndarray) -> float:
    """Return the angle [rad] of the relative rotation of two attitudes (3, 3)."""
    # cos(angle) = (tr(A'B) - 1) / 2
    return math.acos(min(1.0, max(-1.0, 0.5 * (float(np.trace(a.T @ b)) - 1.0))))


def logged_rotation(roll: float, pitch: float, yaw: float) -> np.ndarray:
    """Return the rotation (3, 3), body to vehicle's world, of the logged `stateEstimate` angles [deg]."""
    # R = Rz(yaw) Ry(-pitch) Rx(roll)
    cr, sr = math.cos(math.radians(roll)), math.sin(math.radians(roll))
    cp, sp = math.cos(math.radians(-pitch)), math.sin(math.radians(-pitch))
    cy, sy = math.cos(math.radians(yaw)), math.sin(math.radians(yaw))
    return np.array(
        [
            [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
            [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
            [-sp, cp * sr, cp * cr],
        ]
    )


def in_heading(command: np.ndarray, heading: float) -> np.ndarray:
    """Return a command (4,) for heading 0 converted to one in a heading [rad]."""
    turned = about_z(-heading) @ thrust_direction(command[ROLL_COMMAND], command[PITCH_COMMAND])
    result = np.array(command, float)
    result[[ROLL_COMMAND, PITCH_COMMAND]] = tilt(turned)
    return result


def quaternion_rotation(quaternion: np.ndarray) -> np.ndarray:
    """Return the rotation matrix (3, 3) of a quaternion (4,) w, x, y, z of any length but 0."""
    w, x, y, z = np.asarray(quaternion, float) / np.linalg.norm(quaternion)
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def project_angles(rotation: np.ndarray) -> tuple[float, float, float]:
    """Return roll, pitch, yaw [rad] of R = Rz(yaw) Rx(roll) Ry(pitch) for a rotation (3, 3)."""
    # R[2] = (-cos r sin p, sin r, cos r cos p), R[:2, 1] = cos r (-sin y, cos y)
    roll = math.asin(min(1.0, max(-1.0, rotation[2, 1])))
    return roll, math.atan2(-rotation[2, 0], rotation[2, 2]), math.atan2(-rotation[0, 1], rotation[1, 1])


def heading_of(rotation: np.ndarray) -> float:
    """Return the heading [rad] of the body's x axis seen from above: the yaw of the Crazyflie's angles."""
    return math.atan2(rotation[1, 0], rotation[0, 0])


def wrapped(angle: float) -> float:
    """Return the angle [rad] wrapped to [-pi, pi)."""
    return (angle + math.pi) % (2.0 * math.pi) - math.pi


def radio_setpoint(command: np.ndarray, angle_limit: float) -> tuple[float, float, float, int]:
    """Return the arguments of cflib's `send_setpoint`: roll, pitch [deg], yaw rate [deg/s], thrust.

    command (4,): PWM, roll, pitch [rad], yaw rate [rad/s] in the vehicle's heading. Roll and pitch are
    clipped to angle_limit [rad], the thrust to the range of the firmware. Raises ValueError for a command
    that is NaN or infinite.
    """
    if not np.isfinite(command).all():
        raise ValueError("a command is NaN or infinite")
    # b = (sin p cos r, -sin r, cos p cos r) for the Crazyflie's angles: r = asin(-y), p = atan2(x, z).
    x, y, z = thrust_direction(command[ROLL_COMMAND], command[PITCH_COMMAND])
    roll, pitch = math.asin(min(1.0, max(-1.0, -y))), math.atan2(x, z)
    roll, pitch = (math.degrees(min(angle_limit, max(-angle_limit, angle))) for angle in (roll, pitch))
    thrust = round(min(float(LARGEST_THRUST), max(0.0, float(command[PWM]))))
    return roll, pitch, -math.degrees(float(command[YAW_RATE_COMMAND])), thrust
