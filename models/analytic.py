"""The paper's equations of motion, integrated with RK4, compiled and batched.

Translation, thrust lag and attitude loops are those of Kooi and Babuska (IROS 2021) with the
attitude matrix corrected (see `attitude.py`). Two attitude models:

- ``kinematic``: the paper's first-order loops, d(angle)/dt = (k command - angle)/tau;
- ``rate_loop``: the same loops with a rate loop of bandwidth B under them, as the MuJoCo vehicle has:
  d2(angle)/dt2 = B (rate_wanted - rate) - rate/tau, poles exactly -1/tau and -B.
"""

import math

import numba
import numpy as np

from inclined_landing.models.attitude import (
    LAG,
    PITCH,
    PITCH_COMMAND,
    PWM,
    ROLL,
    ROLL_COMMAND,
    VX,
    VY,
    VZ,
    WX,
    WY,
    WZ,
    YAW_RATE_COMMAND,
    body_rates,
    euler_rates,
)
from inclined_landing.models.parameters import Vehicle
from inclined_landing.models.perturbation import (
    DRAG_CHANGE,
    GAIN_SCALE,
    LAG_SCALE,
    MASS_SCALE,
    NEUTRAL,
    THRUST_BIAS,
    THRUST_SCALE,
    TIME_CONSTANT_SCALE,
)

# The integrated vector: position, velocity, Euler angles, lag, Euler rates (rate loop only).
_PHI, _THETA, _PSI, _OMEGA, _RATES, _SIZE = 6, 7, 8, 9, 10, 13


def pack(vehicle: Vehicle) -> np.ndarray:
    """The constants the kernels need, as one flat array in the order `_unpack` documents."""
    v = vehicle
    return np.array(
        [
            v.body_mass,
            v.environment_gravity,
            v.thrust_lag_rate,
            v.thrust_state_gain,
            v.thrust_direct_gain,
            v.motor_count,
            *v.motor_pwm_to_force,
            *v.motor_pwm_to_speed,
            *v.drag_coefficients,
            v.attitude_gain,
            v.attitude_time_constant,
            v.attitude_bandwidth,
            v.attitude_yaw_bandwidth,
        ]
    )


@numba.njit(cache=True, inline="always")
def rotor_speed_sum(thrust, c):
    """Sum of rotor speeds [rad/s] at total thrust [N] through the static maps; 0 without thrust.

    Below the force that the map gives at PWM 0 the sum goes linearly to zero.
    """
    motors = c[5]
    force = thrust / motors
    if force <= 0.0:
        return 0.0
    if force < c[8]:
        return motors * c[10] * force / c[8]
    pwm = (-c[7] + math.sqrt(c[7] * c[7] + 4.0 * c[6] * (force - c[8]))) / (2.0 * c[6])
    return motors * (c[9] * pwm + c[10])


@numba.njit(cache=True, inline="always")
def total_thrust(lag, pwm, c, p):
    """Total thrust F_t [N] from the lag state and the PWM command."""
    return p[THRUST_SCALE] * (c[3] * lag + c[4] * pwm) + p[THRUST_BIAS]


@numba.njit(cache=True)
def _derivative(y, u, c, p, rate_loop, dy):
    """dy/dt of the integrated vector y (13,) under command u (4,)."""
    sr, cr = math.sin(y[_PHI]), math.cos(y[_PHI])
    sp, cp = math.sin(y[_THETA]), math.cos(y[_THETA])
    sy, cy = math.sin(y[_PSI]), math.cos(y[_PSI])
    r00, r01, r02 = cy * cp - sy * sr * sp, -sy * cr, cy * sp + sy * sr * cp
    r10, r11, r12 = sy * cp + cy * sr * sp, cy * cr, sy * sp - cy * sr * cp
    r20, r21, r22 = -cr * sp, sr, cr * cp
    vx, vy, vz = y[VX], y[VY], y[VZ]
    thrust = total_thrust(y[_OMEGA], u[PWM], c, p)
    speed = rotor_speed_sum(thrust, c) * (1.0 + p[DRAG_CHANGE])
    fx = c[11] * speed * (r00 * vx + r10 * vy + r20 * vz)
    fy = c[12] * speed * (r01 * vx + r11 * vy + r21 * vz)
    fz = c[13] * speed * (r02 * vx + r12 * vy + r22 * vz) + thrust
    mass = c[0] * p[MASS_SCALE]
    dy[0], dy[1], dy[2] = vx, vy, vz
    dy[VX] = (r00 * fx + r01 * fy + r02 * fz) / mass
    dy[VY] = (r10 * fx + r11 * fy + r12 * fz) / mass
    dy[VZ] = (r20 * fx + r21 * fy + r22 * fz) / mass - c[1]
    dy[_OMEGA] = (u[PWM] - c[2] * y[_OMEGA]) / p[LAG_SCALE]
    gain, tau = c[14] * p[GAIN_SCALE], c[15] * p[TIME_CONSTANT_SCALE]
    roll_wanted = (gain * u[ROLL_COMMAND] - y[_PHI]) / tau
    pitch_wanted = (gain * u[PITCH_COMMAND] - y[_THETA]) / tau
    if rate_loop:
        phid, thetad, psid = y[_RATES], y[_RATES + 1], y[_RATES + 2]
        dy[_PHI], dy[_THETA], dy[_PSI] = phid, thetad, psid
        dy[_RATES] = c[16] * (roll_wanted - phid) - phid / tau
        dy[_RATES + 1] = c[16] * (pitch_wanted - thetad) - thetad / tau
        dy[_RATES + 2] = c[17] * (u[YAW_RATE_COMMAND] - psid)
    else:
        dy[_PHI], dy[_THETA], dy[_PSI] = roll_wanted, pitch_wanted, u[YAW_RATE_COMMAND]


