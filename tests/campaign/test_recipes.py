"""Recipes that would do what no recipe may, and recipes with one entry wrong: checked, never run."""

import contextlib
import functools
import tomllib
from pathlib import Path

from inclined_landing.envs.shared.recipe import COMMANDS, OLD_COMMANDS, read_recipe
from inclined_landing.eval import cli
from inclined_landing.train import cli as train
from inclined_landing.train.sweep import jobs
from inclined_landing.train.sweep.check import check
from inclined_landing.train.sweep.command import shipped
from tests.campaign.commands import NEEDED, options
from tests.campaign.judge import TEXTS, Case, Wrong, command, judge, mutations, parametrised, spoilt, write
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
    return spelt(tomllib.loads(GOOD) | changes)


def entries():
    """Every entry times every evil value."""
    good = tomllib.loads(GOOD)
    yield case("good", lambda: spelt(good))
    for name, change in spoilt(good):
        yield case(f"entry {name}", lambda change=change: spelt(change(good)), named="")


def texts():
    """Files of other kinds, and the bytes of a good one damaged."""
    for name, content in TEXTS.items():
        yield case(name, lambda content=content: content)
    for name, make in mutations(GOOD.encode(), 200):
        yield case(f"mutation {name}", make, named="")


def words(name: str) -> list[str]:
    """A command of landing-eval with what it needs, without --out."""
    given = list(NEEDED[name])
    if "--out" in given:
        at = given.index("--out")
        del given[at : at + 2]
    return [name, *(word.replace("{place}", "{run}") for word in given)]


def foreign():
    """Python in place of every word and in every option that is text; and of everything that is trained."""
    for name in COMMANDS:
        given = words(name)
        out = ["--out", "{run}/s"]
        places = [
            [*given[:k], None, *given[k + 1 :], *out]
            for k in range(1, len(given))
            if given[k][0] != "-" and name != "curves"  # whose words are folders
        ]
        places += [
            [*given, f"--{o}", None, *out] for o, about in options(name).items() if "str" in str(about.kind)
        ]
        for place in places:
            for path in PYTHON:
                filled = [path if word is None else word for word in place]
                yield case(
                    f"{' '.join(filled)}",
                    lambda filled=filled: changed(evaluate=[filled]),
                    accepted,
                    named="",
                )
    for option, about in options("train").items():
        if "str" in str(about.kind):
            for path in PYTHON[:2]:
                train = ["landing", f"--{option}={path}"]
                yield case(f"train {option} {path}", lambda train=train: changed(train=train), accepted, "")
    for path in (*PYTHON[:2], "foreign:Fly"):
        yield case(f"task {path}", lambda path=path: changed(train=[path]), accepted, "")


def outputs():
    """Every command that would write where it may not."""
    for name in COMMANDS:
        for kind, out in ELSEWHERE.items():
            for where in ("evaluate", "together"):
                for form in (["--out", out], [f"--out={out}"]):
                    if kind == "the run's link" and where == "together":
                        continue
                    filled = [[*words(name), *form]]
                    yield case(
                        f"{name} {where} {kind} {len(form)}",
                        lambda where=where, filled=filled: changed(**{where: filled}),
                        accepted,
                        named="",
                    )


def others():
    """Commands that fly vehicles, open ports, or are about something else, and options that no recipe has."""
    for name in [*cli.COMMANDS, *cli.OLD_NAMES, "sweep", "", "--help"]:
        if name not in (*COMMANDS, *OLD_COMMANDS):
            for where in ("evaluate", "together"):
                filled = {where: [[name, *words(name)[1:]] if name in NEEDED else [name or "{run}"]]}
                yield case(f"{where} {name}", lambda filled=filled: changed(**filled), accepted, named=where)
    for word in ("--out", "--seed", "--resume", "--report", "--no-report", "--threads", "--no_report"):
        for form in ([word], [f"{word}=1"], [word, "1"]):
            for filled in ({"train": ["landing", *form]}, {"variants": {"short": form}}):
                title = f"{next(iter(filled))} {' '.join(form)}"
                yield case(title, lambda filled=filled: changed(**filled), accepted, named="")
    for word in ("--help", "--version", "--tyro-write-completion", "--print-completion"):
        filled = [word, "bash", "written"][: 1 if word in ("--help", "--version") else 3]
        yield case(f"train {word}", lambda filled=filled: changed(train=filled), accepted, named="")
        for name in COMMANDS:
            make = functools.partial(changed, evaluate=[[name, *filled]])
            yield case(f"{name} {word}", make, accepted, named="")


@parametrised(entries, texts, foreign, outputs, others, each=3)
def test_recipes_are_taken_or_refused_and_nothing_is_run(case, tmp_path):
    judge(case, tmp_path)


def results():
    """A recorded result with one entry wrong, on a page."""
    recipe = shipped()["landing"]
    good = tomllib.loads(recipe.read_text("utf-8"))
    for name, change in spoilt(good["result"]):

        def made(folder, change=change):
            return write(folder / "landing.toml", spelt(good | {"result": change(good["result"])}))

        yield Case(
            f"result {name}",
            made,
            lambda path: command(train.main, ["sweep", str(path), "--page", str(path.parent / "page")]),
            named="",
        )


@parametrised(results, each=3)
def test_results_are_shown_or_refused(case, tmp_path):
    judge(case, tmp_path)
