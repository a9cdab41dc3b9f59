"""The paper's equations of motion, integrated with RK4, compiled and batched.

Translation, thrust lag and attitude loops are those of Kooi and Babuska (IROS 2021) with the
attitude matrix corrected (see `attitude.py`). Two attitude models:

- ``kinematic``: the paper's first-order loops, d(angle)/dt = (k command - angle)/tau;
- ``rate_loop``: the same loops with a rate loop of bandwidth B under them, as the MuJoCo vehicle has:
  d2(angle)/dt2 = B (rate_wanted - rate) - rate/tau, poles exactly -1/tau and -B; with another damping
  than 1 the rate terms are that many times as large.

The named effects of the vehicle (`effects_...`; see `effects/`) are terms of the same equations, left
out while all are neutral. Delays are not equations: the plant shifts the commands.

Symbols of the comments: position x, velocity v, attitude matrix R (body to world), F_t total thrust, f and
tau force and torque in the body frame, Omega state of the thrust lag, phi, theta, psi roll, pitch and yaw.
"""

import dataclasses
import functools
import math
from collections.abc import Callable
from operator import attrgetter
from typing import Any, NamedTuple

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
    body_accelerations,
    body_rates,
    euler_rates,
)
from inclined_landing.models.load import LOAD_SIZE, UNLOADED, hanging, pull, rectify, swing
from inclined_landing.models.parameters import load_vehicle
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
from inclined_landing.models.vehicle import Vehicle

# The integrated vector: position, velocity, Euler angles, lag, Euler rates (rate loop only), and the slung
# load's direction and its rate where there is one.
_PHI, _THETA, _PSI, _OMEGA, _RATES, _SIZE = 6, 7, 8, 9, 10, 13
_LOAD = _SIZE
_LOADED_SIZE = _LOAD + LOAD_SIZE
# Columns of a vehicle's ambient conditions: time [s], battery voltage [V] (NaN: that of the vehicle file),
# inclination of the platform [rad], whether it is there, its azimuth about the vertical [rad].
AMBIENT_SIZE = 5
TIME, VOLTAGE, INCLINATION, PRESENT, AZIMUTH = range(AMBIENT_SIZE)
STILL = np.empty((0, 6))  # no push; None would be another type, and compile everything once more
_DERIVED = ("slab_half_length", "thrust_centre")  # properties of a vehicle that the kernels take too
# Entries of [effects] that are no terms here: what other entries refer to, and what the plants do.
_NO_TERMS = frozenset(
    "battery_reference voltage_reference voltage_open voltage_drop voltage_discharge "
    "ground_fading yaw_imbalance load_length thrust_delay attitude_delay mocap_tilt mocap_delay".split()
)


class Conditions(NamedTuple):
    """What n vehicles fly under."""

    vehicle: np.ndarray  # from `pack`: (1,) for all, or (n,) with a record for each
    perturbation: np.ndarray  # (n, 7), see `perturbation.py`
    ambient: np.ndarray  # (n, AMBIENT_SIZE); `advance` moves the time on
    push: np.ndarray = STILL  # (n, 6) further acceleration [m/s2], torque [N m] in the world's axes; or STILL
    load: np.ndarray = (
        UNLOADED  # (n, 6) states of slung loads, see `load.py`, moved by `advance`; or UNLOADED
    )


# One vehicle while it is integrated, as `rk4` takes it: a record, which unlike a tuple of arrays counts no
# references. Of np.record, whose fields are attributes where Python runs the kernels (NUMBA_DISABLE_JIT) too.
_STEP = np.dtype(
    [
        ("y", float, _LOADED_SIZE),  # integrated vector
        ("command", float, 4),
        ("ambient", float, AMBIENT_SIZE),
        ("push", float, 6),  # further acceleration [m/s2] and torque [N m] in the world's axes
        ("perturbation", float, 7),
        ("torque_limits", float, 3),  # N m about the body's axes, of the rate loops
        ("pushed", bool),  # whether there is a push
        ("limited", bool),  # whether the torques are limited
        ("rate_loop", bool),  # which attitude model
        ("loaded", bool),  # whether there is a slung load
        # Working memory: a stage's integrated vector, its derivative, weighted sum of the derivatives,
        # attitude matrix, force and torque.
        *((name, float, _LOADED_SIZE) for name in ("stage", "derivative", "total")),
        *(("rotation", float, (3, 3)), ("wrench", float, 5)),
    ],
    align=True,
)
STEP = np.dtype((np.record, _STEP))


