"""Flights that contradict the others are found, and said before anything else."""

import dataclasses
import types

import numpy as np
import pytest

from inclined_landing.eval.gap.infer.fit import fit_least_squares, variance_inflation
from inclined_landing.eval.gap.infer.heterogeneity import inconsistent_flights
from inclined_landing.eval.gap.measured.windows import prepare
from inclined_landing.eval.gap.model.columns import BASE, Candidates, ParameterColumn, slab_deviations
from inclined_landing.eval.gap.model.problem import Linearisation, Problem
from inclined_landing.eval.gap.report import words
from inclined_landing.models.effects import LIBRARY
from inclined_landing.models.parameters import load_vehicle
from tests.validation.gap_blind import generate
from tests.validation.gap_blind.causes import Drawn

NAMES = ("thrust_scale", "mass", "attitude_gain", "attitude_trim", "mocap_tilt")
OTHER_VEHICLE = {"thrust_scale": 0.85, "attitude_gain_scale": 1.15}
OTHER_DAY = {"mocap_roll": np.radians(1.5)}


@pytest.fixture(scope="module")
def flown():
    """Ten flights each of the reference, of another vehicle, and with motion capture off its level."""

    def fly(world):
        return generate.logs(generate.fly_all(Drawn(world, {}), np.random.default_rng(5), seconds=6.0))

    return {name: fly(world) for name, world in (("", {}), ("v", OTHER_VEHICLE), ("d", OTHER_DAY))}


def found(flown, kinds):
    """What contradicts in ten flights of these kinds."""
    vehicle = load_vehicle()
    flights = [prepare(flown[kind][k], vehicle) for k, kind in enumerate(kinds)]
    problem = Problem.of(flights, vehicle, {name: LIBRARY[name] for name in NAMES})
    names = (*NAMES, BASE)
    fit = fit_least_squares(
        problem, {name: {} for name in names}, iterations=3, tolerance=5.0, prior=slab_deviations
    )
    inflation = variance_inflation(problem, fit.values)
    problem = dataclasses.replace(problem, inflation=inflation)
    return inconsistent_flights(problem, problem.linearise(fit.values, problem.columns(names)))


def test_flights_of_one_vehicle_and_day_do_not_contradict_each_other(flown):
    assert found(flown, [""] * 10) == ()


def test_one_flight_of_another_vehicle(flown):
    (one,) = found(flown, [""] * 7 + ["v"] + [""] * 2)
    assert one.flights == ("flight_07",) and len(one.others) == 9
    differs = {d.effect: d for d in one.differences}
    assert {"attitude_gain"} < set(differs) and {"thrust_scale", "mass"} & set(differs)
    low, high = differs["attitude_gain"].ci95["scale"]
    assert low < 1.15 < high and high - low < 0.1
    text = " ".join(words.inconsistency(one))
    assert text.startswith(
        "flight_07 contradicts the other 9 flights. Compared with the others, in flight_07"
    )
    assert "run landing-eval gap on the logs of each. False-alarm rate: 1 %." in text


@pytest.mark.parametrize("other, effects", [("v", {"thrust_scale", "mass"}), ("d", {"mocap_tilt"})])
def test_two_groups_of_flights(flown, other, effects):
    (one,) = found(flown, [""] * 5 + [other] * 5)
    groups = {one.flights, one.others}
    assert groups == {tuple(f"flight_{k:02d}" for k in g) for g in (range(5), range(5, 10))}
    assert effects & {d.effect for d in one.differences}
    assert words.inconsistency(one)[0].startswith("Two groups of flights contradict each other: flight_0")


def test_another_calibration_has_its_tilt(flown):
    (one,) = found(flown, ["", "", "d"] + [""] * 7)
    assert one.flights == ("flight_02",)
    low, high = one.differences[0].ci95["roll"]
    assert one.differences[0].effect == "mocap_tilt" and low < np.radians(1.5) < high


def test_false_alarms_are_as_rare_as_stated():
    """400 sets of eight flights that scatter as the noise says: 1 % are 4; chance exceeds 10 in 0.3 %."""
    rng = np.random.default_rng(0)
    columns = tuple(ParameterColumn(name, p.name) for name in NAMES for p in LIBRARY[name].parameters)
    unit = np.array([LIBRARY[c.effect].parameter(c.parameter).negligible for c in columns])
    flights = [types.SimpleNamespace(name=str(k)) for k in range(8)]
    known = Candidates(load_vehicle(), LIBRARY)
    problem = types.SimpleNamespace(
        flights=flights, library=LIBRARY, parameter=known.parameter, variation=known.variation
    )
    alarms = 0
    for _ in range(400):
        slopes = rng.standard_normal((8, 40, len(columns))) / (0.2 * unit)
        noise = rng.standard_normal((8, 40))
        a, b = slopes.swapaxes(1, 2) @ slopes, np.einsum("fnp,fn->fp", slopes, noise)
        near = Linearisation({}, columns, a, b, np.zeros(8), np.arange(8))
        alarms += bool(inconsistent_flights(problem, near))
    assert alarms <= 10
