"""Force and torque of the rotors and the air on a vehicle, compiled.

Every neutral effect of the vehicle (`effects_...`; see `effects/`) is a factor of 1 or a summand of 0, so
that it does not change a single bit. The thrust's lag is here too.

Symbols of the comments: F_t total thrust, Omega state of the thrust lag, f and tau force and torque in the
body frame, v velocity, R attitude matrix (body to world).
"""

import dataclasses
import functools
import math
from collections import defaultdict
from collections.abc import Callable, Sequence
from operator import attrgetter
from types import SimpleNamespace

import numpy as np

from inclined_landing.models.attitude import to_body
from inclined_landing.models.base.errors import UserError
from inclined_landing.models.compiled import inlined, inner, unlocked
from inclined_landing.models.parameters import load_vehicle
from inclined_landing.models.vehicle import Vehicle

# Columns of a vehicle's ambient conditions: time [s], battery voltage [V] (NaN: that of the vehicle file),
# inclination of the platform [rad], whether it is there, its azimuth about the vertical [rad].
AMBIENT_SIZE = 5
TIME, VOLTAGE, INCLINATION, PRESENT, AZIMUTH = range(AMBIENT_SIZE)
_DERIVED = ("slab_half_length", "thrust_centre")  # properties of a vehicle that the kernels take too


@functools.cache
def _layout() -> tuple[Callable, np.dtype]:
    """Return a getter of all values of a vehicle, and the type of the array from `pack`."""
    shipped = load_vehicle()
    tables: dict[str, list[tuple]] = {}
    for field in dataclasses.fields(Vehicle):
        table, _, entry = field.name.partition("_")
        tables.setdefault(table, []).append((entry, float, np.shape(getattr(shipped, field.name))))
    names = [f"{table}_{entry}" for table in tables for entry, *_ in tables[table]]
    more = [(name, float, np.shape(getattr(shipped, name))) for name in _DERIVED]
    return attrgetter(*names, *_DERIVED), np.dtype((np.record, np.dtype([*tables.items(), *more])))


def pack(vehicle: Vehicle) -> np.ndarray:
    """Return the vehicle for the kernels: (1,), a record `v` in which entry `b` of table `a` is `v.a.b`.

    The names are part of the array's type, and so of a compiled kernel's signature.
    """
    values, layout = _layout()
    numbers: list[float] = []
    for value in values(vehicle):
        numbers += value if isinstance(value, tuple) else (value,)
    return np.array(numbers, float).view(layout)


def numbers(records: np.ndarray) -> np.ndarray:
    """Return the records (n,) from `pack` as rows of numbers (n, m) that share their memory."""
    return records.view(float).reshape(len(records), -1)


