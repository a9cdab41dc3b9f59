"""A control period that is solved against the same equations integrated in steps of 0.1 ms."""

import dataclasses
import math

import numba
import numpy as np
import pytest

from inclined_landing.models import equations, forces, held
from inclined_landing.models.attitude import LAG, ROLL, VX, VZ, WX, WZ, YAW, X, Z
from inclined_landing.models.parameters import load_vehicle

V = load_vehicle()
N, PERIOD = 200, 0.02
LIMITS = np.array([V.attitude_torque_limit] * 2 + [V.attitude_yaw_torque_limit])
# What held.py promises; attitude, rates and lag are exact but for the reference's own error: RK4 of the pole
# of 50 1/s in steps of h = 0.1 ms, (50 h)^4/120 = 5e-12 of changes of up to 30 rad/s or 4000 PWM s.
WITHIN = {(X, Z): 1e-6, (VX, VZ): 2e-5, (ROLL, YAW): 1e-10, (WX, WZ): 2e-9, (LAG, LAG): 1e-7}
VEHICLES = {
    "plain": {},
    "spin-down, lift, inflow, drag, wind": {
        "effects_spin_down": 0.7, "effects_translational_lift": 0.01, "effects_axial_inflow": 0.05,
        "effects_body_drag": 0.01, "effects_wind": (1.0, -2.0),
    },
    "battery, trim, drift": {
        "effects_battery_sag": 0.1, "effects_thrust_fade": 0.01, "effects_thrust_bias": 0.02,
        "effects_attitude_trim": (0.03, -0.05), "effects_yaw_drift": 0.2,
    },
    "oscillating loop": {"attitude_damping": 0.5},
    "quick loop": {"attitude_bandwidth": 150.0, "attitude_time_constant": 0.3},
}  # fmt: skip


@numba.njit
def solve(state, commands, conditions, numbers, limits, held_, flown):
    """Advance states (n, 13) by a period, those that held.fly flies, or all of them by RK4."""
    steps = np.zeros(1, equations.STEP)
    for i in range(len(state)):
        s, v = steps[0], conditions.vehicle[0]
        equations._begin(s, state, commands, conditions, i, True, v)
        s.limited = True
        for k in range(3):
            s.torque_limits[k] = limits[k]
        if held_:
            flown[i] = held.solvable(s, v, 0, numbers) and held.fly(s, v, PERIOD, 1.2, 25.0)
        else:
            for _ in range(200):
                equations.rk4(s, v, PERIOD / 200)
        equations.unpack_state(s.y, state, i)


def both(vehicle, state, commands, push=equations.STILL, limits=LIMITS):
    scale = np.linspace(0.8, 1.1, len(state))
    out, flown = [], np.zeros(len(state), bool)
    for way in (True, False):
        conditions = equations.Conditions(forces.pack(vehicle), scale, forces.free_air(len(state)), push)
        out.append(state.copy())
        numbers = forces.numbers(conditions.vehicle)
        solve(out[-1], commands, conditions, numbers, limits, way, flown)
    return *out, flown


def draw(seed):
    rng = np.random.default_rng(seed)
    state = rng.uniform(-1, 1, (N, 13)) * [1, 1, 1, 3.5, 3.5, 3.5, 0.5, 0.5, 3, 4, 4, 3, 0]
    state[:, LAG] = rng.uniform(0.3, 1.7, N) * V.hover_lag
    limit = V.command_angle_limit
    return state, rng.uniform([1e4, -limit, -limit, -2], [6e4, limit, limit, 2], (N, 4))


@pytest.mark.parametrize("name", VEHICLES)
def test_a_period_is_the_equations(name):
    state, commands = draw(0)
    push = np.zeros((N, 6))
    push[:, :3] = np.random.default_rng(1).normal(size=(N, 3))
    solved, integrated, flown = both(dataclasses.replace(V, **VEHICLES[name]), state, commands, push)
    assert flown.mean() > 0.3
    for (first, last), limit in WITHIN.items():
        gap = np.abs(solved - integrated)[flown, first : last + 1].max()
        assert gap < limit, (first, gap)
    np.testing.assert_allclose(solved[~flown], state[~flown], rtol=0, atol=1e-14)  # as they were


def test_a_limited_torque_is_left_to_rk4():
    """Where it has no limit, the torque of those that are refused would reach 95 % of it somewhere."""
    state, commands = draw(2)
    *_, flown = both(V, state, commands)
    _, unlimited, free = both(V, state, commands, limits=np.full(3, math.inf))
    _, limited, _ = both(V, state, commands, limits=LIMITS)
    acts = (np.abs(limited - unlimited)[:, WX : WZ + 1] > 1e-6).any(axis=1)
    assert free.mean() > 0.95 and acts.mean() > 0.05
    assert not (acts & flown).any()
    assert (flown | acts).mean() > 0.9  # few more than those where it acts


UNSOLVED = [field.name for field in dataclasses.fields(V) if field.name not in held.SOLVED]


@pytest.mark.parametrize("change", [
    {"effects_com_offset": (0.001, 0.0)}, {"effects_rotor_loss": (0.1, 0.0, 0.0, 0.0)},
    *({name: 0.01} for name in UNSOLVED),
], ids=str)  # fmt: skip
def test_what_is_not_known_to_be_solvable_is_left_to_rk4(change):
    """Every other entry of a vehicle, and torques that com_offset and rotor_loss make."""
    state, commands = draw(3)
    *_, flown = both(dataclasses.replace(V, **change), state, commands)
    assert not flown.any()


def test_a_pushed_torque_is_left_to_rk4():
    state, commands = draw(3)
    push = np.zeros((N, 6))
    push[:, 4] = 1e-5
    *_, flown = both(V, state, commands, push)
    assert not flown.any()
