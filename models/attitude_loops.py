"""The attitude loops of the equations, compiled: their rates and accelerations, and exact solutions.

Two models, after Kooi and Babuska (IROS 2021):

- ``kinematic``: the paper's first-order loops, d(angle)/dt = (k command - angle)/tau;
- ``rate_loop``: the same loops with a rate loop of bandwidth B under them, as the MuJoCo vehicle has:
  d2(angle)/dt2 = B (rate_wanted - rate) + d(rate_wanted)/dt, the latter at a held command, -rate/tau: poles
  exactly -1/tau and -B; with another damping than 1 the rate terms are that many times as large.

With integral gains, k_i = integral/tau, both want the rate (k command - angle + integral I)/tau for roll and
pitch, dI/dt = k command - angle. I is held where it would grow beyond +-integral_limit (anti-windup).

Symbols of the comments: phi, theta, psi roll, pitch and yaw.
"""

import math

import numba
import numpy as np

from inclined_landing.models.attitude import PITCH_COMMAND, ROLL_COMMAND, YAW_RATE_COMMAND
from inclined_landing.models.perturbation import GAIN_SCALE, TIME_CONSTANT_SCALE


@numba.njit(cache=True, inline="always")
def estimated_angles(roll, pitch, yaw, vx, vy, vz, v):
    """Return roll and pitch [rad] of the onboard estimate at a velocity [m/s] in the world."""
    lean = v.effects.estimator_lean
    if lean == 0.0:
        return roll, pitch
    sr, cr = math.sin(roll), math.cos(roll)
    sp, cp = math.sin(pitch), math.cos(pitch)
    sy, cy = math.sin(yaw), math.cos(yaw)
    forward = (cy * cp - sy * sr * sp) * vx + (sy * cp + cy * sr * sp) * vy - cr * sp * vz
    left = -sy * cr * vx + cy * cr * vy + sr * vz
    # phi_e = phi + lean v_left, theta_e = theta - lean v_forward, (v_forward, v_left, .) = R^T v
    return roll + lean * left, pitch - lean * forward


@numba.njit(cache=True, inline="always")
def angle_errors(roll, pitch, u, v, p):
    """Return the errors [rad] of roll and pitch of the onboard estimate under a command u (4,)."""
    # k (phi_c + trim) - phi_e, theta alike
    gain = v.attitude.gain * p[GAIN_SCALE]
    return (
        gain * (u[ROLL_COMMAND] + v.effects.attitude_trim[0]) - roll,
        gain * (u[PITCH_COMMAND] + v.effects.attitude_trim[1]) - pitch,
    )


@numba.njit(cache=True, inline="always")
def loop_rates(errors, integrals, u, v, p):
    """Return the Euler rates [rad/s] of the paper's first-order loops under a command u (4,).

    errors: of `angle_errors`; integrals: of these over time [rad s], numbers for roll and pitch.
    """
    # dphi/dt = (error + integral I)/tau, theta alike; dpsi/dt = k_psi r_c + drift
    tau, integral = v.attitude.time_constant * p[TIME_CONSTANT_SCALE], v.effects.attitude_integral
    return (
        (errors[0] + integral * integrals[0]) / tau,
        (errors[1] + integral * integrals[1]) / tau,
        v.attitude.yaw_gain * u[YAW_RATE_COMMAND] + v.effects.yaw_drift,
    )


@numba.njit(cache=True, inline="always")
def integral_rate(integral, error, v):
    """Return dI/dt [rad] of an angle error's integral I [rad s]."""
    if abs(integral) >= v.attitude.integral_limit and integral * error > 0.0:
        return 0.0
    return error


@numba.njit(cache=True, inline="always")
def rate_loop_acceleration(commanded_rate, rate, integrated, bandwidth, tau, damping):
    """Return the angular acceleration [rad/s2] of the loop whose poles are -1/tau and -B with damping 1.

    integrated: integral dI/dt [rad/s], with which the poles of the first-order loop stay too.
    """
    # d2phi/dt2 = B (rate_c - rate) + (integral dI/dt - rate)/tau - (damping - 1) (B + 1/tau) rate
    beyond = (damping - 1.0) * (bandwidth + 1.0 / tau)
    return bandwidth * (commanded_rate - rate) + (integrated - rate) / tau - beyond * rate


