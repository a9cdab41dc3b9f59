"""Experiment design: pieces, information gain, safety, the choice, and the command."""

import dataclasses
import json
from types import SimpleNamespace

import numpy as np
import pytest
from msgspec import structs

from inclined_landing.eval.cli import main
from inclined_landing.eval.gap.model.columns import Candidates, ParameterColumn
from inclined_landing.eval.gap.model.reference import ReferenceResidual, VehiclePosterior, free_effects
from inclined_landing.eval.gap.plan import pieces, safety, sentences
from inclined_landing.eval.gap.plan.design import design
from inclined_landing.eval.gap.plan.information import ModelDiscrimination, NoiseLevels
from inclined_landing.eval.gap.plan.pieces import setpoints
from inclined_landing.eval.gap.plan.reading import PlanInput, read_report
from inclined_landing.eval.gap.result import REFERENCE, ScoredSet
from inclined_landing.eval.logs import read_log
from inclined_landing.models.base.errors import UserError
from inclined_landing.models.effects import LIBRARY
from inclined_landing.models.parameters import load_vehicle, write_vehicle
from inclined_landing.models.plants import AnalyticPlant
from tests.refused import refused

VEHICLE = load_vehicle()
FREE, SLAB = (pieces.Space.of(VEHICLE, platform) for platform in (False, True))
WIND = ScoredSet(("wind",), 0.5, {"wind": {"x": 0.5, "y": -0.3}})
DRAG = ScoredSet(("rotor_drag",), 0.5, {"rotor_drag": {"lateral": 1.6, "axial": 1.6}})
BODY = ScoredSet(("body_drag",), 0.5, {"body_drag": {"coefficient": 0.005}})
MASS = ScoredSet(("mass",), 0.5, {"mass": {"scale": 1.05}})
THRUST = ScoredSet(("thrust_scale",), 0.5, {"thrust_scale": {"scale": 0.95}})


def plan_input(*hypotheses):
    """The input of a plan for a report with these sets."""
    report = SimpleNamespace(sets=hypotheses, disturbance={}, immaterial=())
    report.platform = False
    return PlanInput.of(report, VEHICLE, VehiclePosterior.of_file(None, VEHICLE))


def gram(discrimination, setpoints):
    """The matrix of a question on a flight."""
    return discrimination.gram(discrimination.flight(setpoints))


def points(*kinds, space=FREE):
    """Set-points of the middle pieces of some kinds."""
    return setpoints(pieces.joined_path([pieces.midpoint(k) for k in kinds], space), VEHICLE)


@pytest.mark.parametrize("kind", pieces.KINDS)
def test_a_piece_is_smooth_from_rest_to_rest_and_safe(kind):
    alone = setpoints(pieces.single_path(pieces.midpoint(kind), SLAB), VEHICLE)
    assert safety.plan_violation(alone, SLAB) is None
    assert np.abs(alone.velocity[[0, -1]]).max() < 1e-6
    assert np.abs(np.diff(alone.path.position, axis=0)).max() * pieces.RATE < safety.SPEED
    # Commands jump no more in one row than the smoothed doublets do: an eighth of their range.
    assert np.abs(np.diff(alone.command[:, 1:3], axis=0)).max() < VEHICLE.command_angle_limit / 4


def test_the_commands_fly_the_path():
    """The equations under the commands alone stay near the path: what is left out is the rotors' drag.

    At 1.7 m/s it is some 0.35 m/s2 for about a second: a third of a metre at most.
    """
    plan = points("thrusts", "tilts", "run")
    plant = AnalyticPlant(1, VEHICLE, attitude="rate_loop", control_period=0.01)
    start = np.zeros((1, 13))
    start[0, :3], start[0, 12] = plan.path.position[0], VEHICLE.hover_lag
    plant.reset(np.arange(1), start)
    off = []
    for row in range(len(plan.path.yaw) - 1):
        plant.step(plan.command[row : row + 1])
        off.append(np.linalg.norm(plant.state[0, :3] - plan.path.position[row + 1]))
    spans = {s.piece.kind: slice(round(100 * s.start), round(100 * s.stop)) for s in plan.path.spans}
    assert max(off[spans["thrusts"]]) < 0.03
    assert max(off[spans["tilts"]]) < 0.15
    assert max(off) < 0.5


