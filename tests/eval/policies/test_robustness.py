"""`landing-eval robustness`: conditions, what is counted, and sentences that follow from the numbers."""

import json

import numpy as np
import pytest
from markdown_it import MarkdownIt
from PIL import Image

from inclined_landing.envs.policy import load_policy
from inclined_landing.envs.shared.statistics import mean, proportion, spread
from inclined_landing.eval import cli
from inclined_landing.eval.policies.success import sizes
from inclined_landing.eval.robustness import changes, figures, words
from inclined_landing.models.effects import LIBRARY
from inclined_landing.models.errors import UserError
from inclined_landing.models.parameters import check_vehicle, load_vehicle
from tests.pages import EVIL_FILE, check_page


def made_report(landed, names=("nominal", "randomised", "history"), starts=251) -> dict:
    """A report whose shares are `landed(policy, condition)`."""
    rows = []
    cases = changes.conditions()
    share = np.array([[landed(k, case) for k in range(len(names))] for case in cases])
    for case, row in zip(cases, share):
        outcomes = []
        for x in row:
            strict = proportion(round(x * starts), starts)
            rest = proportion(round(0.9 * x * starts), starts)
            outcomes.append(
                {"strict": strict, "success": strict, "touched": proportion(0, starts)}
                | {"at_rest_on_feet": rest, "normal_speed": spread([1.0, 1.2] if x else [])}
            )
        effect = case.effect or LIBRARY["thrust_scale"]
        found = {"parameters": sizes(effect, case.values), "outcomes": outcomes}
        rows.append({"effect": effect.name, "size": case.size} | found)
    differences = []
    for k in range(1, len(names)):
        one = {"none": {"mean": share[0, k] - share[0, 0], "interval": [share[0, k] - share[0, 0]] * 2}}
        for size in changes.SIZES:
            own = [c for c, case in enumerate(cases) if case.size == size]
            one[size] = mean(share[own, k] - share[own, 0])
        differences.append(one)
    curve = [row for row in rows if not row["size"]]
    return {
        "plant": "mujoco",
        "starts": starts,
        "policies": [
            {"name": name, "randomised": k > 0, "history": 4 * (k > 1)} for k, name in enumerate(names)
        ],
        "thrust": sorted(curve, key=lambda row: row["parameters"]["scale"]["value"]),
        "effects": [row for row in rows if row["size"]],
        "differences": differences,
    }


def by_thrust(k, case):
    """The first lands between x0.9 and x1.1, the others from x0.8 on; effects cost more when strong."""
    if not case.size:
        return float((0.88 if k == 0 else 0.79) < case.values["scale"] < 1.11)
    rng = np.random.default_rng(list(case.words.encode()))
    return max(0.0, 1.0 - rng.random() * changes.SIZES[case.size] * (0.5 if k == 0 else 0.1))


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
    cases = changes.conditions()
    assert len(cases) == len(changes.THRUSTS) + 3 * len(LIBRARY)
    known = load_vehicle()
    for case in cases:
        check_vehicle(case.vehicle(known))
    assert cases[0].vehicle(known) is known and changes.THRUSTS[0] == 0.7 and changes.THRUSTS[-1] == 1.15
    assert [case.values["scale"] for case in cases[1:10]] == [x for x in changes.THRUSTS if x != 1.0]


@pytest.fixture(scope="module")
def flown(tmp_path_factory):
    """The command on four starts: the shipped policy beside itself under another name."""
    out = tmp_path_factory.mktemp("robust") / "out"
    copy = out.with_name(f"twin{EVIL_FILE}.zip")
    copy.write_bytes(load_policy("landing-nominal").path.read_bytes())
    options = "--every 60 --thrust 0.7 --effect friction mocap_delay"
    assert cli.main(["robustness", "landing-nominal", str(copy), "--out", str(out), *options.split()]) == 0
    return out


def test_the_terminal_shows_every_policy_whole(capsys):
    words.show(made_report(by_thrust, names=("landing-nominal", "landing", "landing-steep")))
    printed = capsys.readouterr().out
    tables = [line for line in printed.splitlines() if not line.endswith(".")]
    assert "…" not in printed and max(map(len, tables)) <= 120
    assert printed.endswith("least under mass: 228 of 251 flights (90.8 % [86.6, 93.8]).\n")
    for name in ("landing-nominal", "randomised, history 4", "second_order_attitude", "x 1.15"):
        assert name in printed


def test_the_folder_has_everything(flown):
    names = {"index.html", "results.md", "robustness.json", "conditions.csv"}
    assert {p.name for p in flown.iterdir()} == names | {f"robustness_{n}.{k}" for n in ("thrust", "matrix")
                                                         for k in ("png", "pdf")}  # fmt: skip
    page = (flown / "index.html").read_text("utf-8")
    assert page.count("data:image/png;base64") == 2 and "mocap_delay" in page
    check_page(page, f"twin{EVIL_FILE}")
    rows = (flown / "conditions.csv").read_text("utf-8").splitlines()
    assert len(rows) == 1 + 2 * (2 + 2 * 3)


