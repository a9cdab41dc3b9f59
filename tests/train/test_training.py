"""`landing-train`: reproducible, resumable, and one sentence with exit code 2 for whatever is wrong."""

import dataclasses
import json
import math
import sys
from importlib.metadata import version
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import torch
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

from inclined_landing.envs.ids import SHIPPED
from inclined_landing.envs.policy import load_policy
from inclined_landing.envs.policy import locate as locate_policy
from inclined_landing.envs.randomise import Ranges, locate, read_ranges
from inclined_landing.envs.tasks import TASKS, InclinedLanding, StepContext
from inclined_landing.models.attitude import LAG
from inclined_landing.models.base.errors import UserError
from inclined_landing.models.parameters import load_vehicle, write_vehicle
from inclined_landing.train import cli, evaluation, ppo, warm_start
from inclined_landing.train.checkpoint import CHECKPOINT
from inclined_landing.train.config import ENDING, MIN_STEPS_CONTINUED, TrainConfig
from inclined_landing.train.curriculum import Curriculum
from inclined_landing.train.events import EventFile
from inclined_landing.train.run import Run, train
from tests.refused import refused
from tests.training import assert_same_policy, weights

TINY = {"environments": 8, "rollout": 16, "batch_size": 64, "epochs": 2, "steps": 512, "threads": 1,
        "evaluate_every": 0, "checkpoint_every": 2}  # fmt: skip


FEW = 16


@pytest.fixture(autouse=True)
def few_vehicles(monkeypatch):
    """Runs on drawn vehicles draw fewer: each costs time, and how many there are plays no part here."""
    monkeypatch.setattr(Ranges.draw, "__defaults__", (FEW,))


def config(out, **options) -> TrainConfig:
    one = {"nominal": True} if "randomise" not in options and "start_from" not in options else {}
    return TrainConfig(out=out, **(TINY | one | options))


@pytest.fixture(scope="module")
def landing_run(tmp_path_factory):
    """Run folder and metrics of a tiny landing run, with evaluations and checkpoints on its way."""
    return train(config(tmp_path_factory.mktemp("run") / "a", evaluate_every=2, seed=3))


def test_run_folder(landing_run):
    folder, metrics = landing_run
    assert {"run.json", "learning.csv", "evaluations.csv", CHECKPOINT, "best.zip", "final.zip"} <= {
        path.name for path in folder.iterdir()
    }
    assert not [path for path in folder.iterdir() if ".part" in path.name or path.name == ".current.zip"]
    record = json.loads((folder / "run.json").read_text("utf-8"))
    assert (
        record["config"] == metrics["config"] == config(folder, evaluate_every=2, seed=3).resolved().as_json()
    )
    assert record["versions"]["mujoco"] == version("mujoco") and record["command"].startswith("landing-train")
    assert json.loads((folder / "metrics.json").read_text("utf-8")) == metrics
    assert metrics["finished"] and metrics["steps"] == 512
    learning = pd.read_csv(folder / "learning.csv")
    assert learning["steps"].tolist() == [128, 256, 384, 512]
    assert {"training_seconds", "episode_reward", "level", "start_reach"} <= set(learning)
    evaluations = pd.read_csv(folder / "evaluations.csv")
    assert evaluations["steps"].tolist() == [256, 512]
    assert evaluations["strict_success"].between(0, 1).all()
    assert list((folder / "tensorboard").iterdir())
    metadata = load_policy(folder / "final.zip").metadata
    expected = {"task": "landing", "plant": "hybrid", "curriculum": "adaptive", "seed": 3, "steps": 512}
    assert metadata.items() >= (expected | {name: record[name] for name in ("command", "versions")}).items()
    assert metadata["task_options"]["pwm_centre"] == "hover"


def test_same_seed_same_policy_bit_for_bit(landing_run, tmp_path):
    """Also with other evaluations and checkpoints in between, and on more threads."""
    folder, _ = landing_run
    again, _ = train(config(tmp_path / "b", seed=3, evaluate_every=0, checkpoint_every=3, threads=2))
    assert_same_policy(folder / "final.zip", again / "final.zip")
    other, _ = train(config(tmp_path / "c", seed=4))
    a, b = weights(folder / "final.zip"), weights(other / "final.zip")
    assert not np.array_equal(a["action_net.weight"], b["action_net.weight"])


class Killed(BaseException):
    """Stands for a kill right after a checkpoint."""


def train_until(iteration: int, options: TrainConfig, monkeypatch) -> None:
    """Train until the checkpoint of an iteration is written, and no further."""
    run = Run(options)
    checkpoint = Run.checkpoint

    def checkpoint_and_die(self, now):
        checkpoint(self, now)
        if now == iteration:
            raise Killed

    with monkeypatch.context() as patch:
        patch.setattr(Run, "checkpoint", checkpoint_and_die)
        with pytest.raises(Killed):
            run.execute()
    assert not (options.out / "final.zip").exists()


