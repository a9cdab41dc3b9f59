"""Landing studies: what becomes of constructed landings, study files, designs, the numbers made of them."""

import dataclasses
import json
import math

import numpy as np
import pytest

from inclined_landing.eval.landings import landing, maps, report, sensitivity
from inclined_landing.eval.landings.landing import OUTCOMES, RESULTS, simulate
from inclined_landing.eval.landings.parameters import known_parameters, touchdown_states
from inclined_landing.eval.landings.run import design
from inclined_landing.eval.landings.study import read_study, shipped
from inclined_landing.models.attitude import PITCH, X, Z
from inclined_landing.models.parameters import load_vehicle

V = load_vehicle()
STUDY = """
sampling = "latin-hypercube"
samples = 40
seed = 3
[parameters]
inclination = { from = 10, to = 50, unit = "deg" }
friction = { from = 0.2, to = 1.4, unit = "1" }
attitude_error = { mean = 0, deviation = 10, from = -20, to = 40, unit = "deg", distribution = "normal" }
mass = { values = [30, 40], unit = "g" }
"""


def columns(n, **given):
    """Every parameter (n,) [SI]: the given ones, the others at their defaults."""
    p = {name: np.full(n, entry.default) for name, entry in known_parameters().items()}
    for name, value in given.items():
        p[name] = np.broadcast_to(np.asarray(value, float), n).copy()
    return p


def land(n=1, **given):
    p = columns(n, **given)
    result = simulate(touchdown_states(p, V), p)
    return [OUTCOMES[k] for k in result.outcome], dict(zip(RESULTS, result.values.T))


def written(tmp_path, text, name="study.toml"):
    path = tmp_path / name
    path.write_text(text, "utf-8")
    return path


# ---- single landings


def test_constructed_landings_get_their_names():
    """One batch: each row of it is a case whose end is known beforehand."""
    cases = [
        ("rests", dict(friction=1.2)),
        ("rests", dict(friction=0.8, inclination=0.0, normal_speed=0.0, thrust=0.0)),
        ("slides off", dict(friction=0.2, inclination=math.radians(25), normal_speed=0.1)),
        ("tips over", dict(friction=1.2, attitude_error=math.pi, inclination=0.1)),
        ("misses", dict(offset=0.6)),
        ("misses", dict(offset=-0.7)),
        ("bounces off", dict(restitution=0.6, normal_speed=2.0, tangential_speed=2.5)),
    ]
    given = {key for _, changes in cases for key in changes}
    rows = {key: [c.get(key, known_parameters()[key].default) for _, c in cases] for key in given}
    for key, value in {"restitution": 0.0, "contact_time": 0.02}.items():
        rows[key] = [c.get(key, value) for _, c in cases]
    outcomes, _ = land(len(cases), **rows)
    assert outcomes == [name for name, _ in cases]


def test_the_start_is_what_the_parameters_say():
    p = columns(3, attitude_error=[0.0, 0.3, -0.3], start_height=0.01, offset=0.1, foot_height=0.018)
    state = touchdown_states(p, V)
    alpha = V.platform_inclination
    assert state[:, PITCH] - alpha == pytest.approx([0.0, 0.3, -0.3])
    out = np.sin(alpha) * state[:, X] + np.cos(alpha) * (state[:, Z] - V.platform_surface_height)
    # Feet: spheres of 4 mm at 14 mm below and 32.5 mm beside the centre of mass.
    tilted = 0.014 * math.cos(0.3) + 0.0325 * math.sin(0.3) + 0.004
    assert out == pytest.approx([0.028, 0.01 + tilted, 0.01 + tilted], abs=1e-12)
    downhill = -(np.cos(alpha) * state[:, X] - np.sin(alpha) * (state[:, Z] - V.platform_surface_height))
    assert downhill == pytest.approx([0.1, 0.1, 0.1], abs=1e-12)


def test_touchdown_speeds_and_impulse_agree_with_the_change_of_momentum():
    """Motors off before: over 0.1 s the slab gives m v_n and carries the weight. Landed flat, without
    rebound; the drag of rotors at a standstill is zero."""
    n, speed = 3, np.array([0.4, 0.8, 1.2])
    outcomes, r = land(n, normal_speed=speed, thrust=0.0, friction=1.2, inclination=0.3)
    assert outcomes == ["rests"] * n
    g = V.environment_gravity
    # The touch is seen at the end of a step: free fall of two steps of 4 ms at most.
    assert r["touchdown_normal_speed"] == pytest.approx(speed, abs=2 * 0.004 * g)
    expected = V.body_mass * (r["touchdown_normal_speed"] + g * math.cos(0.3) * landing.IMPULSE_TIME)
    assert r["impulse"] == pytest.approx(expected, rel=0.02)
    assert (r["peak_force"] > V.body_mass * g).all() and (np.diff(r["peak_force"]) > 0).all()


