"""Constants (`constants.toml`), how a vehicle is built (`Build`), and what may secretly differ (`World`)."""

from __future__ import annotations

import tomllib
from collections import namedtuple
from importlib import resources
from typing import NamedTuple

import numpy as np

PHYSICS_RATE = 2000  # Hz
CONTROL_RATE = 500
PILOT_RATE = 50
TRACK_RATE = 100  # of the pilot's filter of the position

# Forms that a vehicle's parts may have (see :class:`Build`).
CASCADE, INCREMENTAL, FULL_STATE = 0.0, 1.0, 2.0  # flight controller
FIRST_ORDER_THRUST, FIRST_ORDER_SPEED = 0.0, 1.0  # motors
CHEESEMAN, EXPONENTIAL, FADING = 0.0, 1.0, 2.0  # ground effect


def _entries() -> dict[str, float | tuple[float, ...]]:
    text = resources.files(__package__).joinpath("constants.toml").read_text("utf-8")
    values = {name: entry["value"] for name, entry in tomllib.loads(text).items()}
    return {k: tuple(v) if isinstance(v, list) else float(v) for k, v in values.items()}


_CONSTANTS = _entries()
# What stands in `constants.toml`, SI units, in its order.
Constants = namedtuple("Constants", _CONSTANTS)


class Build(NamedTuple):
    """How a vehicle, its air and its log are made. The defaults are the reference, which flies as the paper's
    equations say, in still air.

    Times that are delays are whole control periods (2 ms). SI units.
    """

    # Flight controller. A cascade: attitude, then rates (proportional, integral, derivative); increments of
    # the torque on a geometric attitude error; or a gain on angle, rate and motor torque.
    controller: float = CASCADE
    lead: float = 1.0  # share of the motors' lag that roll and pitch make up for
    pole_shift: float = 1.0  # 1: the cascade's slow pole is exactly that of the attitude loop
    feed_forward: float = 0.0  # share of the setpoint's rate that is asked for at once
    derivative: float = 0.0  # torque against angular acceleration, in inertias
    derivative_filter: float = 0.005  # s, low-pass of the gyro for it
    integral: float = 0.0  # 1/s2, of the error of roll and pitch rate, in inertias
    integral_leak: float = 1.0  # s, in which it forgets
    kept_torque: float = 0.0  # share of the present torque and acceleration that increments build on
    pole_rate: float = 35.0  # rad/s, fast pair of poles of the full-state gain
    pole_damping: float = 0.8
    # Estimator of roll and pitch: the gyro, corrected by motion capture of some age or by the accelerometer.
    accelerometer: float = 0.0  # 1: levelled by it; its trust is that of the constants
    wander: float = 0.0  # rad, of the accelerometer's level, over a minute
    capture_age: float = 0.0  # s
    # Motors, propellers and geometry.
    motors: float = FIRST_ORDER_THRUST
    spin_down: float = 0.0  # time constant times 1 + this while slowing down
    dead_time: float = 0.0  # s
    thrust_exponent: float = 1.0  # of thrust over PWM, about hover
    thrust_curve: float = 0.0  # quadratic part of the same
    rotor: tuple[float, float, float, float] = (1.0, 1.0, 1.0, 1.0)  # factors of each one's time constant
    # Battery: thrust goes with this power of the voltage, by default made up for.
    battery_power: float = 2.0
    uncompensated: float = 0.0  # share of it that the firmware does not make up for
    polarisation: float = 0.0  # ohm, of a part of the sag that takes its time
    polarisation_time: float = 6.0  # s
    # Air.
    quadratic_drag: tuple[float, float, float] = (0.0, 0.0, 0.0)  # s/m, beside the linear drag
    flapping: float = 0.0  # s/m, by which lateral drag saturates with speed
    ground: float = CHEESEMAN
    ground_range: float = 0.06  # m, of the exponential form
    disturbance: tuple[float, float, float] = (0.0, 0.0, 0.0)  # m/s2, Ornstein-Uhlenbeck
    disturbance_time: float = 0.3  # s
    disturbance_torque: tuple[float, float, float] = (0.0, 0.0, 0.0)  # rad/s2
    # Log.
    log_ticks: float = 5.0  # control periods from row to row
    stamp_jitter: float = 0.0  # s, of the time stamps
    log_estimate: float = 0.0  # 1: roll and pitch of the log are the vehicle's own estimate


