"""Known causes in real flights: the file of rows, the judgement, table and command; made-up flights only."""

import dataclasses
import json
from types import SimpleNamespace

import numpy as np
import pytest

from inclined_landing.eval.gap import gap_example
from inclined_landing.eval.logs import FlightLog
from inclined_landing.models.effects import LIBRARY
from inclined_landing.models.errors import UserError
from inclined_landing.models.parameters import load_vehicle
from tests.proof.__main__ import main
from tests.proof.causes import command, page, rough, rows

ROW = rows.Row(
    set="lab",
    name="a weight",
    kind="cause",
    half="development",
    reference=("before/*.csv",),
    flights=("after/flight{08..10..2}.csv",),
    vehicle="crazyflie-2.1",
    right=("mass", "thrust_scale"),
    beside=("attitude_trim",),
)
RESULT = {
    "set": "lab",
    "name": "a weight",
    "kind": "cause",
    "half": "development",
    "strength": "strong",
    "dose": None,
    "told": {"of": "thrust", "value": 0.9, "tolerance": 0.02},
    "right": ["mass", "thrust_scale"],
    "flights": [3, 2],
    "refused": [],
    "verdict": "effects",
    "named": [
        {
            "name": "mass",
            "class": ["mass", "thrust_scale"],
            "probability": 0.97,
            "sure": True,
            "cost": 0.4,
            "parameters": {"scale": {"value": 1.12, "ci95": [1.09, 1.15], "unit": "1"}},
        }
    ],
    "possible": {"wind": 0.2},
    "inconsistent": [],
    "found": {"value": 0.893, "ci95": [0.87, 0.917]},
    "before": 0.612,
    "after": 0.148,
    "seconds": 12.0,
    "baselines": {"tuning": {"right": True, "wrong": 1, "names": ["mass", "rotor_drag"]}},
    "rough": 0.9,
    "right sure": True,
    "right possible": True,
    "sure names": 1,
    "wrong": [],
    "flagged": False,
}
DOSE = {
    "set": "lab",
    "name": "gain of 0.005",
    "kind": "dose",
    "half": "development",
    "dose": 0.005,
    "parameter": "attitude gain k",
    "flights": [4],
    "refused": [],
    "found": {"value": 0.7, "ci95": [0.6, 0.8]},
}
ERROR = {"set": "lab", "name": "lost", "kind": "cause", "half": "development", "error": "lab: no file like a"}


def made(**changed):
    return RESULT | changed


def test_rows_are_well_formed():
    known = rows.known_rows()
    assert len({r.key for r in known}) == len(known)  # one file each
    for r in known:
        assert r.kind in ("cause", "nothing", "unknown", "dose") and r.strength in (
            "weak",
            "medium",
            "strong",
        ), r
        assert set(r.right) | set(r.beside) <= set(LIBRARY), r
        assert not set(r.right) & set(r.beside), r
        assert bool(r.right) or r.kind != "cause", r
        assert not r.right or r.kind != "nothing", r
        assert rows.base_vehicle(r).body_mass == (r.mass or load_vehicle(r.vehicle).body_mass)
        if r.size:
            assert r.size["of"] in ("thrust", "wind") and r.size["value"] > 0 < r.size["tolerance"], r
        if r.dose is not None:
            assert f" {r.dose:g}" in r.name and not any("{folder}" in one for one in r.flights), r
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
                    one
                    for r in rows.known_rows()
                    if r.set == "CrazyPAD" and " cut" in r.name
                    for one in [r.flights[0].split("/")[2]]
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


def test_patterns_keep_zeros_and_missing_files_are_one_sentence(tmp_path):
    after = tmp_path / "lab" / "after"
    after.mkdir(parents=True)
    for n in (8, 9, 10):
        (after / f"flight{n:02d}.csv").write_text("x")
    (after / "flight12.csv").touch()  # empty: cut short before its first row
    assert [p.name for p in rows.paths_of(tmp_path / ROW.set, ROW.flights)] == [
        "flight08.csv",
        "flight10.csv",
    ]
    with pytest.raises(UserError, match=r"lab: no file like after/flight12\.csv$"):
        rows.paths_of(tmp_path / ROW.set, ["after/flight12.csv"])


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


