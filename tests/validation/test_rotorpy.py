"""RotorPy as a reality of the blind test: its own physics, with the hidden cause where it should be."""

import dataclasses

import numpy as np
import pytest

from tests.validation.gap_blind import cases
from tests.validation.simulator import World
from tests.validation.simulator.paths import Path

rotorpy = pytest.importorskip(
    "tests.validation.gap_blind.rotorpy_reality", exc_type=ImportError, reason="needs rotorpy"
)
HOVER = Path([0.0, 0.0, 1.2]).hold(4.5)
DASH = Path([-1.0, 0.0, 1.0]).hold(0.5).move([1.2, 0.0, 1.0], 1.6).hold(2.4)
FLIGHTS = {
    "usual": (HOVER, World()),
    "weak": (HOVER, World(thrust_scale=0.9)),
    "heavy": (HOVER, World(mass_scale=1.1)),
    "windy": (HOVER, World(wind_x=1.0)),
    "fast": (DASH, World()),
    "slowed": (DASH, World(drag_scale=4.0)),
}


def still(one):
    """The reality without disturbance and noise, with a row of the log for every period."""
    build = one.build._replace(disturbance=(0.0,) * 3, disturbance_torque=(0.0,) * 3, log_ticks=2.0)
    constants = one.constants._replace(position_noise=0.0, attitude_noise=0.0)
    return dataclasses.replace(one, build=build, constants=constants)


@pytest.fixture(scope="module")
def flown():
    """The reality, and its flights by name."""
    one = still(rotorpy.draw(np.random.default_rng(3)))
    paths, worlds = zip(*FLIGHTS.values())
    paths = np.stack([path.rows() for path in paths], axis=1)
    return one, dict(zip(FLIGHTS, rotorpy.fly(paths, worlds, np.random.default_rng(0), one)))


def test_a_batch_flies_as_rotorpy_steps():
    """One second of changing rotor speeds in wind, against RotorPy's own adaptive integration."""
    import torch
    from rotorpy.vehicles.multirotor import Multirotor

    world = World(body_drag=0.01, translational_lift=0.05, drag_scale=1.5)
    clean = still(rotorpy.draw(np.random.default_rng(3))).constants
    params, rng, h = rotorpy.parameters(clean, world), np.random.default_rng(1), 1.0 / rotorpy.RATE
    q = [0.1, -0.05, 0.2, np.sqrt(0.9475)]
    start = np.array([0.0, 0.0, 1.0, 1.0, -0.5, 0.2, *q, 0.0, 0.0, 0.0, 0.4, -0.2, 0.1, *[1700.0] * 4])
    plant, s = rotorpy.vehicle([params] * 2), torch.from_numpy(np.stack([start] * 2))
    own = Multirotor(params, integrator_kwargs={"rtol": 1e-9, "atol": 1e-9})
    state = Multirotor._unpack_state(start.copy())
    for _ in range(rotorpy.RATE // 2):
        speeds = 1750.0 + rng.uniform(-15, 15, 4)
        s = rotorpy.advance(plant, s, torch.from_numpy(np.stack([speeds] * 2)), torch.zeros_like(s), h)
        state = own.step(state, {"cmd_motor_speeds": speeds}, h)
    ended = Multirotor._pack_state(state)
    # The midpoint rule: 3e-5 m at this step, a sixteenth of it at a quarter of the step.
    assert np.abs(s.numpy() - ended)[:, :16].max() < 1e-4 < np.abs(ended - start).max()
    assert np.abs(s.numpy() - ended)[:, 16:].max() < 5e-3  # rad/s


def test_hover_carries_the_weight(flown):
    reality, flown = flown
    force = {name: one.command[-500:, 0].mean() for name, one in flown.items()}
    weight = reality.constants.mass * reality.constants.gravity
    assert force["weak"] == pytest.approx(force["usual"] / 0.9, rel=1e-3)
    assert force["heavy"] == pytest.approx(1.1 * force["usual"], rel=1e-3)
    assert flown["usual"].truth[-1, 12:].sum() == pytest.approx(weight, rel=1e-3)


def test_drag_slows_and_wind_leans(flown):
    reality, flown = flown
    c = reality.constants
    assert flown["slowed"].truth[:, 3].max() < flown["fast"].truth[:, 3].max() - 0.02
    # Of four rotors at hover speed, in 1 m/s.
    force = 4 * c.drag_per_speed[0] * np.sqrt(c.mass * c.gravity / 4 / c.thrust_per_speed)
    lean = flown["windy"].truth[-100:, 7].mean()
    assert lean == pytest.approx(-force / (c.mass * c.gravity), rel=0.02)


def test_a_case_is_drawn_and_flown(monkeypatch):
    case = cases.draw("rotorpy", "rotor_drag", "medium", 2)
    monkeypatch.setattr(cases, "FLIGHTS", 2)
    monkeypatch.setattr(rotorpy, "WARM_UP", 0.4)
    (healthy, hidden), (_, again) = case.fly(0.6), case.fly(0.6)
    assert len(healthy) == len(hidden) == 2 and case.label()["parameters"]["rotor_drag"]["lateral"] != 1.0
    assert np.array_equal(hidden[1].position, again[1].position)
    assert hidden[0].rate == pytest.approx(case.reality.log_rate)
    with pytest.raises(ValueError, match="cannot have ground_effect"):
        cases.draw("rotorpy", "ground_effect", "medium", 2)
    # Motors that are slower still would not fly: such a case is drawn again.
    lags = [cases.draw("rotorpy", "motor_lag", "strong", k) for k in range(8)]
    assert all(rotorpy.flies(one.reality, World(**one.drawn["motor_lag"].world)) for one in lags)
    for one in cases.population(("rotorpy",), 1, 100):
        assert not set(one.causes) & cases.LACKS
