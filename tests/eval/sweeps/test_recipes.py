"""Recipes and what came out: read strictly, summed up by known truths, shown on one page."""

import copy
import json
import math
import re

import pytest
import tomlkit
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import binomtest

from inclined_landing.envs.shared import measured
from inclined_landing.envs.shared.measured import Ran, Result, sum_up, take
from inclined_landing.envs.shared.recipe import COMMANDS, Number, Recipe, filled, read_recipe
from inclined_landing.eval import cli
from inclined_landing.eval.sweeps import page as sweep_page
from inclined_landing.eval.sweeps.picture import variants_figure
from inclined_landing.models.errors import UserError
from inclined_landing.train.cli import main as train
from inclined_landing.train.sweep.command import shipped

GOOD = {
    "title": "Two ways",
    "question": "Which one lands?",
    "answer": "{a.share} against {b.share}, by braces {{like these}}.",
    "train": ["landing", "--steps", "100"],
    "seeds": [1, 2, 3],
    "variants": {"a": [], "b": ["--gamma", "0.9"]},
    "evaluate": [["success", "{run}/final.zip", "--seed", "{seed}", "--out", "{run}/s"]],
    "together": [["curves", "{runs}", "--out", "{sweep}/curves.png"]],
    "figure": "{sweep}/curves.png",
    "video": "{run}/v.gif",
    "numbers": {
        "share": {
            "file": "s/success.json", "path": "conditions.0.grid", "unit": "%", "factor": 100,
            "better": "higher", "bar": 90, "over": "worst",
        },
        "steps": {"file": "metrics.json", "path": ["steps"], "unit": "1", "better": "lower"},
    },
}  # fmt: skip
PNG, GIF = b"\x89PNG\r\n\x1a\n" + bytes(20), b"GIF89a" + bytes(20)


def write(folder, data, name="two.toml"):
    path = folder / name
    path.write_text(tomlkit.dumps(data), "utf-8")
    return path


def number(**changed) -> Number:
    given = {"name": "n", "title": "n", "file": "m.json", "path": ("n",), "unit": "%", "factor": 1.0}
    return Number(**given | {"better": "higher", "bar": None, "over": "median"} | changed)


# ---- the file


def test_a_recipe_is_read_as_it_is_written(tmp_path):
    recipe = read_recipe(write(tmp_path, GOOD))
    assert (recipe.name, recipe.train, recipe.seeds) == ("two", ("landing", "--steps", "100"), (1, 2, 3))
    assert recipe.variants == {"a": (), "b": ("--gamma", "0.9")}
    assert recipe.numbers["share"].path == ("conditions", 0, "grid") and recipe.numbers["share"].bar == 90
    assert recipe.numbers["steps"].path == ("steps",) and recipe.numbers["steps"].over == "median"
    assert recipe.runs()[:3] == [("a", 1), ("b", 1), ("a", 2)] and len(recipe.runs()) == 6


def _places(value, way=()):
    """Every place in a recipe, the whole left out."""
    items = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    for key, inner in items:
        yield (*way, key)
        yield from _places(inner, (*way, key))


leaves = st.one_of(
    st.text(st.characters(codec="utf-8", exclude_characters="\0"), max_size=8),
    st.integers(-(2**63), 2**63 - 1),
    st.floats(),
    st.booleans(),
    st.sampled_from(
        ["{run}", "{seed", "}", "{runs}x", "--seed=3", "--out", "../x.json", "/x.json", "{nobody}"]
    ),
)
odd = st.recursive(
    leaves,
    lambda inner: (
        st.lists(inner, max_size=3) | st.dictionaries(st.text("ab.-_ ", max_size=4), inner, max_size=2)
    ),
    max_leaves=4,
)


