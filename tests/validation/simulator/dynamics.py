"""Rigid body, four motors, air, battery, feet and slung load: time derivative and RK4, compiled.

The state vector: position, velocity (world), quaternion (w, x, y, z; body to world), body rates, four
rotor speeds, position and velocity of the slung load.
"""

import math

import numba
import numpy as np

from .vehicle import CHEESEMAN, EXPONENTIAL, FIRST_ORDER_SPEED

POSITION, VELOCITY, QUATERNION, RATES, ROTORS, LOAD, LOAD_VELOCITY, SIZE = 0, 3, 6, 10, 13, 17, 20, 23

# Rotor k sits at arm * (SIDE_X[k], SIDE_Y[k]); its reaction torque on the body is SPIN[k] * ratio * thrust.
SIDE_X = np.array([1.0, 1.0, -1.0, -1.0])
SIDE_Y = np.array([1.0, -1.0, -1.0, 1.0])
SPIN = np.array([-1.0, 1.0, -1.0, 1.0])

_STRING_STIFFNESS, _STRING_DAMPING = 3600.0, 40.0  # per kilogram of load: 60 rad/s, a third of critical


@numba.njit(cache=True)
def rotation(q, r):
    """Rotation matrix of quaternion q (4,) into r (3, 3)."""
    w, x, y, z = q[0], q[1], q[2], q[3]
    r[0, 0], r[0, 1], r[0, 2] = 1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)
    r[1, 0], r[1, 1], r[1, 2] = 2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)
    r[2, 0], r[2, 1], r[2, 2] = 2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)


@numba.njit(cache=True)
def angles(r):
    """(roll, pitch, yaw) of r = Rz(yaw) Rx(roll) Ry(pitch)."""
    return (
        math.asin(min(1.0, max(-1.0, r[2, 1]))),
        math.atan2(-r[2, 0], r[2, 2]),
        math.atan2(-r[0, 1], r[1, 1]),
    )


@numba.njit(cache=True)
def tilted(roll, pitch, yaw, a, b):
    """Angles of Rz(yaw) Rx(roll) Ry(pitch) Rx(a) Ry(b), yaw continuous with `yaw`."""
    r = np.empty((3, 3))
    q = np.array([math.cos(0.5 * yaw), 0.0, 0.0, math.sin(0.5 * yaw)])
    for half, axis in ((0.5 * roll, 1), (0.5 * pitch, 2), (0.5 * a, 1), (0.5 * b, 2)):
        s, c = math.sin(half), math.cos(half)
        w, x, y, z = q[0], q[1], q[2], q[3]
        if axis == 1:
            q[0], q[1], q[2], q[3] = c * w - s * x, c * x + s * w, c * y + s * z, c * z - s * y
        else:
            q[0], q[1], q[2], q[3] = c * w - s * y, c * x - s * z, c * y + s * w, c * z + s * x
    rotation(q, r)
    new_roll, new_pitch, new_yaw = angles(r)
    return new_roll, new_pitch, new_yaw + 2.0 * math.pi * round((yaw - new_yaw) / (2.0 * math.pi))


@numba.njit(cache=True)
def current(s, c):
    """What the battery gives [A]: a line over thrust, measured by Bitcraze."""
    squares = 0.0
    for k in range(4):
        squares += s[ROTORS + k] ** 2
    return c.hover_current * squares * c.thrust_per_speed / (c.mass * c.gravity)


@numba.njit(cache=True)
def voltage(s, time, c, w):
    """Battery voltage [V] under the load of the present rotor speeds."""
    full = c.battery_voltage + w.battery_voltage - c.battery_fall * max(time, 0.0)
    return full - w.battery_resistance * current(s, c)


