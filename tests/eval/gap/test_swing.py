"""The swing of a slung load from the start that a flight shows."""

import math

import numpy as np
import pytest

from inclined_landing.eval.gap.model.swing import ANGLE, STRETCH, Starts, pulled, stretches
from inclined_landing.models import forces, load
from inclined_landing.models.parameters import load_vehicle

DT, ROWS, G = 0.01, 60, 9.81
V = load_vehicle().changed(effects_load_mass=0.004, effects_load_length=0.5)
SHARE = V.effects_load_mass / (V.body_mass + V.effects_load_mass)


def pull(flight, vehicle, force):
    """Accelerations (m - 1, 3) with the load, from those without it; flight: positions and windows."""
    begun = Starts.none(len(flight[0]), flight[1], ROWS, DT)
    return pulled(force, *flight, ROWS, DT, forces.pack(vehicle), begun)


def flown(seconds=6.0, angle=0.3, noise=0.0, seed=0, vehicle=V):
    """A flight with a swinging load, and accelerations (m - 1, 3) without the load and with it."""
    steps, rng = round(seconds / DT), np.random.default_rng(seed)
    t = DT * np.arange(steps)
    force = np.stack([1.5 * np.sin(2.0 * t), np.cos(3.0 * t), np.full(steps, G / (1.0 - SHARE))], axis=1)
    state = np.array([math.sin(angle), 0.0, -math.cos(angle), 0.0, 0.5 * angle, 0.0])
    share = vehicle.effects_load_mass / (vehicle.body_mass + vehicle.effects_load_mass)
    true = np.array([load.advance(state, *a, share, vehicle.effects_load_length, DT) for a in force])
    speed = np.concatenate([np.zeros((1, 3)), np.cumsum(DT * true, axis=0)])
    position = np.concatenate([np.zeros((1, 3)), np.cumsum(DT * (speed[:-1] + 0.5 * DT * true), axis=0)])
    measured = position + noise * rng.normal(size=position.shape)
    return (measured, np.arange(0, steps + 1 - ROWS, ROWS)), force, true


@pytest.mark.parametrize("angle", [0.0, 0.3, 0.6])
def test_the_swing_is_that_of_the_flight(angle):
    """Accelerations within the angle that noise leaves: of 0.5 mm against 20 mm of swing, 2 % of its pull."""
    flight, force, true = flown(angle=angle, noise=5e-4)
    found = pull(flight, V, force)
    steps = slice(0, flight[1][-1] + ROWS - 1)
    size = SHARE * G * max(angle, 0.1)
    assert np.sqrt(((found - true)[steps] ** 2).mean()) < 0.02 * size
    hanging = np.array(load.HANGING)
    still = np.array([load.advance(hanging, *a, SHARE, V.effects_load_length, DT) for a in force])
    assert angle == 0.0 or np.sqrt(((still - true)[steps] ** 2).mean()) > 0.3 * size


def test_next_to_no_load_is_nothing_to_estimate():
    """Positions that a load moved, seen by a vehicle with a thousandth of it: the prior keeps it hanging."""
    flight, force, _ = flown(angle=0.4, noise=5e-4)
    tiny = V.changed(effects_load_mass=1e-6)
    share = 1e-6 / (V.body_mass + 1e-6)
    hanging = np.array(load.HANGING)
    wanted = np.array([load.advance(hanging, *a, share, V.effects_load_length, DT) for a in force])
    steps = slice(0, flight[1][-1] + ROWS - 1)
    assert np.abs((pull(flight, tiny, force) - wanted)[steps]).max() < 0.1 * share * G * ANGLE


def test_long_flights_start_anew():
    """Each stretch holds whole windows, and ends within its time; gaps between windows are no matter."""
    starts = np.array([*range(0, 900, ROWS), *range(1200, 3000, ROWS)])
    found = np.split(starts, stretches(starts, ROWS, DT)[1:-1])
    assert len(found) == 3
    assert all((s[-1] - s[0] + ROWS - 1) * DT <= STRETCH for s in found)
    flight, force, true = flown(seconds=25.0, angle=0.2)
    parts = np.split(flight[1], stretches(flight[1], ROWS, DT)[1:-1])
    assert len(parts) == 3
    error = pull(flight, V, force) - true
    for part in parts:
        steps = slice(part[0], part[-1] + ROWS - 1)
        assert np.sqrt((error[steps] ** 2).mean()) < 0.02 * SHARE * G * 0.2


def test_steps_beside_the_windows_are_those_of_one_body():
    flight, force, _ = flown()
    found = pull((flight[0], flight[1][2:4]), V, force)
    np.testing.assert_array_equal(found[: 2 * ROWS], (1.0 - SHARE) * force[: 2 * ROWS])
    np.testing.assert_array_equal(found[4 * ROWS - 1 :], (1.0 - SHARE) * force[4 * ROWS - 1 :])