@given(data=st.data())
@settings(max_examples=60, deadline=None)
def test_whatever_stands_in_a_recipe_is_read_or_refused_in_one_sentence(data, tmp_path_factory):
    recipe = copy.deepcopy(GOOD)
    *way, last = data.draw(st.sampled_from(sorted(_places(GOOD), key=str)))
    table = recipe
    for key in way:
        table = table[key]
    if data.draw(st.booleans()):
        table[last] = data.draw(odd)
    elif isinstance(table, dict):
        del table[last]
        table[data.draw(st.text("abcz", min_size=1, max_size=5))] = data.draw(odd)
    path = write(tmp_path_factory.mktemp("odd", numbered=True), recipe)
    try:
        read = read_recipe(path)
    except UserError as error:
        assert str(path) in str(error) and str(error).isprintable() and len(str(error)) < 400 + len(str(path))
    else:
        assert read.runs() and read.numbers and len(set(read.seeds)) == len(read.seeds)
        assert all(isinstance(word, str) and word for words in read.evaluate for word in words)
        assert not {"--seed", "--out"} & set(read.train or ())


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        ({"unknown": 1}, "unknown entry 'unknown'"),
        ({"title": ""}, "title must be text of 1 to 120 characters, not ''"),
        ({"train": "landing"}, "train must be a list"),
        ({"train": ["landing", "--seed", "3"]}, "--seed is not the recipe's to say"),
        ({"variants": {"a": ["--no_report"]}}, "--no_report is not the recipe's to say"),
        ({"seeds": []}, "seeds must be a list of 1 to 100 entries"),
        ({"seeds": [1, 1]}, "a seed is listed twice"),
        ({"seeds": [True]}, "seeds[0] must be a whole number from 0 to 4294967295, not True"),
        ({"evaluate": [["success", "{file}"]]}, "{file} is not known there"),
        ({"evaluate": [["success", "{run.__class__}/x"]]}, "{run.__class__} is not known there"),
        ({"evaluate": [["success", "{run!r}", "{}"]]}, "{run!r} is not known there"),
        ({"evaluate": [["success", "{run"]]}, "{ is not known there"),
        (
            {"evaluate": [["success"], ["fly", "--simulated"]]},
            "evaluate 2: 'fly' is no command that a recipe",
        ),
        ({"together": [["{run}"]]}, "'{run}' is no command that a recipe may run: those are success"),
        ({"figure": "{run}/{seed}.png"}, "{seed} is not known there"),
        ({"seeds": [*range(101)]}, "seeds must be a list of 1 to 100 entries, each"),
        ({"variants": {f"v{k}": [] for k in range(101)}}, "variants must be a table of at most 100 entries"),
        ({"variants": {f"v{k}": [] for k in range(99)}, "seeds": [*range(99)]}, "are 9801 runs"),
        (
            {"numbers": {f"n{k}": GOOD["numbers"]["share"] for k in range(51)}},
            "numbers must be a table of 1 to 50 entries",
        ),
        ({"title": "x" * 121}, "title must be text of 1 to 120 characters"),
        ({"together": [["curves", "{seed}"]]}, "{seed} is not known there"),
        ({"variants": {"a/b": []}}, "must be made of at most 40 letters"),
        ({"answer": "{a.nothing}"}, "{a.nothing} is no number of it; write {a.share}"),
        ({"answer": "{a.share:.2f}"}, "braces hold the name of a number"),
        ({"answer": "{"}, "answer: "),
        ({"numbers": {}}, "numbers must be a table of 1 to 50 entries, not {}"),
        ({"figure": "curves.png"}, "figure must be a .png file in {run}/ or {sweep}/"),
        ({"video": "{run}/../v.gif"}, "video must be a .gif file"),
    ],
)
def test_what_is_wrong_is_named(change, sentence, tmp_path):
    with pytest.raises(UserError) as refused:
        read_recipe(write(tmp_path, GOOD | change))
    assert sentence in str(refused.value)


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        ({"file": "/etc/x.json"}, "in the run folder"),
        ({"file": "../x.json"}, "in the run folder"),
        ({"file": "{run}/x.json"}, "{run} is not known there"),
        ({"path": ""}, "path must be 1 to 20 keys"),
        ({"better": "more"}, "better must be 'higher' or 'lower', not 'more'"),
        ({"over": "best"}, "over must be 'mean' or 'median' or 'worst', not 'best'"),
        ({"bar": math.nan}, "bar must be a number"),
        ({"bar_for": ["nobody"]}, "bar_for must be a list of variants"),
        ({"factor": 0}, "factor must be a number above 0, not 0"),
        ({"places": 2}, "unknown entry 'places'"),
    ],
)
def test_what_is_wrong_with_a_number_is_named(change, sentence, tmp_path):
    data = copy.deepcopy(GOOD)
    data["numbers"]["share"] |= change
    with pytest.raises(UserError) as refused:
        read_recipe(write(tmp_path, data))
    assert sentence in str(refused.value) and "[numbers.share]" in str(refused.value)


