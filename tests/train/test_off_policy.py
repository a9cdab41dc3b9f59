"""`landing-train --algorithm sac|td3`: the same run folder, curriculum and policy file as with PPO."""

import json

import numpy as np
import pandas as pd
import pytest
import torch
from stable_baselines3 import SAC, TD3

from inclined_landing.envs.flights import record_flights
from inclined_landing.envs.policy import load_policy, tensors
from inclined_landing.models.errors import UserError
from inclined_landing.train import cli, run
from inclined_landing.train.config import ALGORITHMS, TrainConfig
from inclined_landing.train.run import CHECKPOINT, Run, train

KINDS = {"sac": SAC, "td3": TD3}
TINY = {"environments": 8, "rollout": 16, "steps": 512, "threads": 1, "evaluate_every": 2, "seed": 3,
        "batch_size": 32, "buffer_size": 2048, "learning_starts": 128, "gradient_steps": 1}  # fmt: skip


def config(out, algorithm="sac", **options) -> TrainConfig:
    return TrainConfig(out=out, algorithm=algorithm, nominal=True, **(TINY | options))


@pytest.fixture(autouse=True, scope="module")
def few_starts():
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(run, "EVALUATION_STARTS", 2)
        yield


@pytest.fixture(scope="module", params=KINDS)
def finished(request, tmp_path_factory):
    """Algorithm, run and metrics of a tiny landing run."""
    begun = Run(config(tmp_path_factory.mktemp("run") / "a", request.param))
    return request.param, begun, begun.execute()


def test_its_run_folder_is_that_of_any_run(finished):
    algorithm, begun, metrics = finished
    names = {path.name for path in begun.folder.iterdir()}
    assert names == {"run.json", "learning.csv", "evaluations.csv", "best.zip", "final.zip", "metrics.json",
                     "tensorboard"}  # fmt: skip
    record = json.loads((begun.folder / "run.json").read_text("utf-8"))
    assert record["config"] == metrics["config"] and record["config"]["algorithm"] == algorithm
    assert metrics["finished"] and metrics["steps"] == 512
    learning, evaluations = (pd.read_csv(begun.folder / f"{n}.csv") for n in ("learning", "evaluations"))
    assert learning["steps"].tolist() == [128, 256, 384, 512]
    assert evaluations["steps"].tolist() == [256, 512]
    for table in (learning, evaluations):
        assert table["cpu_seconds"].is_monotonic_increasing and table["cpu_seconds"].min() > 0
    assert metrics["cpu_seconds"] >= learning["cpu_seconds"].iloc[-1]


def test_its_policy_is_read_flown_and_known_to_sb3(finished):
    algorithm, begun, _ = finished
    policy = load_policy(begun.folder / "final.zip")
    assert policy.metadata["algorithm"] == algorithm.upper() and policy.metadata["steps"] == 512
    assert policy.squashed and policy.activation == "ReLU"
    start = policy.task.sample(np.random.default_rng(0), 3).state
    assert len(record_flights(policy, "analytic", start, steps=5)) == 3
    seen = np.random.default_rng(0).normal(size=(20, 5)).astype(np.float32)
    stock = KINDS[algorithm].load(begun.folder / "final.zip", device="cpu")
    # float32 inside torch, float64 here: sums of 64 + 64 + 5 terms of size 1, each rounded to 6e-8
    np.testing.assert_allclose(stock.predict(seen, deterministic=True)[0], policy.predict(seen), atol=1e-5)


def test_it_learns_from_the_first_update_on(finished):
    """As many updates as there are steps of all vehicles after the random ones; weights follow them."""
    _, begun, _ = finished
    steps, starts, vehicles = (TINY[name] for name in ("steps", "learning_starts", "environments"))
    assert begun.model._n_updates == (steps - starts) // vehicles
    fresh = Run(config(begun.folder.parent / "never", begun.config.algorithm)).model.policy.state_dict()
    trained = tensors(begun.folder / "final.zip")
    assert any(not np.array_equal(trained[name], fresh[name].numpy()) for name in trained)


def test_an_episode_that_is_cut_is_no_end(tmp_path):
    """Its last transition is stored as one after which there is a value, and one that ended is not."""
    random = {"steps": 1280, "learning_starts": 1279}
    begun = Run(config(tmp_path / "a", task="setpoint", evaluate_every=0, **random))
    begun.execute()  # 150 steps an episode: each is truncated
    buffer = begun.model.replay_buffer
    cut = buffer.dones > 0
    assert cut.sum() == begun.env.num_envs
    np.testing.assert_array_equal(buffer.timeouts[cut], 1.0)
    sampled = buffer._get_samples(np.flatnonzero(cut.any(axis=1)))
    assert not sampled.dones.any()


def test_same_seed_same_policy_bit_for_bit(finished, tmp_path):
    """Also without evaluations in between: looking does not change the run."""
    algorithm, begun, _ = finished
    again, _ = train(config(tmp_path / "a", algorithm, evaluate_every=0))
    other, _ = train(config(tmp_path / "b", algorithm, evaluate_every=0, seed=4))
    mine, same, different = (tensors(folder / "final.zip") for folder in (begun.folder, again, other))
    assert mine.keys() == same.keys()
    assert all(np.array_equal(mine[name], same[name]) for name in mine)
    assert any(not np.array_equal(mine[name], different[name]) for name in mine)


