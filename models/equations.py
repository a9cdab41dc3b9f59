"""The paper's equations of motion, integrated with RK4, compiled and batched.

Translation, thrust lag and attitude loops are those of Kooi and Babuska (IROS 2021) with the
attitude matrix corrected (see `attitude.py`). Two attitude models:

- ``kinematic``: the paper's first-order loops, d(angle)/dt = (k command - angle)/tau;
- ``rate_loop``: the same loops with a rate loop of bandwidth B under them, as the MuJoCo vehicle has:
  d2(angle)/dt2 = B (rate_wanted - rate) - rate/tau, poles exactly -1/tau and -B.

The named effects of the vehicle (`effects_...`; see `effects/`) are terms of the same equations, left
out while all are neutral. Delays are not equations: the plant shifts the commands.
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
# The packed constants of the effects (see `pack`), the last one telling whether any is not neutral.
_INERTIA, _ARM, _DISC_HEIGHT, _DISC_RADIUS, _SURFACE, _HALF_LENGTH, _HALF_DEPTH = 18, 20, 21, 22, 23, 24, 25
_SAG_REFERENCE, _V_REFERENCE, _V_OPEN, _V_DROP, _V_DISCHARGE = range(26, 31)
_BIAS, _FADE, _SAG, _SENSITIVITY, _SPIN_DOWN, _BODY_DRAG, _WIND_X, _WIND_Y = range(31, 39)
_LIFT, _INFLOW, _GROUND, _COM_X, _COM_Y, _TRIM_ROLL, _TRIM_PITCH, _YAW_DRIFT, _ACTIVE = range(39, 48)
# What a vehicle meets: time [s], battery voltage [V] (NaN: that of the vehicle file), inclination of the
# platform [rad] and whether it is there.
AMBIENT_SIZE = 4
TIME, VOLTAGE, INCLINATION, PRESENT = range(AMBIENT_SIZE)


def pack(vehicle: Vehicle) -> np.ndarray:
    """The constants the kernels need, as one flat array in the order `_unpack` documents."""
    v = vehicle
    effects = [
        v.effects_thrust_bias,
        v.effects_thrust_fade,
        v.effects_battery_sag,
        v.effects_voltage_sensitivity,
        v.effects_spin_down,
        v.effects_body_drag,
        *v.effects_wind,
        v.effects_translational_lift,
        v.effects_axial_inflow,
        v.effects_ground_effect,
        *v.effects_com_offset,
        *v.effects_attitude_trim,
        v.effects_yaw_drift,
    ]
    battery = [
        v.effects_battery_reference,
        v.effects_voltage_reference,
        v.effects_voltage_open,
        v.effects_voltage_drop,
        v.effects_voltage_discharge,
    ]
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
            *v.body_inertia[:2],
            v.rotor_arm,
            v.rotor_height,
            v.rotor_radius,
            v.platform_surface_height,
            v.slab_half_length,
            0.5 * v.platform_depth,
            *battery,
            *effects,
            float(any(effects)),
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


@numba.njit(cache=True, inline="always")
def loop_rates(roll, pitch, u, c, p):
    """Euler rates [rad/s] of the paper's first-order loops at (roll, pitch) under command u (4,)."""
    gain, tau = c[14] * p[GAIN_SCALE], c[15] * p[TIME_CONSTANT_SCALE]
    return (
        (gain * (u[ROLL_COMMAND] + c[_TRIM_ROLL]) - roll) / tau,
        (gain * (u[PITCH_COMMAND] + c[_TRIM_PITCH]) - pitch) / tau,
        u[YAW_RATE_COMMAND] + c[_YAW_DRIFT],
    )


@numba.njit(cache=True, inline="always")
def lag_derivative(lag, pwm, c, p):
    """dOmega/dt [PWM] of the thrust lag; slower while it spins down, with that effect."""
    rate = (pwm - c[2] * lag) / p[LAG_SCALE]
    if c[_SPIN_DOWN] != 0.0 and rate < 0.0:
        rate /= 1.0 + c[_SPIN_DOWN]
    return rate


