"""Flight controller (500 Hz) and pilot (50 Hz): they see measurements only. Compiled.

The reference's flight controller is cascaded: an attitude loop with a derivative term asks for body rates, a
rate loop asks for torques, whose derivative cancels the motors' lag, and the mixer asks for four thrusts. It
has no integral terms: the paper's identified loop, with a steady gain above one, has none either. Other
vehicles have other controllers (`vehicle.Build`). An integral of roll or pitch rate forgets: one that did not
would hide a centre of mass that is off from everybody.
"""

import math

import numba
import numpy as np

from .dynamics import SIDE_X, SIDE_Y, SPIN
from .vehicle import FULL_STATE, INCREMENTAL

# What the flight controller remembers, three numbers each: filtered setpoint; torques of the last call;
# whether there was one; low-passed gyro; integrals; accelerations that the motors make, and the same through
# the gyro's low-pass.
SETPOINT, TORQUE, AWAKE, SMOOTH, INTEGRAL, MOTOR, LATE, MEMORY = 0, 3, 6, 7, 10, 13, 16, 19

# Columns of the reference, one row per pilot period.
REF_POSITION, REF_VELOCITY, REF_ACCELERATION, REF_YAW, REF_YAW_RATE = 0, 3, 6, 9, 10
REF_ROLL, REF_PITCH, REF_PWM, REF_MODE = 11, 12, 13, 14
# Where the pilot believes the surface to be, and how high above it the motors are cut.
REF_SURFACE, REF_TILT, REF_CUT_HEIGHT, REF_SIZE = 15, 16, 17, 18
# Modes: follow the path; roll and pitch as given; follow, then cut the motors.
TRACK, STEP, LAND = 0.0, 1.0, 2.0


@numba.njit(cache=True)
def pilot(ref, position, velocity, yaw, integral, c, command):
    """Command (4,) [PWM, roll, pitch, yaw rate] from the estimate; integral (3,) is the pilot's memory.

    A pilot who has cut the motors (PWM 0) to land does not start them again.
    """
    if ref[REF_MODE] == LAND:
        tilt = ref[REF_TILT]
        above = position[0] * math.sin(tilt) + (position[2] - ref[REF_SURFACE]) * math.cos(tilt)
        if above < ref[REF_CUT_HEIGHT] or command[0] == 0.0:
            for k in range(4):
                command[k] = 0.0
            return
    step = ref[REF_MODE] == STEP
    wanted_x = wanted_y = wanted_z = 0.0
    for k in range(3):
        gains = c.height_gains if k == 2 else c.position_gains
        error = ref[REF_POSITION + k] - position[k]
        if not (step and k < 2):
            integral[k] = min(1.0, max(-1.0, integral[k] + 0.02 * error))
        wanted = (
            ref[REF_ACCELERATION + k]
            + gains[0] * error
            + gains[1] * (ref[REF_VELOCITY + k] - velocity[k])
            + gains[2] * integral[k]
        )
        if k == 0:
            wanted_x = wanted
        elif k == 1:
            wanted_y = wanted
        else:
            wanted_z = max(wanted + c.gravity, 2.0)
    cy, sy = math.cos(yaw), math.sin(yaw)
    ahead, left = cy * wanted_x + sy * wanted_y, -sy * wanted_x + cy * wanted_y
    total = math.sqrt(ahead * ahead + left * left + wanted_z * wanted_z)
    pitch = math.asin(ahead / total) if not step else ref[REF_PITCH]
    roll = math.asin(-left / total / max(math.cos(pitch), 0.5)) if not step else ref[REF_ROLL]
    if step:
        total = wanted_z / (math.cos(pitch) * math.cos(roll))
    else:
        pitch, roll = pitch + ref[REF_PITCH], roll + ref[REF_ROLL]
    turn = math.atan2(math.sin(ref[REF_YAW] - yaw), math.cos(ref[REF_YAW] - yaw))
    limit, spin = c.angle_limit, c.yaw_rate_limit
    pwm = c.mass * total / c.thrust_per_pwm + ref[REF_PWM]
    command[0] = min(c.pwm_range[1], max(c.pwm_range[0], pwm))
    command[1] = min(limit, max(-limit, roll / c.attitude_gain))
    command[2] = min(limit, max(-limit, pitch / c.attitude_gain))
    command[3] = min(spin, max(-spin, ref[REF_YAW_RATE] + c.yaw_gain * turn))


@numba.njit(cache=True)
def body_rates(roll, pitch, roll_rate, pitch_rate, yaw_rate):
    """Body rates of the Euler rates of Rz(yaw) Rx(roll) Ry(pitch)."""
    sr, cr, sp, cp = math.sin(roll), math.cos(roll), math.sin(pitch), math.cos(pitch)
    return (
        roll_rate * cp - yaw_rate * cr * sp,
        pitch_rate + yaw_rate * sr,
        roll_rate * sp + yaw_rate * cr * cp,
    )


