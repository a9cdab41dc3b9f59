"""The paper's equations of motion, integrated with RK4, compiled and batched.

The equations are those of Kooi and Babuska (IROS 2021) with the attitude matrix corrected (see
`attitude.py`): translation under the forces of `forces.py`, the thrust's lag, and the loops of
`attitude_loops.py`. Delays are not part of them: the plant shifts the commands.

Symbols of the comments: position x, velocity v, attitude matrix R (body to world), f and tau force and torque
in the body frame, Omega state of the thrust lag, phi, theta, psi roll, pitch and yaw.
"""

import functools
from typing import Any, NamedTuple

import numpy as np

from inclined_landing.models.attitude import (
    LAG,
    PITCH,
    PWM,
    ROLL,
    VX,
    VZ,
    WX,
    WY,
    WZ,
    body_accelerations_at,
    body_rates,
    body_rates_at,
    euler_rates,
    euler_rates_at,
    rotation_entries,
    sine_cosine,
    to_body,
    to_world,
)
from inclined_landing.models.attitude_loops import (
    angle_errors,
    estimated_angles,
    integral_rate,
    integrates,
    loop_rates,
    rate_loop_acceleration,
    saturated,
)
from inclined_landing.models.compiled import inlined, inner, kernel
from inclined_landing.models.forces import AMBIENT_SIZE, TIME, free_air, lag_derivative, pack, wrench
from inclined_landing.models.load import LOAD_SIZE, UNLOADED, hanging, pull, rectify, swing
from inclined_landing.models.vehicle import Vehicle

# The integrated vector: position, velocity, Euler angles, lag, Euler rates (rate loop only), where there are
# some the integrals of roll and pitch, and the slung load's direction and its rate where there is one.
_PHI, _THETA, _PSI, OMEGA, RATES, _SIZE = 6, 7, 8, 9, 10, 13
_INTEGRAL, _LOAD = _SIZE, _SIZE + 2
_LOADED_SIZE = _LOAD + LOAD_SIZE
NOT_INTEGRATED = np.empty((0, 2))
STILL = np.empty((0, 6))  # no push; None would be another type, and compile everything once more


class Conditions(NamedTuple):
    """The conditions under which n vehicles fly."""

    vehicle: np.ndarray  # from `pack`: (1,) for all, or (n,) with a record for each
    thrust_scale: np.ndarray  # (n,) factor on the total thrust
    ambient: np.ndarray  # (n, AMBIENT_SIZE); `advance` moves the time on
    push: np.ndarray = STILL  # (n, 6) further acceleration [m/s2], torque [N m] in the world's axes; or STILL
    load: np.ndarray = (
        UNLOADED  # (n, 6) states of slung loads, see `load.py`, moved by `advance`; or UNLOADED
    )
    # (n, 2) integrals [rad s] of the errors of roll and pitch, see `attitude_loops.py`, moved by `advance`
    integral: np.ndarray = NOT_INTEGRATED  # without rows for vehicles without integral gains


# One vehicle while it is integrated, as `rk4` takes it: a record, which unlike a tuple of arrays counts no
# references. Of np.record, whose fields are attributes where Python runs the kernels (NUMBA_DISABLE_JIT) too.
_STEP = np.dtype(
    [
        ("y", float, _LOADED_SIZE),  # integrated vector
        ("command", float, 4),
        ("ambient", float, AMBIENT_SIZE),
        ("push", float, 6),  # further acceleration [m/s2] and torque [N m] in the world's axes
        ("thrust_scale", float),  # factor on the total thrust
        ("torque_limits", float, 3),  # N m about the body's axes, of the rate loops
        ("pushed", bool),  # whether there is a push
        ("limited", bool),  # whether the torques are limited
        ("rate_loop", bool),  # the attitude model: with the rate loop or without
        ("integrated", bool),  # whether the attitude loops have integral gains
        ("loaded", bool),  # whether there is a slung load
        # Working memory: a stage's integrated vector, its derivative, weighted sum of the derivatives.
        *((name, float, _LOADED_SIZE) for name in ("stage", "derivative", "total")),
    ],
    align=True,
)
STEP = np.dtype((np.record, _STEP))


