"""The numbers of the success table, from cases whose answers are known."""

import dataclasses
import json
import math
import shutil
from importlib import resources
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest

from inclined_landing.envs.flights import record_flights
from inclined_landing.envs.policy import load_policy
from inclined_landing.envs.shared import statistics
from inclined_landing.envs.shared.measures import STRICT, SUCCESS, TOUCHED
from inclined_landing.envs.tasks import StepContext, frozen, make_task, slopes
from inclined_landing.envs.tasks.base import hover_states
from inclined_landing.eval import after_training, cli
from inclined_landing.eval.study import changes, flights, groups, rest, show
from inclined_landing.eval.study.engine import evaluate, run
from inclined_landing.eval.study.flights import ARRIVAL, fly_each, table_of
from inclined_landing.models.attitude import LAG, PITCH, VX, VZ
from inclined_landing.models.base import storage
from inclined_landing.models.base.errors import UserError
from inclined_landing.models.effects import LIBRARY
from inclined_landing.models.parameters import load_vehicle
from inclined_landing.models.plants import make_plant

ALPHA = load_vehicle().platform_inclination


class Constant:
    """A policy that always gives the same action."""

    metadata, path, name = {}, "constant", "constant"

    def __init__(self, task, *action):
        self.task, self.action = task, np.array(action)

    def predict(self, observation):
        return np.tile(self.action, (len(observation), 1))


@pytest.fixture(scope="module")
def landing():
    return make_task("landing", pwm_centre="hover")


def pose(z, pitch=ALPHA):
    """At rest over the middle of the slope."""
    state = hover_states(np.array([[0.0, 0.0, z]]), load_vehicle())
    state[:, PITCH] = pitch
    return state


# ---- statistics


def test_intervals_by_hand():
    # p = 28/30, z = 1.959964: centre (p + z^2/60)/(1 + z^2/30) = 0.884144,
    # half width z/(1 + z^2/30) sqrt(p (1 - p)/30 + z^2/3600) = 0.097379
    result = statistics.proportion(28, 30)
    assert (result["value"], result["count"], result["of"]) == (28 / 30, 28, 30)
    assert (result["low"], result["high"]) == pytest.approx((0.786765, 0.981523), abs=1e-6)
    assert statistics.proportion(0, 0) == {"value": None, "low": None, "high": None, "count": 0, "of": 0}
    # mean 2, standard deviation 1, n = 3: 4.302653/sqrt(3) = 2.484138
    result = statistics.mean([1.0, 2.0, 3.0])
    assert result["value"] == 2.0
    assert (result["low"], result["high"]) == pytest.approx((2 - 2.484138, 2 + 2.484138), abs=1e-6)
    nothing = {"value": None, "low": None, "high": None, "min": None, "max": None, "count": 0}
    assert statistics.median([np.nan]) == nothing


# ---- starts


def test_the_frozen_grid_is_what_its_rule_makes():
    task = make_task("landing")
    x, z = np.meshgrid(np.arange(-33, 34, 3) / 10.0, np.arange(125, 226, 10) / 100.0, indexing="ij")
    made = frozen.clear(task, np.column_stack([x.ravel(), z.ravel()]))
    file = resources.files("inclined_landing.envs") / "shipped" / "landing_grid.csv"
    lines = [line for line in file.read_text("utf-8").splitlines() if not line.startswith("#")]
    assert lines == [f"{x:.2f},{z:.2f}" for x, z in made]
    np.testing.assert_array_equal(frozen.grid(), made)
    assert len(np.unique(made, axis=0)) == len(made) == 251
    assert task.start_clearance(task.start(hover_states(made, task.vehicle))).min() >= 0.05


def test_scattered_starts_are_the_papers_within_ten_centimetres():
    starts = frozen.scattered(5)
    offset = starts.reshape(3, 10, 2) - np.array([(0, 2), (-1.5, 1.6), (1.5, 1.8)])[:, None]
    assert 0.05 < np.abs(offset).max() <= 0.1
    np.testing.assert_array_equal(starts, frozen.scattered(5))
    assert (starts != frozen.scattered(6)).all()


# ---- flights and strictness


@pytest.mark.parametrize("plant", ["mujoco", "analytic"])
def test_a_flight_that_touches_first_is_not_strict(landing, plant):
    policy = Constant(landing, 0.0, ALPHA / load_vehicle().command_angle_limit)
    at_goal = pose(landing.goal_position[1])
    on_slope = pose(load_vehicle().platform_surface_height + 0.01)
    flights = record_flights(policy, plant, np.concatenate([at_goal, on_slope]))
    assert [f.success for f in flights] == [True, True]
    assert [f.touched for f in flights] == [False, True]
    assert [f.strict for f in flights] == [True, False]
    table = table_of(landing, flights)
    counts = {measure.name: measure.of(table)["count"] for measure in landing.measures[:3]}
    assert counts == {"strict": 1, "success": 2, "touched": 1}
    row = {measure.name: measure.of(table) for measure in landing.measures[:2]}
    assert not show._equal(SUCCESS, STRICT, {(): row})  # each has its column
    assert show._equal(SUCCESS, STRICT, {(): row | {"success": row["strict"]}})


