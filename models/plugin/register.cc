// Registers the plugins when the library is loaded, with the MuJoCo it was built against only.

#include <mujoco/mujoco.h>

#include "attitude.h"
#include "rotors.h"

mjPLUGIN_LIB_INIT(inclined_landing) {
  if (mj_version() != mjVERSION_HEADER) {
    mju_warning("inclined_landing: the plugins were built for MuJoCo %d, this is MuJoCo %d; "
                "rebuild them",
                mjVERSION_HEADER, mj_version());
    return;
  }
  inclined_landing::RegisterRotors();
  inclined_landing::RegisterAttitude();
}
