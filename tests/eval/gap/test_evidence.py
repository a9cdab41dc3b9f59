"""What the search for sets of effects rests on: noise model, marginal likelihoods, flips of signs."""

import dataclasses
import json
import types
from pathlib import Path

import numpy as np
import pytest
from msgspec import structs
from scipy import optimize, stats
from scipy.signal import lfilter

from inclined_landing.eval.gap.infer.fit import model_error_weights, variance_inflation
from inclined_landing.eval.gap.infer.gaussian import Bounds, LinearGaussian, clipped, truncated_mode
from inclined_landing.eval.gap.infer.residual import _RidgeRegression, _sign_flips, gain_matrix
from inclined_landing.eval.gap.infer.sets import (
    _relevant_subsets,
    confounded_with,
)
from inclined_landing.eval.gap.measured.noise import estimate
from inclined_landing.eval.gap.measured.windows import prepare, remove_tilt
from inclined_landing.eval.gap.model.columns import (
    BASE,
    BASE_DEVIATIONS,
    FITTING,
    LATE,
    SHAPE_COVARIANCE,
    BaseColumn,
    Candidates,
    FormColumn,
    ParameterColumn,
    fitting,
)
from inclined_landing.eval.gap.model.prediction import predict
from inclined_landing.eval.gap.model.problem import Problem
from inclined_landing.eval.gap.model.reference import (
    Basis,
    ReferenceResidual,
    VehiclePosterior,
    digest,
    free_effects,
    posterior_path,
    read_reference,
)
from inclined_landing.eval.gap.result import ScoredSet
from inclined_landing.eval.logs import FlightLog
from inclined_landing.models.attitude import rotation, tilted
from inclined_landing.models.base import storage
from inclined_landing.models.base.errors import UserError
from inclined_landing.models.effects import LIBRARY, Parameter
from inclined_landing.models.parameters import constants, load_vehicle, write_vehicle

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


def test_disturbance_is_recovered_from_what_it_moved():
    """0.4 m/s2 of 0.25 s along x; none along y and in the angles: a share of the noise at most."""
    rng = np.random.default_rng(0)
    flights = [prepare(still(rng), VEHICLE) for _ in range(8)]
    errors = [f.measured - [0.0, 0.0, 1.0, 0.0, 0.0, 0.0] for f in flights]
    for e in errors:
        e[:, 0] += stirred(rng, len(e), 0.4, 0.25)
    along_x, along_y, *angles = estimate(flights, errors)
    assert along_x.size_ci95[0] <= 0.4 <= along_x.size_ci95[1]
    assert along_x.size == pytest.approx(0.4, rel=0.15)
    assert along_x.time_ci95[0] <= 0.25 <= along_x.time_ci95[1]
    assert along_y.size < 0.05 and along_y.size_ci95[0] < 0.02
    for one in (along_x, along_y, *angles):
        assert one.noise_ratio == pytest.approx(1.0, abs=0.3)


def test_errors_larger_than_the_noise_model_says_count_as_what_they_are():
    """Errors that are twice as large cost as much as before; smaller ones no more than the noise says."""
    rng = np.random.default_rng(3)
    problem = Problem.of([prepare(still(rng), VEHICLE) for _ in range(2)], VEHICLE, {})

    def judged(times):  # as if the noise model's variance were smaller by so much
        known = dataclasses.replace(problem, weight=times * problem.weight)
        return dataclasses.replace(known, inflation=variance_inflation(known, {}))

    costs = [judged(times).squares_by_channel({}) for times in (9.0, 36.0)]
    assert costs[1] == pytest.approx(costs[0])
    assert (costs[0] <= problem.white_count.sum() + 1e-6).all()  # a mean square of 1
    assert judged(0.01).inflation == pytest.approx(judged(0.04).inflation)


NO_PAIRS = np.zeros(0, int), np.zeros((0, 2)), np.zeros((0, 2))
UNBOUNDED = Bounds(np.full(8, -np.inf), np.full(8, np.inf), *NO_PAIRS)


