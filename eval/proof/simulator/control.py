"""Flight controller (500 Hz) and pilot (50 Hz): they see measurements only. Compiled.

The flight controller is cascaded: an attitude loop with a derivative term asks for body rates, a rate loop
asks for torques, whose derivative cancels the motors' lag, and the mixer asks for four thrusts. It has no
integral terms: the paper's identified loop, with a steady gain above one, has none either.
"""

import math

import numba

from .dynamics import SIDE_X, SIDE_Y, SPIN

# Columns of the reference, one row per pilot period.
REF_POSITION, REF_VELOCITY, REF_ACCELERATION, REF_YAW, REF_YAW_RATE = 0, 3, 6, 9, 10
REF_ROLL, REF_PITCH, REF_PWM, REF_MODE = 11, 12, 13, 14
# Where the pilot believes the surface to be, and how high above it the motors are cut.
REF_SURFACE, REF_TILT, REF_CUT_HEIGHT, REF_SIZE = 15, 16, 17, 18
TRACK, STEP, LAND = (
    0.0,
    1.0,
    2.0,
)  # modes: follow the path; roll and pitch as given; follow, then cut the motors


@numba.njit(cache=True)
def pilot(ref, position, velocity, yaw, integral, c, command):
    """Command (4,) [PWM, roll, pitch, yaw rate] from the estimate; integral (3,) is the pilot's memory.

    A pilot who has cut the motors (PWM 0) to land does not start them again.
    """
    if ref[REF_MODE] == LAND:
        tilt = ref[REF_TILT]
        above = position[0] * math.sin(tilt) + (position[2] - ref[REF_SURFACE]) * math.cos(tilt)
        if above < ref[REF_CUT_HEIGHT] or command[0] == 0.0:
            command[:] = 0.0
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
def flight_controller(pwm, setpoint, roll, pitch, gyro, memory, dt, c, w, target):
    """Rotor speeds (4,) to ask of the motors, for the perfect supply.

    pwm and setpoint (3,) [roll, pitch rad, yaw rate] as received, roll and pitch [rad] estimated, gyro
    (3,); memory (7,): filtered setpoint, torques of the last call, whether there was one.
    """
    if pwm <= 0.0:
        target[:] = 0.0
        memory[6] = 0.0
        return
    fast, slow = math.exp(-dt / c.setpoint_filter), math.exp(-dt / c.yaw_filter)
    memory[0] = setpoint[0] + fast * (memory[0] - setpoint[0])
    memory[1] = setpoint[1] + fast * (memory[1] - setpoint[1])
    memory[2] = setpoint[2] + slow * (memory[2] - setpoint[2])
    gain = c.attitude_gain * w.attitude_gain_scale
    time = c.attitude_time * w.attitude_time_scale
    bandwidth = 1.0 / (1.0 / c.rate_bandwidth + w.rate_lag)
    roll_rate, pitch_rate, _ = angle_rates(roll, pitch, gyro[0], gyro[1], gyro[2])
    damping = 1.0 / (bandwidth * time)
    wanted_roll = (gain * memory[0] - roll) / time - damping * roll_rate
    wanted_pitch = (gain * memory[1] - pitch) / time - damping * pitch_rate
    p, q, o = body_rates(roll, pitch, wanted_roll, wanted_pitch, memory[2])
    tx = c.inertia[0] * bandwidth * (p - gyro[0])
    ty = c.inertia[1] * bandwidth * (q - gyro[1])
    tz = c.inertia[2] * c.yaw_bandwidth * (o - gyro[2])
    lead = c.motor_time / dt if memory[6] != 0.0 else 0.0
    roll_part = (tx + lead * (tx - memory[3])) / (4.0 * c.arm)
    pitch_part = (ty + lead * (ty - memory[4])) / (4.0 * c.arm)
    yaw_part = (tz + lead * (tz - memory[5])) / (4.0 * c.torque_ratio)
    memory[3], memory[4], memory[5], memory[6] = tx, ty, tz, 1.0
    roll_part, pitch_part = clip(roll_part, c.tilt_authority), clip(pitch_part, c.tilt_authority)
    yaw_part = clip(yaw_part, c.yaw_authority)
    most = c.pwm_limit * 0.25 * c.thrust_per_pwm
    for k in range(4):
        force = 0.25 * c.thrust_per_pwm * pwm + SIDE_Y[k] * roll_part - SIDE_X[k] * pitch_part
        force += SPIN[k] * yaw_part
        target[k] = math.sqrt(min(most, max(0.0, force)) / c.thrust_per_speed)