def test_names_in_commands_are_filled_in():
    names = {"run": "r/1", "runs": ["r/1", "r/2"], "seed": "7"}
    assert filled(["{runs}", "--out", "{run}/{seed}.png"], names) == ["r/1", "r/2", "--out", "r/1/7.png"]


# ---- numbers over seeds


def test_flights_of_all_seeds_are_one_share_with_wilsons_interval():
    found = sum_up(
        "", number(factor=100.0), [("flights", (9, 10)), ("flights", (30, 30)), ("flights", (5, 10))]
    )
    interval = binomtest(44, 50).proportion_ci(method="wilson")
    assert found.values == (90.0, 100.0, 50.0) and found.median == 90.0 and found.mean == pytest.approx(88.0)
    assert found.interval == pytest.approx((100 * interval.low, 100 * interval.high))
    assert found.words == "90 (50 to 100) %"


def test_true_and_false_are_a_share_of_the_seeds():
    found = sum_up("", number(), [("share", True), ("share", False), ("share", True)])
    interval = binomtest(2, 3).proportion_ci(method="wilson")
    assert found.mean == pytest.approx(2 / 3) and found.interval == pytest.approx(
        (interval.low, interval.high)
    )


@given(st.lists(st.floats(-1e6, 1e6), min_size=2, max_size=8))
@settings(max_examples=30, deadline=None)
def test_the_bootstrap_lies_within_the_values_and_around_their_mean(values):
    found = sum_up("", number(), [("number", value) for value in values])
    low, high = found.interval
    room = 1e-9 * (1 + max(map(abs, values)))  # rounding of the mean of eight numbers
    assert min(values) - room <= low <= found.mean + room and found.mean - room <= high <= max(values) + room


@pytest.mark.parametrize(
    ("values", "better", "over", "bar", "held", "met"),
    [
        ([97, 99, 98], "higher", "median", 98, 98, True),
        ([97, 99, 98], "higher", "worst", 98, 97, False),
        ([97, 99, 98], "higher", "mean", 98, 98, True),
        ([3, 1, 2], "lower", "worst", 2, 3, False),
        ([3, 1, 2], "lower", "median", 2, 2, True),
        ([None, 1, 2], "lower", "median", 2, 2, True),
        ([None, None, 2], "lower", "median", 2, None, False),
        ([None, 99, 97], "higher", "median", 98, 97, False),
        ([None, 99, 99], "higher", "worst", 98, None, False),
        ([None, 99, 99], "higher", "mean", 98, None, False),
        ([1, 2, 3], "lower", "median", None, 2, None),
    ],
)
def test_what_is_held_against_the_bar(values, better, over, bar, held, met):
    found = sum_up("", number(better=better, over=over, bar=bar), [("number", value) for value in values])
    assert found.held == held and found.met is met


def test_a_seed_that_never_got_there_is_said():
    found = sum_up("", number(unit="steps", better="lower"), [("number", v) for v in (None, 5, 7)])
    assert (
        found.words == "7 (5 to 7) steps, never in 1 of 3" and found.mean is None and found.interval is None
    )
    assert sum_up("", number(), [("number", None)] * 2).words == "–, never in 2 of 2"