@inlined
def _saturation(torque, limit):
    """Return the torque that must be added to keep a torque within +-limit."""
    return min(limit, max(-limit, torque)) - torque


@inlined
def body_torque(roll, pitch, rates, accelerations, v):
    """Return the body torque (x, y, z) [N m] under which the Euler rates have these accelerations.

    roll, pitch: (sine, cosine) of these angles; rates, accelerations: three each [rad/s, rad/s2].
    """
    j = v.body.inertia
    wx, wy, wz = body_rates_at(roll, pitch, rates[0], rates[1], rates[2])
    ax, ay, az = body_accelerations_at(roll, pitch, rates, accelerations)
    # Euler: tau = J dw/dt + w x J w
    return (
        j[0] * ax + (j[2] - j[1]) * wy * wz,
        j[1] * ay + (j[0] - j[2]) * wz * wx,
        j[2] * az + (j[1] - j[0]) * wx * wy,
    )


@inlined
def _swing(y, dy, mass, v):
    """Write the slung load's motion to dy and add its pull to the acceleration there, without gravity."""
    qx, qy, qz, vx, vy, vz = y[_LOAD], y[_LOAD + 1], y[_LOAD + 2], y[_LOAD + 3], y[_LOAD + 4], y[_LOAD + 5]
    ax, ay, az = dy[VX], dy[VX + 1], dy[VZ]
    share, length = v.effects.load_mass / (mass + v.effects.load_mass), v.effects.load_length
    tension = pull(qx, qy, qz, vx, vy, vz, ax, ay, az, share, length)
    for k in range(3):
        dy[VX + k] += tension * y[_LOAD + k]
        dy[_LOAD + k] = y[_LOAD + 3 + k]
    dy[_LOAD + 3], dy[_LOAD + 4], dy[_LOAD + 5] = swing(qx, qy, qz, vx, vy, vz, ax, ay, az, length)


@inner
def _derivative(y, s, v):
    """Write dy/dt of an integrated vector y (21,) into `s.derivative`; s: a STEP, v: the vehicle's record."""
    u, push, dy = s.command, s.push, s.derivative
    roll_turn, pitch_turn, yaw_turn = sine_cosine(y[_PHI]), sine_cosine(y[_THETA]), sine_cosine(y[_PSI])
    r = rotation_entries(roll_turn, pitch_turn, yaw_turn)
    velocity = y[VX], y[VX + 1], y[VZ]
    fx, fy, fz, tx, ty = wrench(y, velocity, r, y[OMEGA], u[PWM], s.ambient, s.thrust_scale, v)
    # dx/dt = v, dv/dt = R f/m + push - (0, 0, g)
    mass = v.body.mass
    dy[0], dy[1], dy[2] = y[VX], y[VX + 1], y[VZ]
    fx, fy, fz = to_world(r, fx, fy, fz)
    dy[VX], dy[VX + 1], dy[VZ] = fx / mass, fy / mass, fz / mass
    for k in range(3 if s.pushed else 0):
        dy[VX + k] += push[k]
    if s.loaded:
        _swing(y, dy, mass, v)
    dy[VZ] -= v.environment.gravity
    dy[OMEGA] = lag_derivative(y[OMEGA], u[PWM], v)
    angles = estimated_angles(y[_PHI], y[_THETA], y[_PSI], y[VX], y[VX + 1], y[VZ], v)
    errors, integrals = angle_errors(angles[0], angles[1], u, v), (y[_INTEGRAL], y[_INTEGRAL + 1])
    wanted = loop_rates(angles, errors, integrals, u, v)
    for k in range(2):
        dy[_INTEGRAL + k] = integral_rate(integrals[k], errors[k], v) if s.integrated else 0.0
    if s.rate_loop:
        phid, thetad, psid = y[RATES], y[RATES + 1], y[RATES + 2]
        tau = v.attitude.time_constant
        dy[_PHI], dy[_THETA], dy[_PSI] = phid, thetad, psid
        dy[RATES] = rate_loop_acceleration(wanted[0], phid, dy[_INTEGRAL], tau, v)
        dy[RATES + 1] = rate_loop_acceleration(wanted[1], thetad, dy[_INTEGRAL + 1], tau, v)
        dy[RATES + 2] = v.attitude.yaw_bandwidth * (wanted[2] - psid)
        tz = 0.0
        if s.limited:
            rates, accelerations = (phid, thetad, psid), (dy[RATES], dy[RATES + 1], dy[RATES + 2])
            wanted_x, wanted_y, wanted_z = body_torque(roll_turn, pitch_turn, rates, accelerations, v)
            tx += _saturation(wanted_x, s.torque_limits[0])
            ty += _saturation(wanted_y, s.torque_limits[1])
            tz += _saturation(wanted_z, s.torque_limits[2])
        if s.pushed:  # its torque along the body's axes: R^T tau
            px, py, pz = to_body(r, push[3], push[4], push[5])
            tx, ty, tz = tx + px, ty + py, tz + pz
        if tx != 0.0 or ty != 0.0 or tz != 0.0:
            # d2(phi, theta, psi)/dt2 += E(phi, theta) J^-1 tau, E: Euler rates from body rates
            j = v.body.inertia
            a, b, d = euler_rates_at(roll_turn, pitch_turn, tx / j[0], ty / j[1], tz / j[2])
            dy[RATES] += a
            dy[RATES + 1] += b
            dy[RATES + 2] += d
    else:
        dy[_PHI], dy[_THETA], dy[_PSI] = saturated(wanted, v)
        dy[RATES] = dy[RATES + 1] = dy[RATES + 2] = 0.0