def columns_besides(fields: Sequence[str]) -> np.ndarray:
    """Return the columns of `numbers` for all fields of a `Vehicle` except these."""
    besides, (_, layout) = set(fields), _layout()
    columns: list[int] = []
    for field in dataclasses.fields(Vehicle):
        table, _, entry = field.name.partition("_")
        within, begin = layout.fields[table]
        values, offset = within.fields[entry]
        if field.name in besides:
            besides.remove(field.name)
        else:
            columns += range((begin + offset) // 8, (begin + offset + values.itemsize) // 8)
    assert not besides, f"a vehicle has no {besides}"
    return np.array(columns, int)


@inlined
def neutral(row, numbers, columns):
    """Return whether a row of `numbers` is 0 in all of these columns."""
    for k in columns:
        if numbers[row, k] != 0.0:
            return False
    return True


@inlined
def rotor_speed_sum(thrust, v):
    """Return the sum of the rotor speeds [rad/s] at a total thrust [N], 0 without thrust.

    It follows from the static maps of one motor, force a PWM^2 + b PWM + c and speed d PWM + e. Below the
    force c at PWM 0 the sum decreases linearly to zero.
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


@inlined
def total_thrust(lag, pwm, scale, v):
    """Return the total thrust F_t [N], times a scale, at a lag state [PWM s] and a PWM command."""
    # F_t = scale (c_Omega Omega + c_PWM PWM)
    return scale * (v.thrust.state_gain * lag + v.thrust.direct_gain * pwm)


@inlined
def lag_derivative(lag, pwm, v):
    """Return dOmega/dt [PWM] of the thrust lag; slower while it spins down, with that effect."""
    # dOmega/dt = PWM - lambda Omega, over 1 + spin_down where that is negative
    rate = pwm - v.thrust.lag_rate * lag
    if v.effects.spin_down != 0.0 and rate < 0.0:
        rate /= 1.0 + v.effects.spin_down
    return rate


@inlined
def lag_pole(lag, pwm, v):
    """Return the rate [1/s] at which the lag approaches its steady value under a held command."""
    if v.effects.spin_down != 0.0 and pwm < v.thrust.lag_rate * lag:
        return v.thrust.lag_rate / (1.0 + v.effects.spin_down)
    return v.thrust.lag_rate


@unlocked
def lags(pwm, dt, vehicle):
    """Return the lag [PWM s] (m + 1,) under commands (m,) held for `dt` [s], and its mean (m,) over each.

    It is first steady under the first command. The solution is exact.
    """
    # Omega(dt) = Omega_s + (Omega - Omega_s) exp(-lambda dt), Omega_s = PWM/lambda
    v, lag, mean = vehicle[0], np.empty(len(pwm) + 1), np.empty(len(pwm))
    up, down = v.thrust.lag_rate * dt, v.thrust.lag_rate / (1.0 + v.effects.spin_down) * dt  # lambda dt
    kept_up, kept_down = math.exp(-up), math.exp(-down)
    lag[0] = pwm[0] / v.thrust.lag_rate
    for k in range(len(pwm)):
        falls, steady = pwm[k] < v.thrust.lag_rate * lag[k], pwm[k] / v.thrust.lag_rate
        rate, kept = (down, kept_down) if falls else (up, kept_up)
        mean[k] = steady + (lag[k] - steady) * (1.0 - kept) / rate
        lag[k + 1] = steady + (lag[k] - steady) * kept
    return lag, mean


@inlined
def fade(time, v):
    """Return the factor of the thrust that results from the thrust fade after a flight time [s]."""
    return 1.0 - v.effects.thrust_fade * time


@inlined
def battery_voltage(lag, time, v):
    """Return the voltage [V] of the vehicle file's battery at a lag state, after a flight time [s]."""
    # U = U_open - drop load - discharge t, the load as steady PWM: lambda Omega
    load = v.thrust.lag_rate * lag
    return v.effects.voltage_open - v.effects.voltage_drop * load - v.effects.voltage_discharge * time


@inlined
def supply(voltage, lag, time, v):
    """Return the factor of the thrust at a battery voltage [V]; NaN selects that of the vehicle file."""
    if math.isnan(voltage):
        voltage = battery_voltage(lag, time, v)
    return 1.0 + v.effects.voltage_sensitivity * (voltage - v.effects.voltage_reference)


@inlined
def powered_thrust(thrust, lag, time, voltage, v):
    """Return the thrust [N] that sets the rotor speed, with bias, fade, sag and battery voltage."""
    # F = (F_t + bias) (1 - fade t) (1 - sag (load/reference - 1)) (1 + sensitivity (U - U_ref))
    load = v.thrust.lag_rate * lag
    sag = 1.0 - v.effects.battery_sag * (load / v.effects.battery_reference - 1.0)
    return (thrust + v.effects.thrust_bias) * fade(time, v) * sag * supply(voltage, lag, time, v)


@inlined
def intact(v):
    """Return the share of the thrust that the rotors have not lost."""
    loss = v.effects.rotor_loss
    return 1.0 - 0.25 * (loss[0] + loss[1] + loss[2] + loss[3])


def _steady_thrust(pwm, v):
    """Return the thrust [N] under a PWM held for long, at time 0."""
    lag = pwm / v.thrust.lag_rate
    return powered_thrust(total_thrust(lag, pwm, 1.0, v), lag, 0.0, math.nan, v) * intact(v)


def settled_hover(vehicle: Vehicle) -> float:
    """Return the hover PWM at time 0 with the effects on the thrust: bias, sag, voltage.

    It is `Vehicle.hover_pwm` without effects, and the highest command if no command can carry the weight.
    Raises UserError if the battery's sag is relative to a PWM of 0.
    """
    if vehicle.effects_battery_reference == 0.0:
        raise UserError("effects.battery_reference of the vehicle is 0; the battery's sag is relative to it")
    # In Python, because a kernel would take longer to compile than thousands of these take.
    v, pwm = _tables(vehicle), vehicle.hover_pwm
    low, high = 0.0, max(pwm, vehicle.command_pwm_range[1])
    weight = (v.body.mass + v.effects.load_mass) * v.environment.gravity
    if _steady_thrust(pwm, v) == total_thrust(pwm / v.thrust.lag_rate, pwm, 1.0, v):
        return pwm
    for _ in range(60):  # halves: to 1e-13 of what lies between
        pwm = 0.5 * (low + high)
        if _steady_thrust(pwm, v) < weight:
            low = pwm
        else:
            high = pwm
    return high


def _tables(vehicle: Vehicle) -> SimpleNamespace:
    """Return a vehicle with the names of `pack`, for formulas that Python runs."""
    tables: defaultdict[str, SimpleNamespace] = defaultdict(SimpleNamespace)
    for field, value in vars(vehicle).items():
        table, _, entry = field.partition("_")
        setattr(tables[table], entry, value)
    return SimpleNamespace(**tables)


@inlined
def disc_inside(distance, radius):
    """Return the share of a disc inside a straight edge, with its centre `distance` inside the edge."""
    # 1/2 + (d sqrt(1 - d^2) + arcsin d)/pi, the area of a circular segment with d = distance/radius
    d = min(1.0, max(-1.0, distance / radius))
    return 0.5 + (d * math.sqrt(1.0 - d * d) + math.asin(d)) / math.pi


@inlined
def ground_gain(height, v):
    """Return the share of thrust that a rotor gains over an infinite surface, at a height h [m] of its disc.

    gain = strength (radius/(4 h))^2 after Cheeseman and Bennett (1955) to first order, times the fading
    exp((4 radius - h) fading), which is 1 at the reference height of the strength; radius/(4 h) is at most
    1/2 and the gain at most 1.
    """
    ratio = 0.5
    if height > 0.5 * v.rotor.radius:
        ratio = v.rotor.radius / (4.0 * height)
    fading = math.exp((4.0 * v.rotor.radius - height) * v.effects.ground_fading)
    return min(1.0, v.effects.ground_effect * ratio * ratio * fading)


@inner
def ground_effect(position, r, thrust, inclination, present, azimuth, v):
    """Return the extra thrust [N] and body torque (x, y) [N m] of the rotors near a surface.

    position (3,), attitude matrix r as nine entries, thrust [N] of all rotors. The slab acts on the share of
    each disc that is over it along the rotor's axis, and the floor on the rest; heights are measured along
    the normals.
    """
    extra, torque_x, torque_y = 0.0, 0.0, 0.0
    if r[8] <= 0.0:
        return extra, torque_x, torque_y
    si, ci, sa, ca, lean_along, lean_across, facing = 0.0, 1.0, 0.0, 1.0, 0.0, 0.0, 0.0
    if present != 0.0:
        si, ci = math.sin(inclination), math.cos(inclination)
        sa, ca = math.sin(azimuth), math.cos(azimuth)
        lean_along, lean_across = ca * r[2] + sa * r[5], ca * r[5] - sa * r[2]  # of the rotor's axis
        facing = si * lean_along + ci * r[8]  # of the rotor's axis and the slab's normal
    radius = v.rotor.radius
    for side in range(4):
        x = v.rotor.arm if side < 2 else -v.rotor.arm
        y = v.rotor.arm if side % 2 == 0 else -v.rotor.arm
        px = position[0] + r[0] * x + r[1] * y + r[2] * v.rotor.height
        py = position[1] + r[3] * x + r[4] * y + r[5] * v.rotor.height
        pz = position[2] + r[6] * x + r[7] * y + r[8] * v.rotor.height
        share, gain = 0.0, 0.0
        if facing > 0.0:
            forward, beside = ca * px + sa * py, ca * py - sa * px  # horizontal, along the slope's direction
            normal = si * forward + ci * (pz - v.platform.surface_height)
            along = ci * forward - si * (pz - v.platform.surface_height)
            down = normal / facing  # along the rotor's axis
            along -= down * (ci * lean_along - si * r[8])
            across = beside - down * lean_across
            if normal > 0.0 and down * r[8] < pz:  # the slab is below, and the floor below it
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


@inlined
def rotors(lag, pwm, time, voltage, scale, v):
    """Return the thrust [N] of intact rotors at rest in the air, and the rotor speed sum for the drag.

    lag state, PWM, flight time [s], battery voltage [V], scale of the total thrust, vehicle v.
    """
    thrust = powered_thrust(total_thrust(lag, pwm, scale, v), lag, time, voltage, v)
    return thrust, rotor_speed_sum(thrust, v)


@inlined
def in_the_air(thrust, speed, bx, by, bz, v):
    """Return the drag x, y, z [N] and the thrust [N] of `rotors` at an airspeed b [m/s] in the body frame."""
    # Rotor and body drag: f = K (sum of rotor speeds) b - c |b| b, b = R^T (v - wind), K diagonal
    k, flat = v.drag.coefficients, bx * bx + by * by
    drag = -v.effects.body_drag * math.sqrt(flat + bz * bz)
    # F (1 - mean loss) (1 + lift (b_x^2 + b_y^2)) max(0, 1 - inflow b_z)
    lift = 1.0 + v.effects.translational_lift * flat
    thrust *= intact(v) * lift * max(0.0, 1.0 - v.effects.axial_inflow * bz)
    return (k[0] * speed + drag) * bx, (k[1] * speed + drag) * by, (k[2] * speed + drag) * bz, thrust


@inlined
def wrench(position, velocity, r, lag, pwm, ambient, scale, v):
    """Return force x, y, z [N] and torque x, y [N m] in the body frame, without gravity.

    position, velocity (3,) in the world, attitude matrix r as nine entries, lag state and PWM, ambient
    (AMBIENT_SIZE,), scale of the total thrust, vehicle v.
    """
    near = 0.0, 0.0, 0.0
    if v.effects.ground_effect != 0.0:
        near = ground_effect(position, r, 1.0, ambient[INCLINATION], ambient[PRESENT], ambient[AZIMUTH], v)
    return wrench_near(near, velocity, r, lag, pwm, ambient, scale, v)


@inlined
def wrench_near(near, velocity, r, lag, pwm, ambient, scale, v):
    """Return force and torque as `wrench`.

    near (3,): the ground effect's extra thrust [N] and torques [N m] at a thrust of 1 N.
    """
    thrust, speed = rotors(lag, pwm, ambient[TIME], ambient[VOLTAGE], scale, v)
    ax, ay, az = velocity[0] - v.effects.wind[0], velocity[1] - v.effects.wind[1], velocity[2]
    bx, by, bz = to_body(r, ax, ay, az)
    fx, fy, fz, thrust = in_the_air(thrust, speed, bx, by, bz, v)
    tx, ty = near[1] * thrust, near[2] * thrust
    thrust += near[0] * thrust
    # Thrust at (x, y) from the centre of mass, which is at c: tau = (y F, -x F)
    tx += (v.thrust_centre[1] - v.effects.com_offset[1]) * thrust
    ty -= (v.thrust_centre[0] - v.effects.com_offset[0]) * thrust
    return fx, fy, fz + thrust, tx, ty


def free_air(n: int) -> np.ndarray:
    """Return the ambient conditions (n, AMBIENT_SIZE) at time 0, with the file's battery and no platform."""
    ambient = np.zeros((n, AMBIENT_SIZE))
    ambient[:, VOLTAGE] = np.nan
    return ambient
