"""Solution of one control period under a held command, as far as it has a closed form.

This is faster than numerical integration of the whole state. If only the torques of the unsaturated loops act
on a vehicle, roll, pitch, yaw and the thrust's lag have exact solutions (`attitude_loops.py`, `forces.py`).
The remaining translation has a force that depends only on time and velocity. It is integrated in steps of
`_STEP` of the shortest time constant, with attitude and thrust exact at every stage, by Kutta's third-order
method, which is Simpson's rule for terms that depend on time. From states at up to 6 m/s and 6 rad/s, under
commands over the full bounds, the position is within 1e-7 m and the velocity within 2e-6 m/s of the
equations' solution after 20 ms, with strong effects of the air within 1e-6 m and 2e-5 m/s. RK4 in steps of 4
ms is off by 1e-8 m and 4e-7 m/s, and by 8e-5 rad/s where this is exact.
"""

import math

from inclined_landing.models.attitude import (
    PITCH,
    PITCH_COMMAND,
    PWM,
    ROLL,
    ROLL_COMMAND,
    VX,
    VY,
    VZ,
    YAW,
    YAW_RATE_COMMAND,
    X,
    Y,
    Z,
    rotation_entries,
    sine_cosine,
    small_sine_cosine,
    to_body,
    to_world,
)
from inclined_landing.models.attitude_loops import damping_rate, held_angle, held_step
from inclined_landing.models.compiled import inlined, inner
from inclined_landing.models.equations import OMEGA, RATES, body_torque
from inclined_landing.models.forces import (
    TIME,
    VOLTAGE,
    columns_besides,
    in_the_air,
    lag_pole,
    neutral,
    rotors,
)

_STEP = 0.6
# The share of the torque limits that torques may reach. They are checked twice in a step; in between, the
# part of a torque that decays with the shortest time constant departs from a line by (_STEP/2)^2/8 of itself.
_UNLIMITED = 0.95


# Fields of a vehicle that `fly` solves, or that change nothing in the air while all others are 0.
SOLVED = (
    *("body_mass", "body_inertia", "environment_gravity"),
    *("thrust_lag_rate", "thrust_state_gain", "thrust_direct_gain"),
    *("motor_count", "motor_pwm_to_force", "motor_pwm_to_speed"),
    *("rotor_arm", "rotor_height", "rotor_radius", "drag_coefficients"),
    *("attitude_gain", "attitude_time_constant", "attitude_bandwidth", "attitude_damping"),
    *("attitude_yaw_gain", "attitude_yaw_bandwidth", "attitude_integral_limit"),
    *("attitude_torque_limit", "attitude_yaw_torque_limit"),
    *("command_control_period", "command_pwm_range", "command_angle_limit"),
    *("command_yaw_rate_limit", "command_pwm_centre", "command_pwm_span"),
    *("arena_x", "arena_y", "arena_z", "contact_friction", "contact_solref"),
    *("platform_surface_height", "platform_width", "platform_depth", "platform_thickness"),
    *("platform_inclination", "platform_max_inclination"),
    *("disturbance_acceleration", "disturbance_acceleration_time"),
    *("disturbance_angular", "disturbance_angular_time"),
    *("effects_thrust_bias", "effects_thrust_fade", "effects_battery_sag", "effects_battery_reference"),
    *("effects_voltage_sensitivity", "effects_voltage_reference", "effects_voltage_open"),
    *("effects_voltage_drop", "effects_voltage_discharge", "effects_spin_down"),
    *("effects_body_drag", "effects_wind", "effects_translational_lift", "effects_axial_inflow"),
    *("effects_rotor_loss", "effects_com_offset", "effects_attitude_trim", "effects_yaw_drift"),
    *("effects_ground_fading", "effects_load_length", "effects_foot_height", "effects_yaw_imbalance"),
    *("effects_thrust_delay", "effects_attitude_delay", "effects_estimator_delay"),
    *("effects_mocap_tilt", "effects_mocap_delay"),
)
_OTHERS = columns_besides(SOLVED)


