"""A slung load: a point mass on a massless string that hangs from the vehicle's centre of mass.

The string is modelled as a rod that turns freely: it neither stretches nor goes slack. The load collides with
nothing and has no drag. The string is attached at the centre of mass and causes no torque.

Symbols of the comments: q unit vector from the vehicle to the load, q' its rate [1/s], f force on the vehicle
without its weight, a_f = f/m, m and m_l masses of vehicle and load, L the string's length, T its tension.
After Sreenath, Lee and Kumar, "Geometric control and differential flatness of a quadrotor UAV with a
cable-suspended load", CDC 2013:

    T = m m_l/(m + m_l) (L |q'|^2 - q . a_f)
    a = a_f + T/m q - (0, 0, g)
    q'' = (q (q . a_f) - a_f)/L - |q'|^2 q
"""

import math

import numpy as np

from inclined_landing.models.compiled import inlined, unlocked

LOAD_SIZE = 6  # columns of a load's state: direction q, its rate q' [1/s], in the world's axes
HANGING = (0.0, 0.0, -1.0, 0.0, 0.0, 0.0)  # at rest relative to the vehicle
UNLOADED = np.empty((0, LOAD_SIZE))  # of vehicles without loads; None would be another type


def hanging(n: int) -> np.ndarray:
    """Return the states (n, 6) of loads that hang straight down and move with their vehicles."""
    return np.tile(HANGING, (n, 1))


@inlined
def pull(x, y, z, vx, vy, vz, ax, ay, az, share, length):
    """Return the string's tension over the vehicle's mass [m/s2].

    (x, y, z) and (vx, vy, vz): q and q'; (ax, ay, az): a_f [m/s2]; share: m_l/(m + m_l); length [m].
    """
    # T/m = m_l/(m + m_l) (L |q'|^2 - q . a_f)
    return share * (length * (vx * vx + vy * vy + vz * vz) - (x * ax + y * ay + z * az))


@inlined
def swing(x, y, z, vx, vy, vz, ax, ay, az, length):
    """Return q'' (x, y, z) [1/s2]; arguments as of `pull`."""
    along = (x * ax + y * ay + z * az) / length - (vx * vx + vy * vy + vz * vz)
    return along * x - ax / length, along * y - ay / length, along * z - az / length


@inlined
def rectified(x, y, z, vx, vy, vz):
    """Return a load's state after integration with |q| = 1 and q' normal to q."""
    size = math.sqrt(x * x + y * y + z * z)
    x, y, z = x / size, y / size, z / size
    radial = x * vx + y * vy + z * vz
    return x, y, z, vx - radial * x, vy - radial * y, vz - radial * z


@inlined
def rectify(load):
    """Normalise a load's state (6,) in place as `rectified`."""
    state = rectified(load[0], load[1], load[2], load[3], load[4], load[5])
    load[0], load[1], load[2], load[3], load[4], load[5] = state


@inlined
def swung(x, y, z, vx, vy, vz, ax, ay, az, length, dt):
    """Return a load's state `dt` [s] later, by one step of RK4; the other arguments as of `pull`.

    It is stable up to a phase sqrt(|a_f|/L) dt of 2.8 (at 20 m/s2, 0.1 m and 10 ms it is 0.14).
    """
    h = 0.5 * dt
    ax1, ay1, az1 = swing(x, y, z, vx, vy, vz, ax, ay, az, length)
    vx2, vy2, vz2 = vx + h * ax1, vy + h * ay1, vz + h * az1
    ax2, ay2, az2 = swing(x + h * vx, y + h * vy, z + h * vz, vx2, vy2, vz2, ax, ay, az, length)
    vx3, vy3, vz3 = vx + h * ax2, vy + h * ay2, vz + h * az2
    ax3, ay3, az3 = swing(x + h * vx2, y + h * vy2, z + h * vz2, vx3, vy3, vz3, ax, ay, az, length)
    vx4, vy4, vz4 = vx + dt * ax3, vy + dt * ay3, vz + dt * az3
    ax4, ay4, az4 = swing(x + dt * vx3, y + dt * vy3, z + dt * vz3, vx4, vy4, vz4, ax, ay, az, length)
    sixth = dt / 6.0
    return rectified(
        x + sixth * (vx + 2.0 * (vx2 + vx3) + vx4),
        y + sixth * (vy + 2.0 * (vy2 + vy3) + vy4),
        z + sixth * (vz + 2.0 * (vz2 + vz3) + vz4),
        vx + sixth * (ax1 + 2.0 * (ax2 + ax3) + ax4),
        vy + sixth * (ay1 + 2.0 * (ay2 + ay3) + ay4),
        vz + sixth * (az1 + 2.0 * (az2 + az3) + az4),
    )


@inlined
def mean_acceleration(a, change, share, length, dt):
    """Return a vehicle's mean acceleration along an axis, without gravity, over a step of `dt` [s].

    a: a_f along it; change: of q' along it over the step. It is exact for the step; with share 0 it is a_f.
    """
    # (m + m_l) dv/dt + m_l L dq'/dt = f - (m + m_l) g: the change of momentum
    return a - share * (a + length * change / dt)


@unlocked
def advance(load, ax, ay, az, share, length, dt):
    """Advance a load's state (6,) in place by `dt` [s], and return the vehicle's mean acceleration.

    (ax, ay, az): a_f [m/s2] in the world's axes, the force on the vehicle without its weight divided by its
    mass, held over the step. share: m_l/(m + m_l); length [m] of the string.
    """
    x, y, z, vx, vy, vz = load[0], load[1], load[2], load[3], load[4], load[5]
    state = swung(x, y, z, vx, vy, vz, ax, ay, az, length, dt)
    load[0], load[1], load[2], load[3], load[4], load[5] = state
    return (
        mean_acceleration(ax, state[3] - vx, share, length, dt),
        mean_acceleration(ay, state[4] - vy, share, length, dt),
        mean_acceleration(az, state[5] - vz, share, length, dt),
    )
