"""Options of tasks: one record each, from which constructors, `landing-train` and policy files take them."""

import dataclasses
import math
from typing import Annotated

import pytest
from msgspec import Meta

from inclined_landing.envs.tasks import TASKS, InclinedLanding, InclinedTouchdown, SlopeLanding, make_task
from inclined_landing.envs.tasks.training import DEFAULTS, Training
from inclined_landing.models.base.errors import UserError
from inclined_landing.train.config import TrainConfig

RECORDS = [kind.options_type for kind in TASKS.values()]


def test_landing_train_has_an_option_for_each():
    names = {field.name for record in (Training, *RECORDS) for field in dataclasses.fields(record)}
    found = {field.name: field.default for field in dataclasses.fields(TrainConfig)}
    of_tasks = {"azimuth", "observe_contact", "all_commands", "integrator", "keep_out", "min_steps"}
    assert names - set(found) == of_tasks
    assert all(found.get(name) in (None, False) for name in names)


@pytest.mark.parametrize("kind", TASKS.values(), ids=TASKS)
def test_defaults_are_the_tasks_and_are_accepted(kind):
    task = make_task(kind.name)
    kind.options_type().check()
    kind.training.check()
    fields = dataclasses.fields(kind.options_type)
    always = {field.name for field in fields if field.metadata.get("recorded")}
    assert set(task.options) == always
    assert make_task(kind.name, **task.options).options == task.options


CASES = {  # options of landing-train that select a column of the table
    "landing": {"task": "landing", "nominal": True, "dimensions": 3},
    "drawn": {"task": "landing"},
    "drawn-from": {"task": "landing", "start_from": "landing"},
    "drawn-slopes": {"task": "landing", "steepest": 20.0},
    "drawn-space": {"task": "landing", "dimensions": 3},
    "touchdown": {"task": "touchdown"},
    "touchdown-2d": {"task": "touchdown", "dimensions": 2},
    "setpoint": {"task": "setpoint"},
}


@pytest.mark.parametrize("case", DEFAULTS)
def test_training_has_the_values_of_its_column(case):
    column = DEFAULTS[case]
    column.check()
    resolved = TrainConfig(**CASES[case]).resolved()
    expected = vars(column) | CASES[case]
    if resolved.success is None:  # a fixed number of steps
        expected["max_steps"] = None
        expected["evaluate_every"] = 32 if column.randomise else column.evaluate_every
    for name in expected.keys() & vars(resolved).keys():
        found = getattr(resolved, name)
        assert (str(found) if name == "randomise" and found else found) == expected[name], name


@pytest.mark.parametrize(("options", "start_from", "dimensions"), [
    ({}, "descent", 3),
    ({"fastest": 1.0}, "descent", 3),
    ({"nominal": True}, "landing-nominal", None),
    ({"dimensions": 2}, "landing-nominal", 2),
    ({"start_from": "touchdown"}, "touchdown", 3),
    ({"start_from": "landing-nominal"}, "landing-nominal", None),
])  # fmt: skip
def test_a_touchdown_training_goes_on_from_a_policy_or_a_law(options, start_from, dimensions):
    resolved = TrainConfig("touchdown", **options).resolved()
    assert (resolved.start_from, resolved.dimensions) == (start_from, dimensions)


def test_a_custom_task_keeps_the_values_that_it_states(tmp_path):
    file = tmp_path / "mine.py"
    file.write_text(
        "from inclined_landing.envs.tasks import InclinedLanding, Training\n"
        "class Mine(InclinedLanding):\n"
        "    name = 'mine'\n"
        "    training = Training(steps=5000, environments=32, history=1, curriculum='fixed')\n"
    )
    resolved = TrainConfig(f"{file}:Mine").resolved()
    names = ("environments", "history", "curriculum", "rollout", "gae_lambda", "pwm_span", "evaluate_every")
    assert [getattr(resolved, name) for name in names] == [32, 1, "fixed", 32, 0.85, 25_000.0, 32]
    assert str(resolved.randomise) == "robust"


def test_a_field_more_is_an_option_more():
    @dataclasses.dataclass(frozen=True)
    class Options(InclinedLanding.options_type):
        wind: Annotated[float, Meta(ge=0, le=5)] = 0.0

    class Windy(InclinedLanding):
        name = "windy"
        options_type = Options

    assert "wind" in Windy.option_names() and Windy().options == make_task("landing").options
    assert Windy(wind=2).settings.wind == Windy(wind=2).options["wind"] == 2
    with pytest.raises(UserError, match="wind must be a number from 0 to 5, not 6"):
        Windy(wind=6)
    with pytest.raises(UserError, match="a custom task must derive from that class"):
        Windy(steepest=0.3)

    class WindySlopes(SlopeLanding):
        name = "windy-slopes"
        options_type = Options

    assert WindySlopes(steepest=0.3, wind=1.0).observes_slope


@pytest.mark.parametrize("name, kind", [("landing", InclinedLanding), ("touchdown", InclinedTouchdown)])
def test_options_find_the_class(name, kind):
    found = [
        ({}, (True, False, False)),
        ({"steepest": 0.3}, (True, True, False)),
        ({"dimensions": 3}, (False, True, False)),
        ({"dimensions": 3, "fastest": 1.0}, (False, True, True)),
    ]
    for options, traits in found:
        task = make_task(name, **options)
        assert isinstance(task, kind) and task.name == name
        assert (task.is_planar, task.observes_slope, task.platform_moves) == traits
        if options:
            with pytest.raises(UserError, match=f"make_task.'{name}', .... selects the class"):
                kind(**options)


@pytest.mark.parametrize("task, options, sentence", [
    ("landing", {"pwm_centre": "static"}, "pwm_centre must be 'paper', 'hover', 'own' or a PWM from 10000"),
    ("landing", {"pwm_centre": 9_999}, "not 9999"),
    ("landing", {"pwm_centre": math.nan}, "not nan"),
    ("landing", {"pwm_span": 0}, "pwm_span must be a number from 1 to 65535, not 0"),
    ("landing", {"inclination": 1.0}, "outside the supported range"),
    ("landing", {"inclination": math.nan}, "inclination must be a number, not nan"),
    ("landing", {"slope": 1.0}, "the task landing has no option 'slope'; choose from angle_limit"),
    ("landing", {"steepest": 2.0}, "steepest must be an angle above 0 and up to 0.873 rad"),
    ("landing", {"steepest": "wide"}, "steepest must be"),
    ("landing", {"dimensions": 4}, "dimensions must be 2 or 3, not 4"),
    ("landing", {"random_yaw": True}, "random_yaw needs dimensions=3"),
    ("landing", {"azimuth": 1.0}, "azimuth needs dimensions=3"),
    ("landing", {"azimuth": math.inf, "dimensions": 3}, "azimuth must be a number, not inf"),
    ("landing", {"angle_limit": 3.0}, "angle_limit must be an angle from 0.01 to 1.4 rad, not 3.0"),
    ("touchdown", {"fastest": 1.0}, "dimensions=3"),
    ("touchdown", {"fastest": math.nan, "dimensions": 3}, "fastest must be"),
    ("touchdown", {"swell": 1.0, "dimensions": 3}, "fastest too"),
    ("touchdown", {"fastest": 1.0, "swell": "much", "dimensions": 3}, "swell must be"),
])  # fmt: skip
def test_wrong_options_are_refused(task, options, sentence):
    with pytest.raises(UserError, match=sentence):
        make_task(task, **options)
