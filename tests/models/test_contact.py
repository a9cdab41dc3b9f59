"""Restitution, contact time, friction and foot height as settings of the MuJoCo plant."""

import dataclasses
import math

import numpy as np
import pytest

from inclined_landing.eval.truth.contact.drops import drop
from inclined_landing.models import contact
from inclined_landing.models.attitude import LAG, PITCH, STATE_SIZE, VX, VZ, WX, WZ, X, Z
from inclined_landing.models.base.errors import UserError
from inclined_landing.models.geometry import PARTS, SURFACES, reach_below
from inclined_landing.models.parameters import load_vehicle
from inclined_landing.models.plants import MujocoPlant

V = load_vehicle()
G = V.environment_gravity
STEP = 0.004  # s


def unpowered(n, **changes):
    """A plant that is stepped at the engine's step, without attitude torques."""
    vehicle = dataclasses.replace(V, **changes)
    return MujocoPlant(n, vehicle, control_period=STEP, timestep=STEP, torque_needs_motors=True)


def test_a_slower_drop_rebounds_less_and_none_where_none_is_set():
    """Weight takes more of a slower rebound. Restitution as set: tests/eval/truth/test_contact.py."""
    solrefs = contact.solref(np.array([0.0, 0.3, 0.6]), 0.02, G)
    slow, middle, fast = (drop(V, speed, solrefs).restitution.mean(axis=1) for speed in (0.5, 1.0, 2.0))
    assert abs(middle[0]) < 0.01
    assert (slow < middle)[1:].all() and (middle < fast)[1:].all() and (fast - slow)[1:].max() < 0.1


@pytest.mark.parametrize("pitch, part", [(0.0, "feet"), (0.5, "rotors"), (1.0, "body")])
@pytest.mark.parametrize("surface", ["slab", "floor"])
def test_touch_and_force_name_the_part_and_the_surface(surface, pitch, part):
    """Let go 2 mm above the slab or the floor upright, nose down or upside down, on body and rotor discs.

    At rest the surface carries the weight, within 1 % of what still moves; nose down the vehicle falls over.
    """
    plant, pitch, k = unpowered(1), math.pi * pitch, SURFACES.index(surface)
    plant.set_platform([0], 0.0)
    state = np.zeros((1, STATE_SIZE))
    state[0, PITCH], state[0, X] = pitch, 0.0 if surface == "slab" else 1.5
    state[0, Z] = V.platform_surface_height if surface == "slab" else 0.0
    state[0, Z] += reach_below(plant.shapes, (-math.sin(pitch), 0.0, math.cos(pitch))) + 0.002
    plant.reset([0], state)
    first = None
    for _ in range(400):
        plant.step(np.zeros((1, 4)))
        if first is None and plant.contacts.touch.any():
            first = plant.contacts.touch[0].copy()
    assert first[k, PARTS.index(part)] and np.flatnonzero(first.any(axis=1)).tolist() == [k]
    if part != "rotors":
        assert plant.contacts.force[0, k].sum() == pytest.approx(V.weight, rel=0.01)


def test_the_setting_is_monotone():
    """More restitution, less damping; more contact time, less of both."""
    e = np.linspace(0, 0.6, 20)
    stiffness, damping = -contact.solref(e, 0.02, G).T
    assert (np.diff(damping) < 0).all() and (stiffness > 0).all()
    for column in -contact.solref(0.4, np.linspace(0.012, 0.02, 10), G).T:
        assert (np.diff(column) < 0).all()


def fly(plant, steps=50):
    """Drops onto the slope at 0.6 m/s, each farther up; returns the states."""
    n, alpha = plant.n, V.platform_inclination
    state = np.zeros((n, STATE_SIZE))
    state[:, X] = 0.05 * np.arange(n) - 0.1
    state[:, Z] = V.platform_surface_height - state[:, X] * math.tan(alpha) + 0.05
    state[:, PITCH], state[:, VZ], state[:, LAG] = alpha, -0.6, 0.5 * V.hover_lag
    plant.reset(np.arange(n), state)
    history = []
    for _ in range(steps):
        plant.step(np.tile([10_000.0, 0, alpha / V.attitude_gain, 0], (n, 1)))
        history.append(plant.state.copy())
    return np.array(history)