KINDS = {  # the plain landing: test_stopped_by_the_clock_and_resumed_equals_uninterrupted
    "touchdown": {"task": "touchdown"},
    "landing analytic paper": {"task": "landing", "plant": "analytic", "curriculum": "paper"},
    "setpoint": {"task": "setpoint"},
    "averaged weights": {"task": "landing", "curriculum": "balanced"},
    "landing with a history": {"task": "landing", "history": 3},
    "platforms that heave": {"task": "landing", "dimensions": 3, "fastest": 1.0, "swell": 1.0},
}


@pytest.mark.parametrize("kind", [*KINDS, "landing goes on"])
def test_everything_that_a_run_has_is_restored(kind, tmp_path, monkeypatch):
    """A resumed run ends in the bits of one that was never interrupted, whatever it is made of."""
    monkeypatch.setattr(warm_start, "CRITIC_FIRST", 256)
    monkeypatch.setattr(warm_start, "_STEPS", 20)
    monkeypatch.setattr(evaluation, "EVALUATION_STARTS", 2)
    monkeypatch.setattr(evaluation, "ENDING_STARTS", 2)
    options = KINDS.get(kind, {"start_from": "landing"}) | {"steps": 128 * 14, "evaluate_every": 2}
    if kind == "landing goes on":  # until success
        options |= {"steps": None, "max_steps": 128 * 14}
    whole, _ = train(config(tmp_path / "whole", **options))
    train_until(6, config(tmp_path / "cut", **options), monkeypatch)
    resumed, _ = train(TrainConfig(out=tmp_path / "cut", resume=True))
    assert_same_policy(whole / "final.zip", resumed / "final.zip")


def test_stopped_by_the_clock_and_resumed_equals_uninterrupted(landing_run, tmp_path):
    out = tmp_path / "cut"
    _, first = train(config(out, seed=3, max_seconds=1e-6))
    assert not first["finished"] and load_policy(out / "final.zip").metadata["steps"] == first["steps"] < 512
    resumed, metrics = train(TrainConfig(out=out, resume=True))
    assert metrics["finished"] and metrics["steps"] == 512 and metrics["cpu_seconds"] >= first["cpu_seconds"]
    assert pd.read_csv(out / "learning.csv")["cpu_seconds"].is_monotonic_increasing
    assert_same_policy(landing_run[0] / "final.zip", resumed / "final.zip")


@pytest.mark.parametrize("length", [{"steps": 256}, {"steps": None, "max_steps": 256, "evaluate_every": 2}])
def test_a_finished_run_is_trained_for_more(length, tmp_path, monkeypatch):
    """One of fixed length, or one that was to end by success; interrupted, it then goes on as any other."""
    monkeypatch.setattr(evaluation, "ENDING_STARTS", 2)
    monkeypatch.setattr(evaluation, "EVALUATION_STARTS", 2)
    folder, first = train(config(tmp_path / "a", **length))
    assert first["finished"] and first["steps"] == 256
    with pytest.raises(UserError, match="has 256 steps, more than the 128 requested"):
        Run(TrainConfig(out=folder, resume=True, steps=128))
    assert train(TrainConfig(out=folder, resume=True, steps=200))[1]["steps"] == 256  # whole iterations
    _, stopped = train(TrainConfig(out=folder, resume=True, steps=512, max_seconds=1e-6))
    assert not stopped["finished"] and json.loads((folder / "run.json").read_text())["config"]["steps"] == 512
    _, last = train(TrainConfig(out=folder, resume=True))
    assert last["finished"] and last["steps"] == 512 and last["reached"] is None
    assert pd.read_csv(folder / "learning.csv")["steps"].tolist() == [128, 256, 384, 512]
    assert load_policy(folder / "final.zip").metadata["steps"] == 512


@pytest.mark.parametrize(("net_arch", "update"), [((16, 8), "fast"), ((8,), "fast"), ((9, 8, 7), "stock")])
def test_networks_of_other_sizes(net_arch, update, tmp_path):
    """They are trained, evaluated, read, flown, and gone on with."""
    folder, _ = train(config(tmp_path / "a", net_arch=net_arch, update=update, evaluate_every=4, steps=128))
    policy = load_policy(folder / "final.zip")
    assert [len(bias) for bias in policy.biases] == [*net_arch, 2]
    assert np.isfinite(policy.predict(np.zeros((3, 5)))).all()
    assert Run(config(tmp_path / "b", start_from=str(folder / "final.zip"))).config.net_arch == net_arch