@functools.cache
def _layout() -> tuple[Callable, Callable, np.dtype]:
    """Return getters of all values of a vehicle and of its effects' terms, and the type of `pack`'s array."""
    shipped = load_vehicle()
    tables: dict[str, list[tuple]] = {}
    for field in dataclasses.fields(Vehicle):
        table, _, entry = field.name.partition("_")
        tables.setdefault(table, []).append((entry, float, np.shape(getattr(shipped, field.name))))
    names = [f"{table}_{entry}" for table in tables for entry, *_ in tables[table]]
    terms = [f"effects_{entry}" for entry, *_ in tables["effects"] if entry not in _NO_TERMS]
    more = [(name, float, np.shape(getattr(shipped, name))) for name in _DERIVED]
    layout = np.dtype([*tables.items(), *more, ("any_effect", float)])
    return attrgetter(*names, *_DERIVED), attrgetter(*terms), np.dtype((np.record, layout))


def pack(vehicle: Vehicle) -> np.ndarray:
    """Return the vehicle as the kernels take it: (1,), a record `v` whose entry `b` of table `a` is `v.a.b`.

    `v.any_effect` is 1 where any term beyond the paper's equations is not neutral, else 0. The names are
    part of the array's type, and so of a compiled kernel's signature.
    """
    values, terms, layout = _layout()
    numbers: list[float] = []
    for value in values(vehicle):
        numbers += value if isinstance(value, tuple) else (value,)
    numbers.append(any(any(x) if isinstance(x, tuple) else x for x in terms(vehicle)))
    return np.array(numbers, float).view(layout)


@numba.njit(cache=True, inline="always")
def rotor_speed_sum(thrust, v):
    """Return the sum of the rotor speeds [rad/s] at a total thrust [N], 0 without thrust.

    From the static maps of one motor, force a PWM^2 + b PWM + c and speed d PWM + e. Below the force c at
    PWM 0 the sum goes linearly to zero.
    """
    motors = v.motor.count
    to_force, to_speed = v.motor.pwm_to_force, v.motor.pwm_to_speed
    quadratic, linear, idle_force = to_force[0], to_force[1], to_force[2]
    slope, idle_speed = to_speed[0], to_speed[1]
    force = thrust / motors
    if force <= 0.0:
        return 0.0
    if force < idle_force:
        return motors * idle_speed * force / idle_force
    # a PWM^2 + b PWM + c = F_t / motors, solved for PWM; sum = motors (d PWM + e)
    pwm = (-linear + math.sqrt(linear * linear + 4.0 * quadratic * (force - idle_force))) / (2.0 * quadratic)
    return motors * (slope * pwm + idle_speed)


@numba.njit(cache=True, inline="always")
def total_thrust(lag, pwm, v, p):
    """Return the total thrust F_t [N] at a lag state [PWM s] and a PWM command."""
    # F_t = scale (c_Omega Omega + c_PWM PWM) + bias
    return p[THRUST_SCALE] * (v.thrust.state_gain * lag + v.thrust.direct_gain * pwm) + p[THRUST_BIAS]


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
def loop_rates(roll, pitch, u, v, p):
    """Return the Euler rates [rad/s] of the paper's first-order loops under a command u (4,).

    roll, pitch: those of the onboard estimate (`estimated_angles`).
    """
    # dphi/dt = (k (phi_c + trim) - phi_e)/tau, theta alike; dpsi/dt = k_psi r_c + drift
    gain, tau = v.attitude.gain * p[GAIN_SCALE], v.attitude.time_constant * p[TIME_CONSTANT_SCALE]
    return (
        (gain * (u[ROLL_COMMAND] + v.effects.attitude_trim[0]) - roll) / tau,
        (gain * (u[PITCH_COMMAND] + v.effects.attitude_trim[1]) - pitch) / tau,
        v.attitude.yaw_gain * u[YAW_RATE_COMMAND] + v.effects.yaw_drift,
    )