def test_a_flight_may_end_after_some_steps_on_a_surface(landing):
    """One that sinks onto the slab ends there; those in the air and in the goal box are unchanged."""
    states = np.concatenate([pose(1.4, 0.0), pose(3.0, 0.0), pose(landing.goal_position[1])])
    policy = Constant(landing, -0.3, 0.0)
    whole = record_flights(policy, "mujoco", states, steps=60)
    flights = record_flights(policy, "mujoco", states, steps=60, contact_limit=2)
    first = np.flatnonzero(whole[0].reward == -7.0)[1]  # the reward of a step in contact
    assert [len(f.t) - 1 for f in flights] == [first, 60, len(whole[2].t) - 1]
    assert [f.touched for f in flights] == [True, False, False] and flights[2].success
    np.testing.assert_array_equal(flights[0].state, whole[0].state[: first + 1])


def test_wrong_arguments_of_record_flights_are_one_sentence(landing):
    policy = Constant(landing, 0, 0)
    for arguments, options, sentence in (
        ((policy, make_plant("analytic", 2), pose(2.0)), {}, "2 vehicles, but 1 starts"),
        ((policy, "analytic", pose(2.0)), {"steps": 301}, "1 to 300 control steps"),
        ((policy, "analytic", pose(2.0)), {"steps": 2.5}, "1 to 300 control steps, not 2.5"),
        ((policy, "analytic", "x"), {}, "the start state must be an array of real numbers"),
        ((policy, 5, pose(2.0)), {}, "plant must be a plant or the name of one, not 5"),
        (
            ("landing", "analytic", pose(2.0)),
            {},
            "policy must be one that load_policy returns, not 'landing'",
        ),
    ):
        with pytest.raises(UserError, match=sentence):
            record_flights(*arguments, **options)


# ---- motors cut


def test_cut_motors_fall_and_stay(landing):
    state = pose(landing.goal_position[1])
    state[:, LAG] = 0.0
    after = rest.cut_motors(state, ALPHA, rest.VariantChoice(load_vehicle()))
    gap = landing.start_clearance(landing.start(state))[0]
    g = load_vehicle().environment_gravity
    # free fall over the gap, parallel to the slope; the speed is taken up to two 4 ms steps early
    speed = math.sqrt(2 * g * math.cos(ALPHA) * gap)
    assert after.touchdown[0]
    assert after.normal_speed[0] == pytest.approx(speed, abs=2 * 0.004 * g)
    along = abs(math.tan(ALPHA)) * speed
    assert after.tangential_speed[0] == pytest.approx(along, abs=2 * 0.004 * g)
    assert after.at_rest_on_feet[0]  # friction 0.8 holds on a slope of tan 0.48


def test_cut_motors_slide_on_a_slippery_slope(landing):
    slippery = dataclasses.replace(load_vehicle(), contact_friction=0.3)
    after = rest.cut_motors(pose(landing.goal_position[1]), ALPHA, rest.VariantChoice(slippery))
    assert after.touchdown[0] and not after.at_rest_on_feet[0]


def test_flights_that_are_decided_early_end_as_they_would(landing, monkeypatch):
    """From the goal box in many motions: at, above and below the friction that holds the slope."""
    rng = np.random.default_rng(0)
    states = np.repeat(pose(landing.goal_position[1]), 6, axis=0)
    states[:, [VX, VZ]] += rng.uniform(-1.0, 1.0, (6, 2))
    for friction in (0.3, 0.49, 0.8):
        vehicle = dataclasses.replace(load_vehicle(), contact_friction=friction)
        early = rest.cut_motors(states, ALPHA, rest.VariantChoice(vehicle))
        with monkeypatch.context() as patch:
            patch.setattr(rest, "_decided", lambda at_rest_for, on_floor: np.zeros(len(on_floor), bool))
            whole = rest.cut_motors(states, ALPHA, rest.VariantChoice(vehicle))
        np.testing.assert_array_equal(early, whole)


# ---- studies


def of_one(policy, **options):
    """Return the results of one policy on its task."""
    (results,) = run([groups.study({"one": policy}, **options)])
    return results


