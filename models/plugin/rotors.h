// Collective thrust with lag, and the rotors' drag. See README.md for equations and attributes.
#pragma once

#include <mujoco/mujoco.h>

#include "attributes.h"

namespace inclined_landing {

struct RotorsConfig : RotorsAttributes {
  // Sum of the rotor speeds [rad/s] at a total thrust [N]; continuous, 0 without thrust.
  double SpeedSum(double thrust) const;
};

void RegisterRotors();

}  // namespace inclined_landing