@numba.njit(cache=True, inline="always")
def rate_loop_acceleration(commanded_rate, rate, bandwidth, tau, damping):
    """Return the angular acceleration [rad/s2] of the loop whose poles are -1/tau and -B with damping 1."""
    # d2phi/dt2 = B (rate_c - rate) - rate/tau - (damping - 1) (B + 1/tau) rate
    beyond = (damping - 1.0) * (bandwidth + 1.0 / tau)
    return bandwidth * (commanded_rate - rate) - rate / tau - beyond * rate


@numba.njit(cache=True, nogil=True)
def angle_steps(axis, command, twist, start, dt, vehicle):
    """Return the angle (m + 1,) [rad] of the roll (axis 0) or pitch (1) loop, solved exactly.

    The loop starts at rest at `start` [rad]. command (m,) [rad] and twist (m,) further angular accelerations
    [rad/s2] are held for `dt` [s] each.
    """
    v = vehicle[0]
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


@numba.njit(cache=True, inline="always")
def lag_derivative(lag, pwm, v, p):
    """Return dOmega/dt [PWM] of the thrust lag; slower while it spins down, with that effect."""
    # dOmega/dt = (PWM - lambda Omega)/scale, over 1 + spin_down where that is negative
    rate = (pwm - v.thrust.lag_rate * lag) / p[LAG_SCALE]
    if v.effects.spin_down != 0.0 and rate < 0.0:
        rate /= 1.0 + v.effects.spin_down
    return rate


@numba.njit(cache=True, inline="always")
def lag_step(lag, pwm, dt, v):
    """Return the lag [PWM s] after `dt` [s] under a held command, and its mean over the step; exact."""
    # Omega(dt) = Omega_s + (Omega - Omega_s) exp(-lambda dt), Omega_s = PWM/lambda
    rate, steady = v.thrust.lag_rate, pwm / v.thrust.lag_rate
    if v.effects.spin_down != 0.0 and pwm < v.thrust.lag_rate * lag:
        rate /= 1.0 + v.effects.spin_down
    decay = math.exp(-rate * dt)
    mean = steady + (lag - steady) * (1.0 - decay) / (rate * dt)
    return steady + (lag - steady) * decay, mean


@numba.njit(cache=True, nogil=True)
def lags(pwm, dt, vehicle):
    """Return the lag [PWM s] (m + 1,) under commands (m,) held for `dt` [s], first steady under the first."""
    v, out = vehicle[0], np.empty(len(pwm) + 1)
    out[0] = pwm[0] / v.thrust.lag_rate
    for k in range(len(pwm)):
        out[k + 1], _ = lag_step(out[k], pwm[k], dt, v)
    return out


@numba.njit(cache=True, inline="always")
def fade(time, v):
    """Return the factor of the thrust after a flight time [s]."""
    return 1.0 - v.effects.thrust_fade * time


@numba.njit(cache=True, inline="always")
def battery_voltage(lag, time, v):
    """Return the voltage [V] of the vehicle file's battery at a lag state, after a flight time [s]."""
    # U = U_open - drop load - discharge t, the load as steady PWM: lambda Omega
    load = v.thrust.lag_rate * lag
    return v.effects.voltage_open - v.effects.voltage_drop * load - v.effects.voltage_discharge * time


@numba.njit(cache=True, inline="always")
def supply(voltage, lag, time, v):
    """Return the factor of the thrust at the battery's voltage [V]; NaN: that of the vehicle file."""
    if math.isnan(voltage):
        voltage = battery_voltage(lag, time, v)
    return 1.0 + v.effects.voltage_sensitivity * (voltage - v.effects.voltage_reference)


@numba.njit(cache=True, inline="always")
def powered_thrust(thrust, lag, time, voltage, v):
    """Return the thrust [N] that sets the rotor speed: with bias, fade, sag under load, battery voltage."""
    # F = (F_t + bias) (1 - fade t) (1 - sag (load/reference - 1)) (1 + sensitivity (U - U_ref))
    load = v.thrust.lag_rate * lag
    sag = 1.0 - v.effects.battery_sag * (load / v.effects.battery_reference - 1.0)
    return (thrust + v.effects.thrust_bias) * fade(time, v) * sag * supply(voltage, lag, time, v)