@inlined
def pack_state(state, i, y):
    """Write row i of a state (n, 13) with the columns of `attitude.py` as the integrated vector y (13,)."""
    for j in range(9):
        y[j] = state[i, j]
    y[OMEGA] = state[i, LAG]
    rates = euler_rates(state[i, ROLL], state[i, PITCH], state[i, WX], state[i, WY], state[i, WZ])
    y[RATES], y[RATES + 1], y[RATES + 2] = rates


@inlined
def unpack_state(y, state, i):
    """Write an integrated vector y (13,) as row i of a state (n, 13): the inverse of `pack_state`."""
    for j in range(9):
        state[i, j] = y[j]
    state[i, LAG] = y[OMEGA]
    rates = body_rates(y[_PHI], y[_THETA], y[RATES], y[RATES + 1], y[RATES + 2])
    state[i, WX], state[i, WY], state[i, WZ] = rates


@inner
def rk4(s, v, dt):
    """Advance a STEP, its integrated vector and its time, in place by `dt` [s]; v: the vehicle's record."""
    # k1 = f(y), k2 = f(y + dt/2 k1), k3 = f(y + dt/2 k2), k4 = f(y + dt k3)
    y, z, k, total = s.y, s.stage, s.derivative, s.total
    size = _LOAD if s.integrated else (_SIZE if s.rate_loop else RATES)
    size = _LOADED_SIZE if s.loaded else size
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


@inlined
def disturb(s, thrust_scale, push, i):
    """Write the rows of vehicle i of thrust_scale (n,) and push (n, 6), or STILL, into a STEP."""
    s.thrust_scale = thrust_scale[i]
    s.pushed = len(push) > 0
    for k in range(6 if s.pushed else 0):
        s.push[k] = push[i, k]


@inlined
def take_states(s, load, integral, i, v):
    """Copy slung load and integrals of vehicle i, with the record v, from `Conditions` into a STEP."""
    s.integrated = len(integral) > 0 and integrates(v)
    for k in range(2):
        s.y[_INTEGRAL + k] = integral[i, k] if s.integrated else 0.0
    s.loaded = len(load) > 0 and v.effects.load_mass != 0.0
    for k in range(LOAD_SIZE if s.loaded else 0):
        s.y[_LOAD + k] = load[i, k]