def test_numbers_are_taken_from_where_they_stand(tmp_path):
    (tmp_path / "m.json").write_text(
        '{"n": 3, "t": true, "p": {"count": 2, "of": 4}, "no": null, "l": [1, 2.5], "w": "x"}'
    )

    def of(*path):
        return take(number(path=path), tmp_path)

    assert (of("n"), of("t"), of("p")) == (("number", 3), ("share", True), ("flights", (2, 4)))
    assert of("l", 1) == ("number", 2.5) and of("no") == of("no", "steps") == ("number", None)
    for path in (("x",), ("l", 2), ("n", "x"), ("w",), ("p", "x"), ()):
        with pytest.raises(UserError, match="number n"):
            of(*path)
    (tmp_path / "m.json").unlink()
    with pytest.raises(UserError, match=r"m\.json does not exist"):
        of("n")


def test_what_differs_in_kind_is_no_result():
    with pytest.raises(UserError, match="number in one run and share in another"):
        sum_up("", number(), [("number", 1), ("share", True)])


# ---- results and the page


def result_of(recipe: Recipe) -> Result:
    taken = {
        "share": [("flights", (9, 10)), ("flights", (10, 10)), ("flights", (8, 10))],
        "steps": [("number", 3e5), ("number", None), ("number", 4e5)],
    }
    found = [
        sum_up(variant, n, taken[n.name]) for variant in recipe.variants for n in recipe.numbers.values()
    ]
    took = {"cpu_seconds": 20.5, "wall_seconds": 31.0, "ended": "ended"}
    ran = tuple(Ran(variant=variant, seed=seed, **took) for variant, seed in recipe.runs())
    return Result("landing-train sweep two", "a machine", {"mujoco": "4.0.0"}, (0.5, 2.0), tuple(found), ran)


@pytest.fixture
def folder(tmp_path):
    """A finished sweep."""
    path = tmp_path / "runs"
    (path / "a-1").mkdir(parents=True)
    recipe = read_recipe(write(path, GOOD))
    (path / "result.json").write_text(json.dumps(result_of(recipe).record()).replace("NaN", "null"))
    (path / "curves.png").write_bytes(PNG)
    (path / "a-1" / "v.gif").write_bytes(GIF)
    return path


def test_a_result_comes_back_from_json_and_from_toml(tmp_path):
    recipe = read_recipe(write(tmp_path, GOOD))
    result = result_of(recipe)
    assert measured.read(recipe, result.record()) == result
    again = read_recipe(write(tmp_path, GOOD | {"result": result.record()}, "again.toml"))
    assert measured.read(again, again.result) == result


@pytest.mark.parametrize("wrong", ["most", math.nan, 1e9, None, True])
def test_a_median_that_is_not_that_of_the_values_is_refused(wrong, tmp_path):
    recipe = read_recipe(write(tmp_path, GOOD))
    record = result_of(recipe).record()
    next(entry for entry in record["measured"] if "median" in entry)["median"] = wrong
    with pytest.raises(
        UserError, match=r"\[result\] .*median (must be a number|is .*, not that of the values)"
    ):
        measured.read(recipe, record)


@given(data=st.data())
@settings(max_examples=25, deadline=None)
def test_a_damaged_result_is_refused_in_one_sentence(data, tmp_path_factory):
    recipe = read_recipe(write(tmp_path_factory.mktemp("recipe"), GOOD))
    record = json.loads(json.dumps(result_of(recipe).record()))
    *way, last = data.draw(st.sampled_from(sorted(_places(record), key=str)))
    table = record
    for key in way:
        table = table[key]
    table[last] = data.draw(odd)
    try:
        result = measured.read(recipe, record)
    except UserError as error:
        assert str(error).isprintable() and len(str(error)) < 400
    else:
        assert "two" in sweep_page.markdown([sweep_page.Found(recipe, result, {})])


