"""What the search for sets of effects rests on: unrest, marginal likelihoods, flips of signs."""

import dataclasses
import types

import numpy as np
import pytest
from scipy import stats
from scipy.signal import lfilter

from inclined_landing.eval.gap.answer.named import in_its_place, parts_only
from inclined_landing.eval.gap.flights import unrest
from inclined_landing.eval.gap.flights.windows import level, prepare
from inclined_landing.eval.gap.search.evidence import Column
from inclined_landing.eval.gap.search.posterior import Local, Screen
from inclined_landing.eval.gap.search.prediction import predict
from inclined_landing.eval.gap.search.remainder import _Function, _signs, form_of
from inclined_landing.eval.gap.search.sets import Scored, _worth_correcting, weigh
from inclined_landing.eval.logs import FlightLog
from inclined_landing.models.attitude import tilted
from inclined_landing.models.effects import LIBRARY, Parameter
from inclined_landing.models.parameters import load_vehicle

VEHICLE = load_vehicle()
DT = 0.01


def still(rng, seconds=20.0):
    """A hover measured with 1 mm and 5 mrad of noise."""
    m = round(seconds / DT)
    pose = np.array([0.0, 0.0, 1.0, 0.0, 0.0, 0.0]) + rng.standard_normal((m, 6)) * ([1e-3] * 3 + [5e-3] * 3)
    command = np.tile([VEHICLE.hover_pwm, 0.0, 0.0, 0.0], (m, 1))
    return FlightLog("still", np.arange(m) * DT, pose[:, :3], pose[:, 3:], command)


def stirred(rng, m, size, time):
    """Positions (m,) [m] of what an Ornstein-Uhlenbeck acceleration moves from rest."""
    keep = np.exp(-DT / time)
    start = [keep * size * rng.standard_normal()]
    drive = size * np.sqrt(1.0 - keep**2) * rng.standard_normal(m)
    acceleration = lfilter([1.0], [1.0, -keep], drive, zi=start)[0]
    return np.cumsum(np.cumsum(acceleration)) * DT**2


def test_unrest_is_recovered_from_what_it_moved():
    """0.4 m/s2 of 0.25 s along x; none along y and in the angles: a share of the noise at most."""
    rng = np.random.default_rng(0)
    flights = [prepare(still(rng), VEHICLE) for _ in range(8)]
    errors = [f.measured - [0.0, 0.0, 1.0, 0.0, 0.0, 0.0] for f in flights]
    for e in errors:
        e[:, 0] += stirred(rng, len(e), 0.4, 0.25)
    found = unrest.estimate(flights, errors)
    assert found.size_ci95[0, 0] <= 0.4 <= found.size_ci95[1, 0]
    assert found.size[0] == pytest.approx(0.4, rel=0.15)
    assert found.time_ci95[0, 0] <= 0.25 <= found.time_ci95[1, 0]
    assert found.size[1] < 0.05 and found.size_ci95[0, 1] < 0.02
    assert found.noise == pytest.approx(1.0, abs=0.3)


@pytest.fixture(scope="module")
def local():
    """Eight flights' Gram matrices of four effects with two parameters each, one of them at a bound."""
    rng = np.random.default_rng(1)
    slopes = rng.standard_normal((8, 30, 8))
    errors = slopes @ np.array([3.0, 0, 0, 0, 1.0, 0, 0, 0]) + rng.standard_normal((8, 30))
    columns = tuple(Column(name, p) for name in "abcd" for p in ("one", "two"))
    held = np.arange(8) == 5
    return Local(
        problem=types.SimpleNamespace(library=dict.fromkeys("abcd")),
        columns=columns,
        at=rng.standard_normal(8),
        a=np.einsum("gnp,gnq->gpq", slopes, slopes),
        b=np.einsum("gnp,gn->gp", slopes, errors),
        c=(errors**2).sum(axis=1),
        unit=np.ones(8),
        slab=np.full(8, 10.0),
        held=held,
        between=np.ones(8),
        stays=np.zeros(8, bool),
        own_a=np.zeros((8, 8, 8)),
        own_b=np.zeros((8, 8)),
    )


@pytest.mark.parametrize("names", ["", "a", "c", "ab", "acd", "abcd"])
def test_screening_is_the_marginal_likelihood(local, names):
    names = frozenset(names)
    exact = local.log_evidence(names, np.ones((1, 8)))[0]
    assert Screen(local)(names) == pytest.approx(exact, rel=1e-9)