def test_found_load_on_a_string_weighs_as_much_as_mass():
    """A load of a fifth of the vehicle's mass takes thrust over mass to 1/1.2."""
    vehicle = load_vehicle("crazyflie-2.1")
    told = dataclasses.replace(
        ROW, right=("slung_load",), size={"of": "thrust", "value": 0.8, "tolerance": 0.1}
    )
    load = 0.2 * vehicle.body_mass
    slung = effect("slung_load", ["slung_load"], mass=(load, 0.0, 2 * load), length=(0.5, 0.4, 0.6))
    got = rows._found(told, diagnosis(slung), vehicle, vehicle.hover_pwm)
    assert got["value"] == pytest.approx(1 / 1.2)
    assert got["ci95"] == pytest.approx([1 / 1.4, 1.0])


def test_found_wind_is_towards_minus_x():
    vehicle = load_vehicle("crazyflie-2.1")
    told = dataclasses.replace(ROW, right=("wind",), size={"of": "wind", "value": 4.2, "tolerance": 0.5})
    wind = effect("wind", ["wind"], x=(-4.0, -4.5, -3.5), y=(1.0, 0.0, 2.0))
    assert rows._found(told, diagnosis(wind), vehicle, 4e4) == {"value": 4.0, "ci95": [3.5, 4.5]}


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
    text = page.summary_text([RESULT, ERROR])
    assert text.count("\n") == len(page.BARS) + 2 + len(page.BASELINES) - 1
    assert "called unknown as well: 0/1 known causes, 0/0 rows with nothing changed" in text
    assert "where a right name is sure, median: 61 to 15 cm" in text
    assert text.endswith("sparse regression: right among its names 0/0; 0 of its 0 names are wrong")
    missed = {"right": False, "wrong": 1, "names": ["wind"]}
    weak, same = (
        made(baselines={"tuning": missed}, **how) for how in ({"strength": "weak"}, {"kind": "nothing"})
    )
    counts = page.summary_text([RESULT, weak, made(baselines={"tuning": missed}), same, ERROR, DOSE])
    assert "parameter tuning: right among its names 1/2; 4 of its 5 names are wrong" in counts
    assert "named sure: 1/1 (100 %; at least 80 %)" in text and "flagged: 0/0 (none; at least 100 %)" in text


def test_every_line_of_the_table_has_all_columns():
    bare = made(told=None, found=None, before=None, baselines={}, flagged=True)
    lines = page.cells([RESULT, ERROR, bare, DOSE])
    assert all(len(line) == len(page.HEADER) for line in lines)
    assert "mass 1.12 [1.09, 1.15]" in lines[0] and "61 to 15" in lines[0] and "right, 1 wrong" in lines[0]
    assert lines[1][3] == "not read: lab: no file like a"
    assert {"attitude gain k at 0.005", "0.7 [0.6, 0.8]"} < set(lines[3])
    assert page.line(DOSE) == "lab: gain of 0.005: attitude gain k 0.7 [0.6, 0.8]"


def test_the_figures_have_every_dose_with_its_interval():
    cut, lost = made(dose=3.0, told=None), made(dose=4.0, told=None, found=None)
    results = [RESULT, cut, lost, DOSE, ERROR]
    (thrust, wind, cuts), (gains,) = page.draw(results).axes, page.draw_gains(results).axes

    def points(axes):
        """Points and ends of intervals, without those of the legend."""
        ends = [(*bar.get_segments()[0][:, 1],) for bar in axes.collections]
        return [
            tuple(map(float, line.get_xydata()[0])) for line in axes.lines if len(line.get_xdata()) == 1
        ], ends

    assert points(thrust) == ([(0.9, 0.893)], [pytest.approx((0.87, 0.917))]) and not wind.collections
    assert points(cuts) == ([(3.0, 0.893), (4.0, 0.0)], [pytest.approx((0.87, 0.917))])
    assert points(gains) == ([(0.005, 0.7)], [pytest.approx((0.6, 0.8))])


def test_a_dose_is_what_is_identified_of_its_parameter(tmp_path, monkeypatch):
    parameters = [
        SimpleNamespace(name=name, field=field, value=value, ci95=(value - 0.1, value + 0.1))
        for name, field, value in (("tau", "attitude_time_constant", 0.1), ("k", "attitude_gain", 0.7))
    ]
    found = SimpleNamespace(parameters=parameters, flights=("a", "b"))
    monkeypatch.setattr(rows, "identify", lambda flights, vehicle: found)
    monkeypatch.setattr(rows, "paths_of", lambda folder, patterns: [])
    row = dataclasses.replace(ROW, kind="dose", dose=0.005, parameter="attitude_gain")
    monkeypatch.setattr(rows, "read", lambda paths, above: ([flight(), flight()], ["one was refused"]))
    got = rows.answer(tmp_path, row)
    assert (got["parameter"], got["dose"], got["flights"]) == ("k", 0.005, [2])
    assert got["found"]["value"] == 0.7 and set(got) == set(DOSE)
    monkeypatch.setattr(rows, "read", lambda paths, above: ([], ["one was refused"]))
    with pytest.raises(UserError, match="one was refused"):
        rows.answer(tmp_path, row)


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