def test_names_are_text_in_the_results():
    """Whatever policies are called: the Markdown of harmless names, with other words."""
    reader = MarkdownIt("commonmark", {"html": True}).enable("table")
    kinds = []
    evil = ("<img src=x onerror=alert(1)>", "a|b\n\n`c` *d* **e**", "[x](javascript:alert(1)) ![y](z)")
    for names in (("a", "b", "c"), evil):
        text = words.markdown(made_report(by_thrust, names=names))
        tokens = reader.parse(text)
        inside = [child.type for token in tokens for child in token.children or ()]
        kinds.append(
            [*(token.type for token in tokens), *(kind for kind in inside if kind != "text_special")]
        )
    kinds = [[kind for kind in found if kind != "text"] for found in kinds]
    assert kinds[1] == kinds[0] and "<img" not in text and "image" in kinds[0]


def test_the_counts_are_those_of_the_flights(flown):
    """Twins land alike; enough thrust lands, too little never; friction changes the rest alone."""
    report = json.loads((flown / "robustness.json").read_text("utf-8"))
    assert report["starts"] == 5 and [p["name"] for p in report["policies"]] == [
        "landing-nominal",
        f"twin{EVIL_FILE}",
    ]
    for row in (*report["thrust"], *report["effects"]):
        assert row["outcomes"][0] == row["outcomes"][1]
    weak, known = report["thrust"]
    assert weak["parameters"]["scale"]["value"] == 0.7 and weak["outcomes"][0]["strict"]["count"] == 0
    assert known["outcomes"][0]["strict"]["count"] == 5
    slippery = [row for row in report["effects"] if row["effect"] == "friction"]
    assert [row["outcomes"][0]["strict"]["count"] for row in slippery] == [5, 5, 5]
    assert slippery[2]["outcomes"][0]["at_rest_on_feet"]["count"] == 0  # friction 0.16 on a slope of tan 0.48
    assert all(d["none"]["interval"] == [0.0, 0.0] for d in report["differences"])


def test_thrusts_survived_have_no_gap():
    report = made_report(by_thrust)
    assert [words.survived(report, k) for k in range(3)] == [(0.9, 1.1), (0.8, 1.1), (0.8, 1.1)]
    gap = made_report(lambda k, case: float(case.values.get("scale") not in (0.8, 1.05)))
    assert words.survived(gap, 0) == (0.85, 1.0)
    never = made_report(lambda k, case: 0.0)
    assert np.isnan(words.survived(never, 0)).all() and words.summary(never)["rows"][0][3] == "-"


@pytest.mark.parametrize(
    ("plain", "effects", "said"),
    [
        (
            0.0,
            0.2,
            "that is so: no difference can be told; but where the vehicle differs from the model it improves",
        ),
        (-0.1, 0.2, "it costs some of it; but where the vehicle differs from the model it improves"),
        (0.1, 0.2, "it does improve it; where the vehicle differs from the model it improves"),
        (
            0.0,
            0.0,
            "no difference can be told; where the vehicle differs from the model no difference can be told",
        ),
        (
            0.0,
            -0.2,
            "no difference can be told; but where the vehicle differs from the model it makes it worse",
        ),
    ],
)
def test_the_answer_to_the_paper_follows_the_numbers(plain, effects, said):
    def landed(k, case):
        return 0.7 + (k > 0) * (effects * (1 + 0.1 * len(case.words) / 30) if case.size else plain)

    sentences = words.sentences(made_report(landed, names=("nominal", "randomised")))
    assert said in sentences[1] and words.REMARK in sentences[1]


def test_a_policy_that_is_not_randomised_answers_nothing():
    report = made_report(by_thrust)
    for policy in report["policies"]:
        policy["randomised"] = False
    assert not any(words.REMARK in sentence for sentence in words.sentences(report))
    assert words.sentences(made_report(by_thrust, names=("nominal",))) == []


def test_pictures_show_every_number(tmp_path):
    report = made_report(by_thrust)
    curve, heat = figures.thrust_figure(report), figures.matrix_figure(report)
    left, right = curve.axes
    for axes, factor in ((left, 1.0), (right, 0.9)):
        for k, line in enumerate([line for line in axes.lines if line.get_gid() == "share"]):
            found = [100 * row["outcomes"][k]["strict"]["share"] for row in report["thrust"]]
            np.testing.assert_allclose(line.get_ydata(), factor * np.array(found), atol=0.3)
    for axes in heat.axes:
        assert len([c for c in axes.collections if c.get_gid() == "cells"]) == 3
        assert len([t for t in axes.texts if t.get_text().isdigit()]) == 3 * 3 * len(LIBRARY)
    heat.savefig(tmp_path / "heat.png", dpi=80)
    with Image.open(tmp_path / "heat.png") as image:
        assert image.width > 600


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (("touchdown",), "for the task touchdown, not for landing"),
        (("landing", "landing"), "landing is named twice"),
        (("landing", "--effect", "gremlins"), "unknown effect gremlins"),
        (("landing", "--thrust", "0"), "--thrust must be above 0 and at most 3"),
        (("landing", "--every", "0"), "--every must"),
        (("landing", "--plant", "paper"), "unknown plant"),
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
    with pytest.raises(UserError, match="platforms of different inclination"):
        changes.evaluate({"landing": load_policy("landing-nominal"), "flat": flat})