@numba.njit(cache=True, nogil=True)
def angle_steps(axis, command, twist, start, dt, vehicle):
    """Return the angle (m + 1,) [rad] of the roll (axis 0) or pitch (1) loop, solved exactly.

    The loop starts at rest at `start` [rad]. command (m,) [rad] and twist (m,) further angular accelerations
    [rad/s2] are held for `dt` [s] each.
    """
    v = vehicle[0]
    if v.effects.attitude_integral != 0.0:
        return integrated_angle_steps(axis, command, twist, start, dt, vehicle)[:, 0].copy()
    a, b = 1.0 / v.attitude.time_constant, v.attitude.bandwidth
    gain, trim = v.attitude.gain, v.effects.attitude_trim[axis]
    # a = 1/tau, b = B: x'' = a b (rest - x) - damping (a + b) x', rest = k (command + trim) + twist/(a b).
    # Poles -mean +- half. Off the rest, e = x - rest, over one step:
    #   e   <- stay e + drive x',          stay = exp(-mean dt) cosh(half dt) + mean drive
    #   x'  <- (stay - 2 mean drive) x' - a b drive e,   drive = exp(-mean dt) sinh(half dt)/half
    # with cos and sin of |half| dt where the poles are complex.
    mean = 0.5 * v.attitude.damping * (a + b)
    square = mean * mean - a * b
    half = math.sqrt(abs(square))
    if square > 0.0:
        slow, apart = math.exp(-(mean - half) * dt), 2.0 * half * dt
        drive = slow * dt * -math.expm1(-apart) / apart
        stay = slow + (mean - half) * drive
    else:
        slow, swing = math.exp(-mean * dt), half * dt
        drive = slow * dt * (math.sin(swing) / swing if swing > 0.0 else 1.0)
        stay = slow * math.cos(swing) + mean * drive
    out, rate = np.empty(len(command) + 1), 0.0
    out[0] = start
    for k in range(len(command)):
        rest = gain * (command[k] + trim) + twist[k] / (a * b)
        off = out[k] - rest
        out[k + 1] = rest + stay * off + drive * rate
        rate = (stay - 2.0 * mean * drive) * rate - a * b * drive * off
    return out


@numba.njit(cache=True, nogil=True)
def integrated_angle_steps(axis, command, twist, start, dt, vehicle):
    """Return the angle [rad] and the integral of its error [rad s] (m + 1, 2) of a loop with integral gains.

    Arguments as of `angle_steps`; the integral starts as it holds the first twist. Exact within the
    integral's limit, to which it is held after each step.
    """
    v = vehicle[0]
    a, b, integral = 1.0 / v.attitude.time_constant, v.attitude.bandwidth, v.effects.attitude_integral
    # Of z = (x - k (command + trim), x', I, twist):
    #   x'' = a b (integral I - z_0) - a integral z_0 - damping (a + b) x' + twist,  I' = -z_0
    rates = np.zeros((4, 4))
    rates[0, 1], rates[2, 0] = 1.0, -1.0
    rates[1] = -a * (b + integral), -v.attitude.damping * (a + b), a * b * integral, 1.0
    advance = _exponential(rates * dt)
    out, z, limit = np.empty((len(command) + 1, 2)), np.zeros(4), v.attitude.integral_limit
    z[2] = min(limit, max(-limit, -twist[0] / (a * b * integral)))
    out[0] = start, z[2]
    for k in range(len(command)):
        wanted = v.attitude.gain * (command[k] + v.effects.attitude_trim[axis])
        z[0], z[3] = out[k, 0] - wanted, twist[k]
        z = advance @ z
        z[2] = min(limit, max(-limit, z[2]))
        out[k + 1] = z[0] + wanted, z[2]
    return out


@numba.njit(cache=True)
def _exponential(matrix):
    """Return the exponential of a matrix (n, n), by scaling and squaring of its Taylor series."""
    halves = max(0, math.ceil(math.log2(np.abs(matrix).sum(axis=0).max() + 1e-300)) + 4)
    scaled = matrix / 2.0**halves  # of norm 1/16: the series ends at 16^-12/12! = 1e-23
    term, out = np.eye(len(matrix)), np.eye(len(matrix))
    for k in range(1, 12):
        term = term @ scaled / k
        out += term
    for _ in range(halves):
        out = out @ out
    return out


@numba.njit(cache=True, nogil=True)
def yaw_steps(command, dt, vehicle):
    """Return yaw (m + 1,) [rad] from 0, first at the first of the commanded rates (m,) [rad/s]; exact.

    Each rate is held for `dt` [s].
    """
    gain, bandwidth = vehicle[0].attitude.yaw_gain, vehicle[0].attitude.yaw_bandwidth
    drift, decay = vehicle[0].effects.yaw_drift, math.exp(-bandwidth * dt)
    out, rate = np.zeros(len(command) + 1), gain * command[0] + drift
    for k in range(len(command)):
        # r <- r_c + (r - r_c) exp(-B_psi dt), and its integral; r_c = k_psi command + drift
        commanded = gain * command[k] + drift
        out[k + 1] = out[k] + commanded * dt + (rate - commanded) * (1.0 - decay) / bandwidth
        rate = commanded + (rate - commanded) * decay
    return out
