// Attitude loops with a rate loop beneath, as body torques. See README.md for the law.
#pragma once

#include <mujoco/mujoco.h>

#include <string>

#include "defaults.h"

namespace inclined_landing {

struct AttitudeConfig {
  double gain = defaults::gain;                    // 1
  double time_constant = defaults::time_constant;  // s
  double bandwidth = defaults::bandwidth;          // 1/s, roll and pitch
  double yaw_bandwidth = defaults::yaw_bandwidth;  // 1/s
  double trim[2] = {defaults::trim[0], defaults::trim[1]};  // rad, added to roll and pitch commands
  double yaw_drift = defaults::yaw_drift;          // rad/s, added to the yaw rate command

  bool Parse(const mjModel* m, int instance, std::string* error);
};

void RegisterAttitude();

}  // namespace inclined_landing