@pytest.fixture(scope="module")
def local():
    """Eight flights' Gram matrices of four effects with two parameters each, without bounds, with the
    slopes (8, 30, 8) and errors (8, 30) that they are of; the vehicle is off, its errors correlated."""
    rng = np.random.default_rng(1)
    slopes = rng.standard_normal((8, 30, 8))
    errors = slopes @ np.array([3.0, 0, 0, 0, 1.0, 0, 0, 0]) + rng.standard_normal((8, 30))
    columns = tuple(ParameterColumn(name, p) for name in "abcd" for p in ("one", "two"))
    root = 0.3 * rng.standard_normal((8, 8))
    one = LinearGaussian(
        candidates=types.SimpleNamespace(library=dict.fromkeys("abcd")),
        columns=columns,
        values={},
        at=rng.standard_normal(8),
        a=np.einsum("gnp,gnq->gpq", slopes, slopes),
        b=np.einsum("gnp,gn->gp", slopes, errors),
        c=(errors**2).sum(axis=1),
        unit=np.ones(8),
        slab=10.0 * np.eye(8),
        bounds=UNBOUNDED,
        theta_mean=0.3 * rng.standard_normal(8),
        theta_covariance=root @ root.T,
        between=np.ones(8),
        flight_a=np.zeros((8, 8, 8)),
        flight_b=np.zeros((8, 8)),
    )
    return one, slopes, errors


@pytest.mark.parametrize("names", ["", "a", "c", "ab", "acd", "abcd"])
def test_marginal_likelihood_is_that_of_the_normal_law(local, names):
    """The log density of the errors under noise, what is known and the prior, up to a constant."""
    one, slopes, errors = local
    names = frozenset(names)
    wide = np.array([c.effect in names for c in one.columns])
    prior = one.theta_covariance + np.where(np.outer(wide, wide), one.slab, np.diag(~wide))
    slopes = slopes.reshape(-1, 8)
    far = errors.ravel() - slopes @ (one.theta_mean - one.at)
    covariance = np.eye(len(far)) + slopes @ prior @ slopes.T
    density = -0.5 * (far @ np.linalg.solve(covariance, far) + np.linalg.slogdet(covariance)[1])
    assert one.evidence()(names) == pytest.approx(density, rel=1e-6)


@pytest.mark.parametrize("alike", [0.0, 1.0])
def test_sizes_are_freed_where_the_flights_show_them(local, alike):
    """Two large effects: freed from the slab alone, not where each could be the other's opposite."""
    one, slopes, _ = local
    slopes = slopes.copy()
    slopes[..., 2] = (1.0 - alike) * slopes[..., 2] - alike * slopes[..., 0]
    errors = slopes @ np.array([20.0, 0, -20.0, 0, 0, 0, 0, 0])
    case = dataclasses.replace(
        one,
        a=np.einsum("gnp,gnq->gpq", slopes, slopes),
        b=np.einsum("gnp,gn->gp", slopes, errors),
        theta_covariance=1e-6 * np.eye(8),
        theta_mean=np.zeros(8),
        at=np.zeros(8),
    )
    widened = case.for_sizes_of(frozenset("ab")).slab.diagonal() > one.slab.diagonal()
    assert widened[[0, 2]].tolist() == [not alike] * 2 and not widened[[1, 3, 4, 5, 6, 7]].any()


def test_flights_that_were_not_drawn_do_not_count(local):
    one, *_ = local
    weights = np.array([2.0, 0.0, 1.0, 1.0, 0.0, 1.0, 3.0, 0.0])
    drawn = np.repeat(np.arange(8), weights.astype(int))
    same = dataclasses.replace(one, a=one.a[drawn], b=one.b[drawn], c=one.c[drawn])
    for names in map(frozenset, ("", "ac")):
        assert one.evidence(weights)(names) == pytest.approx(same.evidence()(names), rel=1e-9)


