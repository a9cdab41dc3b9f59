"""`landing-eval robustness` over thrust and effects, and over named and drawn vehicles."""

import json
import re

import pandas as pd
import pytest

from inclined_landing.envs.policy import load_policy
from inclined_landing.envs.shared.measures import STRICT
from inclined_landing.eval import cli
from inclined_landing.eval.study import changes, robustness, vehicles
from inclined_landing.eval.study.engine import evaluate, run
from inclined_landing.eval.study.flights import named_policies
from inclined_landing.eval.study.options import THRUSTS
from inclined_landing.models.base.errors import UserError
from inclined_landing.models.effects import LIBRARY
from inclined_landing.models.parameters import check_vehicle, load_vehicle
from tests.pages import EVIL_FILE, check_page

CASES = changes.changes()


def test_sizes_are_distances_from_neutral_within_what_is_possible():
    for effect in LIBRARY.values():
        weak, medium, strong = (changes.sized(effect, share) for share in changes.SIZES.values())
        assert medium == pytest.approx(effect.plausible)
        for p in effect.parameters:
            low, high = p.possible
            assert all(low <= values[p.name] <= high for values in (weak, medium, strong))
            if p.is_reference:
                assert weak[p.name] == strong[p.name] == p.plausible
                continue
            far = p.plausible - p.neutral
            assert weak[p.name] - p.neutral == pytest.approx(0.5 * far)
            assert far * (strong[p.name] - p.plausible) > 0.0  # further off, the same way
    assert changes.sized(LIBRARY["contact_stiffness"], 2.0) == {"scale": 0.1}  # its bound; twice is -0.2


def test_every_condition_is_a_vehicle():
    distinct = {tuple(case.labels.items()) for case in CASES}
    assert len(CASES) == len(THRUSTS) + 3 * len(LIBRARY) == len(distinct)
    known = load_vehicle()
    for case in CASES:
        check_vehicle(case.vehicle(known))
    curve = CASES[: len(THRUSTS)]
    assert [case.values["scale"] for case in curve] == sorted(THRUSTS)
    assert THRUSTS[0] == 0.7 and THRUSTS[-1] == 1.15
    assert [case.values["scale"] for case in curve if case.vehicle(known) is known] == [1.0]


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """The command on five starts: the shipped policy beside itself under another name."""
    out = tmp_path_factory.mktemp("robust") / "out"
    twin = out.with_name(f"twin{EVIL_FILE}.zip")
    twin.write_bytes(load_policy("landing-nominal").path.read_bytes())
    few = changes.changes((0.7,), ("friction",))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(changes, "changes", lambda *of: few)
        arguments = ["landing-nominal", str(twin), "--full", "--every", "60", "--out", str(out)]
        assert cli.main(["robustness", *arguments]) == 0
    return out


def test_the_folder_has_everything(folder):
    figures = {"changes_landing.png", "changes_landing.pdf"}
    names = {"index.html", "robustness.json", "flights.csv"}
    assert {p.name for p in folder.iterdir()} == names | figures
    page = (folder / "index.html").read_text("utf-8")
    assert page.count("data:image/png;base64") == 1 and "friction" in page
    check_page(page, f"twin{EVIL_FILE}")
    flights = pd.read_csv(folder / "flights.csv")
    assert len(flights) == 2 * 5 * (2 + 3)


def test_the_counts_are_those_of_the_flights(folder):
    """Twins land alike; enough thrust lands, too little never; friction changes the rest alone."""
    rows = pd.DataFrame(json.loads((folder / "robustness.json").read_text("utf-8"))["rows"])
    twin = f"twin{EVIL_FILE}"
    of = dict(iter(rows[~rows["measure"].str.endswith("difference")].groupby("policy")))
    assert set(of) == {"landing-nominal", twin}
    numbers = [of[name].drop(columns="policy").reset_index(drop=True) for name in ("landing-nominal", twin)]
    pd.testing.assert_frame_equal(*numbers)
    one = of["landing-nominal"].set_index("measure")
    assert set(one["flights"]) == {5}
    strict, rest = one.loc["strict"], one.loc["at_rest_on_feet"]
    by_thrust = strict.dropna(subset="thrust_scale").set_index("thrust_scale")["count"]
    assert by_thrust.to_dict() == {0.7: 0, 1.0: 5}
    assert strict[strict["effect"] == "friction"]["count"].tolist() == [5, 5, 5]
    slippery = rest[(rest["effect"] == "friction") & (rest["size"] == "strong")]
    assert slippery["count"].item() == 0  # friction 0.16 on a slope of tan 0.48
    differences = rows[rows["measure"] == "strict difference"]
    assert set(differences["size"].dropna()) == {"", *changes.SIZES} and (differences["value"] == 0.0).all()
    flights = pd.read_csv(folder / "flights.csv")
    counted = flights.groupby(["policy", "effect", "size"])["strict"].sum()
    assert counted["landing-nominal", "friction", "strong"] == 5
    assert flights[(flights["policy"] == twin) & (flights["thrust_scale"] == 0.7)]["strict"].sum() == 0


