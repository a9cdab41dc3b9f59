"""`landing-eval touchdown`: the comparison, what it counts, and wrong input."""

import numpy as np
import pytest

from inclined_landing.envs import starts as landing_starts
from inclined_landing.envs.policy import load_policy
from inclined_landing.envs.tasks.touchdown import InclinedTouchdown
from inclined_landing.eval import cli
from inclined_landing.eval.policies import touchdown


@pytest.fixture
def few_starts(monkeypatch):
    monkeypatch.setattr(landing_starts, "grid", lambda: np.array([[0.0, 2.05], [1.5, 1.75], [-1.5, 1.65]]))


def test_shipped_policy_comes_to_rest_more_gently_than_a_motor_cut(few_starts):
    report, _ = touchdown.evaluate(
        load_policy("touchdown"), load_policy("landing-nominal"), frictions=(0.3, 0.8), restitutions=(0.0,)
    )
    assert report["cannot_hold"] == [0.3] and [row["friction"] for row in report["friction"]] == [0.8]
    landed, cut = report["all"]["touchdown"], report["all"]["motor_cut"]
    assert landed["at_rest"]["count"] == landed["at_rest"]["of"] == cut["at_rest"]["of"] == 3
    assert landed["normal_speed"]["median"] < 0.6 * cut["normal_speed"]["median"]
    assert report["weight"] < landed["peak_normal_force"]["min"] < cut["peak_normal_force"]["max"]
    assert len(report["conditions"]) == 1
    touchdown.show(report)


def test_in_space_a_centre_of_mass_off_its_middle_tips_nobody_over(few_starts):
    policy = load_policy("touchdown")
    report, _ = touchdown.evaluate(
        policy, load_policy("landing-3d"), frictions=(0.8,), effects=("com_offset",)
    )
    assert report["effects"][0]["touchdown"]["at_rest"]["count"] == 3


def test_what_ends_a_landing():
    """Idle from the start: one vehicle stands on its feet, one falls to the floor."""
    policy = load_policy("touchdown-nominal")
    task = InclinedTouchdown()
    states = landing_starts.at_rest(task, np.array([task.rest_position, (2.0, 0.3)]))
    states[:, -1] = 0.0
    states[0, 7] = task.inclination
    idle = type("Idle", (), {"task": policy.task, "predict": lambda self, o: -np.ones((len(o), 2))})()
    landings = touchdown.land(idle, states, 0.8, 0.0)
    assert landings.at_rest.tolist() == [True, False]
    assert 0.3 <= landings.time[0] < 0.5 and np.isnan(landings.normal_speed[1])
    weight = task.vehicle.body_mass * task.vehicle.environment_gravity
    assert landings.peak_normal_force[0] == pytest.approx(weight * np.cos(task.inclination), rel=0.6)


def test_effects_are_the_vehicles_that_fly(few_starts):
    """On its own contact the vehicle rests; on a friction below the slope's tangent nobody does."""
    policy, cut = load_policy("touchdown-nominal"), load_policy("landing-nominal")
    task = policy.task
    states = landing_starts.at_rest(task, landing_starts.grid())
    slippery = task.vehicle.changed(contact_friction=0.3)
    assert touchdown.land(policy, states).at_rest.all()
    assert not touchdown.land(policy, states, vehicle=slippery).at_rest.any()
    report, _ = touchdown.evaluate(policy, cut, frictions=(0.3,), effects=("friction", "com_offset"))
    friction, centre = report["effects"]
    assert report["all"] is None and friction["parameters"]["scale"] == {"value": 0.6, "unit": "1"}
    # 0.6 of 0.8 is 0.48, less than tan 25.7 deg = 0.481; off its middle a vehicle leaves the plane sideways
    assert friction["touchdown"]["at_rest"]["count"] == 0 and centre["touchdown"]["at_rest"]["count"] < 3
    touchdown.show(report)


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (["landing"], "trained for the task landing, not for touchdown"),
        (["touchdown", "--baseline", "setpoint"], "trained for the task setpoint, not for landing"),
        (["touchdown", "--effect", "winds"], "unknown effect winds"),
        (["touchdown", "--friction", "-1"], "friction must be from 0 to 10"),
        (["touchdown", "--restitution", "0.9"], "restitution must be from 0 to 0.6"),
    ],
)
def test_wrong_input(arguments, sentence, capsys, tmp_path):
    assert cli.main(["touchdown", *arguments, "--out", str(tmp_path / "new")]) == 2
    printed = capsys.readouterr()
    assert sentence in printed.err and not printed.out and not (tmp_path / "new").exists()


def test_success_sends_touchdown_policies_here(capsys):
    assert cli.main(["success", "touchdown"]) == 2
    assert "is evaluated by landing-eval touchdown" in capsys.readouterr().err