@numba.njit(cache=True)
def derivative(s, target, air, anchor, time, c, b, w, r, contact, ds):
    """ds/dt of state s (23,).

    target (4,) rotor speeds [rad/s] asked of the motors, air (8,): wind (2,) [m/s], disturbance of the
    acceleration (3,) [m/s2] and of angular acceleration (3,) [rad/s2]; anchor (4, 3) points of the surface
    where the feet stick (NaN: not touching), time [s] of the log; r (3, 3) scratch, contact (4,) receives the
    normal force of each foot [N].
    """
    rotation(s[QUATERNION : QUATERNION + 4], r)
    mass = c.mass * w.mass_scale
    # Air.
    ax = s[VELOCITY] - w.wind_x - air[0]
    ay = s[VELOCITY + 1] - w.wind_y - air[1]
    az = s[VELOCITY + 2]
    rising = 0.0
    if w.updraft != 0.0:
        dx, dy = s[0] - w.updraft_x, s[1] - w.updraft_y
        rising = w.updraft * math.exp(-(dx * dx + dy * dy) / (2.0 * w.updraft_radius * w.updraft_radius))
        az -= rising
    bx = r[0, 0] * ax + r[1, 0] * ay + r[2, 0] * az
    by = r[0, 1] * ax + r[1, 1] * ay + r[2, 1] * az
    bz = r[0, 2] * ax + r[1, 2] * ay + r[2, 2] * az
    inflow = (1.0 + w.translational_lift * (bx * bx + by * by)) * (1.0 - w.axial_inflow * bz)
    if rising != 0.0:
        inflow *= 1.0 + 0.05 * rising  # a rotor in rising air gains thrust
    inflow *= w.thrust_scale * (1.0 - w.thrust_fade * max(time, 0.0))
    inflow *= 1.0 - w.yaw_loss * abs(s[RATES + 2])
    lateral = math.sqrt(bx * bx + by * by)
    thrust, speed, tx, ty, tz = rotors(s, target, inflow, lateral, c, b, w, r, ds)
    drag, more = c.drag_per_speed, b.quadratic_drag
    still = w.body_drag * math.sqrt(bx * bx + by * by + bz * bz)
    across = w.drag_scale * w.lateral_drag * speed / (1.0 + b.flapping * lateral)
    fx = -(drag[0] * across * (1.0 + more[0] * abs(bx)) + still) * bx
    fy = -(drag[1] * across * (1.0 + more[1] * abs(by)) + still) * by
    fz = -(drag[2] * w.drag_scale * speed * (1.0 + more[2] * abs(bz)) + still) * bz + thrust
    for k in range(3):
        ds[k] = s[VELOCITY + k]
        ds[VELOCITY + k] = (r[k, 0] * fx + r[k, 1] * fy + r[k, 2] * fz) / mass
    ds[VELOCITY + 2] -= c.gravity
    ahead, left = outside(s, time, r, w)
    ds[VELOCITY] += ahead + air[2]
    ds[VELOCITY + 1] += left + air[3]
    ds[VELOCITY + 2] += air[4]
    if w.load_mass > 0.0:
        pull_load(s, mass, c, w, ds)
    if w.contact != 0.0:
        tx, ty, tz = feet(s, tx, ty, tz, anchor, mass, c, w, r, contact, ds)
    # Rotation.
    jx, jy, jz = c.inertia[0], c.inertia[1], c.inertia[2]
    p, q, o = s[RATES], s[RATES + 1], s[RATES + 2]
    ds[RATES] = (tx - (jz - jy) * q * o) / jx + air[5]
    ds[RATES + 1] = (ty - (jx - jz) * o * p) / jy + air[6]
    ds[RATES + 2] = (tz - (jy - jx) * p * q) / jz + air[7]
    a, b, d, e = s[QUATERNION], s[QUATERNION + 1], s[QUATERNION + 2], s[QUATERNION + 3]
    ds[QUATERNION] = 0.5 * (-b * p - d * q - e * o)
    ds[QUATERNION + 1] = 0.5 * (a * p + d * o - e * q)
    ds[QUATERNION + 2] = 0.5 * (a * q + e * p - b * o)
    ds[QUATERNION + 3] = 0.5 * (a * o + b * q - d * p)


@numba.njit(cache=True)
def outside(s, time, r, w):
    """Horizontal acceleration (x, y) [m/s2] of what stands in the room or hangs on the vehicle."""
    x = y = 0.0
    if w.wall != 0.0:
        x += w.wall * math.exp(min(0.0, s[0] - w.wall_x) / w.wall_range)
    if w.swing != 0.0:
        force = w.swing * math.sin(2.0 * math.pi * time / w.swing_period)
        x += force * math.cos(w.swing_direction)
        y += force * math.sin(w.swing_direction)
    if w.heading_force != 0.0:
        heading = math.atan2(r[1, 0], r[0, 0])
        x += w.heading_force * math.cos(2.0 * heading)
        y += w.heading_force * math.sin(2.0 * heading)
    return x, y


@numba.njit(cache=True)
def ground_gain(height, lateral, c, b, w):
    """Factor of a rotor's thrust at a height [m] above a surface, at a speed [m/s] across its axis.

    The forms agree at four radii, at rest, to first order.
    """
    near = c.rotor_radius / (4.0 * height)
    if b.ground == CHEESEMAN:
        return 1.0 / (1.0 - min(w.ground_effect * near * near, 0.5))
    if b.ground == EXPONENTIAL:
        fading = math.exp((4.0 * c.rotor_radius - height) / b.ground_range)
        return 1.0 + min(w.ground_effect * fading / 256.0, 1.0)
    return 1.0 + min(w.ground_effect * near * near / (1.0 + 0.25 * lateral * lateral), 1.0)