@numba.njit(cache=True)
def angle_rates(roll, pitch, p, q, o):
    """Euler rates of the body rates p, q, o."""
    sr, cr, sp, cp = math.sin(roll), math.cos(roll), math.sin(pitch), math.cos(pitch)
    yaw_rate = (cp * o - sp * p) / max(cr, 0.05)
    return cp * p + sp * o, q - sr * yaw_rate, yaw_rate


@numba.njit(cache=True)
def clip(value, limit):
    return min(limit, max(-limit, value))


@numba.njit(cache=True)
def flight_controller(pwm, setpoint, roll, pitch, gyro, memory, dt, c, b, w, target):
    """Rotor speeds (4,) to ask of the motors, for the perfect supply.

    pwm and setpoint (3,) [roll, pitch rad, yaw rate] as received, roll and pitch [rad] estimated, gyro
    (3,); memory (MEMORY,), all zero before the first call.
    """
    if pwm <= 0.0:
        for k in range(4):
            target[k] = 0.0
        memory[AWAKE] = 0.0
        return
    fast, slow = math.exp(-dt / c.setpoint_filter), math.exp(-dt / c.yaw_filter)
    roll_ahead, pitch_ahead = memory[SETPOINT], memory[SETPOINT + 1]
    for k in range(3):
        keep = slow if k == 2 else fast
        memory[SETPOINT + k] = setpoint[k] + keep * (memory[SETPOINT + k] - setpoint[k])
    roll_ahead = (memory[SETPOINT] - roll_ahead) / dt
    pitch_ahead = (memory[SETPOINT + 1] - pitch_ahead) / dt
    gain = c.attitude_gain * w.attitude_gain_scale
    time = c.attitude_time * w.attitude_time_scale
    wanted_roll, wanted_pitch = gain * memory[SETPOINT], gain * memory[SETPOINT + 1]
    if b.controller == FULL_STATE:
        p, q, o = full_state(wanted_roll - roll, wanted_pitch - pitch, roll, gyro, memory, time, dt, c, b, w)
    elif b.controller == INCREMENTAL:
        p, q, o = incremental(wanted_roll, wanted_pitch, roll, pitch, gyro, memory, time, dt, c, b, w)
    else:
        ahead = b.feed_forward * gain
        p, q, o = cascade(
            *(wanted_roll - roll, wanted_pitch - pitch, ahead * roll_ahead, ahead * pitch_ahead),
            *(roll, pitch, gyro, memory, time, dt, c, b, w),
        )
    tx = c.inertia[0] * p
    ty = c.inertia[1] * q
    tz = c.inertia[2] * o
    lead = c.motor_time / dt if memory[AWAKE] != 0.0 else 0.0
    share = b.lead * lead
    roll_part = (tx + share * (tx - memory[TORQUE])) / (4.0 * c.arm)
    pitch_part = (ty + share * (ty - memory[TORQUE + 1])) / (4.0 * c.arm)
    yaw_part = (tz + lead * (tz - memory[TORQUE + 2])) / (4.0 * c.torque_ratio)
    memory[TORQUE], memory[TORQUE + 1], memory[TORQUE + 2], memory[AWAKE] = tx, ty, tz, 1.0
    roll_part, pitch_part = clip(roll_part, c.tilt_authority), clip(pitch_part, c.tilt_authority)
    yaw_part = clip(yaw_part, c.yaw_authority)
    hover = 0.25 * c.mass * c.gravity
    most = c.pwm_limit * 0.25 * c.thrust_per_pwm / hover
    for k in range(4):
        force = 0.25 * c.thrust_per_pwm * pwm + SIDE_Y[k] * roll_part - SIDE_X[k] * pitch_part
        force += SPIN[k] * yaw_part
        force = min(most, max(0.0, force / hover))
        if b.thrust_exponent != 1.0 or b.thrust_curve != 0.0:
            force = max(0.0, force**b.thrust_exponent + b.thrust_curve * (force - 1.0) * force)
        target[k] = math.sqrt(force * hover / c.thrust_per_speed)