def test_marginal_likelihood_is_that_of_the_normal_law(local):
    """The log density of the errors under noise and prior together, up to a constant."""
    rng = np.random.default_rng(2)
    slopes, errors = rng.standard_normal((30, 8)), rng.standard_normal(30)
    free = np.zeros(8, bool)
    one = Local(**{**vars(local), "at": np.zeros(8), "held": free, "a": (slopes.T @ slopes)[None]})
    one.b, one.c = (slopes.T @ errors)[None], np.array([errors @ errors])

    def density(names):
        prior = np.diag(1.0 / one.precision(names))
        covariance = np.eye(30) + slopes @ prior @ slopes.T
        return -0.5 * (errors @ np.linalg.solve(covariance, errors) + np.linalg.slogdet(covariance)[1])

    for names in map(frozenset, ("", "a", "bd")):
        assert one.log_evidence(names, np.ones((1, 1)))[0] == pytest.approx(density(names), rel=1e-9)


def test_flips_of_signs_raise_few_false_alarms():
    """Of 300 sets of pure noise, judged by the best of three functions, 5 % are alarms: 7 to 25 in 95 %."""
    rng = np.random.default_rng(3)
    blocks, rows, width, ridge = 12, 20, 5, 1.0
    flight_of = np.arange(blocks) // 2
    signs, alarms = _signs(blocks, 0), 0
    for _ in range(300):
        errors = rng.standard_normal((blocks, rows))
        scores = []
        for _ in range(3):
            slopes = rng.standard_normal((blocks, rows, width))
            b = np.einsum("kni,kn->ki", slopes, errors)
            grams = np.einsum("kni,knj->kij", slopes, slopes)
            a = np.stack([grams[flight_of == f].sum(axis=0) for f in range(6)])
            form = form_of(a, b, flight_of, ridge)
            scores.append(_Function("x", "noise", a, b, ridge, form).scores(signs))
        most = np.max(scores, axis=0)
        alarms += most[0] > np.quantile(most[1:], 0.95)
    assert 7 <= alarms <= 25


def test_gain_of_a_function_is_what_fits_to_the_other_flights_take_away():
    rng = np.random.default_rng(4)
    slopes, true = rng.standard_normal((4, 25, 3)), np.array([0.5, -1.0, 0.3])
    errors = slopes @ true + rng.standard_normal((4, 25))
    a, b = np.einsum("gni,gnj->gij", slopes, slopes), np.einsum("gni,gn->gi", slopes, errors)
    closed = 0.0
    for k in range(4):
        others = np.arange(4) != k
        fit = np.linalg.solve(a[others].sum(axis=0) + np.eye(3), b[others].sum(axis=0))
        closed += (errors[k] ** 2).sum() - ((errors[k] - slopes[k] @ fit) ** 2).sum()
    form = form_of(a, b, np.arange(4), 1.0)
    assert form.sum() == pytest.approx(closed, rel=1e-9)


def test_attitudes_are_levelled_and_tilted_back():
    rng = np.random.default_rng(5)
    attitude = rng.uniform([-0.5, -0.5, -3.0], [0.5, 0.5, 3.0], (50, 3))
    measured = np.empty_like(attitude)
    tilted(attitude, 0.05, -0.03, measured)
    assert level(measured, (0.05, -0.03)) == pytest.approx(attitude, abs=1e-12)


def test_what_takes_the_place_of_an_effect_stands_in_sets_without_it():
    """b for a, in the sets that hold 95 %; neither what comes in addition nor what is too rare."""
    shares = {("a", "c"): 0.6, ("b", "c"): 0.25, ("c",): 0.05, ("a", "c", "d"): 0.06, ("e", "c"): 0.03}
    sets = tuple(Scored(frozenset(names), p, {}) for names, p in shares.items())
    found = types.SimpleNamespace(sets=sets, names=sets[0].names)
    assert in_its_place(found, "a") == ("b",)
    assert in_its_place(found, "c") == ()


