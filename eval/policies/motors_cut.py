"""The touchdown of a vehicle whose motors are cut where the policy hands over: the real landing.

From each given state the vehicle flies on in the MuJoCo plant with PWM 0 and no attitude torque (the
torques come from the motors too) for two seconds, watched at every engine step. It is not flown on where
the end is known: once on the floor, or as good as standing still for 0.3 s.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from inclined_landing.models.attitude import VX, VZ, WX, WZ
from inclined_landing.models.plants import MujocoPlant
from inclined_landing.models.plants.recorder import REST_RATE, REST_SPEED, STEP, Recorder
from inclined_landing.models.vehicle import Vehicle

DURATION = 2.0  # s
_STILL = 0.3  # s
# Of the speeds of rest: what slides away at constant acceleration, and is slower for _STILL, has not reached
# them after DURATION, as (1 + DURATION / _STILL) / 8 < 1.
_SLOW = 1 / 8
_LOOK = 5  # engine steps


@dataclasses.dataclass
class Aftermath:
    """One entry per vehicle; speeds are those of the centre of mass, NaN without a touchdown."""

    touched: np.ndarray  # (n,) bool: did any part reach the slab
    normal_speed: np.ndarray  # (n,) m/s into the surface, up to 8 ms before the first touch
    tangential_speed: np.ndarray  # (n,) m/s along the surface, unsigned
    at_rest: np.ndarray  # (n,) bool: at the end still, feet and nothing else on the slab


def cut_motors(
    states: np.ndarray, inclination: float | np.ndarray, vehicle: Vehicle, thrust_scale: float = 1.0
) -> Aftermath:
    """Cut the motors at `states` (n, 13) over platforms inclined by `inclination` (n,) or one for all [rad].

    thrust_scale: of the thrust that still decays.
    """
    n = len(states)
    plant = MujocoPlant(n, vehicle, control_period=STEP, timestep=STEP, torque_needs_motors=True)
    plant.set_platform(np.arange(n), inclination)
    plant.perturb(thrust_scale=thrust_scale)
    recorder = Recorder(plant, states)
    at_rest_for, flying = np.zeros(n), np.arange(n)
    for tick in range(1, round(DURATION / STEP) + 1):
        recorder.step(np.zeros((n, 4)), flying)
        if tick % _LOOK == 0:
            at_rest_for = np.where(recorder.at_rest() & _slow(plant.state), at_rest_for + _LOOK * STEP, 0.0)
            flying = np.flatnonzero((at_rest_for < _STILL) & ~plant.contacts.touch[:, 2].any(axis=1))
            if not len(flying):
                break
    return Aftermath(recorder.touched, *recorder.touch_speeds(), recorder.at_rest())


def _slow(state: np.ndarray) -> np.ndarray:
    """Return (n,) bool: so slow that the vehicle will not be faster than at rest."""
    speed = np.linalg.norm(state[:, VX : VZ + 1], axis=1)
    return (speed < _SLOW * REST_SPEED) & (np.linalg.norm(state[:, WX : WZ + 1], axis=1) < _SLOW * REST_RATE)