def test_the_page_has_question_answer_verdict_and_pictures(folder, tmp_path, capsys):
    (tmp_path / "docs").mkdir()
    assert (
        train(["sweep", str(folder), "--page", str(tmp_path / "out"), "--site", str(tmp_path / "docs")]) == 0
    )
    page = (tmp_path / "out" / "beyond.html").read_text("utf-8")
    text = (tmp_path / "docs" / "beyond.md").read_text("utf-8")
    answer = "90 (80 to 100) % against 90 (80 to 100) %, by braces {like these}."
    for shown in (page, text):
        for words in (
            *("Two ways", "Which one lands?", answer, "worst at least 90", "missed", "0 of 2 bars met"),
            *("never in 1 of 3", "landing-train sweep two", "a machine"),
        ):
            assert words in shown, words
    assert page.count("<img") == 2 and "](beyond/two.png)" in text and "[Two ways](#two-ways)" in text
    assert (tmp_path / "docs" / "beyond" / "two.gif").read_bytes() == GIF
    assert (tmp_path / "out" / "two.png").read_bytes() == PNG


def test_many_variants_have_a_row_each(folder, tmp_path):
    data = GOOD | {"variants": GOOD["variants"] | {"c": []}}
    recipe = read_recipe(write(folder, data))
    (folder / "result.json").write_text(json.dumps(result_of(recipe).record()).replace("NaN", "null"))
    assert train(["sweep", str(folder), "--site", str(tmp_path)]) == 0
    text = (tmp_path / "beyond.md").read_text("utf-8")
    assert "| variant | share [%]: median (range) [95 % of the mean], worst at least 90 | steps:" in text
    for variant in "abc":
        assert f"\n| {variant} | 90 (80 to 100) [74.4, 96.5], missed | 400\u202f000 (300\u202f000" in text


def test_a_recipe_with_its_result_stands_for_its_sweep(folder, tmp_path):
    docs = tmp_path / "docs"
    docs.mkdir()
    assert train(["sweep", str(folder), "--site", str(docs)]) == 0
    before = {path: path.read_bytes() for path in docs.rglob("*") if path.is_file()}
    recipe = read_recipe(folder / "two.toml")
    path = write(tmp_path, GOOD | {"result": result_of(recipe).record()})
    assert train(["sweep", str(path), "--site", str(docs)]) == 0
    assert {path: path.read_bytes() for path in docs.rglob("*") if path.is_file()} == before


def test_the_command_of_a_result_is_that_of_a_sweep(tmp_path):
    recipe = read_recipe(write(tmp_path, GOOD))
    record = result_of(recipe).record()
    for command in ("landing-train sweep two --allow 'my files/hop.py:Hop'", "landing-train sweep a/b.toml"):
        assert measured.read(recipe, record | {"command": command}).command == command
    for command in (
        "",
        "landing-train sweep",
        "curl x | sh",
        "landing-train sweep two; rm x",
        "landing-train 'x",
    ):
        with pytest.raises(UserError, match="command must be that of the sweep"):
            measured.read(recipe, record | {"command": command})


def test_panels_of_many_numbers_stand_apart_below_a_long_title(tmp_path):
    names = [f"n{k}" for k in range(15)]
    data = GOOD | {"numbers": {name: GOOD["numbers"]["share"] for name in names}, "title": "word " * 24}
    recipe = read_recipe(write(tmp_path, {key: value for key, value in data.items() if key != "answer"}))
    found = [
        sum_up(variant, n, [("number", k) for k in (1, 2, None)])
        for variant in recipe.variants
        for n in recipe.numbers.values()
    ]
    figure = variants_figure(recipe, Result("c", "m", {}, (0, 1), tuple(found), ()))
    figure.canvas.draw()
    boxes = [axes.get_tightbbox() for axes in figure.axes]
    texts = [text.get_window_extent() for text in figure.texts]
    assert len(boxes) == 15 and figure.get_figwidth() < 15
    for k, box in enumerate((*boxes, *texts)):
        assert figure.bbox.contains(*box.min) and figure.bbox.contains(*box.max)
        assert not any(box.overlaps(other) for other in (*boxes, *texts)[k + 1 :])