@pytest.mark.parametrize("closes, named", [(5.0, False), (50.0, True)])
def test_a_name_closes_more_than_what_repeats_there(closes, named):
    """40 of the 100 that are left in z repeat; an effect in z must close more, one in x has no part in it."""

    def white(vehicles):
        z, x = 100.0 + (0.0 if "a" in vehicles[0] else closes), 10.0 + (0.0 if "b" in vehicles[0] else 1.0)
        return [np.sqrt(np.array([x, 0.0, z, 0.0, 0.0, 0.0]))[None, :, None]]

    problem = types.SimpleNamespace(flights=[None], weight=np.ones((1, 6)), corrected=set, white=white)
    found = types.SimpleNamespace(values={"a": {}, "b": {}}, inflation=np.ones(6))
    left = types.SimpleNamespace(depends_on=[types.SimpleNamespace(channel="z", share=0.4)])
    assert parts_only(problem, found, left) == ([] if named else ["a"])


def test_the_form_of_the_model_errs_by_a_share_of_the_motion():
    """Errors of 5 % of the motion beside noise: windows that move count less, those that rest do not."""
    rng = np.random.default_rng(6)
    flights = [prepare(still(rng), VEHICLE) for _ in range(6)]
    t = flights[0].t
    moved = [np.outer(np.sin(2 * np.pi * (0.5 + 0.1 * k) * t), np.full(6, 0.3 * (k > 2))) for k in range(6)]
    wrong = [f.measured - [0, 0, 1, 0, 0, 0] + 0.05 * m for f, m in zip(flights, moved)]
    count = sum(len(f.starts) for f in flights)
    rows = np.concatenate([np.full(len(f.starts), f.rows - 2) for f in flights])
    problem = types.SimpleNamespace(flights=flights, rows=rows, logged=np.ones((count, 6)), weight=None)
    weigh(problem, moved, wrong)
    rests = np.arange(count) < count // 2
    white = [f.whitening(f.cut(e)) for f, e in zip(flights, wrong)]
    left = np.concatenate([(x**2).mean(axis=2) for x in white])
    assert left[~rests].mean() > 1.5 * left[rests].mean()
    np.testing.assert_allclose(problem.weight[rests], 1.0)
    # The mean square of some 100 windows of 58 numbers: within 10 % beside what a grid of shares allows.
    weighed = (left * problem.weight)[~rests].mean(axis=0)
    np.testing.assert_allclose(weighed, left[rests].mean(axis=0), rtol=0.3)


def test_an_effect_too_small_to_matter_is_part_of_the_set_without_it(local):
    def parameter(column):
        return Parameter(column.parameter, "1", 0.0, (-9.0, 9.0), 5.0, 1.0)

    problem = types.SimpleNamespace(parameter=parameter)
    sd = np.sqrt(np.diag(local.fit(frozenset("ab"))[1]))
    values = {"a": {"one": 1.0 + 2.0 * sd[0], "two": 0.0}, "b": {"one": 0.0, "two": 0.0}}
    parts = _worth_correcting(problem, local, frozenset("ab"), values)
    assert sum(parts.values()) == pytest.approx(1.0)
    beyond = sum(share for names, share in parts.items() if "a" in names)
    assert beyond == pytest.approx(stats.norm.cdf(2.0), abs=0.02)
    assert sum(share for names, share in parts.items() if "b" in names) < 0.2


@pytest.mark.parametrize("delay", [0.0, 0.0095])
def test_slopes_of_delays_are_sums_of_each_other(delay):
    """Late poses are early commands, also where the slopes bend at a whole row of the log."""
    rng = np.random.default_rng(7)
    log = still(rng, 4.0)
    command = log.command + np.repeat(rng.uniform(-0.2, 0.2, (len(log.t) // 2, 4)), 2, axis=0) * [
        2e4,
        1,
        1,
        0,
    ]
    flight = prepare(dataclasses.replace(log, command=command), VEHICLE)
    vehicle = VEHICLE.changed(effects_thrust_delay=delay, effects_attitude_delay=delay)
    start, slopes = predict(flight, vehicle), {}
    for name in ("thrust_delay", "attitude_delay", "mocap_delay"):
        (p,) = LIBRARY[name].beside(vehicle).parameters
        slopes[name] = (predict(flight, LIBRARY[name].apply(vehicle, {p.name: p.step})) - start) / p.step
    together = slopes["thrust_delay"] + slopes["attitude_delay"]
    assert np.abs(together).max() > 0.1
    # Drag couples both only through the measured attitude: the sum is exact but for rounding over the step.
    np.testing.assert_allclose(slopes["mocap_delay"], together, atol=1e-3 * np.abs(together).max())