@numba.njit(cache=True)
def rotors(s, target, inflow, lateral, c, b, w, r, ds):
    """Thrust [N], sum of speeds [rad/s] and torque (x, y, z) [N m] of the rotors; their part of ds.

    inflow: factor of the thrust, of all rotors alike; lateral: speed [m/s] of the air across their axis.
    """
    nx, nz = math.sin(w.surface_tilt), math.cos(w.surface_tilt)
    thrust = speed = tx = ty = tz = 0.0
    for k in range(4):
        n = s[ROTORS + k]
        slow = c.motor_time * w.motor_time_scale * b.rotor[k]
        if n > target[k]:
            slow *= (1.0 + w.spin_down) * (1.0 + b.spin_down)
        if b.motors == FIRST_ORDER_SPEED:
            ds[ROTORS + k] = (target[k] - n) / slow
        else:
            # Motor torque against the propeller's, which grows with n^2: thrust settles exponentially.
            ds[ROTORS + k] = (target[k] ** 2 - n * n) / (2.0 * slow * max(n, 50.0))
        force = c.thrust_per_speed * n * n * inflow + 0.25 * w.thrust_bias
        x, y = c.arm * SIDE_X[k], c.arm * SIDE_Y[k]
        if w.ground_effect != 0.0:
            px = s[0] + r[0, 0] * x + r[0, 1] * y + r[0, 2] * c.disc_height
            pz = s[2] + r[2, 0] * x + r[2, 1] * y + r[2, 2] * c.disc_height
            height = max(px * nx + (pz - w.surface_height) * nz, 0.5 * c.rotor_radius)
            force *= ground_gain(height, lateral, c, b, w)
        thrust += force
        speed += n
        tx += (y + w.com_y) * force
        ty -= (x + w.com_x) * force
        tz += SPIN[k] * c.torque_ratio * force
    return thrust, speed, tx, ty, tz


@numba.njit(cache=True)
def pull_load(s, mass, c, w, ds):
    """A slung load on a string that only pulls: its part of ds, and what it pulls at the vehicle."""
    dx, dy, dz = s[LOAD] - s[0], s[LOAD + 1] - s[1], s[LOAD + 2] - s[2]
    length = math.sqrt(dx * dx + dy * dy + dz * dz)
    pull = 0.0
    if length > w.load_length:
        along = (
            dx * (s[LOAD_VELOCITY] - s[VELOCITY])
            + dy * (s[LOAD_VELOCITY + 1] - s[VELOCITY + 1])
            + dz * (s[LOAD_VELOCITY + 2] - s[VELOCITY + 2])
        ) / length
        pull = _STRING_STIFFNESS * (length - w.load_length) + _STRING_DAMPING * along
        pull = max(pull, 0.0) * w.load_mass / length
    ds[VELOCITY] += pull * dx / mass
    ds[VELOCITY + 1] += pull * dy / mass
    ds[VELOCITY + 2] += pull * dz / mass
    for k in range(3):
        ds[LOAD + k] = s[LOAD_VELOCITY + k]
    ds[LOAD_VELOCITY] = -pull * dx / w.load_mass
    ds[LOAD_VELOCITY + 1] = -pull * dy / w.load_mass
    ds[LOAD_VELOCITY + 2] = -pull * dz / w.load_mass - c.gravity


@numba.njit(cache=True)
def feet(s, tx, ty, tz, anchor, mass, c, w, r, contact, ds):
    """The torque (x, y, z) with that of the feet added, and their forces added to ds."""
    nx, nz = math.sin(w.surface_tilt), math.cos(w.surface_tilt)
    arm = c.arm
    for k in range(4):
        contact[k] = 0.0
        x, y, z = arm * SIDE_X[k], arm * SIDE_Y[k], -c.foot_height - w.foot_height
        lx = r[0, 0] * x + r[0, 1] * y + r[0, 2] * z
        ly = r[1, 0] * x + r[1, 1] * y + r[1, 2] * z
        lz = r[2, 0] * x + r[2, 1] * y + r[2, 2] * z
        px, py, pz = s[0] + lx, s[1] + ly, s[2] + lz
        depth = -(px * nx + (pz - w.surface_height) * nz)
        if depth <= 0.0:
            continue
        wx = r[0, 0] * s[RATES] + r[0, 1] * s[RATES + 1] + r[0, 2] * s[RATES + 2]
        wy = r[1, 0] * s[RATES] + r[1, 1] * s[RATES + 1] + r[1, 2] * s[RATES + 2]
        wz = r[2, 0] * s[RATES] + r[2, 1] * s[RATES + 1] + r[2, 2] * s[RATES + 2]
        vx = s[VELOCITY] + wy * lz - wz * ly
        vy = s[VELOCITY + 1] + wz * lx - wx * lz
        vz = s[VELOCITY + 2] + wx * ly - wy * lx
        out = vx * nx + vz * nz
        normal = c.foot_stiffness * w.stiffness_scale * depth - c.foot_damping * w.damping_scale * out
        normal = max(normal, 0.0)
        contact[k] = normal
        gx, gy, gz = friction(px, py, pz, vx, vy, vz, anchor[k], normal, nx, nz, c, w)
        gx += normal * nx
        gz += normal * nz
        ds[VELOCITY] += gx / mass
        ds[VELOCITY + 1] += gy / mass
        ds[VELOCITY + 2] += gz / mass
        mx, my, mz = ly * gz - lz * gy, lz * gx - lx * gz, lx * gy - ly * gx
        tx += r[0, 0] * mx + r[1, 0] * my + r[2, 0] * mz
        ty += r[0, 1] * mx + r[1, 1] * my + r[2, 1] * mz
        tz += r[0, 2] * mx + r[1, 2] * my + r[2, 2] * mz
    return tx, ty, tz