def test_matrices_add_up_over_pieces():
    discrimination = ModelDiscrimination([DRAG, BODY], VEHICLE, NoiseLevels.typical())
    both = gram(discrimination, points("run", "circle"))
    parts = [
        gram(discrimination, setpoints(pieces.single_path(pieces.midpoint(k), FREE), VEHICLE))
        for k in ("run", "circle")
    ]
    # Windows are cut elsewhere and the way between the pieces counts too.
    ratio = np.diag(both)[1] / np.diag(sum(parts))[1]  # the first set is where it is linearised
    assert 0.7 < ratio < 1.6


def test_expected_probability_of_two_points_is_that_of_a_logistic_of_a_normal():
    """Nothing free: the log odds are normal with mean d^2/2 and variance d^2."""
    discrimination = ModelDiscrimination([DRAG, BODY], VEHICLE, NoiseLevels.typical())
    discrimination.free[:] = 0.0
    d, seen = 2.0, np.zeros((discrimination.free.shape[1],) * 2)
    seen[0, 0] = d * d
    odds = d * d / 2 + d * np.random.default_rng(0).standard_normal(100_000)
    expected = discrimination.expected(seen)
    # 20 draws of a number of deviation 0.25 at most.
    assert np.diag(expected).mean() == pytest.approx((1 / (1 + np.exp(-odds))).mean(), abs=0.08)
    assert expected.sum(axis=1) == pytest.approx(1.0)


def test_what_predicts_the_same_stays_in_doubt():
    discrimination = ModelDiscrimination(
        [DRAG, structs.replace(DRAG, probability=0.2)], VEHICLE, NoiseLevels.typical()
    )
    seen = gram(discrimination, points("run"))
    assert discrimination.gain(seen) == pytest.approx(0.0, abs=1e-6)
    assert np.diag(discrimination.expected(seen)) == pytest.approx([5 / 7, 2 / 7], abs=1e-6)


def test_moving_tells_drag_and_hovering_does_not():
    discrimination = ModelDiscrimination([DRAG, BODY], VEHICLE, NoiseLevels.typical())
    gains = {k: discrimination.gain(gram(discrimination, points(k))) for k in ("run", "hover", "turn")}
    assert gains["run"] > 0.1 > 0.01 > max(gains["hover"], gains["turn"])


def test_more_noise_tells_less():
    usual = NoiseLevels.typical()
    loud = dataclasses.replace(usual, noise=10 * usual.noise, disturbance=10 * usual.disturbance)
    questions = [ModelDiscrimination([DRAG, BODY], VEHICLE, q) for q in (usual, loud)]
    noise_levels, noisy = (q.gain(gram(q, points("run"))) for q in questions)
    assert noise_levels > 1.5 * noisy


def test_a_badly_known_vehicle_leaves_more_in_doubt():
    """What the identification left uncertain is in all sets alike: it can pass for the drag."""
    columns = tuple(ParameterColumn("rotor_drag", name) for name in ("lateral", "axial"))
    unknown = VehiclePosterior(
        columns, np.zeros(2), np.diag([1.0, 1.0]), ReferenceResidual({}, {}), frozenset()
    )
    sets, levels, run = [DRAG, ScoredSet((), 0.5, {})], NoiseLevels.typical(), points("run")
    exact, vague = (ModelDiscrimination(sets, VEHICLE, levels, reference=r) for r in (None, unknown))
    told = [np.diag(d.expected(gram(d, run))).mean() for d in (exact, vague)]
    assert told[0] > 0.9 and told[1] < 0.75  # sizes of 0.6 with a deviation of 1 on both sides


