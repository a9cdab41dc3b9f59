"""Tasks of one's own that return, raise and have whatever there is where that is checked."""

import contextlib
import dataclasses
import inspect
import unittest.mock

import hypothesis.strategies as st
import numpy as np
from hypothesis import given

from inclined_landing.envs import tasks
from inclined_landing.envs.tasks import Evaluation, Task, Training
from inclined_landing.train import run
from inclined_landing.train.cli import main
from tests.campaign.judge import EVIL, Case, command, examples, judged, write
from tests.campaign.test_folders import TINY
from tests.test_own_task import CODE as HOP

CODE = f"""{HOP}
import dataclasses
from inclined_landing.envs.tasks import Training
from tests.campaign.test_own_tasks import VALUES

class Own(Hop):
    max_steps = 10
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


def method(name: str, body: str, title: str) -> Case:
    """A method with another body."""
    return case(f"{name} {title}", f"def {name}(self, *given, **named): {body}")


def field(where: tuple[str, str], value: str) -> Case:
    """A start or a judgement with one field wrong, or with one more term."""
    name, field = where
    new = f"VALUES[{value!r}]"
    if field == "more":
        field, new = "terms", f"super().evaluate(*given).terms | {{'more': {new}}}"
    return method(
        name, f"return dataclasses.replace(super().{name}(*given), {field}={new})", f"{field} {value}"
    )


def attribute(name: str, value: str) -> Case:
    """An attribute of the class with another value."""
    return case(f"attribute {name} {value}", f"{name} = VALUES[{value!r}]")


def training(field: str, value: str) -> Case:
    """A default of the training with another value."""
    named = "own.py" if field != "start_from" else ""
    return case(f"training {field} {value}", f"training = Training({field}=VALUES[{value!r}])", named)


FIELDS = [
    *(("sample", name) for name in ("state", "inclination", "present", "goal_size")),
    *(("evaluate", field.name) for field in dataclasses.fields(Evaluation)),
    ("evaluate", "more"),
]
EVILS = st.sampled_from(list(VALUES))
PLAIN = EVILS.filter(lambda v: not isinstance(VALUES[v], type))  # a type is said in the words of Python
CASES = st.one_of(
    st.builds(
        lambda name, v: method(name, f"return VALUES[{v!r}]", f"returns {v}"), st.sampled_from(CHECKED), EVILS
    ),
    st.builds(
        lambda name, error: method(name, f"raise {error}", f"raises {error}"),
        st.sampled_from([*METHODS, "__init__"]),
        st.sampled_from(RAISED),
    ),
    st.builds(field, st.sampled_from(FIELDS), EVILS),
    st.builds(attribute, st.sampled_from(ATTRIBUTES), PLAIN),
    st.builds(training, st.sampled_from([f.name for f in dataclasses.fields(Training)]), EVILS),
)


@examples(12)
@given(case=CASES)
def test_own_tasks_are_trained_or_refused(case):
    judged(case)
