"""The study of tosses finds the contact of tosses that the engine itself flew."""

import mujoco
import numpy as np
import pytest

from tests.validation.tosses import SUBSTEPS, Contact, estimate, interval_of, pooled, windows_of

INTERVAL = 1 / 148  # s
TRUTH = Contact(friction=0.3, restitution=0.2, time=0.02, height=-1e-3)


def tossed(count, rows=70):
    """Return tosses (rows, 14) of a cube with the contact of TRUTH."""
    rng, model, found = np.random.default_rng(3), TRUTH.model(INTERVAL), []
    for _ in range(count):
        start = np.zeros(14)
        start[3], start[4:8] = 0.12, rng.normal(size=4)
        start[4:8] /= np.linalg.norm(start[4:8])
        start[8:11], start[11:14] = rng.uniform(-1.0, 1.0, 3) * (1, 1, 0), rng.uniform(-5.0, 5.0, 3)
        data, states = mujoco.MjData(model), []
        data.qpos[:], data.qvel[:] = start[1:8], start[8:14]
        for k in range(rows):
            states.append(np.concatenate([[k * INTERVAL], data.qpos, data.qvel]))
            mujoco.mj_step(model, data, SUBSTEPS)
        found.append(np.array(states))
    return found


def test_contact_is_found_in_tosses_of_the_engine():
    tosses = tossed(6)
    assert interval_of(tosses) == pytest.approx(INTERVAL)
    at, covariance = estimate(windows_of(tosses), INTERVAL)
    spread = np.sqrt(np.diag(covariance))
    # Nothing but the warm start of the engine's solver differs: 0.01 and 0.1 mm.
    assert at[0] == pytest.approx(0.3, abs=0.01) and at[3] == pytest.approx(-1e-3, abs=1e-4)
    assert at[1] == pytest.approx(0.2, abs=0.03) and spread[0] < 0.01


def test_kinds_that_disagree_widen_the_interval():
    """Two of three agree with themselves only; with equal kinds the interval is that of their errors."""
    values, variances = np.array([0.18, 0.22, 0.26]), np.full(3, 1e-6)
    mean, low, high = pooled(values, variances)
    assert mean == pytest.approx(0.22) and low < 0.18 and high > 0.26
    _, low, high = pooled(np.full(3, 0.2), variances)
    assert high - low == pytest.approx(2 * 6.314 * np.sqrt(1e-6 / 3), rel=1e-3)  # t of one degree of freedom
