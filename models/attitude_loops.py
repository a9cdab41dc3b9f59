"""The attitude loops of the equations, compiled: their rates and accelerations, and exact solutions.

Two models, after Kooi and Babuska (IROS 2021):

- ``kinematic``: the paper's first-order loops, d(angle)/dt = (k command - angle)/tau;
- ``rate_loop``: the same loops around a rate loop of bandwidth B, as in the MuJoCo vehicle:
  d2(angle)/dt2 = B (rate_wanted - rate) + d(rate_wanted)/dt, the latter at a held command, -rate/tau: poles
  exactly -1/tau and -B; with a damping other than 1 the rate terms are that many times as large.

With integral gains, both command the rate (k command - angle + integral I)/tau + hold (I/tau - angle) for
roll and pitch, with dI/dt = k command - angle. `integral` acts on the angle, k_i = integral/tau: a step
overshoots, and a steady moment causes no steady tilt. `hold` acts on the rate: I/tau - angle is the integral
of the difference between error/tau and the rate, which moments cause but commands hardly do. The tilt caused
by a moment is then that without integrals, times s/(s + hold). I is held where it would grow beyond
+-integral_limit (anti-windup). With a saturation no larger rate is wanted than 1/saturation.

Symbols of the comments: phi, theta, psi roll, pitch and yaw.
"""

import math

import numpy as np

from inclined_landing.models.attitude import PITCH_COMMAND, ROLL, ROLL_COMMAND, YAW_RATE_COMMAND
from inclined_landing.models.compiled import inlined, inner, kernel, unlocked


@inlined
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


@inlined
def angle_errors(roll, pitch, u, v):
    """Return the errors [rad] of roll and pitch of the onboard estimate under a command u (4,)."""
    # k (phi_c + trim) - phi_e, theta alike
    gain = v.attitude.gain
    return (
        gain * (u[ROLL_COMMAND] + v.effects.attitude_trim[0]) - roll,
        gain * (u[PITCH_COMMAND] + v.effects.attitude_trim[1]) - pitch,
    )


@inlined
def loop_rates(angles, errors, integrals, u, v):
    """Return the Euler rates [rad/s] that the paper's first-order loops command without saturation.

    angles: roll and pitch of the onboard estimate; errors: see `angle_errors`; integrals: their integrals
    over time [rad s]; u: command (4,).
    """
    # dphi/dt = (error + integral I)/tau + hold (I/tau - phi), theta alike; dpsi/dt = k_psi r_c + drift
    tau, hold = v.attitude.time_constant, v.effects.attitude_hold
    integral = v.effects.attitude_integral + hold
    return (
        (errors[0] + integral * integrals[0]) / tau - hold * angles[0],
        (errors[1] + integral * integrals[1]) / tau - hold * angles[1],
        v.attitude.yaw_gain * u[YAW_RATE_COMMAND] + v.effects.yaw_drift,
    )


@inlined
def integrates(v):
    """Return whether the loops of roll and pitch have integral gains."""
    return v.effects.attitude_integral != 0.0 or v.effects.attitude_hold != 0.0


@kernel
def write_resting_integrals(ids, state, vehicles, out):
    """Write the steady integrals (n, 2) [rad s] without a moment, at attitudes without an error.

    Only those of the vehicles `ids` are written. state: (n, 13); vehicles: (n,) or (1,) from `forces.pack`.
    """
    for i in ids:
        v = vehicles[i if len(vehicles) > 1 else 0]
        # integral I/tau + hold (I/tau - angle) = 0
        hold, limit = v.effects.attitude_hold, v.attitude.integral_limit
        total = v.effects.attitude_integral + hold
        time = (hold / total if total != 0.0 else 0.0) * v.attitude.time_constant
        for k in range(2):
            out[i, k] = min(limit, max(-limit, state[i, ROLL + k] * time))


@inlined
def excess(rate, v):
    """Return the ratio of a desired rate [rad/s] of roll or pitch to the rate limit, at least 1."""
    return max(1.0, abs(rate) * v.effects.attitude_saturation)


@inlined
def saturated(rates, v):
    """Return desired Euler rates [rad/s], with those of roll and pitch limited."""
    return rates[0] / excess(rates[0], v), rates[1] / excess(rates[1], v), rates[2]