def counted(flights, cases=CASES):
    """Return what the study of landing policies counts of flights with the given labels and `strict`."""
    names = flights["policy"].unique()
    study = changes.study(dict.fromkeys(names, load_policy("landing")), cases, plant="hybrid")
    columns = {measure.column or measure.name for view in study.views for measure in view.measures}
    return evaluate(study, flights.assign(**dict.fromkeys(columns - set(flights), False)))


@pytest.mark.parametrize(
    ("good", "ends"),
    [((0.9, 0.95, 1.0, 1.05, 1.1), (0.9, 1.1)), ((0.7, 0.85, 1.0, 1.15), (1.0, 1.0)), ((0.9,), None)],
)
def test_thrusts_survived_have_no_gap(good, ends):
    rows = [{"policy": "one", "thrust_scale": x, "strict": x in good, "flight": 0} for x in THRUSTS]
    results = counted(pd.DataFrame(rows))
    assert changes.survived(results, STRICT, "one") == ends


def test_policies_for_other_slopes_are_not_compared():
    flat = load_policy("landing-nominal", inclination=-0.2)
    with pytest.raises(UserError, match="a different inclination than the first"):
        robustness.check_one_slope({"landing": load_policy("landing-nominal"), "flat": flat})


# ---- vehicles

NAMED = ("crazyflie-2.1", "hummingbird")
OPTIONS = {"draws": 6, "plant": "analytic"}


@pytest.fixture(scope="module")
def results():
    policies = {"plain": "landing", "nominal": "landing-nominal"}
    return run([vehicles.study(policies, NAMED, **OPTIONS)])[0]


def test_runs_are_called_by_their_folders_and_files_told_apart(tmp_path):
    for name in "ab":
        (tmp_path / name).mkdir()
        (tmp_path / name / "final.zip").touch()
    one, other = tmp_path / "a", tmp_path / "b/final.zip"
    assert list(named_policies([str(one), str(other), "landing"])) == ["a", "final", "landing"]
    assert list(named_policies([str(one / "final.zip"), str(other)])) == ["a/final", "b/final"]
    assert named_policies(["told=a.zip", "runs/b/"]) == {"told": "a.zip", "b": "runs/b/"}
    with pytest.raises(UserError, match="policy landing is named twice"):
        named_policies(["landing", "landing"])


def test_every_policy_is_counted_on_every_vehicle(results):
    assert results.labels("vehicle") == [*NAMED, "6 drawn vehicles"]
    plain = results.one(STRICT, vehicle="crazyflie-2.1", policy="plain")
    assert plain["flights"] == 251 and plain["value"] > 0.9
    # With wider rotors fewer starts of the grid are clear; its thrust at action 0 is another: none arrives.
    nominal = results.one(STRICT, vehicle="hummingbird", policy="nominal")
    assert 200 < nominal["flights"] < 251 and nominal["count"] == 0 and nominal["mass"] == "500"


def test_drawn_vehicles_are_those_of_the_ranges(results):
    for policy in ("plain", "nominal"):
        together = results.one(STRICT, vehicle="6 drawn vehicles", policy=policy)
        each = [row for row in results.all(STRICT, policy=policy) if row["drawn"] is not None]
        assert len(each) == 6 and {row["flights"] for row in each} == {4}
        assert together["flights"] == 24 and together["count"] == sum(row["count"] for row in each)
    masses = {
        row["value"] for row in results.study.facts if row["of"].startswith("drawn") and row["name"] == "mass"
    }
    assert len(masses) == 6 and set(results.flights["drawn_mass"].dropna()) == masses


def test_the_command_over_vehicles_writes_a_whole_folder(tmp_path, capsys):
    arguments = ["landing", "--vehicle", "crazyflie-2.0", "--draws", "0", "--plant", "analytic"]
    assert cli.main(["robustness", *arguments, "--over=vehicles", "--out", str(tmp_path / "out")]) == 0
    assert re.search(r"in (\d+) of \1 flights \(.*\) with crazyflie-2\.0\.\n", capsys.readouterr().out)
    names = {"index.html", "flights.csv", "robustness.json", "vehicles.pdf", "vehicles.png"}
    assert {p.name for p in (tmp_path / "out").iterdir()} == names
    rows = json.loads((tmp_path / "out/robustness.json").read_text())["rows"]
    assert {row["vehicle"] for row in rows} == {"crazyflie-2.0"}