@numba.njit(cache=True, inline="always")
def intact(v):
    """Return the share of the thrust that the rotors have not lost."""
    loss = v.effects.rotor_loss
    return 1.0 - 0.25 * (loss[0] + loss[1] + loss[2] + loss[3])


@numba.njit(cache=True)
def _hover_pwm(low, high, vehicle, p):
    """Return the PWM between two bounds whose steady thrust is the weight; the upper one where none is."""
    v = vehicle[0]
    weight = (v.body.mass + v.effects.load_mass) * v.environment.gravity
    for _ in range(60):  # halves: to 1e-13 of what lies between
        pwm = 0.5 * (low + high)
        lag = pwm / v.thrust.lag_rate
        if powered_thrust(total_thrust(lag, pwm, v, p), lag, 0.0, math.nan, v) * intact(v) < weight:
            low = pwm
        else:
            high = pwm
    return high


def settled_hover(vehicle: Vehicle) -> float:
    """Return the hover PWM at time 0 with the effects on the thrust: bias, sag, voltage.

    `Vehicle.hover_pwm` where there are none; the highest command where no command carries the weight.
    """
    packed = pack(vehicle)
    if not packed["any_effect"][0]:
        return vehicle.hover_pwm
    high = max(vehicle.hover_pwm, vehicle.command_pwm_range[1])
    return _hover_pwm(0.0, high, packed, NEUTRAL)


@numba.njit(cache=True, inline="always")
def disc_inside(distance, radius):
    """Return the share of a disc on the inner side of a straight edge, its centre `distance` within."""
    # 1/2 + (d sqrt(1 - d^2) + arcsin d)/pi, the area of a circular segment with d = distance/radius
    d = min(1.0, max(-1.0, distance / radius))
    return 0.5 + (d * math.sqrt(1.0 - d * d) + math.asin(d)) / math.pi


@numba.njit(cache=True, inline="always")
def ground_gain(height, v):
    """Return the share of thrust that a rotor gains over an endless surface, at a height h [m] of its disc.

    gain = strength (radius/(4 h))^2 after Cheeseman and Bennett (1955) to first order, times the fading
    exp((4 radius - h) fading), which is 1 where the strength is read; radius/(4 h) at most 1/2, the gain 1.
    """
    ratio = 0.5
    if height > 0.5 * v.rotor.radius:
        ratio = v.rotor.radius / (4.0 * height)
    fading = math.exp((4.0 * v.rotor.radius - height) * v.effects.ground_fading)
    return min(1.0, v.effects.ground_effect * ratio * ratio * fading)


@numba.njit(cache=True)
def ground_effect(position, r, thrust, inclination, present, azimuth, v):
    """Return the extra thrust [N] and body torque (x, y) [N m] of the rotors near a surface.

    position (3,), attitude r (3, 3), thrust [N] of all rotors. Each rotor sees the slab along its axis with
    the share of its disc that is over it, and the floor with the rest; heights are along the normals.
    """
    extra, torque_x, torque_y = 0.0, 0.0, 0.0
    if r[2, 2] <= 0.0:
        return extra, torque_x, torque_y
    si, ci = math.sin(inclination), math.cos(inclination)
    sa, ca = math.sin(azimuth), math.cos(azimuth)
    lean_along, lean_across = ca * r[0, 2] + sa * r[1, 2], ca * r[1, 2] - sa * r[0, 2]  # of the rotor's axis
    facing = si * lean_along + ci * r[2, 2]  # of the rotor's axis and the slab's normal
    radius = v.rotor.radius
    for side in range(4):
        x = v.rotor.arm if side < 2 else -v.rotor.arm
        y = v.rotor.arm if side % 2 == 0 else -v.rotor.arm
        px = position[0] + r[0, 0] * x + r[0, 1] * y + r[0, 2] * v.rotor.height
        py = position[1] + r[1, 0] * x + r[1, 1] * y + r[1, 2] * v.rotor.height
        pz = position[2] + r[2, 0] * x + r[2, 1] * y + r[2, 2] * v.rotor.height
        share, gain = 0.0, 0.0
        if present != 0.0 and facing > 0.0:
            forward, beside = ca * px + sa * py, ca * py - sa * px  # horizontal, along the slope's direction
            normal = si * forward + ci * (pz - v.platform.surface_height)
            along = ci * forward - si * (pz - v.platform.surface_height)
            down = normal / facing  # along the rotor's axis
            along -= down * (ci * lean_along - si * r[2, 2])
            across = beside - down * lean_across
            if normal > 0.0 and down * r[2, 2] < pz:  # the slab is below, and the floor below it
                share = disc_inside(v.slab_half_length - abs(along), radius)
                share *= disc_inside(0.5 * v.platform.depth - abs(across), radius)
                gain = share * ground_gain(normal, v)
        if pz > 0.0:
            gain += (1.0 - share) * ground_gain(pz, v)
        # Each rotor carries a quarter: f_i = gain_i F/4, torque = sum of r_i x (0, 0, f_i)
        force = 0.25 * thrust * gain
        extra += force
        torque_x += y * force
        torque_y -= x * force
    return extra, torque_x, torque_y


