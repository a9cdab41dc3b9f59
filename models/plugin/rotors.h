// Collective thrust with lag, and the rotors' drag. See README.md for equations and attributes.
#pragma once

#include <mujoco/mujoco.h>

#include <string>
#include <vector>

#include "defaults.h"

namespace inclined_landing {

struct RotorsConfig {
  double lag_rate = defaults::lag_rate;        // 1/s
  double state_gain = defaults::state_gain;    // N/(PWM s)
  double direct_gain = defaults::direct_gain;  // N/PWM
  double drag[3] = {defaults::drag[0], defaults::drag[1], defaults::drag[2]};  // kg/rad
  // per motor, static: force = a P^2 + b P + c [N], speed = s P + t [rad/s]
  double pwm_to_force[3] = {defaults::pwm_to_force[0], defaults::pwm_to_force[1],
                            defaults::pwm_to_force[2]};
  double pwm_to_speed[2] = {defaults::pwm_to_speed[0], defaults::pwm_to_speed[1]};
  double motors = defaults::motors;
  // where the discs are: (+-arm, +-arm, disc_height) in the body frame, m
  double arm = defaults::arm, disc_height = defaults::disc_height, disc_radius = defaults::disc_radius;
  std::vector<std::string> surfaces = {"slab", "floor"};  // planes and boxes that ground effect sees
  // effects beyond the paper's equations, neutral in the vehicle file
  double bias = defaults::bias;                              // N
  double fade = defaults::fade;                              // 1/s
  double sag = defaults::sag;                                // 1
  double sag_reference = defaults::sag_reference;            // PWM
  double voltage_sensitivity = defaults::voltage_sensitivity;  // 1/V
  double voltage_reference = defaults::voltage_reference;    // V
  double voltage_open = defaults::voltage_open;              // V
  double voltage_drop = defaults::voltage_drop;              // V/PWM
  double voltage_discharge = defaults::voltage_discharge;    // V/s
  double spin_down = defaults::spin_down;                    // 1
  double body_drag = defaults::body_drag;                    // kg/m
  double translational_lift = defaults::translational_lift;  // s2/m2
  double axial_inflow = defaults::axial_inflow;              // s/m
  double ground_effect = defaults::ground_effect;            // 1

  // Whether the thrust depends on the air or on surfaces nearby.
  bool InAir() const { return translational_lift != 0 || axial_inflow != 0 || ground_effect != 0; }

  bool Parse(const mjModel* m, int instance, std::string* error);

  // Sum of the rotor speeds [rad/s] at a total thrust [N]; continuous, 0 without thrust.
  double SpeedSum(double thrust) const;
};

void RegisterRotors();

}  // namespace inclined_landing
