// Collective thrust with lag, and the rotors' drag. See README.md for equations and attributes.
#pragma once

#include <mujoco/mujoco.h>

#include <string>

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

  bool Parse(const mjModel* m, int instance, std::string* error);

  // Sum of the rotor speeds [rad/s] at a total thrust [N]; continuous, 0 without thrust.
  double SpeedSum(double thrust) const;
};

void RegisterRotors();

}  // namespace inclined_landing