@numba.njit(cache=True, inline="always")
def powered_thrust(thrust, lag, time, voltage, c):
    """Thrust [N] with bias, fade, sag under load and battery voltage: what changes the rotor speed."""
    load = c[2] * lag
    if math.isnan(voltage):
        voltage = c[_V_OPEN] - c[_V_DROP] * load - c[_V_DISCHARGE] * time
    return (
        (thrust + c[_BIAS])
        * (1.0 - c[_FADE] * time)
        * (1.0 - c[_SAG] * (load / c[_SAG_REFERENCE] - 1.0))
        * (1.0 + c[_SENSITIVITY] * (voltage - c[_V_REFERENCE]))
    )


@numba.njit(cache=True)
def ground_effect(position, r, thrust, inclination, present, c):
    """Extra thrust [N] and body torque (x, y) [N m] of the rotors near a surface.

    position (3,), attitude r (3, 3), thrust [N] of all rotors. Each rotor sees the slab or else the floor
    along its axis; its thrust grows by strength (radius/(4 h))^2 with h the distance along the surface's
    normal, the ratio radius/(4 h) at most 1/2.
    """
    extra, torque_x, torque_y = 0.0, 0.0, 0.0
    if r[2, 2] <= 0.0:
        return extra, torque_x, torque_y
    si, ci = math.sin(inclination), math.cos(inclination)
    facing = si * r[0, 2] + ci * r[2, 2]  # of the rotor's axis and the slab's normal
    for side in range(4):
        x = c[_ARM] if side < 2 else -c[_ARM]
        y = c[_ARM] if side % 2 == 0 else -c[_ARM]
        px = position[0] + r[0, 0] * x + r[0, 1] * y + r[0, 2] * c[_DISC_HEIGHT]
        py = position[1] + r[1, 0] * x + r[1, 1] * y + r[1, 2] * c[_DISC_HEIGHT]
        pz = position[2] + r[2, 0] * x + r[2, 1] * y + r[2, 2] * c[_DISC_HEIGHT]
        height = pz
        if present != 0.0 and facing > 0.0:
            normal = si * px + ci * (pz - c[_SURFACE])
            along = ci * px - si * (pz - c[_SURFACE])
            down = normal / facing  # along the rotor's axis
            along -= down * (ci * r[0, 2] - si * r[2, 2])
            across = py - down * r[1, 2]
            if normal > 0.0 and abs(along) <= c[_HALF_LENGTH] and abs(across) <= c[_HALF_DEPTH]:
                height = normal
        ratio = 0.5
        if height > 0.5 * c[_DISC_RADIUS]:
            ratio = c[_DISC_RADIUS] / (4.0 * height)
        force = 0.25 * thrust * c[_GROUND] * ratio * ratio
        extra += force
        torque_x += y * force
        torque_y -= x * force
    return extra, torque_x, torque_y


