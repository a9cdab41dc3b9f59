"""State columns and attitude conversions, compiled and batched.

Attitude is R = Rz(yaw) Rx(roll) Ry(pitch): positive pitch accelerates +x, positive roll -y. This is
the paper's matrix with two misprints corrected (as printed it is not orthonormal).

A vehicle's state is one row of an (n, 13) float64 array, columns X .. LAG below.
"""

import math

import numpy as np

from inclined_landing.models.compiled import formula, inlined, inner, kernel, unlocked

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

# The first terms of their series that rounding leaves at pi/4: (-1)^k/(2 k + 1)! and (-1)^k/(2 k)!.
_SINE = tuple((-1) ** k / math.factorial(2 * k + 1) for k in range(8))
_COSINE = tuple((-1) ** k / math.factorial(2 * k) for k in range(9))
# pi/2, its first part with so few bits that its multiples up to 2^17 are exact.
_QUARTER_HIGH = math.floor(0.5 * math.pi * 2.0**33) / 2.0**33
_QUARTER_LOW = 6.077100506506192e-11  # pi/2 less that
_SINGULAR = 1e-6  # smallest |cos(roll)| used in divisions: the ZXY chart ends at roll = 90 deg


@inlined
def small_sine_cosine(angle):
    """Return sine and cosine of an angle [rad] of at most pi/4 by a Taylor series, exact to rounding."""
    x, s, c = angle * angle, _SINE, _COSINE
    odd = s[4] + x * (s[5] + x * (s[6] + x * s[7]))
    odd = s[0] + x * (s[1] + x * (s[2] + x * (s[3] + x * odd)))
    even = c[4] + x * (c[5] + x * (c[6] + x * (c[7] + x * c[8])))
    even = c[0] + x * (c[1] + x * (c[2] + x * (c[3] + x * even)))
    return angle * odd, even


@inner
def sine_cosine(angle):
    """Return sine and cosine of an angle [rad] up to 1e5, exact to rounding; faster than `math`."""
    # angle = k pi/2 + x, |x| <= pi/4, with pi/2 in two parts
    k = math.floor(angle * (2.0 / math.pi) + 0.5)
    s, c = small_sine_cosine((angle - k * _QUARTER_HIGH) - k * _QUARTER_LOW)
    if k & 1:
        s, c = c, -s
    return (-s, -c) if k & 2 else (s, c)


@inlined
def away_from_zero(cosine):
    """Return the cosine of a roll angle, kept away from zero, where the Euler rates are undefined."""
    if abs(cosine) < _SINGULAR:
        return _SINGULAR if cosine >= 0.0 else -_SINGULAR
    return cosine


@inlined
def euler_rates(roll, pitch, wx, wy, wz):
    """Return the Euler rates (roll, pitch, yaw) [rad/s] from body rates [rad/s]."""
    return euler_rates_at(sine_cosine(roll), sine_cosine(pitch), wx, wy, wz)


@inlined
def euler_rates_at(roll, pitch, wx, wy, wz):
    """Return the same as `euler_rates`, from (sine, cosine) of roll and pitch."""
    (sr, cr), (sp, cp) = roll, pitch
    yaw_rate = (cp * wz - sp * wx) / away_from_zero(cr)
    return cp * wx + sp * wz, wy - sr * yaw_rate, yaw_rate


@inlined
def body_rates(roll, pitch, roll_rate, pitch_rate, yaw_rate):
    """Return body rates [rad/s] from Euler rates [rad/s]; the inverse of `euler_rates`."""
    return body_rates_at(sine_cosine(roll), sine_cosine(pitch), roll_rate, pitch_rate, yaw_rate)


@inlined
def body_rates_at(roll, pitch, roll_rate, pitch_rate, yaw_rate):
    """Return the same as `body_rates`, from (sine, cosine) of roll and pitch."""
    (sr, cr), (sp, cp) = roll, pitch
    return (
        roll_rate * cp - yaw_rate * cr * sp,
        pitch_rate + yaw_rate * sr,
        roll_rate * sp + yaw_rate * cr * cp,
    )


@formula
def body_accelerations(roll, pitch, rates, accelerations):
    """Return the body accelerations [rad/s2] from Euler rates and accelerations (3,) [rad/s, rad/s2]."""
    return body_accelerations_at(sine_cosine(roll), sine_cosine(pitch), rates, accelerations)


@inlined
def body_accelerations_at(roll, pitch, rates, accelerations):
    """Return the same as `body_accelerations`, from (sine, cosine) of roll and pitch."""
    (sr, cr), (sp, cp) = roll, pitch
    roll_rate, pitch_rate, yaw_rate = rates
    roll_acc, pitch_acc, yaw_acc = accelerations
    horizontal = yaw_acc * cr - yaw_rate * roll_rate * sr
    radial = pitch_rate * yaw_rate * cr
    cross = roll_rate * pitch_rate
    return (
        roll_acc * cp - cross * sp - horizontal * sp - radial * cp,
        pitch_acc + yaw_acc * sr + yaw_rate * roll_rate * cr,
        roll_acc * sp + cross * cp + horizontal * cp - radial * sp,
    )