@inlined
def integral_rate(integral, error, v):
    """Return the derivative dI/dt [rad] of the integral I [rad s] of an angle error."""
    if abs(integral) >= v.attitude.integral_limit and integral * error > 0.0:
        return 0.0
    return error


@inlined
def rate_loop_acceleration(wanted, rate, integrated, tau, v):
    """Return the angular acceleration [rad/s2] of the loop whose poles are -1/tau and -B with damping 1.

    wanted: rate [rad/s] from `loop_rates`; integrated: the dI/dt [rad] of that axis, which preserves the
    poles of the first-order loop.
    """
    # d2phi/dt2 = B (rate_w - rate) + d(rate_w)/dt - (damping - 1) (B + 1/tau) rate
    # d(rate_w)/dt = ((integral + hold) dI/dt - rate)/tau - hold rate, 0 where saturated
    over, hold = excess(wanted, v), v.effects.attitude_hold
    following = ((v.effects.attitude_integral + hold) * integrated - rate) / tau - hold * rate
    following = following if over == 1.0 else 0.0
    beyond = (v.attitude.damping - 1.0) * (v.attitude.bandwidth + 1.0 / tau)
    return v.attitude.bandwidth * (wanted / over - rate) + following - beyond * rate


@unlocked
def angle_steps(axis, command, twist, start, dt, vehicle):
    """Return the angle (m + 1,) [rad] of the roll (axis 0) or pitch (1) loop, solved exactly if it neither
    integrates nor saturates.

    The loop starts at rest at `start` [rad]. command (m,) [rad] and twist (m,) further angular accelerations
    [rad/s2] are held for `dt` [s] each.
    """
    v = vehicle[0]
    if integrates(v) or v.effects.attitude_saturation != 0.0:
        return integrated_steps(axis, command, twist, start, dt, vehicle)[:, 0].copy()
    gain, trim = v.attitude.gain, v.effects.attitude_trim[axis]
    tau = v.attitude.time_constant
    step, stiffness = held_step(tau, dt, v), v.attitude.bandwidth / tau
    out, rate = np.empty(len(command) + 1), 0.0
    out[0] = start
    for k in range(len(command)):
        rest = gain * (command[k] + trim) + twist[k] / stiffness
        off, rate = held_angle(out[k] - rest, rate, step)
        out[k + 1] = rest + off
    return out


@inlined
def damping_rate(tau, v):
    """Return the coefficient [1/s] of the rate in a loop of time constant tau [s], the sum of its poles."""
    return v.attitude.damping * (1.0 / tau + v.attitude.bandwidth)


@inlined
def held_step(tau, dt, v):
    """Return the coefficients of `held_angle` for steps of `dt` [s] of a loop with time constant tau [s]."""
    # a = 1/tau, b = B: x'' = a b (rest - x) - damping (a + b) x', rest = k (command + trim) + twist/(a b).
    # Poles -mean +- half. Off the rest, e = x - rest, over one step:
    #   e   <- stay e + drive x',          stay = exp(-mean dt) cosh(half dt) + mean drive
    #   x'  <- (stay - 2 mean drive) x' - a b drive e,   drive = exp(-mean dt) sinh(half dt)/half
    # with cos and sin of |half| dt where the poles are complex.
    mean, stiffness = 0.5 * damping_rate(tau, v), v.attitude.bandwidth / tau
    square = mean * mean - stiffness
    half = math.sqrt(abs(square))
    if square > 0.0:
        slow, apart = math.exp(-(mean - half) * dt), 2.0 * half * dt
        drive = slow * dt * -math.expm1(-apart) / apart
        stay = slow + (mean - half) * drive
    else:
        slow, swing = math.exp(-mean * dt), half * dt
        drive = slow * dt * (math.sin(swing) / swing if swing > 0.0 else 1.0)
        stay = slow * math.cos(swing) + mean * drive
    return stay, drive, stay - 2.0 * mean * drive, stiffness * drive


@inlined
def held_angle(off, rate, step):
    """Return an angle's distance from its steady value [rad] and its rate [rad/s] after a `held_step`."""
    stay, drive, keep, back = step
    return stay * off + drive * rate, keep * rate - back * off