@inlined
def solvable(s, v, i, numbers):
    """Return whether `fly` covers everything that acts on a vehicle: only the torques of its loops, which are
    linear.

    s: its `equations.STEP`; v: its record, which is row i of `numbers`. A field that is not in SOLVED is
    assumed to be something else, unless it is 0.
    """
    push = s.push
    centred = v.effects.com_offset[0] == v.thrust_centre[0] and v.effects.com_offset[1] == v.thrust_centre[1]
    pushed = s.pushed and (push[3] != 0.0 or push[4] != 0.0 or push[5] != 0.0)
    return centred and not pushed and neutral(i, numbers, _OTHERS)


@inlined
def _turned(of, angle):
    """Return (sine, cosine) of an angle increased by a small `angle` [rad], from those of the first."""
    s, c = small_sine_cosine(angle)
    return of[0] * c + of[1] * s, of[1] * c - of[0] * s


@inlined
def _acceleration(vx, vy, vz, turns, thrust, speed, s, v, lightness):
    """Return dv/dt at a velocity and (sine, cosine) of the angles; thrust, speed: from `forces.rotors`."""
    r = rotation_entries(turns[0], turns[1], turns[2])
    # dv/dt = R f/m + push - (0, 0, g)
    ax, ay = vx - v.effects.wind[0], vy - v.effects.wind[1]
    bx, by, bz = to_body(r, ax, ay, vz)
    fx, fy, fz, lift = in_the_air(thrust, speed, bx, by, bz, v)
    x, y, z = to_world(r, lightness * fx, lightness * fy, lightness * (fz + lift))
    if s.pushed:
        return x + s.push[0], y + s.push[1], z + s.push[2] - v.environment.gravity
    return x, y, z - v.environment.gravity


@inlined
def _half_step(now, turns, held):
    """Return the loops' states and (sine, cosine) of the angles half a step later."""
    roll, roll_rate, pitch, pitch_rate, yaw, yaw_rate, lag = now  # angles and lag off their rest, but for yaw
    step, yaw_rest, yaw_kept, yaw_moved, h, lag_kept = held
    new_roll, roll_rate = held_angle(roll, roll_rate, step)
    new_pitch, pitch_rate = held_angle(pitch, pitch_rate, step)
    yaw_turn = yaw_rest * h + (yaw_rate - yaw_rest) * yaw_moved
    yaw_rate = yaw_rest + (yaw_rate - yaw_rest) * yaw_kept
    turns = (
        _turned(turns[0], new_roll - roll),
        _turned(turns[1], new_pitch - pitch),
        _turned(turns[2], yaw_turn),
    )
    return (new_roll, roll_rate, new_pitch, pitch_rate, yaw + yaw_turn, yaw_rate, lag * lag_kept), turns


@inlined
def _allowed(now, turns, rests, poles, limits, v):
    """Return whether torques, angles and rates are within (torque x, y, z, angle, rate) of `limits`."""
    roll, roll_rate, pitch, pitch_rate, _, yaw_rate, _ = now
    stiffness, damping = poles
    rates = roll_rate, pitch_rate, yaw_rate
    accelerations = (
        -stiffness * roll - damping * roll_rate,
        -stiffness * pitch - damping * pitch_rate,
        v.attitude.yaw_bandwidth * (rests[2] - yaw_rate),
    )
    tx, ty, tz = body_torque(turns[0], turns[1], rates, accelerations, v)
    return (
        (abs(tx) <= limits[0] and abs(ty) <= limits[1] and abs(tz) <= limits[2])
        and max(abs(roll + rests[0]), abs(pitch + rests[1])) < limits[3]
        and max(abs(roll_rate), abs(pitch_rate), abs(yaw_rate)) < limits[4]
    )


