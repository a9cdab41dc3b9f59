"""The equivalence report: every claim holds, each with its derivation, and a wrong model is noticed.

The tolerances stand with their derivations in `eval/truth/equivalence/claims.toml`, where tests and report
share them.
"""

import base64
import dataclasses
import json
import math
import re

import numpy as np
import pytest

from inclined_landing.envs.flights import record_flights
from inclined_landing.envs.policy import load_policy
from inclined_landing.envs.tasks import frozen
from inclined_landing.eval import cli
from inclined_landing.eval.base.claims import Claim, Section, number
from inclined_landing.eval.truth.equivalence import (
    check_cases,
    closed_loop,
    command,
    flying,
    inconsistencies,
    isolated,
    levels,
    motor,
    twin,
)
from inclined_landing.models.parameters import load_vehicle

V = load_vehicle()


@pytest.fixture(scope="module")
def policy():
    return load_policy("landing-nominal")


@pytest.fixture(scope="module")
def flights(policy):
    return flying.all_sequences(V, 4, 1, policy)


@pytest.fixture(scope="module")
def steps(flights):
    """Full steps in three dimensions."""
    return next(s for s in flights if s.label == "full steps, 3-D")


def check(claims):
    """All hold, all say why."""
    wrong = [f"{c.name}: {c.measured:.3g} {c.unit}, {c.tolerance}" for c in claims if not c.passed]
    assert claims and not wrong, wrong
    assert all(len(c.why) > 20 for c in claims)


@pytest.mark.parametrize("attitude", flying.MODES)
def test_three_levels(attitude, flights):
    check(levels.measure(V, attitude, flights, 200, 3)[0])


@pytest.mark.parametrize("attitude", flying.MODES)
@pytest.mark.parametrize("change", [
    {"thrust_lag_rate": V.thrust_lag_rate * (1 + 1e-4)},
    {"drag_coefficients": tuple(1.001 * c for c in V.drag_coefficients)},
    {"attitude_time_constant": V.attitude_time_constant * (1 + 1e-4)},
    {"attitude_gain": V.attitude_gain * (1 + 1e-5)},
    {"body_mass": V.body_mass * (1 + 1e-5)},
])  # fmt: skip
def test_a_slightly_wrong_engine_is_noticed(attitude, change, steps):
    """The tolerances are tight enough to see a parameter off by 0.1 % (drag), 0.01 % or 0.001 %."""
    commands, starts = flying.side_by_side(V, [steps])
    flown = flying.fly(flying.equations(4, attitude), commands, starts)
    other = flying.fly(flying.engine(4, attitude, dataclasses.replace(V, **change)), commands, starts)
    assert flying.largest_gaps(other, flown)[0] > levels.FLIGHT_LIMITS[attitude][0]


def test_every_term_by_itself():
    check(isolated.section(V).claims)


def test_plugin_free_twin(flights):
    check(twin.section(V, flights[0].commands).claims)


@pytest.mark.parametrize("integrator, brick", [("RK4", 4e-4), ("implicitfast", 0.07)])
def test_a_rigid_body_tumbles_as_euler_says(integrator, brick, monkeypatch):
    """In 10 s RK4 strays by a third of what is claimed of 30 s at most; a first-order one by more."""
    monkeypatch.setattr(check_cases, "DURATION", 10.0)
    found = check_cases.errors(integrator, 9.81)
    limits = flying.WORDS.tables["check_cases"]
    met = all(found[name] <= limits[name]["high"] / 3.0 for name in ("sphere", "brick", "damped"))
    assert met == (integrator == "RK4") and found["brick"] < brick


def test_discrete_motor_function():
    check(motor.section(V, 0).claims)
    assert np.ptp(motor.discrete(V, motor.commands(V, 0))) > 0.2  # N: the commands do something


def test_the_torque_limit_leaves_one_axis_alone(flights):
    """A full step of one axis needs J B 2 k 30 deg / tau = 5.3 of the 8.5 mN m: bit for bit the same."""
    commands, starts = flying.side_by_side(V, [s for s in flights if s.planar])
    n = commands.shape[1]
    free = flying.fly(flying.engine(n, "rate_loop"), commands, starts)
    limited = flying.fly(flying.MujocoPlant(n, contacts=False), commands, starts)
    np.testing.assert_array_equal(free, limited)