@unlocked
def integrated_steps(axis, command, twist, start, dt, vehicle):
    """Return the angle [rad] and the integral of its error [rad s] (m + 1, 2) of any loop.

    The arguments are those of `angle_steps`. The integral starts at the value that compensates the first
    twist. The solution is exact without saturation while the integral is within its limit, and otherwise
    integrated by RK4.
    """
    v = vehicle[0]
    tau, limit, hold = v.attitude.time_constant, v.attitude.integral_limit, v.effects.attitude_hold
    gain, trim, integral = v.attitude.gain, v.effects.attitude_trim[axis], v.effects.attitude_integral + hold
    out, x, w, i = np.empty((len(command) + 1, 2)), start, 0.0, 0.0
    if integral != 0.0:  # no error and no rate:  B (integral I/tau - hold x) + twist = 0
        i = (hold * x - twist[0] / v.attitude.bandwidth) * tau / integral
        i = min(limit, max(-limit, i))
    out[0] = x, i
    if v.effects.attitude_saturation == 0.0:
        step = _linear_step(dt, v)
        for k in range(len(command)):
            wanted, t = gain * (command[k] + trim), twist[k]
            x, w, i = (
                step[0, 0] * x + step[0, 1] * w + step[0, 2] * i + step[0, 3] * wanted + step[0, 4] * t,
                step[1, 0] * x + step[1, 1] * w + step[1, 2] * i + step[1, 3] * wanted + step[1, 4] * t,
                step[2, 0] * x + step[2, 1] * w + step[2, 2] * i + step[2, 3] * wanted + step[2, 4] * t,
            )
            i = min(limit, max(-limit, i))
            out[k + 1] = x, i
        return out
    rates = 1.0 / tau + v.attitude.bandwidth
    parts = math.ceil(
        4.0 * max(1.0, v.attitude.damping) * rates * dt
    )  # 0.25^5/120: 8e-6 of the quickest change
    h = dt / parts
    for k in range(len(command)):
        wanted, t = gain * (command[k] + trim), twist[k]
        for _ in range(parts):
            x1, w1, i1 = _loop_derivative(x, w, i, wanted, t, v)
            x2, w2, i2 = _loop_derivative(x + 0.5 * h * x1, w + 0.5 * h * w1, i + 0.5 * h * i1, wanted, t, v)
            x3, w3, i3 = _loop_derivative(x + 0.5 * h * x2, w + 0.5 * h * w2, i + 0.5 * h * i2, wanted, t, v)
            x4, w4, i4 = _loop_derivative(x + h * x3, w + h * w3, i + h * i3, wanted, t, v)
            x += h / 6.0 * (x1 + 2.0 * (x2 + x3) + x4)
            w += h / 6.0 * (w1 + 2.0 * (w2 + w3) + w4)
            i += h / 6.0 * (i1 + 2.0 * (i2 + i3) + i4)
        out[k + 1] = x, i
    return out


@inner
def _linear_step(dt, v):
    """Return the step (5, 5) by `dt` [s] of angle, rate, integral, wanted angle and twist of a loop."""
    # z' = A z, so that z <- exp(A dt) z: by its series at dt/2^n, squared n times
    a, unit = np.zeros((5, 5)), 1e-6 * min(1.0, v.attitude.integral_limit) * np.eye(5)
    for j in range(5):
        x, w, i, wanted, t = unit[j]
        a[0, j], a[1, j], a[2, j] = _loop_derivative(x, w, i, wanted, t, v)
    a /= unit[0, 0]
    halvings = max(0, math.ceil(math.log2(max(1e-9, np.abs(a).sum(axis=0).max() * dt)))) + 1
    part, step, term = a * (dt / 2.0**halvings), np.eye(5), np.eye(5)
    for k in range(1, 14):  # 0.5^14/14!: 1e-15
        term = term @ part / k
        step += term
    for _ in range(halvings):
        step = step @ step
    return step


@inlined
def _loop_derivative(angle, rate, integral, wanted, twist, v):
    """Return the derivatives of angle, rate and integral of a loop at a wanted angle [rad]."""
    error, tau, hold = wanted - angle, v.attitude.time_constant, v.effects.attitude_hold
    moved = integral_rate(integral, error, v)
    demanded = (error + (v.effects.attitude_integral + hold) * integral) / tau - hold * angle
    return rate, rate_loop_acceleration(demanded, rate, moved, tau, v) + twist, moved


@unlocked
def yaw_steps(command, dt, vehicle):
    """Return yaw (m + 1,) [rad], starting from 0 at the first of the commanded rates (m,) [rad/s]; exact.

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
