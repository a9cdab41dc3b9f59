"""Known causes in real flights: the file of rows, the judgement, and the counts; made-up flights only."""

import dataclasses
from types import SimpleNamespace

import numpy as np
import pytest

from inclined_landing.eval.logs import FlightLog
from inclined_landing.models.effects import LIBRARY
from inclined_landing.models.parameters import load_vehicle
from tests.proof.causes import page, rough, rows

ROW = rows.Row(
    *("lab", "a weight", "cause", "development", ("before/*.csv",), ("after/*.csv",), "crazyflie-2.1"),
    right=("mass", "thrust_scale"),
    beside=("attitude_trim",),
)
RESULT = {
    **{"set": "lab", "name": "a weight", "kind": "cause", "half": "development", "strength": "strong"},
    **{"dose": None, "told": {"of": "thrust", "value": 0.9, "tolerance": 0.02}, "verdict": "effects"},
    **{"found": {"value": 0.893, "ci95": [0.87, 0.917]}, "before": 0.612, "after": 0.148},
    "baselines": {"tuning": {"right": True, "wrong": 1, "names": ["mass", "rotor_drag"]}},
    **{"right sure": True, "right possible": True, "sure names": 1, "wrong": [], "flagged": False},
}
DOSE = {"set": "lab", "name": "gain of 0.005", "kind": "dose", "dose": 0.005}
ERROR = {"set": "lab", "name": "lost", "kind": "cause", "half": "development", "error": "lab: no file like a"}


def made(**changed):
    return RESULT | changed


def test_rows_are_well_formed():
    known = rows.known_rows()
    assert len({r.key for r in known}) == len(known)  # one file each
    for r in known:
        assert r.kind in ("cause", "nothing", "unknown", "dose"), r
        assert r.strength in ("weak", "medium", "strong"), r
        assert set(r.right) | set(r.beside) <= set(LIBRARY) and not set(r.right) & set(r.beside), r
        assert bool(r.right) or r.kind != "cause", r
        assert not r.right or r.kind != "nothing", r
        assert rows.base_vehicle(r).body_mass == (r.mass or load_vehicle(r.vehicle).body_mass)
        assert not r.size or (r.size["of"] in ("thrust", "wind") and r.size["value"] > 0), r
        assert (r.kind == "dose") == (r.dose is not None and hasattr(load_vehicle(), r.parameter or "-")), r


# Names as they are in a clone of each repository, and which of them were held out.
CLONES = {
    "crazyswarm2-tools": (
        [f"logs/log{n:02d}" for n in range(8, 207)] + ["logs/log70_y", "logs/log88_2_x", "logs/log129_2"],
        lambda p: (n := int(p[8:].split("_")[0])) >= 100 and n % 2 == 1,
    ),
    "neural-fly": (
        [
            f"data/experiment/custom_figure8_{c}_{w}.csv"
            for c in ("NF", "NF-C", "NF-T", "baseline", "indi", "L1")
            for w in ("nowind", "35wind", "70wind", "100wind", "70p20sint")
        ],
        lambda p: "_L1_" in p or "70wind" in p,
    ),
    "crazyflie-data-collection": (
        [f"brushless_flights{load}/data/eckart{n:02d}" for load in ("", "_payload") for n in range(90)],
        lambda p: "payload" in p and int(p[-2:]) % 2 == 1,
    ),
    "neural-swarm": (
        [
            f"data/training/datacollection{day}/{kind}/{vehicle}_{n:02d}{suffix}"
            for day in ("19_12_11_2019", "21_06_16_2020", "23_06_23_2020")
            for kind in (
                *("random_walk_small_small", "swap_small_small"),
                *("randomwalk_s", "randomwalk_s_1", "randomwalk_s_2"),
            )
            for vehicle in ("cf50", "cf51")
            for n in range(6)
            for suffix in ("", ".csv")  # the authors' own conversion lies beside each log
        ],
        lambda p: "21_06_16_2020" in p,
    ),
    "CrazyPAD": (
        [
            f"data/controller_data/{folder}/E{vehicle}_log{n:02d}"
            for folder in (
                *("normal_flight", "add_weight_W1_near_M3", "weight_on_string_W3_near_M3"),
                *("add_weight_W1_near_M4", "add_weight_W1_near_M3_M4"),
                *(
                    r.flights[0].split("/")[2]
                    for r in rows.known_rows()
                    if "CrazyPAD" in r.set and " cut" in r.name
                ),
            )
            for vehicle in (8, 9)
            for n in range(5)
        ],
        lambda p: "/E9_" in p,
    ),
}