def test_what_is_new_in_the_flights_is_told_from_what_was_uncertain(local):
    """delta given the errors, from the joint normal law of theta, delta and the errors."""
    one, slopes, errors = local
    names = frozenset("ab")
    slopes, fresh = slopes.reshape(-1, 8), one.change_covariance(names)
    covariance = np.eye(len(slopes)) + slopes @ (fresh + one.theta_covariance) @ slopes.T
    gain = np.linalg.solve(covariance, slopes @ fresh).T
    at, spread = one.change(names)
    np.testing.assert_allclose(at, gain @ (errors.ravel() - slopes @ (one.theta_mean - one.at)), atol=1e-8)
    np.testing.assert_allclose(spread, fresh - gain @ slopes @ fresh, atol=1e-8)


@pytest.mark.parametrize("seed", range(5))
def test_within_bounds_is_the_likeliest_possible_point(seed):
    """Against a bounded minimisation of the normal law's exponent; one coordinate lies outside."""
    rng = np.random.default_rng(seed)
    root, at = rng.standard_normal((4, 4)), rng.standard_normal(4)
    covariance = root @ root.T + 0.1 * np.eye(4)
    high = np.array([at[0] - 0.5, np.inf, np.inf, np.inf])
    bounds = Bounds(np.full(4, -np.inf), high, *NO_PAIRS)
    found, unlikely = truncated_mode(at, covariance, np.arange(4), bounds)
    inverse = np.linalg.inv(covariance)

    def exponent(x):
        return 0.5 * (x - at) @ inverse @ (x - at)

    best = optimize.minimize(exponent, np.zeros(4), bounds=[(None, h) for h in high], tol=1e-12)
    np.testing.assert_allclose(found, best.x, atol=1e-4)
    assert unlikely == pytest.approx(-best.fun, rel=1e-4)


def test_bounds_of_an_effect_about_a_reference():
    """Sizes about both sides, of opposite signs: the reference lies no further than is possible."""
    pair = np.array([1]), np.array([[-2.0, 2.0]]), np.array([[-0.25, 1.25]])
    bounds = Bounds(np.full(2, -np.inf), np.full(2, np.inf), *pair)
    np.testing.assert_allclose(clipped(np.array([4.0, -3.0]), bounds), [1.25, -0.25])
    np.testing.assert_allclose(clipped(np.array([3.0, 3.0]), bounds), [1.0, 1.0])
    np.testing.assert_allclose(clipped(np.array([0.4, 0.6]), bounds), [0.4, 0.6])


def test_a_shape_is_no_more_probable_than_its_normal_prior_says(local):
    """Sizes of opposite signs about both sides of a reference are a scale."""
    one, *_ = local
    ends = (("reference", 1.0),), (("reference", 2.0),)
    columns = tuple(structs.replace(c, parameter="one", fixed=ends[k % 2]) for k, c in enumerate(one.columns))
    slab = np.kron(np.eye(4), 10.0 * SHAPE_COVARIANCE)
    evidence = dataclasses.replace(one, columns=columns, slab=slab).evidence()
    assert [name for name, _ in evidence.ends] == list("abcd")
    assert evidence._shape_log_prior("a", 4.0, -3.5) < evidence._shape_log_prior("a", 0.2, 0.3) <= 0.0


def test_flips_of_signs_raise_few_false_alarms():
    """Of 300 sets of pure noise, judged by the best of three functions, 5 % are alarms: 7 to 25 in 95 %."""
    rng = np.random.default_rng(3)
    blocks, rows, width, ridge = 12, 20, 5, 1.0
    flight_of = np.arange(blocks) // 2
    signs, alarms = _sign_flips(blocks), 0
    for _ in range(300):
        errors = rng.standard_normal((blocks, rows))
        scores = []
        for _ in range(3):
            slopes = rng.standard_normal((blocks, rows, width))
            b = np.einsum("kni,kn->ki", slopes, errors)
            grams = np.einsum("kni,knj->kij", slopes, slopes)
            a = np.stack([grams[flight_of == f].sum(axis=0) for f in range(6)])
            form = gain_matrix(a, b, flight_of, ridge)
            scores.append(_RidgeRegression("x", "noise", a, b, flight_of, ridge, form).scores(signs))
        most = np.max(scores, axis=0)
        alarms += most[0] > np.quantile(most[1:], 0.95)
    assert 7 <= alarms <= 25