@numba.njit(cache=True, inline="always")
def wrench(position, velocity, r, lag, pwm, ambient, c, p, out):
    """Force (3,) [N] and torque (x, y) [N m] on the vehicle in its body frame, without gravity, into `out`.

    position, velocity (3,) in the world, attitude r (3, 3), lag state and PWM, ambient (AMBIENT_SIZE,).
    """
    thrust = total_thrust(lag, pwm, c, p)
    ax, ay, az = velocity[0], velocity[1], velocity[2]
    out[3] = out[4] = 0.0
    active = c[_ACTIVE] != 0.0
    if active:
        thrust = powered_thrust(thrust, lag, ambient[TIME], ambient[VOLTAGE], c)
        ax -= c[_WIND_X]
        ay -= c[_WIND_Y]
    speed = rotor_speed_sum(thrust, c) * (1.0 + p[DRAG_CHANGE])
    bx = r[0, 0] * ax + r[1, 0] * ay + r[2, 0] * az
    by = r[0, 1] * ax + r[1, 1] * ay + r[2, 1] * az
    bz = r[0, 2] * ax + r[1, 2] * ay + r[2, 2] * az
    out[0], out[1], out[2] = c[11] * speed * bx, c[12] * speed * by, c[13] * speed * bz
    if active:
        thrust *= (1.0 + c[_LIFT] * (bx * bx + by * by)) * max(0.0, 1.0 - c[_INFLOW] * bz)
        if c[_GROUND] != 0.0:
            extra, out[3], out[4] = ground_effect(
                position, r, thrust, ambient[INCLINATION], ambient[PRESENT], c
            )
            thrust += extra
        out[3] -= c[_COM_Y] * thrust
        out[4] += c[_COM_X] * thrust
        drag = -c[_BODY_DRAG] * math.sqrt(bx * bx + by * by + bz * bz)
        out[0] += drag * bx
        out[1] += drag * by
        out[2] += drag * bz
    out[2] += thrust


@numba.njit(cache=True)
def _derivative(y, u, ambient, c, p, rate_loop, r, f, dy):
    """dy/dt of the integrated vector y (13,) under command u (4,); r (3, 3) and f (5,) are scratch."""
    sr, cr = math.sin(y[_PHI]), math.cos(y[_PHI])
    sp, cp = math.sin(y[_THETA]), math.cos(y[_THETA])
    sy, cy = math.sin(y[_PSI]), math.cos(y[_PSI])
    r[0, 0], r[0, 1], r[0, 2] = cy * cp - sy * sr * sp, -sy * cr, cy * sp + sy * sr * cp
    r[1, 0], r[1, 1], r[1, 2] = sy * cp + cy * sr * sp, cy * cr, sy * sp - cy * sr * cp
    r[2, 0], r[2, 1], r[2, 2] = -cr * sp, sr, cr * cp
    wrench(y[:3], y[VX : VZ + 1], r, y[_OMEGA], u[PWM], ambient, c, p, f)
    mass = c[0] * p[MASS_SCALE]
    for k in range(3):
        dy[k] = y[VX + k]
        dy[VX + k] = (r[k, 0] * f[0] + r[k, 1] * f[1] + r[k, 2] * f[2]) / mass
    dy[VZ] -= c[1]
    dy[_OMEGA] = lag_derivative(y[_OMEGA], u[PWM], c, p)
    roll_wanted, pitch_wanted, yaw_wanted = loop_rates(y[_PHI], y[_THETA], u, c, p)
    if rate_loop:
        phid, thetad, psid = y[_RATES], y[_RATES + 1], y[_RATES + 2]
        tau = c[15] * p[TIME_CONSTANT_SCALE]
        dy[_PHI], dy[_THETA], dy[_PSI] = phid, thetad, psid
        dy[_RATES] = c[16] * (roll_wanted - phid) - phid / tau
        dy[_RATES + 1] = c[16] * (pitch_wanted - thetad) - thetad / tau
        dy[_RATES + 2] = c[17] * (yaw_wanted - psid)
        if f[3] != 0.0 or f[4] != 0.0:
            a, b, d = euler_rates(y[_PHI], y[_THETA], f[3] / c[_INERTIA], f[4] / c[_INERTIA + 1], 0.0)
            dy[_RATES] += a
            dy[_RATES + 1] += b
            dy[_RATES + 2] += d
    else:
        dy[_PHI], dy[_THETA], dy[_PSI] = roll_wanted, pitch_wanted, yaw_wanted


@numba.njit(cache=True)
def step(state, commands, c, p, rate_loop, dt, substeps):
    """Advance every vehicle in place by substeps * dt with RK4, at time 0 without platform.

    Like `advance`; only effects that depend on time, voltage or surfaces see the difference.
    """
    ambient = np.zeros((state.shape[0], AMBIENT_SIZE))
    ambient[:, VOLTAGE] = np.nan
    advance(state, commands, ambient, c, p, rate_loop, dt, substeps)


