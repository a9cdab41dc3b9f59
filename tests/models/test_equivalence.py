"""Perturbations mean the same in the MuJoCo vehicle and in the equations: free flight, full command bounds.

Eight random command sequences of 3 s, RK4 at 4 ms in the engine, far above floor and platform. That the
unperturbed plants fly alike is tested with the report, in tests/eval/truth/test_equivalence.py.
"""

import functools

import numpy as np
import pytest

from inclined_landing.eval.truth.equivalence.flying import engine, equations, fly, full_steps, largest_gaps
from inclined_landing.eval.truth.equivalence.levels import FLIGHT_LIMITS
from inclined_landing.models import perturbation
from inclined_landing.models.base.errors import UserError
from inclined_landing.models.parameters import load_vehicle
from inclined_landing.models.plants import AnalyticPlant

V = load_vehicle()
N = 8


def random_commands(seed: int) -> np.ndarray:
    """(150, N, 4) commands over the full bounds."""
    return full_steps(V, N, np.random.default_rng(seed))[:150]


@functools.cache
def nominal_flight(attitude: str) -> np.ndarray:
    return fly(equations(N, attitude), random_commands(7))


CHANGES = {
    "thrust_scale": (0.88, 1.05),
    "thrust_bias": (-0.02, 0.03),
    "lag_scale": (0.5, 2.0),
    "drag_change": (-0.8, 1.5),
    "gain_scale": (0.8, 1.2),
    "time_constant_scale": (0.7, 1.5),
    "mass_scale": (0.9, 1.2),
}


def test_every_perturbation_is_covered():
    assert set(CHANGES) == set(perturbation.NAMES)


@pytest.mark.parametrize("attitude", ["kinematic", "rate_loop"])
@pytest.mark.parametrize("name", CHANGES)
def test_perturbations_mean_the_same_in_both_plants(name, attitude):
    commands = random_commands(7)
    values = np.linspace(*CHANGES[name], N)  # one value per vehicle
    changed = fly(engine(N, attitude), commands, **{name: values})
    wanted = fly(equations(N, attitude), commands, **{name: values})
    position, angle = largest_gaps(changed, wanted)
    # The nominal tolerances: a perturbation changes coefficients by less than a factor of two.
    metres, degrees = FLIGHT_LIMITS[attitude]
    assert position < metres and angle < degrees
    assert largest_gaps(wanted, nominal_flight(attitude))[0] > 0.01  # and it does change the flight


@pytest.mark.parametrize("build", [engine, lambda n, a: equations(n, a, 1)], ids=["mujoco", "analytic"])
def test_the_neutral_perturbation_changes_no_bit(build):
    commands = random_commands(8)[:60]
    plain = fly(build(N, "rate_loop"), commands)
    neutral = dict(zip(perturbation.NAMES, perturbation.NEUTRAL))
    np.testing.assert_array_equal(fly(build(N, "rate_loop"), commands, **neutral), plain)
    plant = build(N, "rate_loop")
    plant.perturb(thrust_scale=1.1, mass_scale=1.1)  # there and back: the engine's fields are expanded now
    np.testing.assert_array_equal(fly(plant, commands, **neutral), plain)


@pytest.mark.parametrize("changes, sentence", [
    ({"wind": 1.0}, "unknown perturbation 'wind'; choose from thrust_scale"),
    ({"mass_scale": 0.0}, "perturbation mass_scale must be finite and scales must be positive"),
    ({"lag_scale": -1.0}, "lag_scale"),
    ({"thrust_bias": np.nan}, "thrust_bias"),
])  # fmt: skip
def test_wrong_perturbations_are_refused(changes, sentence):
    plant = AnalyticPlant(2)
    with pytest.raises(UserError, match=sentence):
        plant.perturb(**changes)
    assert (plant.perturbation == perturbation.NEUTRAL).all()