def test_a_function_is_fitted_to_the_flights_or_to_all_but_one():
    """Its weights are ridge regressions; what it takes off a flight left out adds up to its gain."""
    rng = np.random.default_rng(4)
    slopes, errors = rng.standard_normal((6, 25, 3)), rng.standard_normal((6, 25))
    fold_of = np.array([0, 0, 1, 1, 2, 2])
    grams, b = np.einsum("kni,knj->kij", slopes, slopes), np.einsum("kni,kn->ki", slopes, errors)
    a = np.stack([grams[fold_of == g].sum(axis=0) for g in range(3)])
    function = _RidgeRegression("x", "noise", a, b, fold_of, 1.0, gain_matrix(a, b, fold_of, 1.0))
    for without in (None, 1):
        use = fold_of != (-1 if without is None else without)
        x, y = slopes[use].reshape(-1, 3), errors[use].ravel()
        wanted = np.linalg.solve(x.T @ x + np.eye(3), x.T @ y)
        np.testing.assert_allclose(function.weights(without), wanted, rtol=1e-9)
    assert function.cross_validated_gain()[0].sum() == pytest.approx(function.gain, rel=1e-9)


def test_bumps_and_random_features_follow_a_bent_function():
    """Within 5 % of its size where it was seen; beyond, no feature grows."""
    rng = np.random.default_rng(8)
    seen = rng.uniform([-2.0, 5.0], [2.0, 9.0], (2000, 2))
    value = np.abs(seen[:, 0]) + np.sin(seen[:, 1])
    basis = Basis.of(seen, "velocity")
    features = basis(seen)
    fit = np.linalg.lstsq(features, value, rcond=1e-9)[0]
    assert np.std(features @ fit - value) < 0.05 * np.std(value)
    assert np.abs(basis(seen + [100.0, 0.0])).max() <= np.abs(features).max() + 1.0
    assert Basis.of(seen[:, :1] * 5.0, "flight time")(seen[:, :1]).shape == (2000, 40)  # 20 s, every 0.5


def test_what_is_said_of_fits_is_of_effects_and_parameters_of_the_library():
    for name, own in FITTING.items():
        starts = {parameter for start in own.starts for parameter in start}
        assert starts | set(own.parameters) <= {p.name for p in LIBRARY[name].parameters}, name
        assert set(own.same_as) <= set(LIBRARY)


def test_attitudes_are_levelled_and_tilted_back():
    rng = np.random.default_rng(5)
    attitude = rng.uniform([-0.5, -0.5, -3.0], [0.5, 0.5, 3.0], (50, 3))
    measured = np.empty_like(attitude)
    tilted(attitude, 0.05, -0.03, measured)
    assert remove_tilt(measured, (0.05, -0.03)) == pytest.approx(attitude, abs=1e-12)


def test_what_takes_the_place_of_an_effect_stands_in_sets_without_it():
    """b for a, in the sets that hold 95 %; neither what comes in addition nor what is too rare."""
    shares = {("a", "c"): 0.6, ("b", "c"): 0.25, ("c",): 0.05, ("a", "c", "d"): 0.06, ("e", "c"): 0.03}
    sets = tuple(ScoredSet(names, p) for names, p in shares.items())
    assert confounded_with(sets, sets[0].names, "a") == ("b",)
    assert confounded_with(sets, sets[0].names, "c") == ()


