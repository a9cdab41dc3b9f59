"""The policies in the repository do what the README says of them."""

import pytest

from inclined_landing.envs.ids import SHIPPED
from inclined_landing.envs.policy import load_policy, trained_task
from inclined_landing.eval.study.engine import run
from inclined_landing.eval.study.groups import study
from inclined_landing.eval.study.moving import fly, pilot_of
from inclined_landing.eval.study.scenarios import scenarios

FIRST_SEED = {"landing": 0, "setpoint": 0, "touchdown": 9100, "touchdown-nominal": 10}
MOVING = [name for name in SHIPPED if name.endswith("-moving")]
LANDING = [name for name in SHIPPED if trained_task(name) == "landing" and name not in MOVING]


@pytest.mark.parametrize("name", SHIPPED)
def test_metadata_say_how_it_was_made(name):
    metadata = load_policy(name).metadata
    assert name == metadata["task"] or name.startswith(f"{metadata['task']}-")
    assert metadata["command"].startswith("landing-train")
    assert name not in FIRST_SEED or metadata["seed"] == FIRST_SEED[name]
    assert metadata["versions"]["mujoco"] >= "4" and metadata["steps"] >= 400_000


def every(names):
    """Engine and every scale take minutes: quickly, the hybrid plant, which lands alike (test_hybrid)."""
    slow = [pytest.param(name, "mujoco", marks=pytest.mark.slow) for name in names]
    return pytest.mark.parametrize("name, plant", [(name, "hybrid") for name in names] + slow)


ONE_SLOPE = [name for name in LANDING if not load_policy(name).task.observes_slope]  # the others: test_slopes


def last_group(name, plant, *scales):
    """Return the rows on success of a policy's frozen starts, at each factor on the thrust."""
    (results,) = run([study({name: load_policy(name)}, plant=plant, thrust_scales=scales or (1.0,))])
    measure = results.study.views[0].measures[0]
    rows = [row for row in results.all(measure) if row["policy"]]
    return [row for row in rows if row["starts"] == rows[-1]["starts"]], results


@every(ONE_SLOPE)
def test_landing_succeeds_on_the_frozen_grid(name, plant):
    scales = (1.0, 1.05, 0.95) if plant == "mujoco" else (1.0,)
    (nominal, *others), _ = last_group(name, plant, *scales)
    assert nominal["flights"] >= 200 and nominal["value"] >= 0.99
    assert all(row["value"] >= 0.95 for row in others)


@every(["landing"])
def test_the_policy_of_varied_vehicles_lands_with_another_thrust(name, plant):
    rows, _ = last_group(name, plant, *((0.8, 0.9, 1.1) if plant == "mujoco" else (0.8,)))
    assert min(row["value"] for row in rows) >= 0.97


@every(["setpoint"])
def test_setpoint_is_reached(name, plant):
    _, results = last_group(name, plant)
    assert results.one("mean_error")["value"] < 0.05  # m, after 3 s, from 200 random starts


@pytest.mark.parametrize("name", MOVING)
def test_it_lands_on_platforms_that_travel(name):
    """The first 16 flights of a frozen scenario, always the same; all land where it was made."""
    assert fly(scenarios()["travel_050_cm_s"], pilot_of(load_policy(name)), 16)["at_rest"].sum() >= 14
