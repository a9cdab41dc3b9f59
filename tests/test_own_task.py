"""A task of one's own by import path: trained, resumed, judged and filmed; no file alone has it imported."""

import json
import os
import sys

import pytest

from inclined_landing.envs import tasks
from inclined_landing.envs.policy import load_policy
from inclined_landing.eval.cli import main as evaluate
from inclined_landing.models.base.errors import UserError
from inclined_landing.train.cli import main as train
from tests.refused import refused
from tests.training import assert_same_policy

CODE = '''
import numpy as np
from inclined_landing.envs.tasks import Evaluation, Task, hover_states

class Hop(Task):
    """Be higher than 1.5 m."""
    name = "hop"
    observation_names = ("z", "vz")
    observation_scale = np.array([1.0, 2.0])
    action_names = ("thrust",)
    max_steps = 40

    def sample(self, rng, k):
        return self.start(hover_states(rng.uniform([-1, -1, 0.5], [1, 1, 1.4], (k, 3)), self.vehicle))

    def evaluate(self, context):
        up = context.state[:, 2] > 1.5
        return Evaluation({"up": 1.0 * up}, up, up, np.zeros_like(up))
'''
SIZE = [*"--environments 4 --rollout 32 --batch-size 64 --steps 256 --threads 1 --evaluate-every 2".split(),
        *"--checkpoint-every 1 --no-report".split()]  # fmt: skip


@pytest.fixture
def own(tmp_path, monkeypatch):
    """A folder to work in with the task in `hopping.py`; how to forget that it was imported."""
    (tmp_path / "hopping.py").write_text(CODE, "utf-8")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", list(sys.path))

    def forget():
        tasks._OWN.clear()
        sys.modules.pop("hopping", None)

    yield forget
    forget()


@pytest.mark.parametrize("path", ["hopping:Hop", "hopping.py:Hop"])
def test_all_the_way(path, own, tmp_path, capsys):
    assert train([path, "--out", "whole", *SIZE]) == 0
    assert train([path, "--out", "cut", *SIZE, "--max-seconds", "1e-6"]) == 0
    own()
    assert train(["--resume", "--out", "cut", "--no-report"]) == 2
    sentence = f"cut trains the task {path}; if you trust that code, name it: landing-train {path} --resume"
    assert sentence in capsys.readouterr().err
    assert "hopping" not in sys.modules and not tasks._OWN
    assert train([path, "--resume", "--out", "cut", "--no-report"]) == 0
    assert_same_policy(tmp_path / "whole" / "final.zip", tmp_path / "cut" / "final.zip")
    own()
    assert evaluate(["success", "whole/final.zip", "--plant", "analytic"]) == 2
    assert f"was trained for hop, a task of {path}; if you trust that code" in capsys.readouterr().err
    with pytest.raises(UserError, match=f"--task {path}"):
        load_policy("whole/final.zip")
    assert evaluate(["curves", "whole", "--out", "curves.png"]) == 0
    assert "hopping" not in sys.modules and not tasks._OWN
    capsys.readouterr()
    flown = ["--plant", "analytic", "--task", path]
    assert evaluate(["success", "whole/final.zip", "--json", *flown]) == 0
    report = json.loads(capsys.readouterr().out)
    (task,) = [fact["value"] for fact in report["facts"] if fact["name"] == "task"]
    assert task == "hop" and {row["study"] for row in report["rows"]} == {"success_hop"}
    assert load_policy("whole/final.zip", tasks.make_task("hop")).metadata["task_from"] == path
    small = ["--width", "96", "--height", "64", "--backend", "ray", "--start", "0.5,0,1"]
    assert evaluate(["picture", "whole/final.zip", "--out", "hop.png", *small, *flown]) == 0
    assert evaluate(["figure", "whole/final.zip", "--out", "figures", *flown]) == 0
    assert (tmp_path / "figures" / "trajectory_2.pdf").is_file()