def test_settings_are_those_of_a_compiled_model():
    """Set per vehicle, or compiled into both sides of every pair: the same bits."""
    solref = contact.solref(0.4, 0.018, G)
    plant = MujocoPlant(3)
    plant.set_contact([1], friction=0.35, restitution=0.4, contact_time=0.018)
    plant.set_contact([2], solref=(0.02, 0.7))
    flown = fly(plant)
    nominal = fly(MujocoPlant(3))
    np.testing.assert_array_equal(flown[:, 0], nominal[:, 0])
    changed = dataclasses.replace(V, contact_friction=0.35, contact_solref=tuple(map(float, solref)))
    np.testing.assert_array_equal(flown[:, 1], fly(MujocoPlant(3, changed))[:, 1])
    changed = dataclasses.replace(V, contact_solref=(0.02, 0.7))
    np.testing.assert_array_equal(flown[:, 2], fly(MujocoPlant(3, changed))[:, 2])
    assert not np.array_equal(flown[:, 1], nominal[:, 1])


def test_foot_height_lifts_the_vehicle():
    heights = np.array([0.012, V_FOOT := MujocoPlant(1).foot_height, 0.04])
    plant = unpowered(3)
    ids = np.arange(3)
    plant.set_platform(ids, 0.0)
    plant.set_contact(ids, foot_height=heights)
    state = np.zeros((3, STATE_SIZE))
    state[:, Z] = V.platform_surface_height + heights
    plant.reset(ids, state)
    for _ in range(100):
        plant.step(np.zeros((3, 4)))
    assert V_FOOT == pytest.approx(0.018)
    # At rest the feet are 0.3 mm deep in the surface's soft first millimetre: with an impedance d of 0.6
    # one that carries all the weight is (1 - d) g/(d^2 k) = 1 mm deep, four are a quarter of it or more.
    # Nothing but feet touches, and they carry the weight.
    np.testing.assert_allclose(plant.state[:, Z] - V.platform_surface_height, heights, atol=5e-4)
    assert plant.contacts.touch[:, 0, 0].all() and plant.contacts.touch.sum() == 3
    np.testing.assert_allclose(plant.contacts.force[:, 0, 0], V.body_mass * G, rtol=1e-3)
    assert np.abs(plant.state[:, [*range(VX, VZ + 1), *range(WX, WZ + 1)]]).max() < 1e-3


@pytest.mark.parametrize("options, sentence", [
    ({"friction": -0.1}, "friction must be from 0 to 10, not -0.1"),
    ({"friction": [0.5, math.nan]}, "friction must be from 0 to 10, not nan"),
    ({"restitution": 1.5, "contact_time": 0.02}, "restitution must be from 0 to 0.6, not 1.5"),
    ({"restitution": 0.5, "contact_time": 0.1}, "contact time must be from 0.012 to 0.024 s, not 0.1 s"),
    ({"restitution": 0.5}, "give both restitution and contact time"),
    ({"restitution": 0.5, "contact_time": 0.02, "solref": (0.01, 1)}, "give either restitution"),
    ({"solref": (0.01, -1.0)}, "solref must be"),
    ({"solref": 0.01}, "solref must be two numbers"),
    ({"foot_height": 0.001}, "foot height must be from 0.0108 to 0.054 m, not 0.001 m"),
])  # fmt: skip
def test_wrong_settings_are_refused_and_change_nothing(options, sentence):
    plant = MujocoPlant(2)
    before = plant.save()
    with pytest.raises(UserError, match=sentence):
        plant.set_contact([0, 1], **({"friction": 0.5} | options))
    np.testing.assert_array_equal(plant.save()["contact"], before["contact"])
