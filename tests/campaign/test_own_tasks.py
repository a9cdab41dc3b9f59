"""Tasks of one's own that return, raise and have whatever there is where that is checked."""

import contextlib
import dataclasses
import inspect
import unittest.mock

import numpy as np

from inclined_landing.envs import tasks
from inclined_landing.envs.tasks import Evaluation, Task, Training
from inclined_landing.train import run
from inclined_landing.train.cli import main
from tests.campaign.judge import EVIL, Case, command, judge, parametrised, write
from tests.campaign.test_training import TINY

CODE = """
import dataclasses
import numpy as np
from tests.campaign.test_own_tasks import VALUES
from inclined_landing.envs.tasks import Evaluation, Task, Training, hover_states

class Plain(Task):
    name = "plain"
    observation_names = ("z", "vz")
    observation_scale = np.array([1.0, 2.0])
    action_names = ("thrust",)
    max_steps = 10

    def sample(self, rng, k):
        return self.start(hover_states(rng.uniform([-1, -1, 0.5], [1, 1, 1.4], (k, 3)), self.vehicle))

    def evaluate(self, context):
        up = context.state[:, 2] > 1.5
        return Evaluation({"up": 1.0 * up}, up, up, np.zeros_like(up))

class Own(Plain):
    """
# Besides the evil values: arrays of all kinds, and other things.
VALUES = EVIL | {
    **{f"array of {kind.__name__}": np.ones(2, kind) for kind in (bool, int, float, complex, str, object)},
    "of one": np.ones(1),
    "of none": np.ones(0),
    "matrix": np.ones((2, 13)),
    "matrix with nan": np.full((2, 13), np.nan),
    "column": np.ones((2, 1)),
    "commands": np.ones((2, 4)),
    "observation": np.array([[1.0, 1e39], [0.0, 0.0]]),
    "record": np.zeros(2, [("x", float)]),
    "dates": np.zeros(2, "datetime64[s]"),
    "none": None,
    "a type": int,
    "itself": Task,
    "no score": {"reward": 1.0},
    "score of none": {"score": None},
    "bytes": b"x",
}  # fmt: skip
RAISED = ("ValueError('x')", "KeyError('x\\n')", "SystemExit(3)", "RecursionError()", "ZeroDivisionError",
          "OSError(28, 'full')", "StopIteration", "UnicodeDecodeError('utf-8', b'', 0, 1, 'x')")  # fmt: skip
CHECKED = ("sample", "observe", "evaluate")
METHODS = [name for name, value in vars(Task).items() if inspect.isfunction(value) and name[0] != "_"]
ATTRIBUTES = ("name", "observation_names", "observation_scale", "action_names", "training")


def tried(path):
    """landing-train of the task in a file."""
    words = [f"--{name.replace('_', '-')}={value}" for name, value in TINY.items()]
    with (
        contextlib.chdir(path.parent),
        unittest.mock.patch.object(run, "EVALUATION_STARTS", 2),
        unittest.mock.patch.object(tasks, "_OWN", {}),
    ):
        return command(main, ["own.py:Own", "--out=run", "--no-report", "--plant=analytic", *words])


def case(name: str, body: str, named: str | None = None) -> Case:
    return Case(name, lambda folder: write(folder / "own.py", f"{CODE}{body}\n"), tried, named=named)


def returned():
    """What is checked returns every value."""
    for name in CHECKED:
        for kind in VALUES:
            yield case(f"{name} {kind}", f"def {name}(self, *given, **named): return VALUES[{kind!r}]")


def raised():
    """Every method raises."""
    for name in (*METHODS, "__init__"):
        for error in RAISED:
            yield case(f"{name} raises {error}", f"def {name}(self, *given, **named): raise {error}")


def fields():
    """Starts and judgements with one field wrong, or with one entry of it."""
    start = ("state", "inclination", "present", "goal_size")
    for name, names in (
        ("sample", start),
        ("evaluate", [field.name for field in dataclasses.fields(Evaluation)]),
    ):
        for field in names:
            for value in VALUES:
                yield case(
                    f"{name} {field} {value}",
                    f"def {name}(self, *given): return dataclasses.replace("
                    f"super().{name}(*given), {field}=VALUES[{value!r}])",
                )
    for value in VALUES:
        changed = f"super().evaluate(context).terms | {{'more': VALUES[{value!r}]}}"
        replaced = f"dataclasses.replace(super().evaluate(context), terms={changed})"
        body = f"def evaluate(self, context): return {replaced}"
        yield case(f"term {value}", body)


def attributes():
    """Every attribute that is checked, and every default of the training, with every value."""
    for name in ATTRIBUTES:
        for value in VALUES:
            yield case(f"attribute {name} {value}", f"{name} = VALUES[{value!r}]")
    for field in dataclasses.fields(Training):
        for value in VALUES:
            yield case(
                f"training {field.name} {value}",
                f"training = Training({field.name}=VALUES[{value!r}])",
                named="own.py" if field.name != "start_from" else "",
            )


@parametrised(returned, raised, fields, attributes, each=3)
def test_own_tasks_are_trained_or_refused(case, tmp_path):
    judge(case, tmp_path)
