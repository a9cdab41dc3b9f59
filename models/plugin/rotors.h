// Collective thrust with lag, and the rotors' drag. See README.md for equations and attributes.
#pragma once

#include <mujoco/mujoco.h>

#include "attributes.h"

namespace inclined_landing {

struct RotorsConfig : RotorsAttributes {
  // Whether the thrust depends on the air or on surfaces nearby.
  bool InAir() const { return translational_lift != 0 || axial_inflow != 0 || ground_effect != 0; }

  // Sum of the rotor speeds [rad/s] at a total thrust [N]; continuous, 0 without thrust.
  double SpeedSum(double thrust) const;
};

void RegisterRotors();

}  // namespace inclined_landing