@numba.njit(cache=True)
def cascade(off_roll, off_pitch, roll_ahead, pitch_ahead, roll, pitch, gyro, memory, time, dt, c, b, w):
    """Angular accelerations to ask for [rad/s2]: an attitude loop over a rate loop with three terms.

    off_roll and off_pitch [rad]: what the angles lack; roll_ahead and pitch_ahead [rad/s]: rates fed forward.
    """
    quick = c.rate_bandwidth / (1.0 + b.derivative)  # of the rate loop as a whole
    slower = 1.0 / (1.0 + w.rate_lag * quick)
    quick *= slower
    bandwidth = c.rate_bandwidth * slower
    roll_rate, pitch_rate, _ = angle_rates(roll, pitch, gyro[0], gyro[1], gyro[2])
    damping = b.pole_shift / (quick * time)
    p, q, _ = body_rates(
        roll,
        pitch,
        off_roll / time - damping * roll_rate + roll_ahead,
        off_pitch / time - damping * pitch_rate + pitch_ahead,
        memory[SETPOINT + 2],
    )
    asked, smooth = np.array([p, q]), math.exp(-dt / b.derivative_filter)
    for k in range(2):
        before = memory[SMOOTH + k]
        memory[SMOOTH + k] = gyro[k] + smooth * (before - gyro[k])
        turning = (memory[SMOOTH + k] - before) / dt if memory[AWAKE] != 0.0 else 0.0
        error = asked[k] - gyro[k]
        memory[INTEGRAL + k] += dt * (error - memory[INTEGRAL + k] / b.integral_leak)
        integral = slower * b.integral * memory[INTEGRAL + k]
        asked[k] = bandwidth * error + integral - b.derivative * turning
    # Yaw turns with the rates that are, not with those that roll and pitch ask for.
    _, _, o = body_rates(roll, pitch, roll_rate, pitch_rate, memory[SETPOINT + 2])
    return asked[0], asked[1], c.yaw_bandwidth * (o - gyro[2])


@numba.njit(cache=True)
def incremental(wanted_roll, wanted_pitch, roll, pitch, gyro, memory, time, dt, c, b, w):
    """Angular accelerations to ask for [rad/s2]: increments on those that the motors make at present.

    The attitude error is geometric, between the rotations wanted and present at the same heading.
    """
    sw, cw = math.sin(wanted_roll), math.cos(wanted_roll)
    tw, dw = math.sin(wanted_pitch), math.cos(wanted_pitch)
    s, c_, t, d = math.sin(roll), math.cos(roll), math.sin(pitch), math.cos(pitch)
    # Columns of Rx(roll) Ry(pitch): (d, s t, -c t), (0, c, s), (t, -s d, c d). What turns the present
    # rotation into the one wanted has the products of the columns of both as its entries.
    e32 = -s * d * cw + c_ * d * sw
    e23 = -sw * dw * c_ + cw * dw * s
    e13 = d * tw - s * t * sw * dw - c_ * t * cw * dw
    e31 = dw * t - sw * tw * s * d - cw * tw * c_ * d
    asked = np.array([0.5 * (e32 - e23), 0.5 * (e13 - e31)])
    smooth = math.exp(-dt / b.derivative_filter)
    motor = c.motor_time * (1.0 - b.lead)
    follow = math.exp(-dt / motor) if motor > 0.0 else 0.0
    quick = c.rate_bandwidth / (1.0 + w.rate_lag * c.rate_bandwidth)
    for k in range(2):
        before = memory[SMOOTH + k]
        memory[SMOOTH + k] = gyro[k] + smooth * (before - gyro[k])
        turning = (memory[SMOOTH + k] - before) / dt if memory[AWAKE] != 0.0 else 0.0
        torque = memory[TORQUE + k] / c.inertia[k]
        memory[MOTOR + k] = torque + follow * (memory[MOTOR + k] - torque)
        memory[LATE + k] = memory[MOTOR + k] + smooth * (memory[LATE + k] - memory[MOTOR + k])
        asked[k] = quick * (asked[k] / time - gyro[k]) + b.kept_torque * (memory[LATE + k] - turning)
    return asked[0], asked[1], c.yaw_bandwidth * (memory[SETPOINT + 2] * c_ * d - gyro[2])


@numba.njit(cache=True)
def full_state(off_roll, off_pitch, roll, gyro, memory, time, dt, c, b, w):
    """Angular accelerations to ask for [rad/s2]: a gain on angle, rate and the motors' present torque.

    It puts the poles at -1/time and a pair of rate `pole_rate` and damping `pole_damping`.
    """
    slow, lag = 1.0 / time, c.motor_time
    quick = b.pole_rate / (1.0 + w.rate_lag * b.pole_rate)
    angle_gain = lag * slow * quick * quick
    rate_gain = lag * (quick * quick + 2.0 * b.pole_damping * quick * slow)
    torque_gain = lag * (slow + 2.0 * b.pole_damping * quick) - 1.0
    asked, follow = np.array([off_roll, off_pitch]), math.exp(-dt / lag)
    for k in range(2):
        torque = memory[TORQUE + k] / c.inertia[k]
        memory[MOTOR + k] = torque + follow * (memory[MOTOR + k] - torque)
        asked[k] = angle_gain * asked[k] - rate_gain * gyro[k] - torque_gain * memory[MOTOR + k]
    return asked[0], asked[1], c.yaw_bandwidth * (memory[SETPOINT + 2] * math.cos(roll) - gyro[2])