@numba.njit(cache=True)
def step(state, commands, c, p, rate_loop, dt, substeps):
    """Advance every vehicle in place by substeps * dt with RK4.

    state (n, 13) with the columns of `attitude.py`, commands (n, 4) held constant, c from `pack`,
    p (n, 7) perturbations, rate_loop: which attitude model. With the kinematic model the body rates
    in the state are those of the first-order loops at the end of the step.
    """
    size = _SIZE if rate_loop else _RATES
    y, z, total = np.zeros(_SIZE), np.zeros(_SIZE), np.zeros(_SIZE)
    k = np.zeros(_SIZE)
    for i in range(state.shape[0]):
        s, u = state[i], commands[i]
        y[:9] = s[:9]
        y[_OMEGA] = s[LAG]
        y[_RATES], y[_RATES + 1], y[_RATES + 2] = euler_rates(s[ROLL], s[PITCH], s[WX], s[WY], s[WZ])
        for _ in range(substeps):
            _derivative(y, u, c, p[i], rate_loop, k)
            for j in range(size):
                total[j] = k[j]
                z[j] = y[j] + 0.5 * dt * k[j]
            _derivative(z, u, c, p[i], rate_loop, k)
            for j in range(size):
                total[j] += 2.0 * k[j]
                z[j] = y[j] + 0.5 * dt * k[j]
            _derivative(z, u, c, p[i], rate_loop, k)
            for j in range(size):
                total[j] += 2.0 * k[j]
                z[j] = y[j] + dt * k[j]
            _derivative(z, u, c, p[i], rate_loop, k)
            for j in range(size):
                y[j] += dt / 6.0 * (total[j] + k[j])
        s[:9] = y[:9]
        s[LAG] = y[_OMEGA]
        if not rate_loop:
            y[_RATES], y[_RATES + 1], y[_RATES + 2] = loop_rates(y[_PHI], y[_THETA], u, c, p[i])
        s[WX], s[WY], s[WZ] = body_rates(y[_PHI], y[_THETA], y[_RATES], y[_RATES + 1], y[_RATES + 2])


@numba.njit(cache=True, inline="always")
def loop_rates(roll, pitch, u, c, p):
    """Euler rates [rad/s] of the paper's first-order loops at (roll, pitch) under command u (4,)."""
    gain, tau = c[14] * p[GAIN_SCALE], c[15] * p[TIME_CONSTANT_SCALE]
    return (
        (gain * u[ROLL_COMMAND] - roll) / tau,
        (gain * u[PITCH_COMMAND] - pitch) / tau,
        u[YAW_RATE_COMMAND],
    )


def derivative(state: np.ndarray, command: np.ndarray, vehicle: Vehicle, rate_loop=False):
    """Time derivative of one state, for model comparison.

    state (13,), command (4,). Returns a dict with `acceleration` (3,) [m/s2], `euler_rates` (3,)
    [rad/s], `lag_rate` [PWM] and, for the rate loop, `euler_accelerations` (3,) [rad/s2].
    """
    y, dy = np.zeros(_SIZE), np.zeros(_SIZE)
    y[:9], y[_OMEGA] = state[:9], state[LAG]
    y[_RATES:] = euler_rates(state[ROLL], state[PITCH], state[WX], state[WY], state[WZ])
    _derivative(y, np.asarray(command, float), pack(vehicle), np.array(NEUTRAL), rate_loop, dy)
    result = {
        "acceleration": dy[VX : VZ + 1].copy(),
        "euler_rates": dy[_PHI : _PSI + 1].copy(),
        "lag_rate": float(dy[_OMEGA]),
    }
    if rate_loop:
        result["euler_accelerations"] = dy[_RATES:].copy()
    return result