def test_landings_of_a_policy_that_hovers(landing):
    results = of_one(Constant(landing, 0.0, 0.0), plant="analytic", thrust_scales=(1.0, 0.9), seed=1)
    flown = {"paper's three": 3, "paper's +-0.1 m": 30, "frozen grid": 251}
    assert {row["starts"]: row["flights"] for row in results.all(SUCCESS)} == flown
    assert not any(row["count"] for row in results.all(SUCCESS))
    assert not any(row["count"] for row in results.all(TOUCHED, thrust_scale=1.0))
    # it sinks onto the slope from (0, 2)
    assert results.one(TOUCHED, thrust_scale=0.9, starts="paper's three")["count"] == 1
    speed = results.one("entry_speed", thrust_scale=1.0)
    assert speed["value"] is None and speed["flights"] == 0
    storage.to_json(show.document("success", [results]))


def test_how_landings_enter_the_goal_box(landing):
    policy = Constant(landing, 0.0, ALPHA / load_vehicle().command_angle_limit)
    states = np.concatenate([pose(landing.goal_position[1])] * 4)
    states[:, VX], states[:, VZ] = [0.5, -0.5, 0.0, 0.0], [0.0, 0.0, 0.5, -0.5]
    table = next(fly_each(policy, landing.start(states), "mujoco", [(load_vehicle(), 1.0)]))
    entry = {measure.name: measure.of(table) for measure in ARRIVAL}
    # normal (-0.434, 0, 0.901): only the second and the third move away
    assert entry["moving_away"]["count"] == 2 and entry["moving_away"]["flights"] == 4
    assert entry["entry_speed"]["value"] == pytest.approx(0.5, abs=0.1)  # 20 ms later
    assert entry["entry_normal_speed"]["max"] == pytest.approx(0.45, abs=0.1)


def test_setpoint_flights_of_a_policy_that_hovers():
    task = make_task("setpoint", pwm_centre="hover")
    results = of_one(Constant(task, 0.0, 0.0, 0.0), plant="analytic", seed=2)
    starts = task.sample(np.random.default_rng(2), 200).state
    distance = np.linalg.norm(starts[:, :3] - [0, 0, 1.2], axis=1)
    assert results.one("mean_error")["value"] == pytest.approx(distance.mean(), abs=1e-9)
    assert results.one("within")["count"] == (distance < 0.05).sum()


# ---- effects


THREE = changes.changes((), ("thrust_scale", "motor_lag", "platform_tilt"), ("medium",))


def under_effects(policy, plant="hybrid"):
    """Return the results of one policy under three effects, from every 25th start."""
    (results,) = run([changes.study({"one": policy}, THREE, plant=plant, every=25)])
    return results


def test_effects_on_a_policy_that_hovers(landing, capsys):
    """It hangs where it starts, unless the thrust is another; the start keeps its load under another lag."""
    results = under_effects(Constant(landing, 0.0, 0.0))
    touched = {row["effect"]: row["count"] for row in results.all(TOUCHED) if row["effect"]}
    assert list(touched) == ["none", "thrust_scale", "motor_lag", "platform_tilt"]
    assert touched.pop("thrust_scale") > 0 and not any(touched.values())
    assert results.one("strict", effect="none")["flights"] >= 10
    assert results.one("at_rest_on_feet", effect="none")["count"] == 0
    (fact,) = [row for row in results.study.facts if row["of"] == "thrust_scale medium"]
    assert fact["value"] == 0.88 and fact["unit"] == "1"
    show.show([results])
    assert "scale 0.88" in capsys.readouterr().out


@pytest.mark.parametrize("name", ["landing", "landing-vehicles"])  # the latter observes its vehicle
def test_vehicles_that_fly_together_fly_as_they_do_alone(name):
    """Bit for bit, a delayed command, a slung load and another thrust among them."""
    policy = load_policy(name)
    known = policy.task.vehicle
    effects = ("attitude_delay", "slung_load", "platform_tilt", "foot_height", "motor_lag")
    cases = changes.changes((), effects, ("medium",))
    variants = [(case.vehicle(known), 1.0) for case in cases] + [(known, 0.9)]
    starts = policy.task.start(hover_states(frozen.grid()[::250], known))
    together = list(fly_each(policy, starts, "hybrid", variants))
    alone = [next(fly_each(policy, starts, "hybrid", [variant])) for variant in variants]
    assert len(together) == 7
    pd.testing.assert_frame_equal(pd.concat(together), pd.concat(alone), check_exact=True)


