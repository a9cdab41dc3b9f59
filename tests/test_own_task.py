"""A task of one's own by import path: trained, resumed, judged and filmed; no file alone has it imported."""

import json
import sys

import pytest
from campaign.training import assert_same_policy

from inclined_landing.envs import tasks
from inclined_landing.envs.policy import load_policy
from inclined_landing.eval.cli import main as evaluate
from inclined_landing.models.errors import UserError
from inclined_landing.train.cli import main as train

CODE = '''
import numpy as np
from inclined_landing.envs.tasks import Judgement, Task, hover_states

class Hop(Task):
    """Be higher than 1.5 m."""
    name = "hop"
    observation_names = ("z", "vz")
    observation_scale = np.array([1.0, 2.0])
    action_names = ("thrust",)
    max_steps = 40

    def sample(self, rng, k):
        return self.start(hover_states(rng.uniform([-1, -1, 0.5], [1, 1, 1.4], (k, 3)), self.vehicle))

    def judge(self, moment):
        up = moment.state[:, 2] > 1.5
        return Judgement({"up": 1.0 * up}, up, up, np.zeros_like(up))
'''
SIZE = [*"--environments 4 --rollout 32 --batch-size 64 --steps 256 --threads 1 --evaluate-every 2".split(),
        *"--video-every 0 --checkpoint-every 1 --no-report".split()]  # fmt: skip


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
    assert report["task"] == "hop" and report["trained"]["task_from"] == path
    small = ["--width", "96", "--height", "64", "--backend", "ray", "--start", "0.5,0,1"]
    assert evaluate(["picture", "whole/final.zip", "--out", "hop.png", *small, *flown]) == 0
    assert load_policy("whole/final.zip", tasks.make_task("hop")).task.name == "hop"


@pytest.mark.parametrize(
    ("path", "code", "sentence"),
    [
        ("nowhere:Hop", "", "cannot be imported: ModuleNotFoundError: No module named 'nowhere'"),
        ("nowhere.py:Hop", "", "cannot be imported: FileNotFoundError"),
        ("hopping.py:", "", "is written module:Class or file.py:Class, not hopping.py:"),
        ("hopping.py:Jump", "", "hopping.py has no class Jump derived from inclined_landing.envs.tasks.Task"),
        ("hopping.py:np", "", "hopping.py has no class np derived"),
        ("hopping.py:Hop", "Hop.name = 'landing'", "is called landing, as one of this package; rename it"),
        ("hopping.py:Hop", "Hop.name = 'a b'", "has the name 'a b'; it takes small letters and digits"),
        ("hopping.py:Hop", "del Hop.action_names", "lacks action_names"),
        ("hopping.py:Hop", "Hop.action_names = ('lift',)", "known are thrust, roll, pitch, yaw rate"),
        ("hopping.py:Hop", "Hop.observation_names = ('z',)", "has not one observation_scale for each"),
        ("hopping.py:Bare", "class Bare(Task): pass", "lacks judge and sample"),
        ("hopping.py:Hop", "1 / 0", "cannot be imported: ZeroDivisionError: division by zero"),
        ("hopping.py:Hop", "raise SystemExit", "cannot be imported: SystemExit"),
    ],
)
def test_what_is_no_task_is_refused_in_a_sentence(path, code, sentence, own, tmp_path, capsys):
    (tmp_path / "hopping.py").write_text(CODE + "\n" + code, "utf-8")
    assert train([path, "--out", "run", *SIZE]) == 2
    error = capsys.readouterr().err
    assert sentence in error and error.count("\n") == 1
    assert not (tmp_path / "run").exists()