@numba.njit(cache=True, inline="always")
def wrench(position, velocity, r, lag, pwm, ambient, v, p, out):
    """Write force (3,) [N] and torque (x, y) [N m] in the body frame, without gravity, into `out` (5,).

    position, velocity (3,) in the world, attitude r (3, 3), lag state and PWM, ambient (AMBIENT_SIZE,),
    vehicle v and perturbation p (7,).
    """
    thrust = total_thrust(lag, pwm, v, p)
    ax, ay, az = velocity[0], velocity[1], velocity[2]
    out[3] = out[4] = 0.0
    if v.any_effect != 0.0:
        thrust = powered_thrust(thrust, lag, ambient[TIME], ambient[VOLTAGE], v)
        ax -= v.effects.wind[0]
        ay -= v.effects.wind[1]
    # Rotor drag: f = K (sum of rotor speeds) b, b = R^T (v - wind), K diagonal
    speed = rotor_speed_sum(thrust, v) * (1.0 + p[DRAG_CHANGE])
    bx = r[0, 0] * ax + r[1, 0] * ay + r[2, 0] * az
    by = r[0, 1] * ax + r[1, 1] * ay + r[2, 1] * az
    bz = r[0, 2] * ax + r[1, 2] * ay + r[2, 2] * az
    k = v.drag.coefficients
    out[0], out[1], out[2] = k[0] * speed * bx, k[1] * speed * by, k[2] * speed * bz
    if v.any_effect != 0.0:
        # F (1 - mean loss) (1 + lift (b_x^2 + b_y^2)) max(0, 1 - inflow b_z)
        lift = 1.0 + v.effects.translational_lift * (bx * bx + by * by)
        thrust *= intact(v) * lift * max(0.0, 1.0 - v.effects.axial_inflow * bz)
        if v.effects.ground_effect != 0.0:
            extra, out[3], out[4] = ground_effect(
                position, r, thrust, ambient[INCLINATION], ambient[PRESENT], ambient[AZIMUTH], v
            )
            thrust += extra
        # Thrust at (x, y) from the centre of mass, which is at c: tau = (y F, -x F)
        out[3] += (v.thrust_centre[1] - v.effects.com_offset[1]) * thrust
        out[4] -= (v.thrust_centre[0] - v.effects.com_offset[0]) * thrust
        # Body drag: f = -c |b| b
        drag = -v.effects.body_drag * math.sqrt(bx * bx + by * by + bz * bz)
        out[0] += drag * bx
        out[1] += drag * by
        out[2] += drag * bz
    out[2] += thrust


@numba.njit(cache=True, inline="always")
def _saturation(torque, limit):
    """Return what must be added to a torque so that it is within +-limit."""
    return min(limit, max(-limit, torque)) - torque