def test_a_sliding_vehicle_stops_where_friction_says():
    """Distance v^2 / (2 g (mu cos - sin)) for a block; the vehicle lands with it, feet down."""
    speed, mu, alpha = np.array([0.4, 0.6]), 0.6, math.radians(10)
    outcomes, r = land(
        2, tangential_speed=speed, normal_speed=0.05, thrust=0.0, friction=mu, inclination=alpha
    )
    assert outcomes == ["rests", "rests"]
    pressed = r["touchdown_tangential_speed"] - mu * r["touchdown_normal_speed"]  # after the impact
    stop = pressed**2 / (2 * V.environment_gravity * (mu * math.cos(alpha) - math.sin(alpha)))
    # Up to 8 ms pass before the feet are pressed on, and the impact turns the vehicle a little.
    assert r["slide_distance"] == pytest.approx(stop, rel=0.15)
    assert (r["settling_time"] < 2 * speed / (V.environment_gravity * 0.4) + 0.2).all()


def test_no_landing_depends_on_the_others():
    """On slopes of their own, touched at different times, some after others were decided: the bits of each
    landing are those that it has alone."""
    p = columns(
        5,
        inclination=np.radians([5.0, 20.0, 35.0, 50.0, 28.0]),
        offset=[0.40, 0.0, 0.38, -0.3, 0.1],
        tangential_speed=[2.0, 0.0, 2.5, 0.0, 0.0],
        start_height=[5e-4, 0.03, 5e-4, 0.05, 0.06],
        attitude_error=[0.0, 0.1, 0.0, -0.1, 0.2],
        thrust=0.4,
    )
    states = touchdown_states(p, V)
    together = simulate(states, p, duration=0.5)
    decided = together.values[[0, 2], list(RESULTS).index("touchdown_time")]
    assert decided.max() < 0.01 < np.delete(together.values[:, 0], [0, 2]).min()
    for k in range(5):
        alone = simulate(states[[k]], {name: column[[k]] for name, column in p.items()}, duration=0.5)
        assert alone.outcome[0] == together.outcome[k]
        np.testing.assert_array_equal(alone.values[0], together.values[k])


# ---- study files and designs


def test_a_fingerprint_is_of_what_the_landings_depend_on(tmp_path):
    study = read_study(written(tmp_path, STUDY))
    words = dataclasses.replace(study, title="other", maps=())
    assert words.fingerprint() == study.fingerprint()
    assert dataclasses.replace(study, seed=4).fingerprint() != study.fingerprint()


def test_the_hypercube_is_one_landing_in_each_slice(tmp_path):
    values, start = design(read_study(written(tmp_path, STUDY)))
    alpha = np.degrees(values["inclination"])
    assert sorted(np.floor((alpha - 10) / 40 * 40)) == list(range(40))
    mu = (values["friction"] - 0.2) / 1.2
    assert sorted(np.floor(mu * 40)) == list(range(40))
    error = np.degrees(values["attitude_error"])
    assert error.min() >= -20 and error.max() <= 40 and abs(np.median(error)) < 2
    assert sorted(values["mass"]) == [0.03] * 20 + [0.04] * 20
    assert (start == 0).all() and (values["thrust"] == 1.0).all()


def test_a_factorial_has_every_combination(tmp_path):
    text = """
    sampling = "factorial"
    [parameters]
    friction = { from = 0.4, to = 1.2, count = 3, unit = "1" }
    mass = { values = [30, 40], unit = "g" }
    """
    study = read_study(written(tmp_path, text))
    values, _ = design(study)
    pairs = list(zip(values["friction"], values["mass"]))
    expected = [(0.4, 0.03), (0.4, 0.04), (0.8, 0.03), (0.8, 0.04), (1.2, 0.03), (1.2, 0.04)]
    assert np.allclose(pairs, expected)
    started = dataclasses.replace(study, starts=((0.0,) * 13,) * 5)
    values, start = design(started)
    assert started.total == len(start) == 30
    assert start[:6].tolist() == [0, 1, 2, 3, 4, 0] and values["friction"][4] == 0.4


# ---- what is made of the results


def test_sensitivities_find_what_matters():
    rng = np.random.default_rng(0)
    a, b, c = rng.random((3, 8000))
    y = 2 * a + b  # variances 4 to 1, nothing from c
    index = sensitivity.variance_shares([a, b, c], y)
    # Twenty bins leave 1/400 of a linear effect's variance inside them.
    assert index[:, 0] == pytest.approx([0.8, 0.2, 0.0], abs=0.02)
    for value, low, high in index[:2]:
        assert low < value + 0.01 and high > value - 0.01
    assert sensitivity.variance_shares([a], np.ones(8000)) is None