@inner
def fly(s, v, period, largest_angle, largest_rate):
    """Advance a STEP that is `solvable`, its integrated vector and time, by `period` [s] if it may.

    Returns whether it was advanced. It is left unchanged if a torque comes near its limit, if roll or pitch
    exceeds `largest_angle` [rad], or if the rate of an angle exceeds `largest_rate` [rad/s].
    """
    y, u, scale, pwm = s.y, s.command, s.thrust_scale, s.command[PWM]
    tau, gain = v.attitude.time_constant, v.attitude.gain
    damping, bandwidth = damping_rate(tau, v), v.attitude.yaw_bandwidth
    steps = math.ceil(period * max(damping, bandwidth, largest_rate) / _STEP)
    dt = period / steps
    h, sixth = 0.5 * dt, dt / 6.0
    poles = v.attitude.bandwidth / tau, damping
    rests = (
        gain * (u[ROLL_COMMAND] + v.effects.attitude_trim[0]),
        gain * (u[PITCH_COMMAND] + v.effects.attitude_trim[1]),
        v.attitude.yaw_gain * u[YAW_RATE_COMMAND] + v.effects.yaw_drift,
    )
    steady, yaw_kept = pwm / v.thrust.lag_rate, math.exp(-bandwidth * h)
    lag_kept = math.exp(-lag_pole(y[OMEGA], pwm, v) * h)
    held = held_step(tau, h, v), rests[2], yaw_kept, (1.0 - yaw_kept) / bandwidth, h, lag_kept
    tx, ty, tz = s.torque_limits[0], s.torque_limits[1], s.torque_limits[2]
    limits = _UNLIMITED * tx, _UNLIMITED * ty, _UNLIMITED * tz, largest_angle, largest_rate
    roll, pitch, yaw, lag = y[ROLL] - rests[0], y[PITCH] - rests[1], y[YAW], y[OMEGA] - steady
    now = roll, y[RATES], pitch, y[RATES + 1], yaw, y[RATES + 2], lag
    turns = sine_cosine(y[ROLL]), sine_cosine(y[PITCH]), sine_cosine(y[YAW])
    if not _allowed(now, turns, rests, poles, limits, v):
        return False
    lightness, time, voltage = 1.0 / v.body.mass, s.ambient[TIME], s.ambient[VOLTAGE]
    thrust, speed = rotors(now[6] + steady, pwm, time, voltage, scale, v)
    px, py, pz, vx, vy, vz = y[X], y[Y], y[Z], y[VX], y[VY], y[VZ]
    for _ in range(steps):
        # k1 = f(0, v), k2 = f(dt/2, v + dt/2 k1), k3 = f(dt, v + dt (2 k2 - k1))
        ax, ay, az = _acceleration(vx, vy, vz, turns, thrust, speed, s, v, lightness)
        now, turns = _half_step(now, turns, held)
        thrust, speed = rotors(now[6] + steady, pwm, time + h, voltage, scale, v)
        bx, by, bz = _acceleration(
            vx + h * ax, vy + h * ay, vz + h * az, turns, thrust, speed, s, v, lightness
        )
        now, turns = _half_step(now, turns, held)
        if not _allowed(now, turns, rests, poles, limits, v):
            return False
        time += dt
        thrust, speed = rotors(now[6] + steady, pwm, time, voltage, scale, v)
        wx, wy, wz = vx + dt * (2.0 * bx - ax), vy + dt * (2.0 * by - ay), vz + dt * (2.0 * bz - az)
        cx, cy, cz = _acceleration(wx, wy, wz, turns, thrust, speed, s, v, lightness)
        # x <- x + dt v + dt^2/6 (k1 + 2 k2), v <- v + dt/6 (k1 + 4 k2 + k3)
        px += dt * (vx + sixth * (ax + 2.0 * bx))
        py += dt * (vy + sixth * (ay + 2.0 * by))
        pz += dt * (vz + sixth * (az + 2.0 * bz))
        vx += sixth * (ax + 4.0 * bx + cx)
        vy += sixth * (ay + 4.0 * by + cy)
        vz += sixth * (az + 4.0 * bz + cz)
    y[X], y[Y], y[Z], y[VX], y[VY], y[VZ] = px, py, pz, vx, vy, vz
    y[ROLL], y[PITCH], y[YAW], y[OMEGA] = now[0] + rests[0], now[2] + rests[1], now[4], now[6] + steady
    y[RATES], y[RATES + 1], y[RATES + 2] = now[1], now[3], now[5]
    s.ambient[TIME] = time
    return True