def test_a_run_trains_evaluates_and_resumes_with_its_vehicle_and_slope(tmp_path):
    shipped, file = load_vehicle(), tmp_path / "heavy.toml"
    heavy = dataclasses.replace(shipped, body_mass=1.2 * shipped.body_mass)
    write_vehicle(file, heavy)
    out, slope = tmp_path / "run", math.radians(15)
    begun = Run(config(out, vehicle=file, inclination=15, max_seconds=1e-6))
    assert begun.learner.batch.plant.vehicle == begun.evaluation.plant.vehicle == heavy
    assert begun.learner.task.pwm_centre == heavy.hover_pwm
    begun.execute()
    file.unlink()  # the run has a copy
    resumed = Run(TrainConfig(out=out, resume=True))
    assert resumed.learner.batch.plant.vehicle == resumed.evaluation.task.vehicle == heavy
    assert resumed.learner.task.inclination == resumed.evaluation.task.inclination == slope
    resumed.execute()
    policy = load_policy(out / "final.zip")
    assert policy.metadata["vehicle"] == {"body_mass": heavy.body_mass}
    assert policy.task.inclination == policy.metadata["task_options"]["inclination"] == slope
    # Flown in any vehicle, action 0 is the thrust that it was in training.
    assert policy.task.vehicle == shipped and policy.task.pwm_centre == heavy.hover_pwm


@pytest.mark.parametrize("task", [name for name in TASKS if name in SHIPPED])
def test_a_run_goes_on_from_a_policy_of_its_own_task(task, tmp_path):
    """Its actor, its noise and its critic; the actor is left alone at first, the critic learns."""
    begun = Run(config(tmp_path / "a", task=task, start_from=task, steps=256))
    shipped = weights(load_policy(task).path)
    for name, own in begun.learner.model.policy.state_dict().items():
        np.testing.assert_array_equal(own, np.float32(shipped[name]))
    folder = begun.folder
    begun.execute()
    after = weights(folder / "final.zip")
    np.testing.assert_array_equal(after["action_net.weight"], np.float32(shipped["action_net.weight"]))
    assert not np.array_equal(after["value_net.weight"], np.float32(shipped["value_net.weight"]))
    again, _ = train(config(tmp_path / "b", task=task, start_from=str(folder / "final.zip"), steps=256))
    assert load_policy(again / "final.zip").task.name == task


def test_a_run_goes_on_without_the_policy_that_it_started_from(tmp_path, landing_run):
    """The file may be gone or be another one by then: the run has a copy."""
    given = tmp_path / "given.zip"
    given.write_bytes((landing_run[0] / "final.zip").read_bytes())
    options = {"start_from": str(given), "nominal": True, "steps": 256}
    whole, _ = train(config(tmp_path / "whole", **options))
    out, _ = train(config(tmp_path / "cut", max_seconds=1e-6, **options))
    (out / "final.zip").unlink()
    given.unlink()
    for content in (None, (locate_policy("setpoint")).read_bytes()):
        if content is not None:
            given.write_bytes(content)
        assert Run(TrainConfig(out=out, resume=True)).config.start_from == str(out / "from.zip")
    resumed, _ = train(TrainConfig(out=out, resume=True))
    assert_same_policy(whole / "final.zip", resumed / "final.zip")
    assert json.loads((resumed / "run.json").read_text("utf-8"))["config"]["start_from"] == str(given)


