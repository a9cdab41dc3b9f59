"""Offsets between the streams of flights whose offsets are known."""

import dataclasses

import numpy as np
import pytest
from scipy.signal import lfilter

from inclined_landing.eval.logs import FlightLog
from inclined_landing.models.attitude import rotations
from inclined_landing.models.errors import UserError
from tests.proof.gap_real.alignment import align_commands, align_pose

DT, FINE = 0.01, 10  # s between rows; steps of the integration in each


def flight(seed: int, late: float = 0.0, above: float = 0.0, noise: float = 0.0) -> FlightLog:
    """30 s of tilting about with drag: attitude dated `late` [s], tracked a point `above` [m] the mass.

    Attitude follows its command with two lags of 40 ms.
    """
    random = np.random.default_rng(seed)
    m, dt = 3000 * FINE, DT / FINE
    t = np.arange(m) * dt
    asked = sum(
        random.uniform(0.02, 0.05, 2) * np.sin(2 * np.pi * f * t[:, None] + random.uniform(0, 6, 2))
        for f in random.uniform(0.3, 3.0, 8)
    )
    keep = np.exp(-dt / 0.04)
    angles = asked
    for _ in range(2):
        angles = lfilter([1 - keep], [1, -keep], angles, axis=0)
    attitude = np.column_stack([angles, np.zeros(m)])
    axis = rotations(attitude)[:, :, 2]
    velocity = np.zeros((m, 3))
    force = 9.81 / axis[:, 2]
    for k in range(m - 1):
        push = force[k] * axis[k] - [0.0, 0.0, 9.81] - [0.4, 0.4, 0.0] * velocity[k]
        velocity[k + 1] = velocity[k] + dt * push
    position = np.cumsum(velocity, axis=0) * dt + above * axis + [0.0, 0.0, 2.0]
    rows = slice(0, None, FINE)
    seen = np.stack([np.interp(t - late, t, column) for column in attitude.T], axis=1)
    command = np.column_stack([np.full(m, 4e4), asked, np.zeros(m)])
    pose_noise = noise * random.normal(size=(m, 3))
    return FlightLog(f"flight {seed}", t[rows], (position + pose_noise)[rows], seen[rows], command[rows])


@pytest.mark.parametrize(("late", "above"), [(0.0, 0.0), (0.012, 0.0), (-0.008, 0.025), (0.0, -0.03)])
def test_late_attitude_and_the_height_of_the_tracked_point(late, above):
    found = align_pose(flight(1, late, above, noise=1e-4))
    # The speed of the tracked point is taken for that of the mass: 1 ms at 25 mm and this drag.
    assert found.delay.value == pytest.approx(late, abs=0.0025)
    assert found.height.value == pytest.approx(above, abs=0.0015)
    assert found.delay.half_width < 0.002 and found.height.half_width < 0.002


def test_commands_late_in_one_flight_of_four():
    logs = [flight(seed) for seed in range(4)]
    log = logs[2]
    shifted = log.command.copy()
    for k in (1, 2):
        shifted[:, k] = np.interp(log.t - 0.02, log.t, log.command[:, k])
    logs[2] = dataclasses.replace(log, command=shifted)
    late = [estimate.value for estimate in align_commands(logs)]
    np.testing.assert_allclose(late, [-0.005, -0.005, 0.015, -0.005], atol=0.001)


def test_too_little_flight_is_said():
    with pytest.raises(UserError, match="of flight"):
        align_pose(flight(0).between(0.0, 5.0))
    with pytest.raises(UserError, match="at least two"):
        align_commands([flight(0)])
    log = flight(0)
    blind = dataclasses.replace(log, attitude=np.full_like(log.attitude, np.nan))
    with pytest.raises(UserError, match="not logged"):
        align_pose(blind)
