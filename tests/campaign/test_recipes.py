"""Recipes that would do what no recipe may, and recipes with one entry wrong: checked, never run."""

import contextlib
import tomllib
from pathlib import Path

import hypothesis
import hypothesis.strategies as st
import pytest
from hypothesis import given

from inclined_landing.envs.shared.recipe import COMMANDS, OLD_COMMANDS, read_recipe
from inclined_landing.eval import cli
from inclined_landing.train import cli as training
from inclined_landing.train.sweep import jobs
from inclined_landing.train.sweep.check import check
from tests import ROOT
from tests.campaign.commands import NEEDED, options
from tests.campaign.judge import Case, Wrong, command, contents, examples, judged, spoilt, write
from tests.campaign.test_toml import spelt

GOOD = """
title = "Small"
question = "Does it land?"
answer = "In {short.strict}."
train = ["landing"]
seeds = [1, 2]
evaluate = [["success", "{run}/final.zip", "--seed", "{seed}", "--out", "{run}/s"]]
together = [["curves", "{runs}", "--out", "{sweep}/c.png"]]
figure = "{sweep}/c.png"
[variants]
short = ["--steps", "1000"]
[numbers.strict]
title = "strict"
file = "s/success.json"
path = ["conditions", 0, "strict"]
unit = "%"
factor = 100
better = "higher"
bar = 98
over = "worst"
bar_for = ["short"]
"""
GOOD_TABLES = tomllib.loads(GOOD)
# Imported, it would leave a file.
FOREIGN = "from pathlib import Path\nPath(__file__).with_name('imported').touch()\n"
PYTHON = (
    "foreign.py:Fly",
    "./foreign.py:Fly",
    "{here}/foreign.py:Fly",
    "foreign:Fly",
    "{here}/x:y/../foreign.py:Fly",
)
ELSEWHERE = {
    "absolute": "/tmp/out",
    "here": "out",
    "above": "{sweep}/../../out",
    "above the run": "{run}/../out",
    "the sweep": "{sweep}",
    "the run": "{run}",
    "the records": "{sweep}/steps/out",
    "the recipe": "{here}/out",
    "through nothing": "{run}/../../../new/../out",
    "over a link": "{sweep}/link/out",
    "through the run's link": "{run}/link/out",
    "what it found": "{sweep}/result.json",
    "a device": "/dev/null",
    "home": "~/out",
}  # fmt: skip


def checked(path: Path):
    """The recipe after everything that is looked at before a sweep begins."""
    with contextlib.chdir(path.parent):
        recipe = read_recipe(path.name)
        folder = Path("runs")
        check(recipe, jobs.of_runs(recipe, folder, Path()), jobs.of_all(recipe, folder, Path()))
    return recipe


def runs(recipe) -> None:
    """It has runs, numbers, and words of text."""
    assert recipe.runs() and recipe.numbers
    assert all(isinstance(word, str) and word for words in recipe.evaluate for word in words)


def accepted(recipe) -> None:
    """For `works` of what must be refused."""
    raise Wrong(f"accepted: {recipe.train}, {recipe.evaluate}, {recipe.together}")


def case(name: str, make, works=runs, named: str | None = None) -> Case:
    def made(folder: Path) -> Path:
        write(folder / "foreign.py", FOREIGN)
        (folder / "runs" / "short-1").mkdir(parents=True)
        for place in ("runs/link", "runs/short-1/link"):
            (folder / place).symlink_to(folder)
        return write(folder / "recipe.toml", make())

    return Case(name, made, checked, works, named=named)


def changed(**changes) -> str:
    return spelt(GOOD_TABLES | changes)


def words(name: str) -> list[str]:
    """A command of landing-eval with what it needs, without --out."""
    given = list(NEEDED[name])
    if "--out" in given:
        at = given.index("--out")
        del given[at : at + 2]
    return [name, *(word.replace("{place}", "{run}") for word in given)]


def refused(title: str, named: str = "", **changes) -> Case:
    """A recipe that is refused with other entries."""
    return case(title[:80], lambda: changed(**changes), accepted, named)