def test_the_manual_names_the_commands_of_recipes():
    manual = (shipped()["landing"].parent / "README.md").read_text("utf-8")
    (said,) = re.findall(r"of `landing-eval` the commands that judge and draw: (.*?)\. ", manual, re.S)
    assert re.findall(r"`(\w+)`", said) == list(COMMANDS) and set(COMMANDS) < set(cli.COMMANDS)


def test_variants_without_a_figure_of_their_own_get_one(folder, tmp_path):
    write(folder, {key: value for key, value in GOOD.items() if key != "figure"})
    assert train(["sweep", str(folder), "--page", str(tmp_path / "out")]) == 0
    assert (tmp_path / "out" / "two.png").read_bytes()[:4] == PNG[:4]
    assert len((tmp_path / "out" / "two.png").read_bytes()) > 5000


def test_what_a_recipe_says_is_text_on_the_page(folder, tmp_path):
    (tmp_path / "d").mkdir()
    evil = "<script>alert(1)</script> | `x` ![y](z) [l](javascript:x)"
    write(folder, GOOD | {"title": f"T {evil}", "question": evil, "answer": evil})
    assert train(["sweep", str(folder), "--page", str(tmp_path / "o"), "--site", str(tmp_path / "d")]) == 0
    page, text = (tmp_path / "o" / "beyond.html").read_text(), (tmp_path / "d" / "beyond.md").read_text()
    assert "<script>" not in page and "<script>" not in text and "`x`" not in text
    assert all(line.count("|") in (0, 4, 7) for line in text.splitlines())  # columns of the two tables
    assert not re.search(r"\]\((?!#|beyond/)", text)  # links are those of the page


@pytest.mark.parametrize(
    ("spoil", "sentence"),
    [
        (lambda f: (f / "result.json").unlink(), "is not finished"),
        (lambda f: (f / "two.toml").unlink(), "holds 0 recipes"),
        (lambda f: (f / "curves.png").write_bytes(b"GIF89a"), "is no PNG file"),
        (lambda f: (f / "a-1" / "v.gif").write_bytes(GIF + bytes(1_300_000)), "at most 1258291"),
        (lambda f: (f / "a-1" / "v.gif").unlink(), "does not exist"),
        (lambda f: (f / "result.json").write_text("[]"), "has no [result] yet"),
        (lambda f: (f / "result.json").write_text("{"), "is not JSON"),
    ],
)
def test_a_folder_that_is_no_sweep(spoil, sentence, folder, tmp_path, capsys):
    spoil(folder)
    assert train(["sweep", str(folder), "--page", str(tmp_path / "out")]) == 2
    said = capsys.readouterr().err
    assert sentence in said and said.count("\n") == 1 and not (tmp_path / "out").exists()


def test_the_page_says_where_it_cannot_stand(folder, tmp_path, capsys):
    assert train(["sweep", "--page", str(tmp_path / "o")]) == 2
    assert "name at least one sweep" in capsys.readouterr().err
    assert train(["sweep", str(folder), "--page", str(tmp_path / "o"), "--record"]) == 2
    assert "--page and --site run nothing" in capsys.readouterr().err
    assert train(["sweep", str(folder), str(folder), "--page", str(tmp_path / "o")]) == 2
    assert "is there twice" in capsys.readouterr().err
    assert train(["sweep", str(folder), "--page", str(folder)]) == 2
    assert "not empty" in capsys.readouterr().err


def test_only_the_variants_that_are_named_have_to_meet_the_bar():
    held = number(bar=97.0, bar_for=("hover",))
    assert held.of("hover").bar == 97.0 and held.of("drift").bar is None
    assert number(bar=97.0).of("drift").bar == 97.0