@numba.njit(cache=True, inline="always")
def _saturations(y, dy, v, limits):
    """Return the body torque (x, y, z) [N m] by which limits (3,) [N m] change that of the loops in dy."""
    j, roll, pitch = v.body.inertia, y[_PHI], y[_THETA]
    rates = y[_RATES], y[_RATES + 1], y[_RATES + 2]
    accelerations = dy[_RATES], dy[_RATES + 1], dy[_RATES + 2]
    wx, wy, wz = body_rates(roll, pitch, rates[0], rates[1], rates[2])
    ax, ay, az = body_accelerations(roll, pitch, rates, accelerations)
    # Euler: tau = J dw/dt + w x J w
    return (
        _saturation(j[0] * ax + (j[2] - j[1]) * wy * wz, limits[0]),
        _saturation(j[1] * ay + (j[0] - j[2]) * wz * wx, limits[1]),
        _saturation(j[2] * az + (j[1] - j[0]) * wx * wy, limits[2]),
    )


@numba.njit(cache=True, inline="always")
def _swing(y, dy, mass, v):
    """Write the slung load's motion into dy, its pull added to the acceleration there, without gravity's."""
    qx, qy, qz, vx, vy, vz = y[_LOAD], y[_LOAD + 1], y[_LOAD + 2], y[_LOAD + 3], y[_LOAD + 4], y[_LOAD + 5]
    ax, ay, az = dy[VX], dy[VX + 1], dy[VZ]
    share, length = v.effects.load_mass / (mass + v.effects.load_mass), v.effects.load_length
    tension = pull(qx, qy, qz, vx, vy, vz, ax, ay, az, share, length)
    for k in range(3):
        dy[VX + k] += tension * y[_LOAD + k]
        dy[_LOAD + k] = y[_LOAD + 3 + k]
    dy[_LOAD + 3], dy[_LOAD + 4], dy[_LOAD + 5] = swing(qx, qy, qz, vx, vy, vz, ax, ay, az, length)


@numba.njit(cache=True)
def _derivative(y, s, v):
    """Write dy/dt of an integrated vector y (19,) into `s.derivative`; s: a STEP, v: the vehicle's record."""
    u, p, push, dy, r, f = s.command, s.perturbation, s.push, s.derivative, s.rotation, s.wrench
    # R = Rz(psi) Rx(phi) Ry(theta)
    sr, cr = math.sin(y[_PHI]), math.cos(y[_PHI])
    sp, cp = math.sin(y[_THETA]), math.cos(y[_THETA])
    sy, cy = math.sin(y[_PSI]), math.cos(y[_PSI])
    r[0, 0], r[0, 1], r[0, 2] = cy * cp - sy * sr * sp, -sy * cr, cy * sp + sy * sr * cp
    r[1, 0], r[1, 1], r[1, 2] = sy * cp + cy * sr * sp, cy * cr, sy * sp - cy * sr * cp
    r[2, 0], r[2, 1], r[2, 2] = -cr * sp, sr, cr * cp
    wrench(y[:3], y[VX : VZ + 1], r, y[_OMEGA], u[PWM], s.ambient, v, p, f)
    # dx/dt = v, dv/dt = R f/m + push - (0, 0, g)
    mass = v.body.mass * p[MASS_SCALE]
    for k in range(3):
        dy[k] = y[VX + k]
        dy[VX + k] = (r[k, 0] * f[0] + r[k, 1] * f[1] + r[k, 2] * f[2]) / mass
        if s.pushed:
            dy[VX + k] += push[k]
    if s.loaded:
        _swing(y, dy, mass, v)
    dy[VZ] -= v.environment.gravity
    dy[_OMEGA] = lag_derivative(y[_OMEGA], u[PWM], v, p)
    roll, pitch = estimated_angles(y[_PHI], y[_THETA], y[_PSI], y[VX], y[VX + 1], y[VZ], v)
    roll_rate, pitch_rate, yaw_rate = loop_rates(roll, pitch, u, v, p)  # commanded
    if s.rate_loop:
        phid, thetad, psid = y[_RATES], y[_RATES + 1], y[_RATES + 2]
        tau = v.attitude.time_constant * p[TIME_CONSTANT_SCALE]
        dy[_PHI], dy[_THETA], dy[_PSI] = phid, thetad, psid
        bandwidth, damping = v.attitude.bandwidth, v.attitude.damping
        dy[_RATES] = rate_loop_acceleration(roll_rate, phid, bandwidth, tau, damping)
        dy[_RATES + 1] = rate_loop_acceleration(pitch_rate, thetad, bandwidth, tau, damping)
        dy[_RATES + 2] = v.attitude.yaw_bandwidth * (yaw_rate - psid)
        tx, ty, tz = f[3], f[4], 0.0
        if s.limited:
            over_x, over_y, over_z = _saturations(y, dy, v, s.torque_limits)
            tx, ty, tz = tx + over_x, ty + over_y, tz + over_z
        if s.pushed:  # its torque along the body's axes: R^T tau
            tx += r[0, 0] * push[3] + r[1, 0] * push[4] + r[2, 0] * push[5]
            ty += r[0, 1] * push[3] + r[1, 1] * push[4] + r[2, 1] * push[5]
            tz += r[0, 2] * push[3] + r[1, 2] * push[4] + r[2, 2] * push[5]
        if tx != 0.0 or ty != 0.0 or tz != 0.0:
            # d2(phi, theta, psi)/dt2 += E(phi, theta) J^-1 tau, E: Euler rates from body rates
            j = v.body.inertia
            a, b, d = euler_rates(y[_PHI], y[_THETA], tx / j[0], ty / j[1], tz / j[2])
            dy[_RATES] += a
            dy[_RATES + 1] += b
            dy[_RATES + 2] += d
    else:
        dy[_PHI], dy[_THETA], dy[_PSI] = roll_rate, pitch_rate, yaw_rate
        dy[_RATES] = dy[_RATES + 1] = dy[_RATES + 2] = 0.0