@pytest.mark.parametrize("name", CLONES)
def test_halves_are_kept_apart(name, tmp_path):
    """In a whole clone no development row reads what was held out; held-out rows judge that alone."""
    paths, held_out = CLONES[name]
    for path in paths:
        file = tmp_path / name / path
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text("x")
    mine = [r for r in rows.known_rows() if r.set == name]
    assert mine
    for r in mine:
        reference, flights = (
            {p.relative_to(tmp_path / name).as_posix() for p in rows.paths_of(tmp_path / r.set, patterns)}
            if patterns or r.kind != "dose"
            else set()
            for patterns in (r.reference, r.flights)
        )
        if r.half == "development":
            assert not {p for p in reference | flights if held_out(p)}, r.name
        else:
            assert all(held_out(p) for p in flights), r.name
        if r.reference_above is None:  # otherwise the same flights, cut by height
            assert not reference & flights, r.name
        assert not {f"{p}.csv" for p in reference | flights} & (reference | flights), (
            f"{r.name}: flights twice"
        )


def effect(name, members, sure=True, **parameters):
    estimates = {k: SimpleNamespace(value=v, ci95=(low, high)) for k, (v, low, high) in parameters.items()}
    values = {k: p.value for k, p in estimates.items()}
    return SimpleNamespace(
        name=name, members=members, sure=sure, parameters=estimates, values=lambda: dict(values)
    )


def diagnosis(*effects, possible=(), verdict="effects", inconsistent=()):
    one = [SimpleNamespace(flights=inconsistent)] if inconsistent else []
    return SimpleNamespace(
        effects=effects, possible=dict.fromkeys(possible, 0.3), verdict=verdict, inconsistent_flights=one
    )


@pytest.mark.parametrize(
    ("answer", "expected"),
    [
        # Right by itself, or by a class that holds a right name.
        (diagnosis(effect("mass", ["mass"])), (True, True, [])),
        (diagnosis(effect("thrust_bias", ["thrust_bias", "thrust_scale"])), (True, True, [])),
        # Named but not sure, or only possible: not sure, and never wrong.
        (diagnosis(effect("mass", ["mass"], sure=False)), (False, True, [])),
        (diagnosis(possible=["mass"]), (False, True, [])),
        (diagnosis(effect("wind", ["wind"], sure=False)), (False, False, [])),
        # What goes with the cause is neither right nor wrong; anything else is wrong.
        (diagnosis(effect("attitude_trim", ["attitude_trim"])), (False, False, [])),
        (diagnosis(effect("mass", ["mass"]), effect("wind", ["wind"])), (True, True, ["wind"])),
    ],
)
def test_judgement(answer, expected):
    got = rows.judged(ROW, answer)
    assert (got["right sure"], got["right possible"], got["wrong"]) == expected
    assert got["sure names"] == sum(e.sure for e in answer.effects)


def test_flagged_is_unknown_or_flights_that_must_be_inconsistent():
    sensor = dataclasses.replace(ROW, kind="unknown", inconsistent=("b", "c"))
    assert not rows.judged(ROW, diagnosis())["flagged"]
    assert rows.judged(ROW, diagnosis(verdict="unknown"))["flagged"]
    assert rows.judged(sensor, diagnosis(inconsistent=("data/b", "data/c")))["flagged"]
    assert not rows.judged(sensor, diagnosis(inconsistent=("data/b", "data/a")))["flagged"]
    assert not rows.judged(sensor, diagnosis())["flagged"]
    assert not rows.judged(ROW, diagnosis(inconsistent=("b",)))["flagged"]  # none was told to be