def test_copies_of_a_vehicle_differ_by_the_drawn_factors_unless_that_is_impossible():
    factor = {"thrust": 1.02, "lag": 1.2, "drag": 0.8, "gain": 0.97, "time_constant": 1.1, "mass": 1.01}
    varied = safety._varied(VEHICLE, factor)
    assert varied.thrust_per_pwm == pytest.approx(1.02 * VEHICLE.thrust_per_pwm, rel=1e-12)
    # PWM = m g / (thrust per PWM), Omega = PWM / lambda
    assert varied.hover_lag == pytest.approx(1.01 / 1.02 * 1.2 * VEHICLE.hover_lag, rel=1e-12)
    assert safety._varied(VEHICLE, factor | {"lag": 1e-3}) == VEHICLE  # its lag is quicker than a step


def test_a_plan_through_the_slab_or_a_wall_is_refused():
    through = dataclasses.replace(SLAB, home=FREE.home)
    run = setpoints(pieces.joined_path([pieces.midpoint("run")], through), VEHICLE)
    assert "surface" in safety.plan_violation(run, through).text
    aside = dataclasses.replace(FREE, home=FREE.home + [0.0, 1.0, 0.0])
    run = pieces.Piece("run", (0.5, 0.5, 0.75, 0.5))  # towards +y
    wrong = safety.plan_violation(setpoints(pieces.joined_path([run], aside), VEHICLE), aside)
    assert "fence" in wrong.text  # before it is out of the free space


def test_a_vehicle_that_cannot_hold_its_height_is_not_safe():
    weak = dataclasses.replace(VEHICLE, thrust_state_gain=0.5 * VEHICLE.thrust_state_gain)
    plan, noise_levels = points("low_hover"), NoiseLevels.typical()
    assert safety.simulate_plan(plan, [VEHICLE], FREE, noise_levels)[0] is None
    wrong, _ = safety.simulate_plan(plan, [VEHICLE, weak], FREE, noise_levels)
    assert "strays" in wrong.text or "surface" in wrong.text


def test_simulated_flights_follow_the_plan():
    plan = points("tilts", "run", "low_hover")
    states = safety.fly(plan, VEHICLE, FREE, NoiseLevels.typical(), 0).states
    assert states.shape == (safety.COPIES, len(plan.path.yaw[::2]), 13)
    assert np.abs(states[..., :3] - plan.path.position[::2]).max() < 0.15
    again = safety.fly(plan, VEHICLE, FREE, NoiseLevels.typical(), 0).states
    assert np.array_equal(states, again)


@pytest.fixture(scope="module")
def plan():
    return design(plan_input(DRAG, BODY), seconds=10.0)


def test_the_design_is_safe_repeatable_and_tells(plan):
    assert plan.path.seconds == 10.0
    assert safety.plan_violation(plan.points, FREE) is None
    assert plan.expected_accuracy > 0.6  # of flights with all, a tenth and a hundredth of the information
    kinds = {span.piece.kind for span in plan.path.spans}
    assert kinds & {"run", "circle"}
    # Drag shows at any height: nothing brings the flight near the floor.
    assert not any(span.piece.near for span in plan.path.spans)
    assert plan.without is None and sentences.why_near(plan) == []


def test_only_weighing_distinguishes_mass_from_thrust():
    discrimination = ModelDiscrimination([MASS, THRUST], VEHICLE, NoiseLevels.typical())
    expected = discrimination.expected(gram(discrimination, points("climb", "thrusts")))
    found = sentences.effects_in_doubt(plan_input(MASS, THRUST), discrimination, expected)
    assert not any(one.resolved for one in found)
    assert "Weigh the vehicle" in " ".join(sentences.measured_otherwise(found))


@pytest.mark.slow
def test_a_flight_goes_near_the_floor_where_it_must_and_says_why():
    """The ground effect shows there alone, and already above the least height."""
    strong = LIBRARY["ground_effect"].plausible | {"strength": 12.0}
    ground = ScoredSet(("ground_effect",), 0.5, {"ground_effect": strong})
    low = design(plan_input(ScoredSet((), 0.5, {}), ground), seconds=10.0)
    near = [span.piece for span in low.path.spans if span.piece.near]
    least = pieces.KINDS["low_pass"].bounds["height"][0]
    assert near and max(piece.height for piece in near) > least + 0.01
    assert low.expected[1, 1] > low.without[1, 1] + 0.2
    (said,) = sentences.why_near(low)
    assert "because ground effect cannot be identified higher up" in said