def free_air(n: int) -> np.ndarray:
    """Return the ambient conditions (n, AMBIENT_SIZE) at time 0, the battery the file's and no platform."""
    ambient = np.zeros((n, AMBIENT_SIZE))
    ambient[:, VOLTAGE] = np.nan
    return ambient


@numba.njit(cache=True, inline="always")
def pack_state(s, y):
    """Write a state s (13,) with the columns of `attitude.py` as the integrated vector y (13,)."""
    for j in range(9):
        y[j] = s[j]
    y[_OMEGA] = s[LAG]
    y[_RATES], y[_RATES + 1], y[_RATES + 2] = euler_rates(s[ROLL], s[PITCH], s[WX], s[WY], s[WZ])


@numba.njit(cache=True, inline="always")
def unpack_state(y, s):
    """Write an integrated vector y (13,) as a state s (13,): the inverse of `pack_state`."""
    for j in range(9):
        s[j] = y[j]
    s[LAG] = y[_OMEGA]
    s[WX], s[WY], s[WZ] = body_rates(y[_PHI], y[_THETA], y[_RATES], y[_RATES + 1], y[_RATES + 2])


@numba.njit(cache=True)
def rk4(s, v, dt):
    """Advance a STEP, its integrated vector and its time, in place by `dt` [s]; v: the vehicle's record."""
    # k1 = f(y), k2 = f(y + dt/2 k1), k3 = f(y + dt/2 k2), k4 = f(y + dt k3)
    y, z, k, total = s.y, s.stage, s.derivative, s.total
    size = _LOADED_SIZE if s.loaded else (_SIZE if s.rate_loop else _RATES)
    _derivative(y, s, v)
    for j in range(size):
        total[j] = k[j]
        z[j] = y[j] + 0.5 * dt * k[j]
    s.ambient[TIME] += 0.5 * dt
    _derivative(z, s, v)
    for j in range(size):
        total[j] += 2.0 * k[j]
        z[j] = y[j] + 0.5 * dt * k[j]
    _derivative(z, s, v)
    for j in range(size):
        total[j] += 2.0 * k[j]
        z[j] = y[j] + dt * k[j]
    s.ambient[TIME] += 0.5 * dt
    _derivative(z, s, v)
    # y <- y + dt/6 (k1 + 2 k2 + 2 k3 + k4)
    for j in range(size):
        y[j] += dt / 6.0 * (total[j] + k[j])
    if s.loaded:
        rectify(y[_LOAD:])