def test_shares_of_correlated_parameters_are_counted_once():
    """x and z correlated by r, y = x + z + noise: Cov(x, y)/Var y = (1 + r)/(2 + 2 r + 1) for each."""
    rng, r = np.random.default_rng(1), 0.8
    x, w, noise = rng.standard_normal((3, 20000))
    z = r * x + math.sqrt(1.0 - r * r) * w
    found = sensitivity.variance_shares([x, z, w**2], x + z + noise)
    # Bins leave 2 % of x and z inside them; standard errors of some 0.005.
    assert found[:, 0] == pytest.approx([(1 + r) / (3 + 2 * r)] * 2 + [0.0], abs=0.03)
    assert (found[:, 1] < found[:, 0]).all() and found[:, 0].sum() < 1.0
    # Exactly the same twice: half each, and all of it together.
    twice = sensitivity.variance_shares([x, x], x)
    assert twice[:, 0] == pytest.approx([0.5, 0.5], abs=0.02)
    # Counteracting: y = 2 x - z has Cov(-z, y) = 1 - 2 r < 0.
    against = sensitivity.variance_shares([x, z], 2 * x - z)[:, 0]
    assert against[1] == pytest.approx((1 - 2 * r) / (5 - 4 * r), abs=0.03) and against.sum() <= 1.0
    assert sensitivity.variance_shares([x[:30], z[:30]], x[:30]) is None


def test_map_boundary_and_prediction():
    """Landings that rest exactly where friction holds the slope: the boundary is the prediction."""
    known = known_parameters()
    alpha, mu = (x.ravel() for x in np.meshgrid(np.radians(np.arange(10, 41, 2)), np.arange(0.1, 1.2, 0.02)))
    outcome = np.where(mu > np.tan(alpha), landing.RESTS, landing.SLIDES)
    one = maps.make_map(known["inclination"], known["friction"], alpha, mu, outcome)
    assert one.levels and one.counts.sum() == len(mu) and one.counts.max() == 1
    for row in maps.boundary(one, "y"):
        (crossing,) = row["crossings"]
        assert crossing["rests_above"]
        assert crossing["at"] == pytest.approx(math.tan(math.radians(row["place"])), abs=0.011)
    for row in maps.boundary(one, "x"):
        for crossing in row["crossings"]:
            assert not crossing["rests_above"]
            assert math.tan(math.radians(crossing["at"])) == pytest.approx(row["place"], abs=0.03)
    x, y = maps.quasi_static(one, {})
    assert np.allclose(y, np.tan(np.radians(x)))
    other = maps.make_map(known["mass"], known["friction"], alpha, mu, outcome)
    _, y = maps.quasi_static(other, {"inclination": 0.3})
    assert np.allclose(y, math.tan(0.3))
    assert maps.quasi_static(other, {}) is None


@pytest.mark.parametrize("name", sorted(shipped()))
def test_shipped_results_are_of_the_shipped_studies(name):
    found = json.loads((shipped()[name].parent / "results" / name / "landings.json").read_text("utf-8"))
    study = read_study(name)
    facts = [{"study": "landings", **row} for row in report.facts(study)]
    flown = {row["name"]: row["value"] for row in found["facts"]}
    later = ("landings", "start states")  # known once the starts are flown
    assert [f for f in facts if f["name"] not in later] == [
        f for f in found["facts"] if f["name"] not in later
    ]
    assert flown["landings"] == study.total * max(1, flown["start states"])
    counts = [row["count"] for row in found["rows"] if row["measure"] in landing.OUTCOMES]
    assert sum(counts) == flown["landings"]


@pytest.mark.slow
def test_an_early_end_changes_no_outcome(monkeypatch):
    """Landings that lie still are not watched to the end: they miss some millimetres of creeping, no more."""
    study = read_study("steep_landing")
    rows = range(400)
    values, _ = design(study)
    p = {name: column[rows] for name, column in values.items()}
    states = touchdown_states(p, study.vehicle)
    early = simulate(states, p)
    monkeypatch.setattr(landing, "REST_TIME", math.inf)
    late = simulate(states, p)
    np.testing.assert_array_equal(early.outcome, late.outcome)
    # In the rest of two seconds it creeps, by no more than three times as fast as so far, and rocks a little.
    tolerance = {"slide_distance": 6.0 * landing.REST_CREEP, "largest_tilt": 1e-4}
    for name, one, other in zip(RESULTS, early.values.T, late.values.T):
        assert (np.nan_to_num(np.abs(one - other)) <= tolerance.get(name, 0.0)).all(), name
    np.testing.assert_array_equal(np.isnan(early.values), np.isnan(late.values))