def test_the_form_of_the_model_errs_by_a_share_of_the_motion():
    """Errors of 5 % of the motion beside noise: windows that move count less, those that rest do not."""
    rng = np.random.default_rng(6)
    flights = [prepare(still(rng), VEHICLE) for _ in range(6)]
    t = flights[0].t
    moved = [np.outer(np.sin(2 * np.pi * (0.5 + 0.1 * k) * t), np.full(6, 0.3 * (k > 2))) for k in range(6)]
    wrong = [f.measured - [0, 0, 1, 0, 0, 0] + 0.05 * m for f, m in zip(flights, moved)]
    count = sum(len(f.starts) for f in flights)
    white = np.concatenate([np.full(len(f.starts), f.rows - 2) for f in flights])
    problem = types.SimpleNamespace(
        flights=flights, white_count=white, logged=np.ones((count, 6)), requested=False
    )
    weight = model_error_weights(problem, moved, wrong)
    rests = np.arange(count) < count // 2
    white = [f.whitening(f.cut(e)) for f, e in zip(flights, wrong)]
    left = np.concatenate([(x**2).mean(axis=2) for x in white])
    assert left[~rests].mean() > 1.5 * left[rests].mean()
    np.testing.assert_allclose(weight[rests], 1.0)
    # The mean square of some 100 windows of 58 numbers: within 10 % beside what a grid of shares allows.
    weighed = (left * weight)[~rests].mean(axis=0)
    np.testing.assert_allclose(weighed, left[rests].mean(axis=0), rtol=0.3)


def test_an_effect_too_small_to_matter_is_part_of_the_set_without_it(local):
    """Two standard deviations of one size are beyond what nobody needs to correct; another lies within."""
    one, *_ = local
    at, spread = one.change(frozenset("ab"))
    edge = abs(at[0]) - 2.0 * np.sqrt(spread[0, 0])
    assert edge > 0.0

    def parameter(column):
        negligible = edge if (column.effect, column.parameter) == ("a", "one") else 100.0
        return Parameter(column.parameter, bounds=(-900.0, 900.0), plausible=5.0, negligible=negligible)

    parts = _relevant_subsets(types.SimpleNamespace(parameter=parameter), one, frozenset("ab"))
    assert sum(parts.values()) == pytest.approx(1.0)
    assert parts[frozenset("a")] == pytest.approx(stats.norm.cdf(2.0), abs=1e-6)
    assert sum(share for names, share in parts.items() if "b" in names) < 1e-6


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
        step = FITTING[name].parameters["delay"].step
        slopes[name] = (predict(flight, LIBRARY[name].apply(vehicle, {"delay": step})) - start) / step
    together = slopes["thrust_delay"] + slopes["attitude_delay"]
    assert np.abs(together).max() > 0.1
    # Drag couples both only through the measured attitude: the sum is exact but for rounding over the step.
    np.testing.assert_allclose(slopes["mocap_delay"], together, atol=1e-3 * np.abs(together).max())


def rolling(rng, m=300):
    """What `form` reads of a flight at 100 rows a second: at 1 m/s, attitudes and commands at random."""
    attitude = rng.uniform(-0.4, 0.4, (m - 1, 3))
    command = np.column_stack([VEHICLE.hover_pwm * rng.uniform(0.8, 1.2, m), rng.uniform(-0.3, 0.3, (m, 3))])
    return types.SimpleNamespace(
        dt=DT,
        t=np.arange(m) * DT,
        velocity=np.tile([0.6, -0.8, 0.5], (m, 1)),
        command=command,
        usable=np.ones(m, bool),
        middle_rotation=np.stack([rotation(*angles) for angles in attitude]),
    )


def test_a_contribution_that_comes_later_is_a_shift_to_first_order():
    """The next term is half of LAG squared times the second derivative."""
    flight, frequency = rolling(np.random.default_rng(9)), 2.0
    t = flight.t[:, None] - np.array([0.0, 0.3, 0.7, 1.1, 1.5, 2.1])

    def contribution(late):
        return 0.2 * np.sin(frequency * (t - late))

    for group, own in (("translation", slice(0, 3)), ("attitude", slice(3, 5)), ("yaw", slice(5, 6))):
        column = FormColumn("", f"{group} late").along(contribution(0.0), flight)
        others = np.delete(column, np.arange(6)[own], axis=1)
        shifted = contribution(LATE) - contribution(0.0)
        assert not others.any()
        np.testing.assert_allclose(
            column[5:-5, own], shifted[5:-5, own], atol=0.6 * 0.2 * (frequency * LATE) ** 2
        )
        np.testing.assert_allclose(column[:, own], shifted[:, own], atol=0.1 * np.abs(shifted).max())