@numba.njit(cache=True)
def advance(state, commands, ambient, c, p, rate_loop, dt, substeps):
    """Advance every vehicle, and its time, in place by substeps * dt with RK4.

    state (n, 13) with the columns of `attitude.py`, commands (n, 4) held constant, ambient (n, 4) with
    the columns time, voltage, inclination, present, c from `pack`, p (n, 7) perturbations, rate_loop:
    which attitude model. With the kinematic model the body rates in the state are those of the
    first-order loops at the end of the step, and torques have no effect.
    """
    size = _SIZE if rate_loop else _RATES
    y, z, total = np.zeros(_SIZE), np.zeros(_SIZE), np.zeros(_SIZE)
    k, r, f = np.zeros(_SIZE), np.empty((3, 3)), np.zeros(5)
    for i in range(state.shape[0]):
        s, u, around = state[i], commands[i], ambient[i]
        y[:9] = s[:9]
        y[_OMEGA] = s[LAG]
        y[_RATES], y[_RATES + 1], y[_RATES + 2] = euler_rates(s[ROLL], s[PITCH], s[WX], s[WY], s[WZ])
        for _ in range(substeps):
            _derivative(y, u, around, c, p[i], rate_loop, r, f, k)
            for j in range(size):
                total[j] = k[j]
                z[j] = y[j] + 0.5 * dt * k[j]
            around[TIME] += 0.5 * dt
            _derivative(z, u, around, c, p[i], rate_loop, r, f, k)
            for j in range(size):
                total[j] += 2.0 * k[j]
                z[j] = y[j] + 0.5 * dt * k[j]
            _derivative(z, u, around, c, p[i], rate_loop, r, f, k)
            for j in range(size):
                total[j] += 2.0 * k[j]
                z[j] = y[j] + dt * k[j]
            around[TIME] += 0.5 * dt
            _derivative(z, u, around, c, p[i], rate_loop, r, f, k)
            for j in range(size):
                y[j] += dt / 6.0 * (total[j] + k[j])
        s[:9] = y[:9]
        s[LAG] = y[_OMEGA]
        if not rate_loop:
            y[_RATES], y[_RATES + 1], y[_RATES + 2] = loop_rates(y[_PHI], y[_THETA], u, c, p[i])
        s[WX], s[WY], s[WZ] = body_rates(y[_PHI], y[_THETA], y[_RATES], y[_RATES + 1], y[_RATES + 2])


def derivative(state: np.ndarray, command: np.ndarray, vehicle: Vehicle, rate_loop=False):
    """Time derivative of one state, for model comparison.

    state (13,), command (4,). Returns a dict with `acceleration` (3,) [m/s2], `euler_rates` (3,)
    [rad/s], `lag_rate` [PWM] and, for the rate loop, `euler_accelerations` (3,) [rad/s2].
    """
    y, dy = np.zeros(_SIZE), np.zeros(_SIZE)
    y[:9], y[_OMEGA] = state[:9], state[LAG]
    y[_RATES:] = euler_rates(state[ROLL], state[PITCH], state[WX], state[WY], state[WZ])
    ambient = np.array([0.0, np.nan, 0.0, 0.0])
    c, p, command = pack(vehicle), np.array(NEUTRAL), np.asarray(command, float)
    _derivative(y, command, ambient, c, p, rate_loop, np.empty((3, 3)), np.zeros(5), dy)
    result = {
        "acceleration": dy[VX : VZ + 1].copy(),
        "euler_rates": dy[_PHI : _PSI + 1].copy(),
        "lag_rate": float(dy[_OMEGA]),
    }
    if rate_loop:
        result["euler_accelerations"] = dy[_RATES:].copy()
    return result