def test_a_landing_run_that_goes_on_begins_at_the_end_of_its_curriculum(tmp_path):
    """And may end after the steps in which the critic comes first, and some; a new run has more."""
    begun = Run(TrainConfig(out=tmp_path / "a", start_from="landing-nominal", nominal=True))
    assert (
        begun.learner.curriculum.level == 1.0
        and begun.ending.least_steps == MIN_STEPS_CONTINUED > warm_start.CRITIC_FIRST
    )
    assert begun.learner.curriculum.learning_rate_share(0, None) == 1.0
    begun.learner.curriculum.advance(8192)
    assert begun.learner.curriculum.learning_rate_share(10**6, None) == 1.0  # it does not succeed yet
    for _ in range(60):
        begun.learner.curriculum.episode(success=True, length=50)
    begun.learner.curriculum.advance(8192)
    assert (
        begun.learner.curriculum.learning_rate_share(8192 + begun.learner.curriculum.settling // 2, None)
        == 0.5
    )
    new = Run(TrainConfig(out=tmp_path / "b", nominal=True))
    assert new.learner.curriculum.level == 0.0 and new.ending.least_steps == 300_000


def test_a_run_goes_on_over_a_platform_of_another_height(tmp_path):
    """As identified from landings: actor and critic answer as before, though goal and centre moved."""
    file, shipped = tmp_path / "low.toml", load_vehicle()
    write_vehicle(file, shipped.changed(platform_surface_height=1.1))
    begun = Run(config(tmp_path / "a", start_from="landing-nominal", vehicle=file))
    same = Run(config(tmp_path / "b", start_from="landing-nominal"))
    assert begun.learner.task.goal_position[1] == pytest.approx(same.learner.task.goal_position[1] - 0.05)
    given = np.random.default_rng(0).normal(0.0, 1.0, (20, 5)).astype(np.float32)
    taken, _ = begun.learner.model.predict(given, deterministic=True)
    np.testing.assert_allclose(taken, load_policy("landing-nominal").predict(given), atol=1e-5)  # float32
    values = [
        run.learner.model.policy.predict_values(torch.as_tensor(given)).detach() for run in (begun, same)
    ]
    np.testing.assert_allclose(*values, rtol=1e-4, atol=1e-4)


def test_a_run_goes_on_with_a_longer_history_that_counts_nothing_at_first(tmp_path):
    """And with the same one where none is asked for; never with a shorter one."""
    begun = Run(config(tmp_path / "a", start_from="landing-nominal", history=2, steps=256, inclination=10.0))
    task = begun.learner.task
    assert task.history == 2 and begun.evaluation.task.options == task.options
    assert begun.learner.teacher.task.inclination == task.inclination == math.radians(10.0)
    given = np.random.default_rng(0).normal(0.0, 1.0, (20, 5 + 2 * 7)).astype(np.float32)
    taken, _ = begun.learner.model.predict(given, deterministic=True)
    np.testing.assert_allclose(
        taken, load_policy("landing-nominal").predict(given[:, :5]), atol=1e-5
    )  # float32
    begun.execute()
    saved = str(tmp_path / "a" / "final.zip")
    assert load_policy(saved).task.history == 2
    again = Run(config(tmp_path / "b", start_from=saved, steps=256))
    assert again.config.history == 2
    with pytest.raises(UserError, match="needs --history 2 or more"):
        Run(config(tmp_path / "c", start_from=saved, history=1))
    with pytest.raises(UserError, match="needs --history 2 or more"):
        Run(config(tmp_path / "d", task="touchdown", start_from=saved))


DRAWN = """
nominal = 0.2
[effects.thrust_scale]
scale = [0.8, 1.1]
[effects.attitude_delay]
delay = [0, 0.03]
probability = 0.5
[effects.mocap_delay]
delay = [0, 0.03]
[body]
mass = [0.03, 0.04]
[disturbance]
acceleration = [[0, 0.1], [0, 0.1], [0, 0.1]]
acceleration_time = [[0.3, 0.3], [0.3, 0.3], [0.3, 0.3]]
"""


@pytest.mark.slow
def test_a_randomised_run_is_resumed_bit_for_bit_with_its_copy(tmp_path):
    ranges = tmp_path / "ranges.toml"
    ranges.write_text(DRAWN, "utf-8")
    # 384 steps of each vehicle, so that every episode ends once at least
    options = {"randomise": ranges, "steps": 128 * 24}
    whole, _ = train(config(tmp_path / "whole", **options))
    out = tmp_path / "cut"
    train(config(out, **options, max_seconds=0.5))
    ranges.unlink()  # the run has its own
    resumed = Run(TrainConfig(out=out, resume=True))
    assert resumed.learner.batch.nominal == 0.2 and len(resumed.learner.batch.plant.pool) == FEW
    resumed.execute()
    assert_same_policy(whole / "final.zip", out / "final.zip")
    assert load_policy(out / "final.zip").metadata["ranges"]["body"] == {"mass": [0.03, 0.04]}


@pytest.mark.slow
def test_two_of_three_evaluated_flights_have_varied_vehicles(tmp_path):
    """One deviation each, as often as the others; a shipped file goes by its name."""
    begun = Run(config(tmp_path / "run", randomise=Path("robust"), steps=256, evaluate_every=1))
    plant = begun.evaluation.plant
    varied = np.arange(plant.n) % 3 > 0
    assert (plant.choice[~varied] == 0).all()
    assert list(plant.pool) == read_ranges("robust").each_alone(plant.vehicle)
    assert np.ptp(np.bincount(plant.choice[varied])[1:]) <= 1
    np.testing.assert_allclose(
        begun.evaluation.starts(0).state[:, LAG], plant.hover_share * plant.vehicle.hover_lag
    )
    begun.execute()
    last = begun.evaluation.rows[-1]
    assert last["score"] == pytest.approx((last["score_nominal"] + 2 * last["score_varied"]) / 3)
    assert (tmp_path / "run" / "randomise.toml").read_text("utf-8") == locate("robust").read_text("utf-8")
    assert Run(TrainConfig(out=tmp_path / "run", resume=True)).metrics is not None


def test_a_run_is_not_resumed_with_other_ranges(tmp_path):
    ranges = tmp_path / "ranges.toml"
    ranges.write_text("[effects.mass]\nscale = [0.8, 1.1]\n", "utf-8")
    train(config(tmp_path / "run", randomise=ranges, max_seconds=1e-6))
    (tmp_path / "run" / "randomise.toml").write_text("[effects.mass]\nscale = [0.8, 1.2]\n", "utf-8")
    with pytest.raises(UserError, match=r"belongs to different ranges than randomise\.toml"):
        Run(TrainConfig(out=tmp_path / "run", resume=True))


def test_a_policy_is_carried_over_to_another_action_map(tmp_path):
    """Same PWM and same noise in PWM, but for float32: 3e-7 of a span and of what adds up in 64 products."""
    shipped = load_policy("landing-nominal")
    begun = Run(config(tmp_path / "a", start_from="landing-nominal", pwm_centre=40_000.0, pwm_span=24_000.0))
    begun.folder.mkdir()
    own, path = begun.learner.task, tmp_path / "carried.zip"
    path.write_bytes(begun.learner.policy_file())
    carried = load_policy(path)
    for task in (own, carried.task):
        assert (task.pwm_centre, task.pwm_span) == (40_000, 24_000)
    start = own.sample(np.random.default_rng(0), 400)
    seen = own.observe(StepContext(start.state))
    before, after = shipped.predict(seen), carried.predict(seen)
    within = (np.abs(before[:, 0]) < 1.0) & (np.abs(after[:, 0]) < 1.0)
    assert within.sum() > 50
    commands = [p.task.commands(action.astype(float)) for p, action in ((shipped, before), (carried, after))]
    np.testing.assert_allclose(commands[0][within, 0], commands[1][within, 0], rtol=0, atol=1e-5 * 24_000)
    np.testing.assert_array_equal(commands[0][:, 1:], commands[1][:, 1:])
    noise = [np.exp(weights(p.path)["log_std"]) * [p.task.pwm_span, 1.0] for p in (shipped, carried)]
    np.testing.assert_allclose(*noise, rtol=1e-6)
    again = Run(config(tmp_path / "b", start_from=str(path)))
    assert (again.learner.task.pwm_centre, again.learner.task.pwm_span) == (40_000, 24_000)


def test_resume_with_other_options_is_refused_by_name(landing_run):
    folder = landing_run[0]
    before = {path: path.stat().st_mtime_ns for path in folder.rglob("*")}
    others = {"net_arch": (9,), "seed": 9, "task": "setpoint", "inclination": 9.0, "start_from": "landing"}
    for option, value in others.items():
        name = {"start_from": "from", "net_arch": "net-arch"}.get(option, option)
        said = f"continues with the options of the run, which has .* for --{name}, not"
        with pytest.raises(UserError, match=said):
            Run(TrainConfig(out=folder, resume=True, **{option: value}))
    assert Run(TrainConfig(out=folder, resume=True, steps=512, seed=3)).metrics["steps"] == 512
    defaults = TrainConfig(out=folder, resume=True, task="landing")  # as of the run, but for the seed
    assert Run(defaults, {"task", "reward_scale", "plant"}).metrics["steps"] == 512
    with pytest.raises(UserError, match="which has 3 for --seed, not 0"):
        Run(defaults, {"seed"})
    assert {path: path.stat().st_mtime_ns for path in folder.rglob("*")} == before


def test_training_applies_the_curriculum_and_evaluation_does_not(tmp_path):
    """The vehicles train under the first stage; the judge's task and plant are the plain ones."""
    begun = Run(config(tmp_path / "a"))
    begun.execute()
    assert begun.learner.task.conditions == begun.learner.curriculum.conditions()
    assert not begun.learner.task.conditions.platform
    assert begun.evaluation.task.conditions == type(begun.evaluation.task.conditions)()
    plant = begun.evaluation.plant
    assert plant.keep_out == 0.0 and plant.kind == "hybrid" and plant.attitude == "rate_loop"
    assert begun.learner.batch.plant.keep_out == 0.04


# --- runs that end by success ------------------------------------------------------------------------

OPEN = {"steps": None, "evaluate_every": 2, "environments": 4, "curriculum": "none"}  # 64 steps a rollout


@pytest.fixture
def scores(monkeypatch):
    """Scores of the evaluations to come, instead of flights; the last one is repeated."""
    said = [0.0]

    def score(*_):
        return {"score": said.pop(0) if len(said) > 1 else said[0]}

    monkeypatch.setattr(evaluation, "ENDING_STARTS", 2)
    monkeypatch.setattr(evaluation.PeriodicEvaluation, "fly", score)
    return said


def set_least_steps(steps, monkeypatch):
    """Let runs of the landing task end by success after fewer steps."""
    monkeypatch.setattr(
        InclinedLanding, "training", dataclasses.replace(InclinedLanding.training, min_steps=steps)
    )


def test_a_run_ends_at_two_good_evaluations_in_a_row(tmp_path, scores, monkeypatch):
    """And not before its least steps."""
    scores[:] = [1.0]
    set_least_steps(300, monkeypatch)
    assert train(config(tmp_path / "least", **OPEN))[1]["steps"] == 384
    scores[:] = [0.99, 0.98, 0.99, 0.995, 0.0]
    set_least_steps(0, monkeypatch)
    begun = Run(config(tmp_path / "a", **OPEN))
    metrics = begun.execute()
    assert metrics["steps"] == 8 * 64 and metrics["finished"] and metrics["reached"] is True
    assert metrics["ended"] == "two evaluations in a row at 99 % after 512 steps"
    assert [e["score"] for e in begun.evaluation.rows] == [0.99, 0.98, 0.99, 0.995]
    assert Run(TrainConfig(out=tmp_path / "a", resume=True)).metrics["reached"] is True
    fixed, _ = train(config(tmp_path / "b", **OPEN | {"steps": 512}))  # with another learning rate
    assert load_policy(fixed / "final.zip").metadata["steps"] == 512


def test_on_varied_vehicles_a_run_learns_again_until_it_lands_them_too(tmp_path, monkeypatch):
    """Nothing is evaluated before the learning rate has settled; it starts again where nothing improves."""
    monkeypatch.setattr(Curriculum, "may_plateau", lambda _, steps: steps > 2 * 64)
    nominal = [1.0, 1.0, 1.0, 0.98, 1.0, 1.0, 0.98, 0.99, 0.99]
    varied = [0.5, 0.6, 0.7, 0.8, 0.81, 0.70, 0.99, 0.99, 1.0]  # sums of pairs: 1.51 after 1.5 at the sixth
    scores = iter(zip(nominal, varied))
    monkeypatch.setattr(evaluation, "ENDING_STARTS", 4)

    def score(*_):
        one, other = next(scores)
        return {"score": other, "score_nominal": one, "score_varied": other}

    monkeypatch.setattr(evaluation.PeriodicEvaluation, "fly", score)
    again: list[int] = []
    options = OPEN | {"evaluate_every": 1, "randomise": Path("robust")}
    set_least_steps(0, monkeypatch)
    run = Run(config(tmp_path / "a", **options))
    monkeypatch.setattr(run.learner.curriculum, "most_restarts", 1)
    monkeypatch.setattr(Curriculum, "learn_again", lambda _: again.append(run.learner.model.num_timesteps))
    monkeypatch.setattr(type(run.learner.curriculum), "learn_again", Curriculum.learn_again)
    metrics = run.execute()
    assert again == [8 * 64]
    assert metrics["reached"] is True and metrics["steps"] == 11 * 64
    assert "99 % with the nominal and with varied vehicles after 704 steps" in metrics["ended"]
    # Without further restarts it makes do with what it lands.
    scores = iter(zip(nominal, varied))
    run = Run(config(tmp_path / "b", **options))
    metrics = run.execute()
    assert metrics["reached"] is True and metrics["steps"] == 8 * 64
    assert "nominal vehicle and no further rise with varied ones (70 %) after 512 steps" in metrics["ended"]
    assert Run(TrainConfig(out=tmp_path / "b", resume=True)).metrics["reached"] is True


def test_a_run_does_not_end_before_its_curriculum(tmp_path, scores):
    scores[:] = [1.0]
    folder, metrics = train(config(tmp_path / "a", **OPEN | {"curriculum": "adaptive"}, max_steps=384))
    assert metrics["steps"] == 384 and metrics["finished"] and metrics["reached"] is False
    assert metrics["ended"] == (
        "ended without two evaluations in a row at 99 %: after 384 steps the last one gave 100 %, "
        "and the curriculum was at level 0.00"
    )
    assert (folder / "final.zip").exists() and (folder / "best.zip").exists()


def test_its_exit_code_and_its_sentence_say_that_a_run_ended_without(tmp_path, scores, capsys, monkeypatch):
    monkeypatch.setattr("inclined_landing.train.cli._report", lambda *_: print("report", file=sys.stderr))
    tiny = "--environments 4 --rollout 16 --batch-size 64 --epochs 1 --threads 1".split()
    out = ["--out", str(tmp_path / "a")]
    assert (
        cli.main(
            [*tiny, *out, "--nominal", "--evaluate-every", "1", "--max-steps", "128", "--max-seconds", "1e-6"]
        )
        == 3
    )
    *_, said, last = capsys.readouterr().err.splitlines()  # after the progress, before the report
    assert (
        last == "report"
        and "after 128 steps of at most" not in said
        and "--resume with the same --out to continue" in said
    )
    for _ in range(2):  # to its end, and once more
        assert cli.main(["--resume", *out]) == 3
        *_, said, last = capsys.readouterr().err.splitlines()
        assert last == "report" and said.startswith(
            "landing-train: ended without two evaluations in a row at 99 %: after 128 steps"
        )
    metrics = json.loads((tmp_path / "a" / "metrics.json").read_text("utf-8"))
    assert metrics["ended"] in said and metrics["reached"] is False


@pytest.mark.parametrize("dies_at", [4, 8])
def test_killed_and_resumed_a_run_ends_by_success_in_the_same_bits(dies_at, tmp_path, scores, monkeypatch):
    """At the checkpoint in between, and at the one of the end itself."""
    to_come = [0.99, 0.98, 0.99, 1.0, 0.0]
    scores[:] = to_come
    set_least_steps(0, monkeypatch)
    whole, _ = train(config(tmp_path / "whole", **OPEN))
    scores[:] = to_come
    train_until(dies_at, config(tmp_path / "cut", **OPEN), monkeypatch)
    scores[:] = to_come[dies_at // 2 :]
    resumed, metrics = train(TrainConfig(out=tmp_path / "cut", resume=True))
    assert metrics["steps"] == 512 and metrics["reached"]
    assert_same_policy(whole / "final.zip", resumed / "final.zip")


def test_the_length_of_a_run_is_fixed_or_open(tmp_path):
    def ends(**options):
        resolved = TrainConfig(out=tmp_path / "a", **options).resolved()
        return [getattr(resolved, name) for name in ENDING]

    assert ends() == ends(nominal=True) == [None, 0.99, 3_000_000]
    assert ends(steps=7) == [7, None, None] and ends(task="setpoint") == [2_000_000, None, None]
    assert ends(success=0.5, max_steps=9) == [None, 0.5, 9]
    short = TrainConfig(out=tmp_path / "a", max_steps=9).resolved()
    assert short.least_steps(InclinedLanding) == 9
    for wrong, sentence in (
        ({"evaluate_every": 0}, "--evaluate-every 0 needs --steps"),
        ({"task": "setpoint", "success": 0.9}, "--success is only for the task landing"),
    ):
        with pytest.raises(UserError, match=sentence):
            ends(**wrong)


def test_evaluation_starts_are_neither_training_starts_nor_another_seeds(tmp_path):
    judges = [Run(config(tmp_path / str(seed), seed=seed)).evaluation for seed in (0, 1)]
    first = judges[0].starts(0).state
    assert not np.array_equal(first, judges[1].starts(0).state)
    assert not np.array_equal(first, judges[0].starts(1).state)
    trained = Run(config(tmp_path / "c", seed=0, curriculum="none"))
    trained.learner.batch.reset()
    assert not set(trained.learner.batch.plant.state[:, 0]) & set(first[:, 0])


# --- a policy that observes its vehicle's parameters -------------------------------------------------


def test_a_run_records_what_its_policy_observes(tmp_path):
    privileged = {"observe_vehicle": True, "pwm_centre": "own", "history": 0, "randomise": "vehicles"}
    Run(config(tmp_path / "a", steps=128, **privileged)).execute()
    policy = load_policy(tmp_path / "a" / "final.zip", vehicle=load_vehicle("hummingbird"))
    assert policy.task.observe_vehicle and policy.task.per_vehicle_hover and len(policy.centre) == 11
    assert policy.task.pwm_centre == load_vehicle("hummingbird").hover_pwm
    assert policy.metadata["ranges"]["vehicles"][0] == "crazyflie-2.0"
    on = TrainConfig(start_from=str(tmp_path / "a" / "final.zip")).resolved()
    assert on.observe_vehicle and on.pwm_centre == "own"


def test_a_named_vehicle_is_copied_into_the_run():
    resolved = TrainConfig(vehicle="hummingbird", nominal=True).resolved()
    copied = resolved.copied()["vehicle.toml"]
    assert copied.name == "hummingbird.toml" and copied.is_file()
    assert ppo.build_task(resolved).pwm_centre == load_vehicle("hummingbird").hover_pwm


# --- wrong input -------------------------------------------------------------------------------------

WRONG = {
    "hover": "unknown task 'hover'; choose from landing, setpoint, touchdown",
    "--plant gazebo": "gazebo",
    "--net-arch 64 0": "--net-arch",
    "--from landing-nominal --net-arch 32": "has a different network than training uses",
    "--update slow": "slow",
    "--learning-rate 2": "--learning-rate must be a number above 0 and below 1, not 2",
    "--gamma nan": "--gamma must be",
    "landing setpoint": "setpoint",
    "--environments 3 --rollout 11 --batch-size 32": "leaves a last minibatch of one sample",
    "--resume": "nothing to resume",
    "--curriculum steep": "unknown curriculum 'steep' for task landing",
    "setpoint --curriculum adaptive": "unknown curriculum 'adaptive' for task setpoint",
    "--pwm-centre static": "pwm-centre",
    "setpoint --inclination 10": "--inclination does not apply to the task setpoint",
    "--net-arch": "--net-arch needs a value; is a shell variable unset?",
    "--random-yaw": "random_yaw needs dimensions=3",
    "--steepest 60": "steepest must be an angle above 0 and up to 0.873 rad",
    "--randomise none.toml": "randomise file none.toml does not exist",
    "--from none.zip": "policy none.zip does not exist",
    "--from landing-3d": "landing-3d.zip has other observations than this run (",
    "--from landing-nominal --observe-vehicle": "must be continued without --observe-vehicle",
    "--from landing-nominal --pwm-centre own": "can only be continued with its own PWM at action 0",
    "--from setpoint": "trained for the task setpoint, not for landing",
    "setpoint --from landing": "trained for the task landing, not for setpoint",
    "touchdown --plant analytic": "needs the MuJoCo plant",
    "touchdown --curriculum none": "it must be touchdown",
    "touchdown --nominal --pwm-centre paper": "can only continue policies with its pwm_centre",
    "--nominal --randomise robust": "--nominal and --randomise cannot be combined",
    "--environments 16384 --rollout 65536": "GB of memory",
    "--success 0.9": "--steps fixes the length of the run and cannot be combined with --success",
}


@pytest.mark.parametrize("arguments", WRONG)
def test_wrong_input_is_one_sentence_and_writes_nothing(arguments, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(evaluation, "EVALUATION_STARTS", 2)
    # Options that would be taken by mistake then end soon.
    tiny = "--environments 2 --rollout 4 --batch-size 8 --steps 8 --evaluate-every 0".split()
    words = arguments.split()
    for option, value in zip(tiny[::2], tiny[1::2]):
        words += [option, value] if option not in words else []
    said = refused(cli.main, [*words, "--no-report"], WRONG[arguments], tmp_path)
    assert said.startswith("landing-train: ")


def test_curves_that_cannot_be_written_are_one_sentence(tmp_path, monkeypatch):
    """On a full disk: from the first byte on, or later."""
    folder, name = tmp_path / "tensorboard", r"cannot write \S+tensorboard/events\.out\.tfevents\.\S+: "
    file = EventFile(folder)
    file._file.close()
    file._file = file._records._writer = open("/dev/full", "wb")
    with pytest.raises(UserError, match=name + "no space left on device"):
        file.write({"a": 1.0}, {"a": None}, 3)
    file.close()
    with pytest.raises(UserError, match=name + "not a directory"):
        EventFile(next(folder.iterdir()) / "tensorboard")


def test_curves_after_the_checkpoint_are_hidden(tmp_path):
    """As TensorBoard reads them: two runs of three iterations, the second resumed after two."""
    for resumed_at, first in ((None, 1), (2, 3)):
        file = EventFile(tmp_path, resumed_at)
        for step in range(first, first + 3):
            file.write(
                {"a": 10.0 * first + step, "b": 1.0, "text": "x"},
                {"a": None, "b": "tensorboard", "text": None},
                step,
            )
        file.close()
    read = EventAccumulator(str(tmp_path))
    read.Reload()
    assert read.Tags()["scalars"] == ["a"]
    assert [(event.step, event.value) for event in read.Scalars("a")] == [
        (1, 11),
        (2, 12),
        (3, 33),
        (4, 34),
        (5, 35),
    ]


def test_an_existing_run_is_not_overwritten(landing_run, capsys):
    folder = landing_run[0]
    before = {path: path.stat().st_mtime_ns for path in folder.rglob("*")}
    assert cli.main(["--out", str(folder)]) == 2
    assert "exists and is not empty; choose another name" in capsys.readouterr().err
    assert {path: path.stat().st_mtime_ns for path in folder.rglob("*")} == before


@pytest.mark.parametrize("options", [
    *({"task": task} for task in TASKS), {"nominal": True}, {"dimensions": 3, "fastest": 1.0},
    {"start_from": "landing-vehicles"}, {"task": "touchdown", "nominal": True}, {"net_arch": [32]},
])  # fmt: skip
def test_resolved_configurations_stay_as_they_are(options):
    """Also through the JSON of a run folder."""
    once = TrainConfig(**options).resolved()
    assert once.resolved() == once
    assert TrainConfig(**json.loads(json.dumps(once.as_json()))).resolved() == once