def test_what_is_promised_is_that_of_the_closed_loop(plan):
    """The matrices are of the simulated flights: each tracks the plan, none to the last centimetre."""
    gaps = [np.abs(one.states[0, :, :3] - plan.path.position[1::2]).max() for one in plan.flown]
    assert all(0.001 < gap < safety.ASTRAY for gap in gaps)
    logs = [one.log(plan.discrimination.noise_levels.noise) for one in plan.flown]
    grams = plan.discrimination.flown_grams(logs)
    assert plan.discrimination.forecast(grams) == pytest.approx(plan.expected)
    assert np.diag(plan.discrimination.expected(grams)).min() > 0.8  # with all of the information
    open_loop = plan.discrimination.gram(plan.discrimination.flight(plan.points))
    ratio = grams[0, 1, 1] / open_loop[1, 1]  # of the information about the second set
    assert 0.5 < ratio < 2.0 and ratio != 1.0


def report(tmp_path, *hypotheses, **more):
    folder = tmp_path / "report"
    folder.mkdir(exist_ok=True)
    sets = [
        {"effects": list(h.effects), "probability": h.probability, "values": h.values} for h in hypotheses
    ]
    (folder / "report.json").write_text(
        json.dumps({"version": 1, "verdict": "effects", "sets": sets, **more})
    )
    return folder


@pytest.mark.slow
def test_the_command_writes_the_same_flight_and_it_reads_as_a_log(plan, tmp_path, capsys):
    folder, out = report(tmp_path, DRAG, BODY), tmp_path / "flight"
    assert main(["plan", str(folder), "--out", str(out), "--seconds", "10"]) == 0
    said = capsys.readouterr().out
    assert "rotor drag (50 %) and body drag (50 %)" in said and "Expected probabilities" in said
    assert {p.name for p in out.iterdir()} == {"flight.csv", "plan.json"}
    assert (out / "flight.csv").read_text() == plan.points.csv()
    log = read_log(out / "flight.csv")
    # Set-points that stand still are read as values that are held, and left out.
    assert log.missing == () and 700 < len(log) < 1000
    written = json.loads((out / "plan.json").read_text())
    assert written["sets"][0]["expected"] > 0.6 and written["simulated"]["flights"] == 2 * safety.COPIES
    assert main(["plan", str(folder), "--out", str(out)]) == 2
    assert "not empty" in capsys.readouterr().err


def test_what_shows_near_the_floor_is_sought_there(tmp_path):
    ground = ScoredSet(("ground_effect",), 0.03, {"ground_effect": LIBRARY["ground_effect"].plausible})
    doubt, _ = read_report(report(tmp_path, ScoredSet((), 0.9, {}), ground))
    assert [h.effects for h in doubt.hypotheses] == [(), ("ground_effect",)]
    discrimination = ModelDiscrimination(doubt.hypotheses, VEHICLE, doubt.noise_levels)
    gains = {k: discrimination.gain(gram(discrimination, points(k))) for k in ("low_hover", "run")}
    assert gains["low_hover"] > 3 * abs(gains["run"])


def test_no_flight_is_for_what_does_not_matter(tmp_path):
    sets = (ScoredSet(("wind",), 0.6, WIND.values), ScoredSet((), 0.4, {}))
    (alone,) = read_report(report(tmp_path, *sets, immaterial=["wind"]))[0].hypotheses
    assert alone.effects == () and alone.probability == pytest.approx(1.0)


def test_no_flight_where_none_is_needed_or_none_tells(tmp_path, capsys):
    out = tmp_path / "flight"
    alone = report(tmp_path, structs.replace(DRAG, probability=0.97))
    assert main(["plan", str(alone), "--out", str(out)]) == 0
    assert "No flight is needed: rotor drag has a probability of 97 %." in capsys.readouterr().out
    assert not out.exists()


