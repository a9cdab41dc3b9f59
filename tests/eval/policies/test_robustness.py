"""`landing-eval robustness` over thrust and effects, and what all studies share: counts, tables, figures."""

import json
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest

from inclined_landing.envs.policy import load_policy
from inclined_landing.envs.shared.statistics import proportion, spread
from inclined_landing.eval import cli
from inclined_landing.eval.policies import changes, study, tables
from inclined_landing.eval.policies.panels import draw_panels
from inclined_landing.models.effects import LIBRARY
from inclined_landing.models.errors import UserError
from inclined_landing.models.parameters import check_vehicle, load_vehicle
from tests.pages import EVIL_FILE, check_page

CASES = changes.changes()
VEHICLES = ("--over=vehicles",)


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
    assert len(CASES) == len(changes.THRUSTS) + 3 * len(LIBRARY) == len({case.name for case in CASES})
    known = load_vehicle()
    for case in CASES:
        check_vehicle(case.vehicle(known))
    assert CASES[0].vehicle(known) is known and changes.THRUSTS[0] == 0.7 and changes.THRUSTS[-1] == 1.15
    assert [case.values["scale"] for case in CASES[1:10]] == [x for x in changes.THRUSTS if x != 1.0]


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """The command on five starts: the shipped policy beside itself under another name."""
    out = tmp_path_factory.mktemp("robust") / "out"
    twin = out.with_name(f"twin{EVIL_FILE}.zip")
    twin.write_bytes(load_policy("landing-nominal").path.read_bytes())
    options = "--full --every 60 --thrust 0.7 --effect friction"
    assert cli.main(["robustness", "landing-nominal", str(twin), "--out", str(out), *options.split()]) == 0
    return out


def test_the_folder_has_everything(folder):
    figures = {"robustness.png", "robustness.pdf"}
    names = {"index.html", "robustness.json", "flights.csv"}
    assert {p.name for p in folder.iterdir()} == names | figures
    page = (folder / "index.html").read_text("utf-8")
    assert page.count("data:image/png;base64") == 1 and "friction" in page
    check_page(page, f"twin{EVIL_FILE}")
    flights = pd.read_csv(folder / "flights.csv")
    assert len(flights) == 2 * 5 * (2 + 3)


def test_the_counts_are_those_of_the_flights(folder):
    """Twins land alike; enough thrust lands, too little never; friction changes the rest alone."""
    report = json.loads((folder / "robustness.json").read_text("utf-8"))
    assert report["starts"] == 5
    assert [p["name"] for p in report["policies"]] == ["landing-nominal", f"twin{EVIL_FILE}"]
    for row in (*report["thrust"], *report["effects"]):
        assert row["outcomes"][0] == row["outcomes"][1]
    weak, known = report["thrust"]
    assert weak["parameters"]["scale"]["value"] == 0.7 and weak["outcomes"][0]["strict"]["count"] == 0
    assert known["outcomes"][0]["strict"]["count"] == 5
    slippery = [row for row in report["effects"] if row["effect"] == "friction"]
    assert [row["outcomes"][0]["strict"]["count"] for row in slippery] == [5, 5, 5]
    assert slippery[2]["outcomes"][0]["at_rest_on_feet"]["count"] == 0  # friction 0.16 on a slope of tan 0.48
    assert all(d["none"]["interval"] == [0.0, 0.0] for d in report["differences"])
    flights = pd.read_csv(folder / "flights.csv")
    counted = flights.groupby(["policy", "condition"])["strict"].sum()
    assert counted["landing-nominal", "friction strong"] == 5
    assert counted["landing-nominal", "thrust_scale 0.7"] == 0


@pytest.mark.parametrize(
    ("good", "ends"),
    [((0.9, 0.95, 1.0, 1.05, 1.1), (0.9, 1.1)), ((0.7, 0.85, 1.0, 1.15), (1.0, 1.0)), ((0.9,), None)],
)
def test_thrusts_survived_have_no_gap(good, ends):
    rows = [
        {
            "parameters": {"scale": {"value": x}},
            "outcomes": [{"strict": proportion(251 * (x in good), 251)}],
        }
        for x in changes.THRUSTS
    ]
    assert changes.survived({"thrust": rows}, 0) == ends