class World(NamedTuple):
    """What one flight meets beyond the constants; every default is neutral.

    Delays are whole control periods (2 ms). Angles in rad, SI units.
    """

    thrust_scale: float = 1.0
    thrust_bias: float = 0.0  # N
    thrust_fade: float = 0.0  # 1/s, from the start of the log
    mass_scale: float = 1.0
    # The battery. Thrust goes with the voltage squared and is nominal at `battery_reference`; with reference
    # 0 the firmware makes up for it, and only the voltage channel shows the load.
    battery_reference: float = 0.0  # V
    battery_resistance: float = 0.08  # ohm
    battery_voltage: float = 0.0  # V, open circuit at the start, above that of the constants
    motor_time_scale: float = 1.0
    spin_down: float = 0.0  # time constant times 1 + this while slowing down
    drag_scale: float = 1.0
    lateral_drag: float = 1.0  # factor of the drag across the rotors' axis
    body_drag: float = 0.0  # kg/m
    wind_x: float = 0.0  # m/s
    wind_y: float = 0.0
    translational_lift: float = 0.0  # s2/m2
    axial_inflow: float = 0.0  # s/m
    ground_effect: float = 0.0
    com_x: float = 0.0  # m, thrust acts this far from the centre of mass
    com_y: float = 0.0
    thrust_delay: float = 0.0  # s
    attitude_delay: float = 0.0
    mocap_delay: float = 0.0
    attitude_gain_scale: float = 1.0
    attitude_time_scale: float = 1.0
    rate_lag: float = 0.0  # s, added to 1/bandwidth of the rate loop
    trim_roll: float = 0.0  # rad, of the command
    trim_pitch: float = 0.0
    yaw_drift: float = 0.0  # rad/s
    mocap_roll: float = 0.0  # rad, of the tracked body against the vehicle; the vehicle does not use it
    mocap_pitch: float = 0.0
    level_roll: float = 0.0  # rad, of the attitude estimate that control and log share
    level_pitch: float = 0.0
    log_delay: float = 0.0  # s, of the pose in the log alone
    # The surface under the vehicle: a plane through (0, 0, height), normal (sin tilt, 0, cos tilt).
    contact: float = 0.0  # 1: the feet can touch it
    surface_height: float = 0.0  # m
    surface_tilt: float = 0.0  # rad
    friction: float = 0.8
    stiffness_scale: float = 1.0
    damping_scale: float = 1.0
    foot_height: float = 0.0  # m, by which the feet reach lower
    # Causes that no library of the workflow has.
    updraft: float = 0.0  # m/s at the centre of a column
    updraft_x: float = 0.0
    updraft_y: float = 0.0
    updraft_radius: float = 0.4
    dead_zone: float = 0.0  # rad, roll and pitch commands below it are taken as 0
    cross_coupling: float = 0.0  # share of the roll command that leaks into pitch
    load_mass: float = 0.0  # kg, on a string
    load_length: float = 0.25  # m
    yaw_loss: float = 0.0  # s/rad, share of thrust lost per rate of yaw
    wall: float = 0.0  # m/s2, towards +x at the wall
    wall_x: float = 1.3  # m
    wall_range: float = 0.25  # m
    capture_scale: float = 0.0  # 1/m, growth of motion capture's scale with x
    swing: float = 0.0  # m/s2, of a horizontal force that comes and goes with the time of the log
    swing_period: float = 3.0  # s
    swing_direction: float = 0.0  # rad
    heading_force: float = 0.0  # m/s2, in the world, with twice the heading
    quantum: float = 0.0  # rad, step of the roll and pitch commands received
    # What does not repeat.
    gust: float = 0.0  # m/s, standard deviation of a horizontal wind without mean
    gust_time: float = 0.8  # s, correlation time
    gust_calm: float = 0.0  # share of the time without
    command_jitter: float = 0.0  # s, up to which commands come later than their delay


def constants() -> Constants:
    """Return the constants of `constants.toml`."""
    return Constants(**_CONSTANTS)


def record(values: Constants | Build | World) -> np.void:
    """The same entries as the kernels take them: a record, which costs a compiled function one argument.

    A named tuple costs it one for each number, in every call that hands it on.
    """
    layout = [(name, float, np.shape(value)) for name, value in values._asdict().items()]
    return np.array(tuple(values), layout)[()]
