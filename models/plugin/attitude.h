// Attitude loops with a rate loop beneath, as body torques. See README.md for the law.
#pragma once

namespace inclined_landing {

void RegisterAttitude();

}  // namespace inclined_landing
