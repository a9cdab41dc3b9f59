"""The page of recipes and their recorded results, `docs/evidence/recipes.md`.

    python docs/site/recipes.py    # writes the page

A result is that of `landing-train sweep`, copied next to its recipe in `train/recipes`. Figures and films are
those of the commands that the recipe names in a comment, copied into `docs/beyond`; `tasks.gif` shows one
flight each of the recipes for other slopes and platforms.
"""

from __future__ import annotations

import re
from pathlib import Path

from generated import table  # in this folder

from inclined_landing.models.base import schema, storage
from inclined_landing.train.sweep.recipe import Recipe, read_recipe, shipped
from inclined_landing.train.sweep.result import HEADS, Result

ROOT = Path(__file__).parents[2]
PAGE = ROOT / "docs" / "evidence" / "recipes.md"
ORDER = (
    *("landing", "slopes", "steep", "three_dimensions", "mission", "touchdown", "moving"),
    *("vehicles", "vehicles-blind", "vehicles-own", "identified", "ablations", "ablations-settings"),
)
INTRODUCTION = (
    "Results of the shipped [recipes](../../train/recipes/README.md), over seeds that nothing was tuned on: "
    "median and range over the seeds, mean with its 95 % interval, and the bar that every single seed has to "
    "reach. This page is written by `python docs/site/recipes.py`."
)

FILM = "Landings on a steep slope, on a slope that faces sideways, and on a ship"


def recorded(recipe: Recipe, name: str) -> Result:
    """The recorded result of a recipe; raises an error where it is damaged or of another recipe."""
    path = shipped()[name].with_suffix(".json")
    result = schema.parse(storage.read_json(path, "result"), Result, f"{path}: ")
    found = [(one.variant, one.number) for one in result.measured if len(one.values) == len(recipe.seeds)]
    if found != [(variant, number) for variant in recipe.variants for number in recipe.numbers]:
        raise ValueError(f"{path} is not the result of its recipe")
    return result


def page() -> str:
    """The page as Markdown."""
    sections, answers = [], []
    for name in ORDER:
        recipe = read_recipe(shipped()[name])
        result = recorded(recipe, name)
        anchor = re.sub(r"[-\s]+", "-", re.sub(r"[^\w\s-]", "", recipe.title.lower()).strip())
        answers.append([f"[{recipe.title}](#{anchor})", result.answer(recipe)])
        sections.append(_section(name, recipe, result))
    film = f"![{FILM}](../beyond/tasks.gif)\n"
    head = ["# Evidence: recipes\n", INTRODUCTION + "\n", table(["recipe", "answer"], answers), film]
    return "\n".join([*head, *sections])


def _section(name: str, recipe: Recipe, result: Result) -> str:
    rows, heads = [list(row) for row in result.rows(recipe)], list(HEADS)
    if "" in recipe.variants:
        rows, heads = [row[1:] for row in rows], heads[1:]
    pictures = [
        f"{name}{suffix}"
        for suffix in (".png", ".gif")
        if (ROOT / "docs/beyond" / f"{name}{suffix}").is_file()
    ]
    return "\n".join(
        [
            f"## {recipe.title}\n",
            f"*{recipe.question}*\n",
            table(heads, rows),
            *(f"![{recipe.title}](../beyond/{picture})\n" for picture in pictures),
            f"Seeds {', '.join(map(str, recipe.seeds))}. {result.cost()} {_versions(result)}\n",
            "To run it again:\n",
            f"```sh\n{result.command}\n```\n",
        ]
    )


def _versions(result: Result) -> str:
    """Return a sentence with the commits at which a recipe was run."""
    revision = str(result.versions.get("git revision"))
    commits = re.sub(r"([0-9a-f]{8})[0-9a-f]{32}", r"\1", revision).replace("+changes", " with changes")
    first, *others = commits.split(" and ")
    if not others:
        return f"It was run at commit {first}."
    return f"It was run at the commits {', '.join([first, *others[:-1]])} and {others[-1]}."


if __name__ == "__main__":
    PAGE.write_text(page(), "utf-8")
