"""`Vehicle`: the constants of one vehicle and its arena, and derived quantities."""

from __future__ import annotations

import dataclasses
import math

from inclined_landing.models.base.errors import UserError

SOLID_BELOW = 0.08  # m, of the platform under the slab


@dataclasses.dataclass(frozen=True)
class Vehicle:
    """The constants of one vehicle and its arena, SI units; field `a_b` is entry `b` of table `a`.

    Use :func:`dataclasses.replace` for a variant, or `changed`.
    """

    body_mass: float
    body_inertia: tuple[float, float, float]
    environment_gravity: float
    thrust_lag_rate: float
    thrust_state_gain: float
    thrust_direct_gain: float
    motor_count: float
    motor_pwm_to_force: tuple[float, float, float]
    motor_pwm_to_speed: tuple[float, float]
    rotor_arm: float
    rotor_height: float
    rotor_radius: float
    drag_coefficients: tuple[float, float, float]
    attitude_gain: float
    attitude_time_constant: float
    attitude_bandwidth: float
    attitude_damping: float
    attitude_integral_limit: float
    attitude_yaw_gain: float
    attitude_yaw_bandwidth: float
    attitude_torque_limit: float
    attitude_yaw_torque_limit: float
    command_control_period: float
    command_pwm_range: tuple[float, float]
    command_angle_limit: float
    command_yaw_rate_limit: float
    command_pwm_centre: float
    command_pwm_span: float
    arena_x: tuple[float, float]
    arena_y: tuple[float, float]
    arena_z: tuple[float, float]
    platform_surface_height: float
    platform_width: float
    platform_depth: float
    platform_thickness: float
    platform_inclination: float
    platform_max_inclination: float
    contact_friction: float
    contact_solref: tuple[float, float]
    disturbance_acceleration: tuple[float, float, float]
    disturbance_acceleration_time: tuple[float, float, float]
    disturbance_angular: tuple[float, float, float]
    disturbance_angular_time: tuple[float, float, float]
    effects_thrust_bias: float
    effects_thrust_fade: float
    effects_battery_sag: float
    effects_battery_reference: float
    effects_voltage_sensitivity: float
    effects_voltage_reference: float
    effects_voltage_open: float
    effects_voltage_drop: float
    effects_voltage_discharge: float
    effects_spin_down: float
    effects_body_drag: float
    effects_wind: tuple[float, float]
    effects_translational_lift: float
    effects_axial_inflow: float
    effects_ground_effect: float
    effects_ground_fading: float
    effects_rotor_loss: tuple[float, float, float, float]
    effects_yaw_imbalance: float
    effects_com_offset: tuple[float, float]
    effects_load_mass: float
    effects_load_length: float
    effects_foot_height: float
    effects_thrust_delay: float
    effects_attitude_delay: float
    effects_attitude_integral: float
    effects_attitude_hold: float
    effects_attitude_saturation: float
    effects_attitude_trim: tuple[float, float]
    effects_estimator_lean: float
    effects_yaw_drift: float
    effects_mocap_tilt: tuple[float, float]
    effects_mocap_delay: float
    effects_estimator_delay: float

    def changed(self, **fields: object) -> Vehicle:
        """Return a variant with other values of some fields; ten times as fast as `dataclasses.replace`."""
        if unknown := fields.keys() - self.__dict__.keys():
            raise TypeError(f"a vehicle has no entry {', '.join(sorted(unknown))}")
        variant = object.__new__(type(self))
        variant.__dict__.update(self.__dict__, **fields)
        return variant

    @property
    def thrust_per_pwm(self) -> float:
        """Return the steady total thrust per PWM [N/PWM] of the transfer function."""
        return self.thrust_state_gain / self.thrust_lag_rate + self.thrust_direct_gain

    @property
    def weight(self) -> float:
        """Return the weight that the rotors carry in hover [N]: the vehicle and its slung load."""
        return (self.body_mass + self.effects_load_mass) * self.environment_gravity

    @property
    def hover_pwm(self) -> float:
        """Return the PWM at which the thrust of the transfer function equals the weight (about 34 100)."""
        return self.weight / self.thrust_per_pwm

    def without_thrust_lag(self) -> Vehicle:
        """Return the vehicle with the same steady thrust but without thrust lag."""
        return self.changed(thrust_state_gain=0.0, thrust_direct_gain=self.thrust_per_pwm)

    @property
    def thrust_centre(self) -> tuple[float, float]:
        """Return the point at which the total thrust acts [m], x forward and y left of the rotors' centre."""
        # (sum x_i (1 - loss_i), sum y_i (1 - loss_i)) / sum (1 - loss_i)
        one, two, three, four = (1.0 - loss for loss in self.effects_rotor_loss)
        arm = self.rotor_arm / (one + two + three + four)
        return arm * (one - two - three + four), arm * (three + four - one - two)

    @property
    def hover_lag(self) -> float:
        """Return the lag state Omega in hover [PWM s]."""
        return self.hover_pwm / self.thrust_lag_rate

    @property
    def static_hover_pwm(self) -> float:
        """Return the PWM at which the *static* map's thrust equals the weight (the paper quotes 42 000)."""
        a, b, c = self.motor_pwm_to_force
        force = self.weight / self.motor_count
        return (-b + math.sqrt(b * b - 4 * a * (c - force))) / (2 * a)

    @property
    def slab_half_length(self) -> float:
        """Return half the slab's length along the slope [m]: `width` is horizontal at the default angle."""
        return 0.5 * self.platform_width / math.cos(self.platform_inclination)

    @property
    def slab_depth(self) -> float:
        """Return the thickness of the colliding slab [m], which is larger than drawn: a fast vehicle
        penetrates by centimetres, and up to half of the thickness the engine pushes it out at the upper side.
        """
        return self.platform_thickness + SOLID_BELOW

    def check_inclination(self, inclination: float) -> float:
        """Return `inclination` [rad] if the platform supports it, else raise UserError."""
        limit = self.platform_max_inclination
        if not (math.isfinite(inclination) and abs(inclination) <= limit + 1e-12):
            raise UserError(
                f"platform inclination {math.degrees(inclination):g} deg is outside the supported "
                f"range of -{math.degrees(limit):.0f} to {math.degrees(limit):.0f} deg"
            )
        return float(inclination)