def test_the_search_for_contacts_changes_no_bit_in_the_air(steps):
    commands, starts = flying.side_by_side(V, [steps])
    searched = flying.fly(flying.MujocoPlant(4, V.changed(**flying.UNLIMITED)), commands, starts)
    np.testing.assert_array_equal(flying.fly(flying.engine(4, "rate_loop"), commands, starts), searched)


def test_closed_loop_in_both_plants(policy):
    starts = frozen.clear(policy.task, frozen.grid())[::6]
    part = closed_loop.section(policy, starts)
    check(part.claims)
    assert len(part.data["plants"]) == 4 and len(part.data["comparisons"]) == 3


def test_a_policy_that_does_not_land_fails_the_claim(policy, monkeypatch):
    def short(policy, plant, states):
        return [dataclasses.replace(f, success=False) for f in record_flights(policy, plant, states, steps=2)]

    monkeypatch.setattr(closed_loop, "record_flights", short)
    part = closed_loop.section(policy, frozen.grid()[:4])
    assert not part.passed and not part.data["comparisons"]


def test_inconsistencies(flights):
    part = inconsistencies.section(V, flights[0])
    check(part.claims)
    assert len(part.tables[0].rows) == 6


@pytest.mark.parametrize("measured, low, high, passed", [
    (1.0, -math.inf, 1.0, True), (1.1, -math.inf, 1.0, False), (math.nan, -math.inf, 1.0, False),
    (0.4, 0.5, math.inf, False), (0.5, 0.5, math.inf, True), (math.nan, 0.5, math.inf, False),
])  # fmt: skip
def test_claims(measured, low, high, passed):
    claim = Claim("c", measured, high, "m", "because", low)
    assert claim.passed is passed


def test_rounding_errors_next_to_their_bounds_are_shown_as_nothing():
    assert Claim("c", -5.55e-17, 1.0, "%", "contact").shown == 0.0
    assert Claim("c", 1.1e-16, 1e-14, "m", "rounding itself").shown == 1.1e-16


def test_numbers_as_people_write_them():
    pairs = [(0.0, "0"), (1.26e-6, "1.3e-6"), (0.4219, "0.422"), (34099.2, "34\u202f099"), (123.4, "123")]
    assert [number(x) for x, _ in pairs] == [text for _, text in pairs]
    assert number(math.nan) == "–"


@pytest.mark.slow
def test_command_writes_page_json_and_figures(tmp_path):
    out = tmp_path / "run"
    assert cli.main(["equivalence", "--out", str(out), "--quick", "--seed", "5"]) == 0
    record = json.loads((out / "report.json").read_text())
    assert not record["failed"]
    assert sum(len(s["claims"]) for s in record["sections"].values()) > 65
    page = (out / "report.html").read_text()
    images = re.findall(r'src="data:image/png;base64,([^"]+)"', page)
    files = sorted(path.name for path in out.glob("*.png"))
    assert len(images) == len(files) == 1
    assert {base64.b64decode(image) for image in images} == {(out / name).read_bytes() for name in files}
    assert not re.search(r'(src|href)="(?!data:|#)', page)  # self-contained
    for section in record["sections"].values():
        assert section["title"].replace("'", "&#39;") in page
    assert {p.name for p in out.iterdir()} == {*files, "report.html", "report.json"}


def test_failing_claims_give_exit_code_1(tmp_path, capsys, monkeypatch):
    failing = Claim("water is dry", 1.0, 0.0, "m", "it is not, so this claim has to fail")
    section = Section("levels", "Levels", ["Text."], [failing])
    monkeypatch.setattr(command, "measurements", lambda *_: {"levels": lambda: section})
    assert cli.main(["equivalence", "--out", str(tmp_path / "run")]) == 1
    assert "not met: water is dry: 1 m, tolerance at most 0" in capsys.readouterr().out
    assert json.loads((tmp_path / "run" / "report.json").read_text())["failed"] == ["water is dry"]
    assert "1 of 1 claims are not met" in (tmp_path / "run" / "report.html").read_text()
