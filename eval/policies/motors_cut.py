"""What becomes of a vehicle whose motors are cut where the policy hands over: the real landing.

From each given state the vehicle flies on in the MuJoCo plant with PWM 0 and no attitude torque (the
torques come from the motors too) for two seconds, watched at every engine step.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from inclined_landing.models.parameters import Vehicle
from inclined_landing.models.plants import MujocoPlant
from inclined_landing.models.plants.recorder import STEP, Recorder

DURATION = 2.0  # s


@dataclasses.dataclass
class Aftermath:
    """One entry per vehicle; speeds are those of the centre of mass, NaN without a touchdown."""

    touched: np.ndarray  # (n,) bool: did any part reach the slab
    normal_speed: np.ndarray  # (n,) m/s into the surface, up to 8 ms before the first touch
    tangential_speed: np.ndarray  # (n,) m/s along the surface, unsigned
    at_rest: np.ndarray  # (n,) bool: at the end still, feet and nothing else on the slab


def cut_motors(
    states: np.ndarray, inclination: float, vehicle: Vehicle, thrust_scale: float = 1.0
) -> Aftermath:
    """Cut the motors at `states` (n, 13) over a platform inclined by `inclination` [rad].

    thrust_scale: of the thrust that still decays.
    """
    n = len(states)
    plant = MujocoPlant(n, vehicle, control_period=STEP, timestep=STEP, torque_needs_motors=True)
    plant.set_platform(np.arange(n), inclination)
    plant.perturb(thrust_scale=thrust_scale)
    recorder = Recorder(plant, states)
    for _ in range(round(DURATION / STEP)):
        recorder.step(np.zeros((n, 4)))
    return Aftermath(recorder.touched, *recorder.touch_speeds(), recorder.at_rest())