def test_the_figure_shows_effects_that_cost_landings():
    """And of these every size at which one costs some; the flights of two policies at 100 starts."""
    landed = {
        "drag": {"weak": (100, 100), "medium": (96, 100)},
        "mass": {"weak": (97, 100), "medium": (94, 100)},
    }
    effects = [
        {"effect": name, "size": size, "outcomes": [{"strict": proportion(n, 100)} for n in counts]}
        for name, sizes in landed.items()
        for size, counts in sizes.items()
    ]
    report = {"thrust": [None], "effects": effects}
    (panel,) = changes._panels(report, ["a", "b"])
    assert panel.title == "Medium effects" and panel.conditions == ["mass"]
    assert [panel.shares[name]["mass"]["count"] for name in "ab"] == [94, 100]
    (said,) = changes._left_out(report)
    assert "1 of 2 effects" in said


def test_a_table_has_a_row_for_each_outcome():
    found = {"strict": proportion(3, 4), "normal_speed": spread([1.0, 2.0, 4.0]), "of no measure": 7}
    table = tables.outcomes_table(("policy", "thrust"), [(("a", "x 1"), found), (("a", "x 2"), found)])
    assert table.heads == ("policy", "thrust", "flights", "strict [%]", "normal speed [m/s]")
    assert table.rows[0] == ("a", "x 1", "4", "75.0 [30.1, 95.4]", "2.00")
    assert table.rows[1][:2] == ("", "x 2")


def test_figures_show_every_number():
    lines = {"a": {0.9: proportion(9, 10), 1.0: proportion(10, 10)}, "b": {}}
    rows = {"a": {"wind": proportion(1, 2)}, "b": {"mass": proportion(2, 2)}}
    panels = [tables.Panel("Over thrust", lines, "thrust [1]"), tables.Panel("Effects", rows)]
    left, right = draw_panels(panels, "strict success").axes
    (line,) = [line for line in left.lines if line.get_gid() == "share"]
    np.testing.assert_allclose(line.get_xydata(), [[0.9, 90], [1.0, 100]])
    assert [text.get_text() for text in right.get_yticklabels()] == ["wind", "mass"]
    marks = [bar.lines[0].get_xydata() for bar in right.containers]
    np.testing.assert_allclose(np.concatenate(marks)[:, 0], [50, 100])
    assert [round(float(mark[0, 1])) for mark in marks] == [0, 1]


def test_long_work_says_how_long_it_takes_and_what_is_done(monkeypatch, capsys):
    flights = pd.DataFrame({"strict": [True, False]})
    work = {("one", f"condition {k}"): lambda: flights for k in range(3)}
    assert len(study.fly_all(work)) == 3 and not capsys.readouterr().err.strip()
    clock = iter(range(0, 10_000, 100))
    monkeypatch.setattr(study, "time", SimpleNamespace(monotonic=lambda: next(clock)))
    study.fly_all(work)
    said = capsys.readouterr().err.split("\n")
    assert said[0] == "3 x 2 flights: about 5 min"
    assert [line.partition(":")[0] for line in said[1:4]] == [f"condition {k}, one" for k in range(3)]
    assert "1 of 2 flights" in said[1]


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (("touchdown",), "touchdown.zip is for touchdown"),
        (("landing-slopes",), "observes the slope"),
        (("landing", "landing"), "landing is named twice"),
        (("landing", "--effect", "gremlins"), "unknown effect gremlins"),
        (("landing", "--thrust", "0"), "--thrust must be a number above 0"),
        (("landing", "--every", "0"), "--every must"),
        (("landing", "--plant", "paper"), "unknown plant"),
        (("landing", "--vehicle", "sparrow", *VEHICLES), "vehicle file sparrow does not exist"),
        (("landing", "--ranges", "sparrow", *VEHICLES), "randomise file sparrow does not exist"),
        (("landing", "--ranges", "sparrow", "--draws=0", *VEHICLES), "randomise file sparrow does not exist"),
        (("setpoint", *VEHICLES), "policy setpoint is for the task setpoint, not for landing"),
        (("setpoint", "--over=slopes"), "setpoint, not for landing"),
        (("a=",), "a policy must be POLICY or LABEL=POLICY"),
        ((), "name at least one policy"),
    ],
)
def test_wrong_input_is_one_sentence_and_writes_nothing(arguments, sentence, tmp_path, capsys):
    assert cli.main(["robustness", *arguments, "--out", str(tmp_path / "out")]) == 2
    said = capsys.readouterr().err
    assert sentence in said and said.count("\n") == 1
    assert not list(tmp_path.iterdir())


def test_policies_for_other_slopes_are_not_compared():
    flat = load_policy("landing-nominal", inclination=-0.2)
    with pytest.raises(UserError, match="trained for different inclinations"):
        changes.run({"landing": load_policy("landing-nominal"), "flat": flat}, CASES[:1], plant="hybrid")
