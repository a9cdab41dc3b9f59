"""Training with the numbers of the vehicle: what is stamped, and what a policy may go on from."""

import pytest

from inclined_landing.envs.policy import load_policy
from inclined_landing.models.errors import UserError
from inclined_landing.models.parameters import load_vehicle
from inclined_landing.train import ppo
from inclined_landing.train.config import TrainConfig
from inclined_landing.train.run import Run

SMALL = {
    "environments": 4,
    "rollout": 16,
    "batch_size": 64,
    "evaluate_every": 0,
    "threads": 1,
    "report": False,
}


def test_a_run_stamps_what_its_policy_is_told(tmp_path):
    told = {"observe_vehicle": True, "pwm_centre": "own", "history": 0, "randomise": "vehicles", "steps": 128}
    run = Run(TrainConfig("landing", out=tmp_path / "told", **told, **SMALL))
    run.execute()
    policy = load_policy(tmp_path / "told/final.zip", vehicle=load_vehicle("hummingbird"))
    assert policy.task.observe_vehicle and policy.task.per_vehicle_hover and len(policy.centre) == 11
    assert policy.task.pwm_centre == load_vehicle("hummingbird").hover_pwm
    assert policy.metadata["ranges"]["vehicles"][0] == "crazyflie-2.0"
    on = TrainConfig("landing", start_from=str(tmp_path / "told/final.zip"), success=0.9).resolved()
    assert on.observe_vehicle and on.pwm_centre == "own"


def test_a_named_vehicle_is_copied_into_the_run():
    config = TrainConfig("landing", vehicle="hummingbird", nominal=True).resolved()
    copied = config.copied()["vehicle.toml"]
    assert copied.name == "hummingbird.toml" and copied.is_file()
    assert ppo.build_task(config).pwm_centre == load_vehicle("hummingbird").hover_pwm


@pytest.mark.parametrize("options, sentence", [
    ({"observe_vehicle": True}, "goes on without --observe-vehicle"),
    ({"pwm_centre": "own"}, "goes on with its own PWM at action 0 only"),
])  # fmt: skip
def test_a_policy_goes_on_as_it_was_told(options, sentence, tmp_path):
    with pytest.raises(UserError, match=sentence):
        Run(
            TrainConfig(
                "landing",
                out=tmp_path / "on",
                start_from="landing-nominal",
                success=0.9,
                **options,
                **{**SMALL, "evaluate_every": 16},
            )
        )
