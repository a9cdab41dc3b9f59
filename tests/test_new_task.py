"""A task of its own in a few lines: what `envs.tasks.base.Task` has defaults for is enough for everything."""

import numpy as np
import pytest
from PIL import Image

from inclined_landing.envs.tasks import TASKS
from inclined_landing.envs.tasks.base import Evaluation, Task, hover_states
from inclined_landing.eval.cli import main as evaluate
from inclined_landing.train.cli import main as train


class Climb(Task):
    """Be higher than 1.5 m."""

    name = "climb"
    observation_names = ("z", "vz")
    observation_scale = np.array([1.0, 2.0])
    action_names = ("thrust",)

    def sample(self, rng, k):
        """Starts anywhere below."""
        return self.start(hover_states(rng.uniform([-1, -1, 0.5], [1, 1, 1.4], (k, 3)), self.vehicle))

    def evaluate(self, context):
        """One for every step up there; the first one ends the episode."""
        up = context.state[:, 2] > 1.5
        return Evaluation({"up": 1.0 * up}, up, up, np.zeros_like(up))


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """A run of one rollout, with its report."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(TASKS, "climb", Climb)
        out = tmp_path_factory.mktemp("climb") / "run"
        size = "--environments 4 --rollout 32 --batch-size 64 --steps 128 --threads 1 --evaluate-every 1"
        assert train(["climb", "--out", str(out), "--no-report", *size.split()]) == 0
        yield out


def test_it_is_trained_with_the_default_score(run):
    rows = (run / "evaluations.csv").read_text().splitlines()
    assert rows[0].split(",") == ["steps", "training_seconds", "cpu_seconds", "score", "reward"]


def test_it_is_evaluated_and_its_goal_is_reached_by_climbing(run, tmp_path, capsys):
    arguments = ["success", str(run / "final.zip"), "--plant", "analytic"]
    assert evaluate(arguments) == 0
    table = capsys.readouterr().out
    assert "success [%]" in table and "200" in table


def test_it_is_pictured(run, tmp_path, capsys):
    out = tmp_path / "climb.png"
    size = ["--width", "96", "--height", "64", "--backend", "ray", "--plant", "analytic"]
    whole = ["picture", str(run / "final.zip"), "--out", str(out), "--start", "0.5,0,1"]
    assert evaluate([*whole, *size]) == 0
    with Image.open(out) as image:
        assert image.size == (96, 64)
    assert "from x 0.5, y 0, z 1 m: " in capsys.readouterr().out
    assert evaluate(["figure", str(run / "final.zip"), "--out", str(tmp_path), "--plant", "analytic"]) == 0
    assert (tmp_path / "trajectory.pdf").is_file()