@formula
def quaternion(roll, pitch, yaw):
    """Return the unit quaternion (w, x, y, z) of Rz(yaw) Rx(roll) Ry(pitch)."""
    (sr, cr), (sp, cp), (sy, cy) = sine_cosine(0.5 * roll), sine_cosine(0.5 * pitch), sine_cosine(0.5 * yaw)
    w, x, y, z = cr * cp, sr * cp, cr * sp, sr * sp  # Rx Ry
    return cy * w - sy * z, cy * x - sy * y, cy * y + sy * x, cy * z + sy * w


@inlined
def euler_angles(w, x, y, z):
    """Return (roll, pitch, yaw) [rad] of a unit quaternion, roll in [-pi/2, pi/2]."""
    sin_roll = min(1.0, max(-1.0, 2.0 * (y * z + w * x)))
    pitch = math.atan2(-2.0 * (x * z - w * y), 1.0 - 2.0 * (x * x + y * y))
    yaw = math.atan2(-2.0 * (x * y - w * z), 1.0 - 2.0 * (x * x + z * z))
    return math.asin(sin_roll), pitch, yaw


@unlocked
def tilted(attitudes, roll, pitch, out):
    """Write attitudes (n, 3), rotated in the body frame by Rx(roll) Ry(pitch), to `out` (n, 3)."""
    t = rotation(roll, pitch, 0.0)
    for i in range(attitudes.shape[0]):
        (sr, cr), (sp, cp) = sine_cosine(attitudes[i, 0]), sine_cosine(attitudes[i, 1])
        # Without the heading, which is added again.
        ahead = cp * t[0, 1] + sp * t[2, 1]
        left = sr * sp * t[0, 1] + cr * t[1, 1] - sr * cp * t[2, 1]
        x = -cr * sp * t[0, 0] + sr * t[1, 0] + cr * cp * t[2, 0]
        y = -cr * sp * t[0, 1] + sr * t[1, 1] + cr * cp * t[2, 1]
        z = -cr * sp * t[0, 2] + sr * t[1, 2] + cr * cp * t[2, 2]
        out[i, 0] = math.asin(min(1.0, max(-1.0, y)))
        out[i, 1] = math.atan2(-x, z)
        out[i, 2] = attitudes[i, 2] + math.atan2(-ahead, left)


@inlined
def rotation_entries(roll, pitch, yaw):
    """Return the nine entries of the rotation matrix, row by row, from (sine, cosine) of the angles."""
    (sr, cr), (sp, cp), (sy, cy) = roll, pitch, yaw
    # R = Rz(psi) Rx(phi) Ry(theta)
    first = cy * cp - sy * sr * sp, -sy * cr, cy * sp + sy * sr * cp
    second = sy * cp + cy * sr * sp, cy * cr, sy * sp - cy * sr * cp
    return first + second + (-cr * sp, sr, cr * cp)


@inlined
def to_world(r, x, y, z):
    """Return a vector of the body's axes along the world's; r: nine entries of the attitude matrix."""
    return (
        r[0] * x + r[1] * y + r[2] * z,
        r[3] * x + r[4] * y + r[5] * z,
        r[6] * x + r[7] * y + r[8] * z,
    )


@inlined
def to_body(r, x, y, z):
    """Return a vector of the world's axes along the body's: the inverse of `to_world`."""
    return (
        r[0] * x + r[3] * y + r[6] * z,
        r[1] * x + r[4] * y + r[7] * z,
        r[2] * x + r[5] * y + r[8] * z,
    )


@inlined
def entries(r):
    """Return the nine entries of a matrix (3, 3), row by row."""
    return r[0, 0], r[0, 1], r[0, 2], r[1, 0], r[1, 1], r[1, 2], r[2, 0], r[2, 1], r[2, 2]


@kernel
def rotation(roll, pitch, yaw):
    """Return the rotation matrix (3, 3) from body to world."""
    of = rotation_entries(sine_cosine(roll), sine_cosine(pitch), sine_cosine(yaw))
    r = np.empty((3, 3))
    for k in range(9):
        r[k // 3, k % 3] = of[k]
    return r


@unlocked
def rotations(attitude):
    """Return the rotation matrices (m, 3, 3) of attitudes (m, 3)."""
    r = np.empty((attitude.shape[0], 3, 3))
    for k in range(attitude.shape[0]):
        r[k] = rotation(attitude[k, 0], attitude[k, 1], attitude[k, 2])
    return r
