"""The frame that has a surface's heading: what is seen in it, and what is commanded from it."""

import numpy as np
import pytest

from inclined_landing.models import surface
from inclined_landing.models.attitude import PITCH, ROLL, WX, WY, WZ, YAW, Z, euler_rates, rotations

RNG = np.random.default_rng(5)


def somewhere(n):
    """States (n, 13) of vehicles and platforms (n, 12), any heading, attitudes up to 0.6 rad."""
    state, platform = RNG.normal(0.0, 1.0, (n, 13)), RNG.normal(0.0, 1.0, (n, 12))
    for row in (state, platform):
        row[:, [ROLL, PITCH]] = RNG.uniform(-0.6, 0.6, (n, 2))
        row[:, YAW] = RNG.uniform(-np.pi, np.pi, n)
    return state, platform


def test_turned_together_vehicle_and_surface_look_the_same():
    """To rounding: numbers of size 3 pass a handful of operations."""
    state, platform = somewhere(200)
    turn = RNG.uniform(-np.pi, np.pi, 200)
    platform = np.concatenate([platform, np.zeros((200, 1))], axis=1)
    both = surface.turned(state, turn), surface.turned(platform, turn)[:, :12]
    assert np.abs(surface.heading_frame(*both) - surface.heading_frame(state, platform)).max() < 1e-13
    lengths = np.linalg.norm(surface.platform_motion(platform)[:, :3], axis=1)
    assert lengths == pytest.approx(np.linalg.norm(platform[:, 3:6], axis=1), abs=1e-13)


def test_the_seen_attitude_has_the_vehicles_thrust_axis():
    state, platform = somewhere(200)
    seen = surface.heading_frame(state, platform)
    angles = np.ascontiguousarray(np.column_stack([seen[:, [ROLL, PITCH]], platform[:, YAW]]))
    own = rotations(np.ascontiguousarray(state[:, ROLL : YAW + 1]))[:, :, Z]
    assert np.abs(rotations(angles)[:, :, Z] - own).max() < 1e-13
    same = state.copy()
    same[:, YAW] = platform[:, YAW]
    assert (
        np.abs(surface.heading_frame(same, platform)[:, [ROLL, PITCH]] - state[:, [ROLL, PITCH]]).max()
        < 1e-13
    )


def test_commands_lead_to_the_attitude_that_was_meant():
    """Where no limit is met: a vehicle with gain times the turned command shows gain times the meant one."""
    state, platform = somewhere(200)
    commands, gain = RNG.uniform(-0.4, 0.4, (200, 4)), 1.1
    state[:20, YAW] = platform[:20, YAW]  # some have it already
    meant, others = commands[:, 1:3].copy(), commands[:, [0, 3]].copy()
    surface.turn_commands(commands, gain, 1.0, state, platform)
    state[:, [ROLL, PITCH]] = gain * commands[:, 1:3]
    assert np.abs(surface.heading_frame(state, platform)[:, [ROLL, PITCH]] - gain * meant).max() < 1e-13
    assert (commands[:, [0, 3]] == others).all() and np.abs(commands[:20, 1:3] - meant[:20]).max() < 1e-15
    surface.turn_commands(commands, gain, 0.1, state, platform)
    assert np.abs(commands[:, 1:3]).max() <= 0.1


def test_the_thrust_axis_turns_as_its_rate_says():
    """Against the axis a moment before and after, turned by the body's rates; the surface stands still."""
    state, platform = somewhere(100)
    step = 1e-5  # s; central differences err by (rate step)^2, rates up to 4 rad/s, and 1e-16 / step
    axes = []
    for time in (-step, step):
        moved = state.copy()
        rates = np.array([euler_rates(*row) for row in state[:, [ROLL, PITCH, WX, WY, WZ]]])
        moved[:, ROLL : YAW + 1] += time * rates
        moved[:, YAW] -= platform[:, YAW]
        axes.append(rotations(np.ascontiguousarray(moved[:, ROLL : YAW + 1]))[:, :, Z])
    found = (axes[1] - axes[0]) / (2.0 * step)
    np.testing.assert_allclose(surface.thrust_turning(state, platform), found, atol=1e-8)