def test_errors_of_a_contribution_are_of_its_own_size():
    """Its acceleration times a quantity: at 1 m/s sideways and 0.5 m/s up speed and climb are one."""
    rng = np.random.default_rng(10)
    flight = rolling(rng)
    contribution = np.cumsum(np.cumsum(rng.standard_normal((300, 6)), axis=0), axis=0) * DT**2
    for name in ("translation speed", "translation climb"):
        column = FormColumn("", name).along(contribution, flight)
        second = [np.diff(x[:, :3], 2, axis=0) for x in (column, contribution)]
        np.testing.assert_allclose(*second, atol=1e-12)
        assert not column[:, 3:].any()
    for effect in LIBRARY:
        for name in fitting(effect).forms:
            column = FormColumn("", name).along(contribution, flight)
            assert column.any() and np.isfinite(column).all()


def test_thrust_and_drag_are_the_acceleration_without_gravity():
    """Thrust lies along the body's z axis and drag across it; along x is what drag has there."""
    rng = np.random.default_rng(11)
    flight, gravity = rolling(rng), 9.81
    predicted = np.cumsum(np.cumsum(rng.standard_normal((300, 6)), axis=0), axis=0) * DT**2
    second = np.diff(predicted[:, :3], 2, axis=0) + [0.0, 0.0, gravity * DT**2]

    def part(name):
        column = BaseColumn(name).along(predicted, gravity, flight)
        assert not column[:, 3:].any()
        return np.diff(column[:, :3], 2, axis=0)

    thrust, drag, along = part("thrust speed"), part("drag speed"), part("drag x")
    axes = flight.middle_rotation[1:]
    np.testing.assert_allclose(thrust + drag, second, atol=1e-12)
    np.testing.assert_allclose(np.cross(thrust, axes[:, :, 2]), 0.0, atol=1e-12)
    np.testing.assert_allclose(np.einsum("ki,ki->k", drag, axes[:, :, 2]), 0.0, atol=1e-12)
    np.testing.assert_allclose(
        along, np.einsum("ki,ki->k", drag, axes[:, :, 0])[:, None] * axes[:, :, 0], atol=1e-12
    )
    for name in BASE_DEVIATIONS:
        assert np.isfinite(BaseColumn(name).along(predicted, gravity, flight)).all()


@pytest.fixture(scope="module")
def reference():
    """Of a few columns of every kind, with a function that repeats."""
    rng = np.random.default_rng(12)
    columns = (
        ParameterColumn("wind", "x"),
        ParameterColumn("battery_sag", "sag", (("reference", 26100.0),)),
        FormColumn("wind", "translation late"),
        BaseColumn("drag x"),
    )
    root = rng.standard_normal((4, 4))
    basis = Basis.of(rng.standard_normal((50, 2)), "velocity")
    width = basis(np.zeros((1, 2))).shape[1]
    repeating = ReferenceResidual({"velocity": basis}, {"velocity": {"z": rng.standard_normal(width)}})
    return VehiclePosterior(
        columns, rng.standard_normal(4), root @ root.T, repeating, frozenset(free_effects())
    )


def test_a_posterior_is_read_as_it_was_written(reference, tmp_path):
    text = storage.to_json(reference.to_json(VEHICLE))
    again = VehiclePosterior.from_json(json.loads(text))
    assert again.columns == reference.columns
    np.testing.assert_array_equal(again.mean, reference.mean)
    np.testing.assert_array_equal(again.covariance, reference.covariance)
    inputs = np.random.default_rng(13).standard_normal((9, 2))
    one, other = (r.repeating for r in (reference, again))
    np.testing.assert_array_equal(one.bases["velocity"](inputs), other.bases["velocity"](inputs))
    assert set(one.weights) == set(other.weights)
    np.testing.assert_array_equal(one.weights["velocity"]["z"], other.weights["velocity"]["z"])
    # Beside its vehicle's file it is found, beside another's not, and damaged it is refused.
    file = tmp_path / "mine.toml"
    write_vehicle(file, VEHICLE)
    posterior_path(file).write_text(text)
    found, said = read_reference(file, VEHICLE)
    assert not said and found.columns == reference.columns
    other, said = read_reference(file, VEHICLE.changed(body_mass=0.05))
    assert "a different vehicle" in said and not other.mean.any()
    posterior_path(file).write_text(text.replace('"mean"', '"means"'))
    with pytest.raises(UserError, match="posterior"):
        read_reference(file, VEHICLE)