def test_rough_regression_leaves_out_the_ground():
    """Half of the flight stands on the floor at half the command: the air alone tells the thrust."""
    made = flight(height=0.5)
    floor = np.stack([made.position[:, 0], made.position[:, 1], 0.0 * made.t], axis=1)
    command = made.command * [0.5, 1.0, 1.0, 1.0]
    half = made.t < 10.0
    landed = dataclasses.replace(
        made,
        position=np.where(half[:, None], made.position, floor),
        command=np.where(half[:, None], made.command, command),
    )
    # 0.25 s of smoothing about the step of 1 s of 10 s: 1 % of the rows, off by half.
    assert rough.thrust([flight()], [landed]) == pytest.approx(1.0, rel=0.02)


def test_rough_regressions_without_motors_or_requests_say_nothing():
    made = flight()
    off = dataclasses.replace(made, command=made.command * [0.0, 1.0, 1.0, 1.0], requests=None)
    assert rough.thrust([made], [off]) is None and rough.wind([off], [made]) is None
    assert rough.request([made], [off], 2) is None


@pytest.fixture
def one_row(monkeypatch):
    monkeypatch.setattr(command, "known_rows", lambda: [ROW])


@pytest.mark.usefixtures("one_row")
def test_kept_rows_are_not_flown_again(tmp_path, capsys):
    """The page is made from the rows that are kept; nothing of the (empty) data folder is read."""
    kept = tmp_path / "out" / "rows" / f"{ROW.key}.json"
    kept.parent.mkdir(parents=True)
    kept.write_text(json.dumps(RESULT))
    assert main(["causes", str(tmp_path), "--out", str(tmp_path / "out")]) == 0
    assert "named sure: 1/1" in capsys.readouterr().out
    assert {p.name for p in (tmp_path / "out").iterdir()} == {
        *("rows", "table.md", "causes.json", "causes.png", "gains.png", "report.html")
    }
    written = json.loads((tmp_path / "out" / "causes.json").read_text())
    assert written["rows"] == [RESULT] and written["summary"]["interval"] == [1, 1]
    assert "| lab | a weight | 3 and 2 | effects |" in (tmp_path / "out" / "table.md").read_text()
    assert "mass 1.12 [1.09, 1.15]" in (tmp_path / "out" / "report.html").read_text()


@pytest.mark.usefixtures("one_row")
def test_missing_flights_are_a_line_of_the_table(tmp_path, capsys):
    assert main(["causes", str(tmp_path), "--out", str(tmp_path / "out"), "--processes", "1"]) == 0
    assert "lab: a weight: " in capsys.readouterr().err
    assert "no file like before/*.csv" in (tmp_path / "out" / "table.md").read_text()


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (["--only", "moon"], "no rows; --only takes CrazyPAD, crazyflie-data-collection, "),
        (["--processes", "0"], "--processes must lie from 1 to 64, not 0"),
    ],
)
def test_wrong_words_are_one_sentence(words, sentence, tmp_path, capsys):
    assert main(["causes", str(tmp_path), "--out", str(tmp_path / "out"), *words]) == 2
    printed = capsys.readouterr().err
    assert printed.startswith(f"python -m tests.proof: {sentence}") and printed.count("\n") == 1, printed
    assert main(["causes", str(tmp_path / "none"), "--out", str(tmp_path / "out")]) == 2
    assert "none: no folder" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


@pytest.mark.slow
def test_a_row_of_made_up_flights(tmp_path):
    """Flights of one vehicle against others of the same: nothing changed, and the row says so."""
    gap_example.command(tmp_path / "lab")
    same = dataclasses.replace(
        ROW,
        kind="nothing",
        reference=("fit/*.csv",),
        flights=("heldout/*.csv",),
        right=(),
        beside=(),
    )
    result = rows.answer(tmp_path, same)
    assert result["sure names"] == 0 and result["wrong"] == [] and not result["refused"]
    # The identified vehicle predicts other flights of its own: nothing of the error is closed by a name.
    assert result["after"] == pytest.approx(result["before"])
    assert set(result) == set(RESULT)
    page.write(tmp_path, [result])