def test_found_thrust_is_that_over_mass():
    vehicle = load_vehicle("crazyflie-2.1")
    told = dataclasses.replace(ROW, size={"of": "thrust", "value": 0.9, "tolerance": 0.02})
    scaled = effect("mass", ["mass"], scale=(1.25, 1.0, 1.6))
    got = rows._found(told, diagnosis(scaled), vehicle, vehicle.hover_pwm)
    # Specific thrust goes with 1/mass.
    assert got["value"] == pytest.approx(1 / 1.25)
    assert got["ci95"] == pytest.approx([1 / 1.6, 1.0])
    both = diagnosis(scaled, effect("thrust_scale", ["thrust_scale"], scale=(1.25, 1.2, 1.3)))
    assert rows._found(told, both, vehicle, vehicle.hover_pwm)["value"] == pytest.approx(1.0)
    assert rows._found(told, diagnosis(effect("wind", ["wind"])), vehicle, vehicle.hover_pwm) is None
    assert rows._found(ROW, diagnosis(scaled), vehicle, vehicle.hover_pwm) is None  # no size was told


def test_summary_counts_each_bar_by_hand():
    weak = made(strength="weak") | {"right sure": False}
    possible = made(found=None) | {"right sure": False, "sure names": 2, "wrong": ["wind"]}
    outside = made(kind="unknown", told=None, found=None, flagged=True)
    same = made(kind="nothing", told=None, found=None) | {"sure names": 0}
    narrow = made(found={"value": 0.8, "ci95": [0.7, 0.879]})  # with the tolerance of 0.02 short of 0.9
    touching = made(found={"value": 0.8, "ci95": [0.7, 0.881]})
    got = page.summary([RESULT, weak, possible, outside, same, narrow, touching, ERROR, DOSE])
    assert got == {
        "sure": (3, 4),  # the weak one does not count
        "possible": (4, 4),
        "wrong": (1, 7),
        "interval": (3, 5),  # one was not found, one is too narrow
        "nothing": (0, 1),
        "unknown": (1, 1),
    }
    text = page.summary_text([RESULT, weak, made(kind="nothing", told=None), ERROR, DOSE])
    assert "called unknown as well: 0/2 known causes, 0/1 rows with nothing changed" in text
    assert "where a right name is sure, median: 61 to 15 cm" in text
    assert "parameter tuning: right among its names 1/1; 3 of its 6 names are wrong" in text


def flight(thrust=1.0, wind=0.0, m3=1.0, height=0.0):
    """Twenty seconds along x in closed form: thrust over mass, wind along -x, request of M3, all exact."""
    t = np.arange(2000) * 0.01
    still = 0.0 * t
    x, v, a = 3.0 * np.sin(t), 3.0 * np.cos(t), -3.0 * np.sin(t)
    through = v + wind
    # g tan(pitch) = a + (k1 + k2 |v - w|) (v - w), with the level 0.05 m/s2 off
    pitch = np.arctan((a + (0.2 + 0.02 * abs(through)) * through - 0.05) / 9.81)
    pwm = 40000.0 * np.hypot(a, 9.81) / 9.81 / thrust
    requests = np.stack([pwm, pwm, m3 * pwm, pwm], axis=1)
    return FlightLog(
        *("made", t, np.stack([x, still, 1.0 + height * np.sin(0.5 * t)], axis=1)),
        np.stack([still, pitch, still], axis=1),
        np.stack([pwm, still, pitch, still], axis=1),
        requests=requests,
    )


def test_rough_regressions_have_back_what_was_put_in():
    # Smoothing over 0.25 s takes 0.1 % of a sine of 1 rad/s, and 0.5 % of the speed's square.
    assert rough.thrust([flight()], [flight(0.8)]) == pytest.approx(0.8, rel=2e-3)
    assert rough.wind([flight()], [flight(wind=4.0)]) == pytest.approx(4.0, rel=0.02)
    assert rough.wind([flight()], [flight()]) == pytest.approx(0.0, abs=0.02)
    assert rough.request([flight(m3=1.03)], [flight(m3=1.2)], 2) == pytest.approx(1.2 / 1.03 - 1.0)