@pytest.mark.parametrize(("path", "code", "sentence"), [
    ("nowhere:Hop", "", "cannot be imported: ModuleNotFoundError: No module named 'nowhere'"),
    ("nowhere.py:Hop", "", "task file nowhere.py does not exist"),
    ("pipe.py:Hop", "", "task file pipe.py is a pipe or device, not a file"),
    ("loop.py:Hop", "", "task file loop.py cannot be read: too many levels of symbolic links"),
    ("hopping.py:", "", "as module:Class or file.py:Class, not hopping.py:"),
    ("hopping.py:Jump", "", "hopping.py has no class Jump derived from inclined_landing.envs.tasks.Task"),
    ("hopping.py:np", "", "hopping.py has no class np derived"),
    ("hopping.py:Hop", "Hop.name = 'landing'", "is named landing, as a task of this package"),
    ("hopping.py:Hop", "Hop.name = 'a b'", "has name 'a b'; use lowercase letters and digits"),
    ("hopping.py:Hop", "del Hop.action_names", "lacks action_names"),
    ("hopping.py:Hop", "Hop.action_names = ('lift',)", "choose from thrust, roll, pitch, yaw rate"),
    ("hopping.py:Hop", "Hop.action_names = ()", "has action_names (); it must be"),
    ("hopping.py:Hop", "Hop.observation_names = ('z', 'z')", "it must be a tuple of distinct names"),
    ("hopping.py:Hop", "Hop.observation_names = ('z',)", "observation_scale must have shape (1,)"),
    ("hopping.py:Hop", "Hop.observation_scale[0] = 0", "has an observation_scale that is not positive"),
    ("hopping.py:Bare", "class Bare(Task): pass", "lacks evaluate and sample"),
    ("hopping.py:Hop", "1 / 0", "cannot be imported: ZeroDivisionError: division by zero"),
    ("hopping.py:Hop", "raise SystemExit", "cannot be imported: SystemExit"),
])  # fmt: skip
def test_a_class_that_is_not_a_task_is_refused_in_a_sentence(path, code, sentence, own, tmp_path):
    (tmp_path / "hopping.py").write_text(CODE + "\n" + code, "utf-8")
    os.mkfifo(tmp_path / "pipe.py")
    (tmp_path / "loop.py").symlink_to("loop.py")
    refused(train, [path, "--out", "run", *SIZE], sentence, tmp_path / "run")


JUDGED = (
    "evaluate(self, context): "
    "up = context.state[:, 2] > 1.5; return Evaluation({'up': 1.0 * up}, up, up, np.zeros_like(up))"
)


@pytest.mark.parametrize(
    ("method", "sentence"),
    [
        ("evaluate(self, context): return 1 / 0", "ZeroDivisionError: division by zero"),
        ("evaluate(self, context): return None", "evaluate returned None, not an Evaluation"),
        ("evaluate(self, context): return self.reward_weights['up']", "has no weight of the term up; it is"),
        (JUDGED.replace("1.0 * up", "1.0"), "term up must have shape (2,), not ()"),
        (JUDGED.replace("1.0 * up", "np.nan + up"), "term up must be finite"),
        (JUDGED.replace("up, up, np", "1.0 * up, up, np"), "success must be boolean"),
        ("sample(self, rng, k): return 3", "sample returned 3, not a Start"),
        ("sample(self, rng, k): return self.start(np.full((k, 13), np.nan))", "states must be finite"),
        ("sample(self, rng, k): return self.start(np.zeros((1, 13)))", "shape (2, 13), not (1, 13)"),
        ("observe(self, context): return context.state[:, :1]", "observe returned must have shape (2, 2)"),
        ("observe(self, context): return [['a', 'b']] * 2", "observe returned must be finite"),
        ("score(self, flights): return 1 / 0", "ZeroDivisionError: division by zero"),
        ("__init__(self): pass", "__init__() "),
    ],
)
def test_what_is_wrong_with_its_code_is_said_before_the_training(method, sentence, own, tmp_path):
    (tmp_path / "hopping.py").write_text(f"{CODE}\n    def {method}\n", "utf-8")
    said = refused(train, ["hopping.py:Hop", "--out", "run", *SIZE], sentence, tmp_path / "run")
    assert said.startswith("landing-train: task hop")


def test_what_goes_wrong_in_the_midst_of_it_leaves_a_run_that_goes_on(own, tmp_path, capsys):
    late = "Hop.n += 1; return Evaluation({'up': up * [1, np.nan][Hop.n > 100]}, up, up, up & False)"
    wrong = f"    n = 0\n    def evaluate(self, context): up = context.state[:, 2] > 1.5; {late}\n"
    (tmp_path / "hopping.py").write_text(f"{CODE}\n{wrong}", "utf-8")
    assert train(["hopping.py:Hop", "--out", "cut", *SIZE]) == 2
    error = capsys.readouterr().err
    assert "task hop: the reward of a step is NaN or infinite; after " in error
    assert "cut has a checkpoint: correct the task and continue with --resume" in error
    (tmp_path / "hopping.py").write_text(CODE, "utf-8")
    own()
    assert train(["hopping.py:Hop", "--out", "cut", "--resume", "--no-report"]) == 0
    capsys.readouterr()


def test_commands_say_it_too(own, tmp_path, capsys):
    assert train(["hopping.py:Hop", "--out", "run", *SIZE]) == 0
    own()
    (tmp_path / "hopping.py").write_text(f"{CODE}\n    def evaluate(self, context): return 1 / 0\n", "utf-8")
    capsys.readouterr()
    assert evaluate(["success", "run/final.zip", "--plant", "analytic", "--task", "hopping.py:Hop"]) == 2
    assert capsys.readouterr().err.endswith("evaluate raised ZeroDivisionError: division by zero (line 20)\n")
