"""The simulator's constants (`constants.toml`) and what may secretly differ (:class:`World`)."""

from __future__ import annotations

import functools
import tomllib
from importlib import resources
from typing import NamedTuple

PHYSICS_RATE = 2000  # Hz
CONTROL_RATE = 500
LOG_RATE = 100
PILOT_RATE = 50


class Constants(NamedTuple):
    """The entries of `constants.toml`, SI units."""

    mass: float
    inertia: tuple[float, float, float]
    gravity: float
    thrust_per_pwm: float
    thrust_per_speed: float
    motor_time: float
    torque_ratio: float
    arm: float
    disc_height: float
    rotor_radius: float
    pwm_limit: float
    drag_per_speed: tuple[float, float, float]
    hover_current: float
    battery_voltage: float
    battery_fall: float
    attitude_gain: float
    attitude_time: float
    rate_bandwidth: float
    setpoint_filter: float
    yaw_bandwidth: float
    yaw_filter: float
    tilt_authority: float
    yaw_authority: float
    gyro_noise: float
    attitude_trust: float
    position_filter: tuple[float, float]
    position_gains: tuple[float, float, float]
    height_gains: tuple[float, float, float]
    yaw_gain: float
    pwm_range: tuple[float, float]
    angle_limit: float
    yaw_rate_limit: float
    position_noise: float
    attitude_noise: float
    voltage_noise: float
    platform_height: float
    platform_tilt: float
    foot_height: float
    foot_stiffness: float
    foot_damping: float
    foot_tangent: tuple[float, float]


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
    # The surface under the vehicle: a plane through (0, 0, height), normal (sin tilt, 0, cos tilt).
    contact: float = 0.0  # 1: the feet can touch it
    surface_height: float = 0.0  # m
    surface_tilt: float = 0.0  # rad
    friction: float = 0.8
    stiffness_scale: float = 1.0
    damping_scale: float = 1.0
    # Causes that no library of the workflow has.
    updraft: float = 0.0  # m/s at the centre of a column
    updraft_x: float = 0.0
    updraft_y: float = 0.0
    updraft_radius: float = 0.4
    dead_zone: float = 0.0  # rad, roll and pitch commands below it are taken as 0
    gust: float = 0.0  # m/s, standard deviation of a horizontal wind without mean
    cross_coupling: float = 0.0  # share of the roll command that leaks into pitch
    load_mass: float = 0.0  # kg, on a string
    load_length: float = 0.25  # m


@functools.lru_cache(maxsize=1)
def constants() -> Constants:
    """Read `constants.toml`."""
    text = resources.files(__package__).joinpath("constants.toml").read_text("utf-8")
    values = {name: entry["value"] for name, entry in tomllib.loads(text).items()}
    return Constants(**{k: tuple(v) if isinstance(v, list) else float(v) for k, v in values.items()})