def test_a_tilted_platform_is_tilted_for_the_plant_alone(landing, monkeypatch):
    inclinations = []

    def recorded(policy, plant, states, **options):
        flights = record_flights(policy, plant, states, steps=2)
        inclinations.extend(flight.inclination for flight in flights)
        return flights

    monkeypatch.setattr(flights, "record_flights", recorded)
    under_effects(Constant(landing, 0.0, 0.0), plant="analytic")
    assert inclinations == pytest.approx(
        np.repeat([ALPHA, ALPHA, ALPHA, ALPHA + 0.05], len(inclinations) // 4)
    )


def test_effects_on_a_setpoint_policy():
    task = make_task("setpoint", pwm_centre="hover")
    results = under_effects(Constant(task, 0.0, 0.0, 0.0), plant="analytic")
    error = {row["effect"]: row["value"] for row in results.all("mean_error") if row["effect"]}
    assert error["thrust_scale"] > error["none"] + 1.0


def test_the_policy_sees_what_motion_capture_shows(landing):
    """With a late measurement the first observation after a reset is the start, then what was before."""
    vehicle = LIBRARY["mocap_delay"].apply(load_vehicle(), {"delay": 0.04})
    seen = []

    class Watching(Constant):
        def predict(self, observation):
            seen.append(observation.copy())
            return super().predict(observation)

    plant = make_plant("analytic", 1, vehicle)
    (flight,) = record_flights(Watching(landing, 0.0, 0.3), plant, pose(2.0)[0], steps=12)
    expected = landing.observe(StepContext(flight.state[:-1]))
    np.testing.assert_array_equal(np.concatenate(seen)[2:], expected[:-2])


# ---- side by side


def test_policies_stand_side_by_side_each_on_its_task(monkeypatch, tmp_path, capsys):
    """A run folder is its final policy; the numbers of each are those of the policy alone."""
    grid = frozen.grid()[::25]
    monkeypatch.setattr(frozen, "grid", lambda: grid)
    monkeypatch.setattr(slopes, "_EACH", 2)
    run_folder = tmp_path / "my-run"
    run_folder.mkdir()
    shutil.copy(load_policy("landing-nominal").path, run_folder / "final.zip")
    arguments = ["--plant", "analytic", "--thrust-scale", "1", "0.9"]
    names = ["landing-slopes", str(run_folder), "big@hummingbird=landing-vehicles", "setpoint"]
    assert cli.main(["success", *names, *arguments, "--out", str(tmp_path / "out")]) == 0
    printed = capsys.readouterr().out
    report = json.loads((tmp_path / "out/success.json").read_text())
    by_name = {name: [row for row in report["rows"] if row["policy"] == name] for name in NAMED}
    assert {row["policy"] for row in report["rows"]} == set(NAMED)
    assert "my-run reached the goal box in" in printed
    assert "\nsetpoint was within" in printed
    flights = pd.read_csv(tmp_path / "out/flights.csv")
    assert set(flights["thrust_scale"]) == {1.0, 0.9}
    assert cli.main(["success", str(run_folder), *arguments, "--json"]) == 0
    alone = json.loads(capsys.readouterr().out)["rows"]
    keys = alone[0].keys() - {"study"}
    assert [{key: row[key] for key in keys} for row in by_name["my-run"]] == [
        {key: row[key] for key in keys} for row in alone
    ]


NAMED = ("landing-slopes", "my-run", "big@hummingbird", "setpoint")


@pytest.mark.parametrize(
    ("flown", "landed", "hinted"), [(20.0, 0, True), (20.0, 3, False), (-20.0, 0, False)]
)
def test_a_slope_of_the_other_sign_on_which_nothing_lands_gets_a_hint(flown, landed, hinted):
    task = make_task("landing", inclination=math.radians(flown))
    policy = Constant(task, 0.0, 0.0)
    policy.metadata = {"task_options": {"inclination": math.radians(-25.7)}}
    study = groups.study({"one": policy}, plant="analytic")
    flights = pd.DataFrame({"strict": np.arange(250) < landed, "cut": False}).assign(
        policy="one", thrust_scale=1.0, starts="frozen grid", slope="", success=False, touched=False
    )
    columns = {measure.column or measure.name for measure in (*task.measures, *ARRIVAL)}
    flights = flights.assign(**dict.fromkeys(columns - set(flights), 0.0))
    remark = study.remarks(evaluate(study, flights))[0]
    assert remark.endswith("try --inclination -20.") == hinted


# ---- the report on a training


def test_a_report_is_refused_for_an_evaluation_that_no_command_has():
    final = SimpleNamespace(task=SimpleNamespace(name="mine", evaluated_by="juggling"))
    with pytest.raises(UserError, match="task mine: no report is known for evaluated_by = 'juggling'"):
        after_training._study(final, {}, None)


def test_descent_is_the_law_even_next_to_a_folder_of_that_name(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "descent").mkdir()
    origin = after_training._origin(make_task("touchdown"), "descent", None)
    assert origin.name == "landing-nominal"