@inlined
def give_states(s, load, integral, i):
    """Copy slung load and integrals of a STEP, if there are any, to those of vehicle i."""
    for k in range(2 if s.integrated else 0):
        integral[i, k] = s.y[_INTEGRAL + k]
    for k in range(LOAD_SIZE if s.loaded else 0):
        load[i, k] = s.y[_LOAD + k]


@kernel
def _begin(s, state, commands, conditions, i, rate_loop, v):
    """Write row i of state (n, 13), commands (n, 4) and conditions into a STEP, with unlimited torques.

    v: the vehicle's record.
    """
    pack_state(state, i, s.y)
    take_states(s, conditions.load, conditions.integral, i, v)
    for k in range(4):
        s.command[k] = commands[i, k]
    for k in range(AMBIENT_SIZE):
        s.ambient[k] = conditions.ambient[i, k]
    disturb(s, conditions.thrust_scale, conditions.push, i)
    s.rate_loop, s.limited = rate_loop, False


@kernel
def advance(state, commands, conditions, rate_loop, dt, substeps):
    """Advance every vehicle, and its time, in place by substeps * dt with RK4.

    state (n, 13) with the columns of `attitude.py`, commands (n, 4) held constant, conditions: `Conditions`,
    rate_loop: the attitude model, True for the rate loop. With the kinematic model the body rates in the
    state are those of the first-order loops at the end of the step, and torques have no effect.
    """
    steps = np.zeros(1, STEP)
    for i in range(state.shape[0]):
        s, v = steps[0], conditions.vehicle[i if len(conditions.vehicle) > 1 else 0]
        _begin(s, state, commands, conditions, i, rate_loop, v)
        for _ in range(substeps):
            rk4(s, v, dt)
        y = s.y
        if not rate_loop:
            angles = estimated_angles(y[_PHI], y[_THETA], y[_PSI], y[VX], y[VX + 1], y[VZ], v)
            errors = angle_errors(angles[0], angles[1], s.command, v)
            integrals = y[_INTEGRAL], y[_INTEGRAL + 1]
            rates = loop_rates(angles, errors, integrals, s.command, v)
            y[RATES], y[RATES + 1], y[RATES + 2] = saturated(rates, v)
        unpack_state(y, state, i)
        give_states(s, conditions.load, conditions.integral, i)
        conditions.ambient[i, TIME] = s.ambient[TIME]


@functools.lru_cache(maxsize=8)
def _alone(vehicle: Vehicle) -> Conditions:
    """Return the conditions of one vehicle in still air."""
    return Conditions(pack(vehicle), np.ones(1), free_air(1), load=hanging(1))


@kernel
def _derivatives(state, commands, conditions, rate_loop):
    """Return dy/dt (21,) of the integrated vector of one vehicle in a state (1, 13) under commands (1, 4)."""
    steps = np.zeros(1, STEP)
    s, v = steps[0], conditions.vehicle[0]
    _begin(s, state, commands, conditions, 0, rate_loop, v)
    _derivative(s.y, s, v)
    return steps[0].derivative.copy()


def derivative(
    state: np.ndarray, command: np.ndarray, vehicle: Vehicle, rate_loop: bool = False
) -> dict[str, Any]:
    """Return the time derivative of one state, for comparing models; a slung load hangs straight down.

    state (13,), command (4,). The dict has `acceleration` (3,) [m/s2], `euler_rates` (3,) [rad/s],
    `lag_rate` [PWM] and, for the rate loop, `euler_accelerations` (3,) [rad/s2].
    """
    given = np.asarray(state, float)[None], np.asarray(command, float)[None]
    dy = _derivatives(*given, _alone(vehicle), bool(rate_loop))
    result: dict[str, Any] = {
        "acceleration": dy[VX : VZ + 1].copy(),
        "euler_rates": dy[_PHI : _PSI + 1].copy(),
        "lag_rate": float(dy[OMEGA]),
    }
    if rate_loop:
        result["euler_accelerations"] = dy[RATES:_SIZE].copy()
    return result