def test_a_posterior_stays_with_its_vehicle_where_an_effect_is_neutral(reference):
    """So a shipped one outlives a new effect of the library."""
    hash_of = reference.to_json(VEHICLE)["vehicle"]
    assert reference.to_json(VEHICLE.changed(disturbance_acceleration=(0.1, 0.1, 0.1)))["vehicle"] == hash_of
    for field, value in (("effects_wind", (0.1, 0.0)), ("attitude_gain", 0.9), ("body_mass", 0.04)):
        assert reference.to_json(VEHICLE.changed(**{field: value}))["vehicle"] != hash_of
    older = {name: value for name, value in vars(VEHICLE).items() if name != "effects_wind"}
    assert digest(types.SimpleNamespace(**older)) == hash_of  # from before the library had wind


@pytest.mark.parametrize(
    "name", ["crazyflie-2.1-lee", "crazyflie-2.1-upgraded-lee", "crazyflie-2.1-brushless-flown"]
)
def test_a_shipped_vehicle_that_was_identified_has_its_posterior(name):
    found, said = read_reference(Path(name), load_vehicle(name))
    assert found.from_flights and not said
    assert found.covariance.any() and found.repeating.bases


def test_a_reference_knows_its_own_columns_only(reference):
    mean, covariance = reference.along(
        [ParameterColumn("mass", "scale"), reference.columns[1], reference.columns[0]]
    )
    assert mean.tolist() == [0.0, reference.mean[1], reference.mean[0]]
    assert not covariance[0].any() and covariance[1, 2] == reference.covariance[1, 0]


def test_an_effect_that_the_library_got_later_has_its_prior(reference):
    columns = [
        ParameterColumn("axial_inflow", "coefficient"),
        reference.columns[0],
        ParameterColumn("mass", "scale"),
    ]
    earlier = dataclasses.replace(reference, library=reference.library - {"axial_inflow"})
    mean, covariance = earlier.with_new_effects(VEHICLE).along(columns)
    assert mean.tolist() == [0.0, reference.mean[0], 0.0]
    plausible = LIBRARY["axial_inflow"].plausible["coefficient"]
    assert covariance.diagonal().tolist() == [plausible**2, reference.covariance[0, 0], 0.0]
    assert reference.with_new_effects(VEHICLE) is reference


def test_a_vehicle_file_alone_is_as_uncertain_as_its_entries_say():
    one = VehiclePosterior.of_file(None, VEHICLE)
    assert not one.mean.any()
    deviation = {c.key: s for c, s in zip(one.columns, np.sqrt(np.diag(one.covariance)))}
    (mass,) = (c for c in constants() if c.field == "body_mass")
    # Slopes are taken over a step of 0.5 %, of a logarithm: half of that in the mean.
    assert deviation["mass", "scale"] == pytest.approx(mass.uncertainty / 1.96 / mass.value, rel=3e-3)
    assert 0.0 < deviation[BASE, "drag x"] <= BASE_DEVIATIONS["drag x"]


@pytest.mark.parametrize("bias", [0.0, 0.08, -0.05])
def test_a_thrust_loss_costs_its_share_of_the_scaled_thrust_in_hover(bias):
    """On an identified vehicle other effects move the command at which it hovers; a bias is not scaled."""
    vehicle = load_vehicle().changed(effects_thrust_bias=bias)
    candidates = Candidates.for_vehicle(vehicle, LIBRARY)
    level = candidates.hover_acceleration({})
    lost = level - candidates.hover_acceleration({"thrust_scale": {"scale": 0.85}})
    assert level[2] == pytest.approx(0.0, abs=1e-6)
    # F = c u + bias = m g in hover, so that 15 % of c u are 0.15 (m g - bias)
    assert lost[2] == pytest.approx(0.15 * (vehicle.environment_gravity - bias / vehicle.body_mass), rel=1e-6)
