"""Landings seen at the engine's steps, and the frame of the surface they end on."""

import math

import numpy as np
import pytest

from inclined_landing.models import surface
from inclined_landing.models.attitude import PITCH, STATE_SIZE, VX, VZ, Z
from inclined_landing.models.parameters import load_vehicle
from inclined_landing.models.plants import MujocoPlant
from inclined_landing.models.plants.recorder import STEP, Recorder, present_forces

V = load_vehicle()
ALPHA = V.platform_inclination
WEIGHT = V.body_mass * V.environment_gravity


def over_slab(*heights, inclination=ALPHA, speed=0.0) -> np.ndarray:
    """States (n, 13), motors stopped, feet at `heights` [m] over the slab and parallel to it."""
    plant, state = MujocoPlant(1), np.zeros((len(heights), STATE_SIZE))
    normal = surface.normal_of(inclination)
    state[:, :3] = normal * (plant.foot_height + np.array(heights)[:, None])
    state[:, Z] += V.platform_surface_height
    state[:, VX : VZ + 1] = -speed * normal
    state[:, PITCH] = inclination
    return state


@pytest.mark.parametrize("subset", [False, True])
def test_a_landing_is_the_same_at_any_control_period_and_in_any_company(subset):
    """Every engine step is seen within a control period; vehicles that are left out stand still."""
    heights, slopes = (0.03, 0.001, 0.08, 0.05), np.radians([-10.0, -20.0, 0.0, 30.0])
    states = np.concatenate([over_slab(h, inclination=a, speed=0.4) for h, a in zip(heights, slopes)])
    seen = []
    for period in (STEP, None):
        plant = MujocoPlant(4, control_period=period, timestep=STEP, torque_needs_motors=True)
        plant.set_platform(np.arange(4), slopes)
        recorder = Recorder(plant, states)
        ids = np.array([0, 3]) if subset and period is None else None
        for _ in range(round(0.2 / plant.control_period)):
            recorder.step(np.zeros((4, 4)), ids)
        seen.append([*recorder.touch, recorder.feet_force, plant.state])
        if ids is not None:
            assert plant.state[[1, 2]] == pytest.approx(states[[1, 2]], abs=1e-15)  # to Euler angles and back
            assert recorder.touched.tolist() == [True, False, False, True]
    compared = [0, 3] if subset else slice(None)
    for fine, coarse in zip(*seen):
        np.testing.assert_array_equal(fine[compared], coarse[compared])
    assert np.diff(seen[0][0][[1, 0, 3, 2]]).min() > 0  # the higher, the later


def test_at_rest_on_the_feet_and_not_otherwise():
    """Set down on the slope, lying on the back on it, standing on the floor, still in the air."""
    plant = MujocoPlant(4, torque_needs_motors=True)
    states = np.tile(over_slab(0.0), (4, 1))
    states[1, :3] += surface.normal_of(ALPHA) * 0.002
    states[1, PITCH] += math.pi
    states[2, [0, Z, PITCH]] = 1.5, plant.foot_height, 0.0
    states[3, Z] += 60.0
    recorder = Recorder(plant, states)
    for _ in range(100):
        recorder.step(np.zeros((4, 4)))
    assert recorder.at_rest().tolist() == [True, False, False, False]
    plant.contacts.touch[0, 0, 1] = True  # a part beside the feet
    assert not recorder.at_rest().any()
    away, along = surface.split(present_forces(plant, 0)[1].sum(axis=0), ALPHA)
    # Creep below 0.2 mm/s leaves the balance of forces to 1 %.
    assert [away, along] == pytest.approx([WEIGHT * math.cos(ALPHA), -WEIGHT * math.sin(ALPHA)], rel=0.01)