@pytest.mark.parametrize("change, sentence", [
    ({"sets": [{"effects": ["drag"], "probability": 1.0}]}, "sets[0] has the unknown effect 'drag'"),
    ({"sets": [{"effects": ["wind"], "probability": 1.0}]}, "sets[0].values.wind is missing"),
    ({"sets": [{"effects": ["wind"], "probability": 1.0, "values": {"wind": {"x": 90.0}}}]},
     "sets[0].values.wind.x is 90; it must be from -20 to 20"),
])  # fmt: skip
def test_bad_reports_are_refused_in_one_sentence(tmp_path, change, sentence):
    folder = report(tmp_path, WIND, BODY, **change)
    refused(main, ["plan", str(folder), "--out", str(tmp_path / "flight")], sentence, tmp_path)


# What identification gives a vehicle: delays, a battery, a slower yaw loop, drag and a standing trim.
IDENTIFIED = {
    "as shipped": VEHICLE,
    "late": VEHICLE.changed(
        effects_attitude_delay=0.045, effects_thrust_delay=0.021, effects_mocap_delay=0.013
    ),
    "drained": VEHICLE.changed(effects_battery_sag=0.3),
    "quick yaw": VEHICLE.changed(attitude_yaw_bandwidth=40.0, attitude_yaw_gain=0.8),
    "heavy": VEHICLE.changed(body_mass=0.041, effects_body_drag=0.004, effects_attitude_trim=(0.02, 0.01)),
    "little drag": VEHICLE.changed(drag_coefficients=(-2e-7, -2e-7, -3e-7)),
}


@pytest.mark.parametrize("vehicle", IDENTIFIED.values(), ids=IDENTIFIED)
def test_whatever_the_search_finds_for_an_identified_vehicle_can_be_planned_from(tmp_path, vehicle):
    """The search clips values to the bounds for the vehicle diagnosed: the widest of them are read."""
    folder = tmp_path / "report"
    file = folder / REFERENCE
    file.parent.mkdir(parents=True)
    write_vehicle(file, vehicle)
    candidates = Candidates.for_vehicle(load_vehicle(file), free_effects())
    found = {
        end: {n: {p.name: p.possible[end] for p in e.parameters} for n, e in candidates.library.items()}
        for end in (0, 1)
    }
    rows = [ScoredSet((name,), 0.01, {name: v[name]}) for v in found.values() for name in v]
    plan_input, _ = read_report(report(tmp_path, *rows))
    assert plan_input.vehicle == load_vehicle(file)
    assert {h.effects for h in plan_input.hypotheses} == {(name,) for name in candidates.library}


def test_the_vehicle_that_gap_identified_is_planned_for(tmp_path):
    """`gap --reference` puts it into its folder, and the values of the report are on top of it."""
    folder = report(tmp_path, ScoredSet(("attitude_delay",), 0.5, {"attitude_delay": {"delay": -0.02}}))
    with pytest.raises(UserError, match=r"attitude_delay\.delay is -0\.02; it must be from 0 to 0\.2"):
        read_report(folder)
    (folder / REFERENCE).parent.mkdir()
    write_vehicle(folder / REFERENCE, IDENTIFIED["late"])
    plan_input, _ = read_report(folder)
    assert plan_input.vehicle.effects_attitude_delay == 0.045


def test_no_report_and_no_room_are_refused(tmp_path, capsys):
    assert main(["plan", str(tmp_path / "no"), "--out", str(tmp_path / "flight")]) == 2
    assert "is not a folder" in capsys.readouterr().err
    usual, narrow = plan_input(DRAG, BODY), VEHICLE.changed(arena_y=(-0.5, 0.5))
    with pytest.raises(ValueError, match=r"6\.2 x 0\.4 x 1\.8 m to fly in"):
        design(dataclasses.replace(usual, vehicle=narrow))
    with pytest.raises(ValueError, match="battery"):
        design(dataclasses.replace(usual, vehicle=VEHICLE.changed(effects_voltage_discharge=0.1)))


def test_a_flight_is_flown_for_what_it_can_show():
    found = [sentences.InDoubt(name, 0.5, 0.6, 0.4, 0.8) for name in ("thrust_scale", "mass", "rotor_drag")]
    assert sentences.is_worth_flying(found, 1.0) and not sentences.is_worth_flying(found, 0.0)
    assert not sentences.is_worth_flying(found[:2], 1.0)  # whatever the gain: their ratio alone shows
