"""The policies in the repository do what the README says of them."""

import pytest

from inclined_landing.envs.policy import SHIPPED, load_policy
from inclined_landing.eval.policies.success import evaluate

FIRST_SEED = {"landing": 0, "setpoint": 0, "touchdown": 10}


@pytest.mark.parametrize("name", SHIPPED)
def test_stamp_says_how_it_was_made(name):
    metadata = load_policy(name).metadata
    assert metadata["task"] == name and metadata["plant"] == "mujoco"
    assert metadata["command"].startswith("landing-train") and metadata["seed"] == FIRST_SEED[name]
    assert metadata["versions"]["mujoco"] == "4.0.0" and metadata["steps"] >= 1_000_000


def test_landing_succeeds_on_the_frozen_grid():
    report = evaluate(load_policy("landing"), thrust_scales=(1.0, 1.05, 0.95))
    nominal, *others = [condition["grid"] for condition in report["conditions"]]
    assert nominal["strict"]["of"] >= 200 and nominal["strict"]["share"] >= 0.99
    assert all(grid["success"]["share"] >= 0.95 for grid in others)


def test_setpoint_is_reached():
    error = evaluate(load_policy("setpoint"))["conditions"][0]["error"]
    assert error["mean"] < 0.05  # m, after 3 s, from 200 random starts