def foreign(name: str, path: str, data) -> Case:
    """Python in place of a word or of an option that is text."""
    given = words(name)
    places = [
        [*given[:k], path, *given[k + 1 :]]
        for k in range(1, len(given))
        if given[k][0] != "-" and name != "curves"  # whose words are folders
    ]
    places += [[*given, f"--{o}", path] for o, about in options(name).items() if "str" in str(about.kind)]
    if not places:
        hypothesis.reject()
    filled = [*data.draw(st.sampled_from(places)), "--out", "{run}/s"]
    return refused(" ".join(filled), evaluate=[filled])


def output(name: str, kind: str, where: str, joined: bool) -> Case:
    """A command that would write where it may not."""
    if kind == "through the run's link" and where == "together":
        kind = "home"
    out = ELSEWHERE[kind]
    filled = [*words(name), *([f"--out={out}"] if joined else ["--out", out])]
    return refused(f"{name} {where} {kind} {joined}", **{where: [filled]})


def other(name: str, where: str) -> Case:
    """A command that flies vehicles, opens ports, or is about something else."""
    filled = [name, *words(name)[1:]] if name in NEEDED else [name or "{run}"]
    return refused(f"{where} {name}", where, **{where: [filled]})


def trained(train: list[str]) -> Case:
    return refused(f"train {train}", train=train)


PROGRAMS = ("--help", "--version", "--tyro-write-completion", "--print-completion")
IDLE = ("--out", "--seed", "--resume", "--report", "--no-report", "--threads", "--no_report")
FORMS = [form for word in IDLE for form in ([word], [f"{word}=1"], [word, "1"])]
KNOWN = (*COMMANDS, *OLD_COMMANDS)
OTHERS = [n for n in (*cli.COMMANDS, "sweep", "", "--help") if n not in KNOWN]
LISTS = st.sampled_from(("evaluate", "together"))
TEXTUAL = st.deferred(
    lambda: st.sampled_from([o for o, about in options("train").items() if "str" in str(about.kind)])
)
NAMES = st.sampled_from(list(COMMANDS))
KINDS = {
    "entries": spoilt(GOOD_TABLES).map(
        lambda s: case(f"entry {s[0]}", lambda: spelt(s[1](GOOD_TABLES)), named="")
    ),
    "texts": contents(GOOD.encode()).map(lambda s: case(*s, named="")),
    "foreign": st.one_of(
        st.builds(foreign, NAMES, st.sampled_from(PYTHON), st.data()),
        st.builds(
            lambda o, path: trained(["landing", f"--{o}={path}"]), TEXTUAL, st.sampled_from(PYTHON[:2])
        ),
        st.sampled_from((*PYTHON[:2], "foreign:Fly")).map(lambda path: trained([path])),
    ),
    "outputs": st.builds(output, NAMES, st.sampled_from(list(ELSEWHERE)), LISTS, st.booleans()),
    "others": st.one_of(
        st.builds(other, st.sampled_from(OTHERS), LISTS),
        st.sampled_from(FORMS).map(lambda form: trained(["landing", *form])),
        st.sampled_from(FORMS).map(lambda form: refused(f"variant {form}", variants={"short": form})),
        st.sampled_from(PROGRAMS).map(lambda word: trained([word, "bash", "written"])),
        st.builds(
            lambda name, word: refused(f"{name} {word}", evaluate=[[name, word, "bash"]]),
            *(NAMES, st.sampled_from(PROGRAMS)),
        ),
    ),
}


@pytest.mark.parametrize("kind", KINDS)
@examples(4)
@given(data=st.data())
def test_recipes_are_taken_or_refused_and_nothing_is_run(kind, data):
    judged(data.draw(KINDS[kind]))


def test_a_good_recipe_is_taken():
    assert judged(case("good", changed)) == "works"


RECORDED = tomllib.loads((ROOT / "train" / "recipes" / "landing.toml").read_text("utf-8"))


@examples(3)
@given(spoilt=spoilt(RECORDED["result"]))
def test_results_are_shown_or_refused(spoilt):
    """A recorded result with one entry wrong, on a page."""
    name, change = spoilt

    def make(folder: Path) -> Path:
        return write(folder / "landing.toml", spelt(RECORDED | {"result": change(RECORDED["result"])}))

    def take(path: Path) -> str:
        return command(training.main, ["sweep", str(path), "--page", str(path.parent / "page")])

    judged(Case(f"result {name}", make, take, named=""))