@numba.njit(cache=True)
def friction(px, py, pz, vx, vy, vz, anchor, normal, nx, nz, c, w):
    """Coulomb friction [N] of a foot at p with velocity v: a bristle to its anchor, at most mu normal."""
    if math.isnan(anchor[0]):
        return 0.0, 0.0, 0.0
    gx = c.foot_tangent[0] * (anchor[0] - px) - c.foot_tangent[1] * vx
    gy = c.foot_tangent[0] * (anchor[1] - py) - c.foot_tangent[1] * vy
    gz = c.foot_tangent[0] * (anchor[2] - pz) - c.foot_tangent[1] * vz
    across = gx * nx + gz * nz
    gx -= across * nx
    gz -= across * nz
    size = math.sqrt(gx * gx + gy * gy + gz * gz)
    if size > w.friction * normal:
        scale = w.friction * normal / size
        return gx * scale, gy * scale, gz * scale
    return gx, gy, gz


@numba.njit(cache=True)
def move_anchors(s, r, anchor, contact, c, w):
    """Where the feet stick after a step: set on first touch, dragged along by slipping, lost in the air."""
    rotation(s[QUATERNION : QUATERNION + 4], r)
    nx, nz = math.sin(w.surface_tilt), math.cos(w.surface_tilt)
    arm = c.arm
    for k in range(4):
        x, y, z = arm * SIDE_X[k], arm * SIDE_Y[k], -c.foot_height - w.foot_height
        px = s[0] + r[0, 0] * x + r[0, 1] * y + r[0, 2] * z
        py = s[1] + r[1, 0] * x + r[1, 1] * y + r[1, 2] * z
        pz = s[2] + r[2, 0] * x + r[2, 1] * y + r[2, 2] * z
        if px * nx + (pz - w.surface_height) * nz >= 0.0:
            anchor[k, 0] = np.nan
            continue
        if math.isnan(anchor[k, 0]):
            anchor[k, 0], anchor[k, 1], anchor[k, 2] = px, py, pz
            continue
        ex, ey, ez = anchor[k, 0] - px, anchor[k, 1] - py, anchor[k, 2] - pz
        across = ex * nx + ez * nz
        ex -= across * nx
        ez -= across * nz
        stretch = math.sqrt(ex * ex + ey * ey + ez * ez)
        longest = w.friction * contact[k] / c.foot_tangent[0]
        scale = min(1.0, longest / stretch) if stretch > 0.0 else 1.0
        anchor[k, 0], anchor[k, 1], anchor[k, 2] = px + ex * scale, py + ey * scale, pz + ez * scale


@numba.njit(cache=True)
def advance(s, target, air, anchor, time, dt, c, b, w, work, r, contact):
    """Advance state s (23,) in place by dt [s] with classical RK4; work (4, 23) is scratch."""
    k, z, total = work[0], work[1], work[2]
    for j in range(SIZE):
        z[j], total[j] = s[j], 0.0
    for stage in range(4):
        later = 0.0 if stage == 0 else dt if stage == 3 else 0.5 * dt
        derivative(z, target, air, anchor, time + later, c, b, w, r, contact, k)
        weight = 2.0 if 0 < stage < 3 else 1.0
        ahead = dt if stage == 2 else 0.5 * dt
        for j in range(SIZE):
            total[j] += weight * k[j]
            z[j] = s[j] + ahead * k[j]
    for j in range(SIZE):
        s[j] += dt / 6.0 * total[j]
    norm = 0.0
    for j in range(QUATERNION, QUATERNION + 4):
        norm += s[j] * s[j]
    norm = math.sqrt(norm)
    for j in range(QUATERNION, QUATERNION + 4):
        s[j] /= norm
    if w.contact != 0.0:
        move_anchors(s, r, anchor, contact, c, w)