@numba.njit(cache=True, inline="always")
def disturb(s, perturbation, push, i):
    """Write the rows of vehicle i of perturbation (n, 7) and push (n, 6), or STILL, into a STEP."""
    for k in range(7):
        s.perturbation[k] = perturbation[i, k]
    s.pushed = len(push) > 0
    for k in range(6 if s.pushed else 0):
        s.push[k] = push[i, k]


@numba.njit(cache=True, inline="always")
def take_load(s, load, i, v):
    """Write the slung load of vehicle i, with the record v, into a STEP; load (n, 6) or UNLOADED."""
    s.loaded = len(load) > 0 and v.effects.load_mass != 0.0
    for k in range(LOAD_SIZE if s.loaded else 0):
        s.y[_LOAD + k] = load[i, k]


@numba.njit(cache=True, inline="always")
def give_load(s, load, i):
    """Write the slung load of a STEP, if it has one, as that of vehicle i."""
    for k in range(LOAD_SIZE if s.loaded else 0):
        load[i, k] = s.y[_LOAD + k]


@numba.njit(cache=True)
def _begin(s, state, command, conditions, i, rate_loop, v):
    """Write state (13,), command (4,) and conditions of vehicle i into a STEP, with unlimited torques.

    v: the vehicle's record.
    """
    pack_state(state, s.y)
    take_load(s, conditions.load, i, v)
    for k in range(4):
        s.command[k] = command[k]
    for k in range(AMBIENT_SIZE):
        s.ambient[k] = conditions.ambient[i, k]
    disturb(s, conditions.perturbation, conditions.push, i)
    s.rate_loop, s.limited = rate_loop, False


@numba.njit(cache=True)
def advance(state, commands, conditions, rate_loop, dt, substeps):
    """Advance every vehicle, and its time, in place by substeps * dt with RK4.

    state (n, 13) with the columns of `attitude.py`, commands (n, 4) held constant, conditions: `Conditions`,
    rate_loop: which attitude model. With the kinematic model the body rates in the state are those of the
    first-order loops at the end of the step, and torques have no effect.
    """
    steps = np.zeros(1, STEP)
    for i in range(state.shape[0]):
        s, v = steps[0], conditions.vehicle[i if len(conditions.vehicle) > 1 else 0]
        _begin(s, state[i], commands[i], conditions, i, rate_loop, v)
        for _ in range(substeps):
            rk4(s, v, dt)
        y = s.y
        if not rate_loop:
            roll, pitch = estimated_angles(y[_PHI], y[_THETA], y[_PSI], y[VX], y[VX + 1], y[VZ], v)
            y[_RATES], y[_RATES + 1], y[_RATES + 2] = loop_rates(roll, pitch, s.command, v, s.perturbation)
        unpack_state(y, state[i])
        give_load(s, conditions.load, i)
        conditions.ambient[i, TIME] = s.ambient[TIME]


@numba.njit(cache=True)
def _derivatives(state, command, conditions, rate_loop):
    """Return dy/dt (19,) of the integrated vector of one vehicle."""
    steps = np.zeros(1, STEP)
    s, v = steps[0], conditions.vehicle[0]
    _begin(s, state, command, conditions, 0, rate_loop, v)
    _derivative(s.y, s, v)
    return steps[0].derivative.copy()


def derivative(
    state: np.ndarray, command: np.ndarray, vehicle: Vehicle, rate_loop: bool = False
) -> dict[str, Any]:
    """Return the time derivative of one state, for model comparison; a slung load hangs straight down.

    state (13,), command (4,). The dict has `acceleration` (3,) [m/s2], `euler_rates` (3,) [rad/s],
    `lag_rate` [PWM] and, for the rate loop, `euler_accelerations` (3,) [rad/s2].
    """
    conditions = Conditions(pack(vehicle), np.array([NEUTRAL]), free_air(1), load=hanging(1))
    dy = _derivatives(np.asarray(state, float), np.asarray(command, float), conditions, bool(rate_loop))
    result: dict[str, Any] = {
        "acceleration": dy[VX : VZ + 1].copy(),
        "euler_rates": dy[_PHI : _PSI + 1].copy(),
        "lag_rate": float(dy[_OMEGA]),
    }
    if rate_loop:
        result["euler_accelerations"] = dy[_RATES:_SIZE].copy()
    return result