def test_the_curriculum_reaches_the_vehicles_once_an_iteration(tmp_path):
    begun = Run(config(tmp_path / "a", evaluate_every=0))
    levels, advance = [], begun.curriculum.advance

    def raised(steps):
        advance(steps)
        begun.curriculum.level = steps / 1024
        levels.append((steps, begun.env.env.task.conditions.start_reach))

    begun.curriculum.advance = raised
    begun.execute()
    assert [steps for steps, _ in levels] == [128, 256, 384, 512]
    reached = [reach for _, reach in levels]  # what was flown until then
    assert reached == sorted(set(reached)) and reached[0] == 0.5
    assert begun.env.env.task.conditions == begun.curriculum.conditions()
    assert begun._judge.task.conditions == type(begun._judge.task.conditions)()


def test_the_learning_rate_falls_as_the_curriculum_says(tmp_path):
    begun = Run(config(tmp_path / "a", task="setpoint", curriculum="none", evaluate_every=0))
    begun.execute()  # to its end, after which the last updates come
    for optimizer in (begun.model.actor.optimizer, begun.model.critic.optimizer):
        (group,) = optimizer.param_groups
        assert group["lr"] == pytest.approx(1e-3 * begun.config.learning_rate)  # the least


def test_what_other_algorithms_have_is_refused(tmp_path):
    given = {"update": "fast", "start_from": "landing"}
    for algorithm, own in ALGORITHMS.items():
        for name in {*set().union(*ALGORITHMS.values())} - set(own):
            option = "from" if name == "start_from" else name.replace("_", "-")
            with pytest.raises(UserError, match=f"--{option} is an option of .* which {algorithm} does not"):
                TrainConfig(algorithm=algorithm, **{name: given.get(name, 1)}).resolved()
        once = TrainConfig(algorithm=algorithm).resolved()
        assert once.resolved() == once
    for wrong, sentence in (
        ({"task": "touchdown"}, "training of the task touchdown goes on from a policy, which only ppo does"),
        ({"buffer_size": 31}, "--buffer-size must be 32 or more"),
        ({"learning_starts": 512}, "--learning-starts 512 leaves nothing of 512 steps to learn in"),
        ({"buffer_size": 10**9}, r"--buffer-size 1000000000 need about .* GB of memory"),
    ):
        with pytest.raises(UserError, match=sentence):
            Run(config(tmp_path / "a", **wrong))
    assert not list(tmp_path.iterdir())


def test_it_is_not_resumed(finished, capsys):
    _, begun, _ = finished
    before = {path: path.stat().st_mtime_ns for path in begun.folder.rglob("*")}
    assert cli.main(["--resume", "--out", str(begun.folder)]) == 2
    said = capsys.readouterr().err
    assert "a replay buffer is not kept" in said and said.count("\n") == 1
    assert {path: path.stat().st_mtime_ns for path in begun.folder.rglob("*")} == before


def test_an_interruption_promises_nothing(tmp_path, monkeypatch, capsys):
    def interrupt(self):
        raise KeyboardInterrupt

    monkeypatch.setattr(Run, "execute", interrupt)
    assert cli.main(["--out", str(tmp_path / "a"), "--environments", "2", "--algorithm", "td3"]) == 130
    said = capsys.readouterr().err
    assert "keeps no checkpoint" in said and "--resume" not in said


def test_stopped_by_the_clock_it_ends_properly(tmp_path):
    folder, metrics = train(config(tmp_path / "a", max_cpu_seconds=1e-6, evaluate_every=0))
    assert not metrics["finished"] and metrics["steps"] == 128 + 8
    assert load_policy(folder / "final.zip").metadata["steps"] == metrics["steps"]
    assert not (folder / CHECKPOINT).exists() and (folder / "learning.csv").exists()


def test_cpu_time_goes_on_where_ppo_is_resumed(tmp_path):
    options = {"environments": 8, "rollout": 16, "batch_size": 64, "epochs": 1, "steps": 512, "threads": 1}
    folder, first = train(TrainConfig(out=tmp_path / "a", evaluate_every=0, max_cpu_seconds=1e-6, **options))
    assert not first["finished"]
    _, last = train(TrainConfig(out=folder, resume=True))
    assert last["finished"] and last["cpu_seconds"] > first["cpu_seconds"] > 0
    assert pd.read_csv(folder / "learning.csv")["cpu_seconds"].is_monotonic_increasing


def test_noise_is_on_the_actions_of_td3(tmp_path):
    """Flown actions differ from the policy's by noise of the given size, cut at the bounds."""
    begun = Run(config(tmp_path / "a", "td3", action_noise=0.05, evaluate_every=0))
    begun.execute()
    model = begun.model
    with torch.no_grad():
        meant = model.predict(model._last_obs, deterministic=True)[0]
    flown = np.array([model._sample_action(0, model.action_noise, 8)[1] for _ in range(500)])
    inside = np.abs(meant) < 0.75  # five standard deviations from the bounds
    error = (flown - meant)[:, inside]
    # of 500 draws each, a standard deviation is known to 3.2 %
    np.testing.assert_allclose(error.std(axis=0), 0.05, rtol=0.16)
