"""State columns and attitude conversions, compiled and batched.

Attitude is R = Rz(yaw) Rx(roll) Ry(pitch): positive pitch accelerates +x, positive roll -y. This is
the paper's matrix with two misprints corrected (as printed it is not orthonormal).

A vehicle's state is one row of an (n, 13) float64 array, columns X .. LAG below.
"""

import math

import numba
import numpy as np

X, Y, Z, VX, VY, VZ, ROLL, PITCH, YAW, WX, WY, WZ, LAG = range(13)
STATE_SIZE = 13
STATE_NAMES = (
    *("x", "y", "z", "vx", "vy", "vz", "roll", "pitch", "yaw"),
    *("wx", "wy", "wz", "lag"),
)
STATE_UNITS = ("m", "m", "m", "m/s", "m/s", "m/s", "rad", "rad", "rad", "rad/s", "rad/s", "rad/s", "PWM s")
PWM, ROLL_COMMAND, PITCH_COMMAND, YAW_RATE_COMMAND = range(4)
COMMAND_SIZE = 4
COMMAND_NAMES = ("pwm", "roll", "pitch", "yaw_rate")
COMMAND_UNITS = ("PWM", "rad", "rad", "rad/s")

_SINGULAR = 1e-6  # smallest |cos(roll)| used in divisions: the ZXY chart ends at roll = 90 deg


@numba.njit(cache=True, inline="always")
def safe_cosine(roll):
    """cos(roll), kept away from zero where the Euler rates are undefined."""
    c = math.cos(roll)
    if abs(c) < _SINGULAR:
        return _SINGULAR if c >= 0.0 else -_SINGULAR
    return c


@numba.njit(cache=True, inline="always")
def euler_rates(roll, pitch, wx, wy, wz):
    """Rates (roll, pitch, yaw) [rad/s] from body rates [rad/s]."""
    sp, cp = math.sin(pitch), math.cos(pitch)
    yaw_rate = (cp * wz - sp * wx) / safe_cosine(roll)
    return cp * wx + sp * wz, wy - math.sin(roll) * yaw_rate, yaw_rate


@numba.njit(cache=True, inline="always")
def body_rates(roll, pitch, roll_rate, pitch_rate, yaw_rate):
    """Body rates [rad/s] from Euler rates [rad/s]; the inverse of `euler_rates`."""
    sr, cr = math.sin(roll), math.cos(roll)
    sp, cp = math.sin(pitch), math.cos(pitch)
    return (
        roll_rate * cp - yaw_rate * cr * sp,
        pitch_rate + yaw_rate * sr,
        roll_rate * sp + yaw_rate * cr * cp,
    )


@numba.njit(cache=True, inline="always")
def body_accelerations(roll, pitch, rates, accelerations):
    """Time derivative [rad/s2] of `body_rates` at Euler rates and accelerations (3,) each [rad/s, rad/s2]."""
    roll_rate, pitch_rate, yaw_rate = rates
    roll_acc, pitch_acc, yaw_acc = accelerations
    sr, cr = math.sin(roll), math.cos(roll)
    sp, cp = math.sin(pitch), math.cos(pitch)
    horizontal = yaw_acc * cr - yaw_rate * roll_rate * sr
    radial = pitch_rate * yaw_rate * cr
    cross = roll_rate * pitch_rate
    return (
        roll_acc * cp - cross * sp - horizontal * sp - radial * cp,
        pitch_acc + yaw_acc * sr + yaw_rate * roll_rate * cr,
        roll_acc * sp + cross * cp + horizontal * cp - radial * sp,
    )


@numba.njit(cache=True, inline="always")
def quaternion(roll, pitch, yaw):
    """Unit quaternion (w, x, y, z) of Rz(yaw) Rx(roll) Ry(pitch)."""
    cr, sr = math.cos(0.5 * roll), math.sin(0.5 * roll)
    cp, sp = math.cos(0.5 * pitch), math.sin(0.5 * pitch)
    cy, sy = math.cos(0.5 * yaw), math.sin(0.5 * yaw)
    w, x, y, z = cr * cp, sr * cp, cr * sp, sr * sp  # Rx Ry
    return cy * w - sy * z, cy * x - sy * y, cy * y + sy * x, cy * z + sy * w


@numba.njit(cache=True, inline="always")
def euler_angles(w, x, y, z):
    """(roll, pitch, yaw) [rad] of a unit quaternion, roll in [-pi/2, pi/2]."""
    sin_roll = min(1.0, max(-1.0, 2.0 * (y * z + w * x)))
    pitch = math.atan2(-2.0 * (x * z - w * y), 1.0 - 2.0 * (x * x + y * y))
    yaw = math.atan2(-2.0 * (x * y - w * z), 1.0 - 2.0 * (x * x + z * z))
    return math.asin(sin_roll), pitch, yaw


@numba.njit(cache=True, nogil=True)
def tilted(attitudes, roll, pitch, out):
    """Attitudes (n, 3) turned in their own frame by Rx(roll) Ry(pitch), into `out` (n, 3)."""
    t = rotation(roll, pitch, 0.0)
    for i in range(attitudes.shape[0]):
        sr, cr = math.sin(attitudes[i, 0]), math.cos(attitudes[i, 0])
        sp, cp = math.sin(attitudes[i, 1]), math.cos(attitudes[i, 1])
        # Without the heading, which is added again.
        ahead = cp * t[0, 1] + sp * t[2, 1]
        left = sr * sp * t[0, 1] + cr * t[1, 1] - sr * cp * t[2, 1]
        x = -cr * sp * t[0, 0] + sr * t[1, 0] + cr * cp * t[2, 0]
        y = -cr * sp * t[0, 1] + sr * t[1, 1] + cr * cp * t[2, 1]
        z = -cr * sp * t[0, 2] + sr * t[1, 2] + cr * cp * t[2, 2]
        out[i, 0] = math.asin(min(1.0, max(-1.0, y)))
        out[i, 1] = math.atan2(-x, z)
        out[i, 2] = attitudes[i, 2] + math.atan2(-ahead, left)


@numba.njit(cache=True)
def rotation(roll, pitch, yaw):
    """Rotation matrix (3, 3), body to world."""
    sr, cr = math.sin(roll), math.cos(roll)
    sp, cp = math.sin(pitch), math.cos(pitch)
    sy, cy = math.sin(yaw), math.cos(yaw)
    r = np.empty((3, 3))
    r[0, 0], r[0, 1], r[0, 2] = cy * cp - sy * sr * sp, -sy * cr, cy * sp + sy * sr * cp
    r[1, 0], r[1, 1], r[1, 2] = sy * cp + cy * sr * sp, cy * cr, sy * sp - cy * sr * cp
    r[2, 0], r[2, 1], r[2, 2] = -cr * sp, sr, cr * cp
    return r


@numba.njit(cache=True, nogil=True)
def rotations(attitude):
    """Rotation matrices (m, 3, 3) of attitudes (m, 3)."""
    r = np.empty((attitude.shape[0], 3, 3))
    for k in range(attitude.shape[0]):
        r[k] = rotation(attitude[k, 0], attitude[k, 1], attitude[k, 2])
    return r
