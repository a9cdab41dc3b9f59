"""Reader of recipes (TOML): command lines, their seeds, and the numbers to read from their output.

train/recipes/README.md is their manual.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from importlib import resources
from pathlib import Path
from typing import Annotated, Literal

from msgspec import Meta, field

from inclined_landing.envs.shared.options import Seed
from inclined_landing.models.base import schema, storage
from inclined_landing.models.base.errors import UserError, choices, shown
from inclined_landing.models.base.schema import Real, Table

Text = Annotated[str, Meta(min_length=1, max_length=1000)]
Name = Annotated[str, Meta(pattern=r"^[A-Za-z0-9][A-Za-z0-9_.-]{0,39}$")]


class Number(Table, frozen=True, kw_only=True):
    """A number that every run writes to a JSON file below its folder. It is at a path of keys separated by
    dots or, if the file contains the rows of a study, an entry of the first row with the given labels.
    """

    title: Text
    file: Text
    path: Text = ""
    row: dict[Text, str | float] = field(default_factory=dict)
    entry: Literal["value", "low", "high", "min", "max"] = "value"  # of that row
    unit: Text = "1"
    factor: Annotated[float, Meta(gt=0, le=1e300)] = 1.0  # times what the file says
    at_least: Real | None = None  # the bar for every seed, in the unit


class Recipe(Table, frozen=True, kw_only=True):
    """A recipe: `commands` are run in order for every seed and variant."""

    title: Text
    question: Text
    answer: Text = ""  # with {number}, or {variant.number}
    seeds: Annotated[tuple[Seed, ...], Meta(min_length=1, max_length=100)]
    variants: Annotated[dict[Name, str], Meta(min_length=1)] = field(default_factory=lambda: {"": ""})
    commands: Annotated[tuple[Text, ...], Meta(min_length=1)]
    numbers: Annotated[dict[Name, Number], Meta(min_length=1)]

    def runs(self) -> list[tuple[str, int]]:
        """Return variant and seed of every run, ordered by seed."""
        return [(variant, seed) for seed in self.seeds for variant in self.variants]


def shipped() -> dict[str, Path]:
    """Return the shipped recipes by name."""
    folder = Path(str(resources.files("inclined_landing.train") / "recipes"))
    return {path.stem: path for path in sorted(folder.glob("*.toml"))}


def read_recipe(path: Path) -> Recipe:
    """Read a recipe; raises UserError, naming file and entry, for anything that is wrong."""
    data = storage.read_toml(path, "recipe")
    try:
        recipe = schema.parse(data, Recipe)
        if len(set(recipe.seeds)) < len(recipe.seeds):
            raise UserError("a seed is listed twice")
        for name, number in recipe.numbers.items():
            if bool(number.path) == bool(number.row):
                raise UserError(f"number {name} needs either a path or a row")
        numbers = [f"{variant}.{name}".lstrip(".") for variant in recipe.variants for name in recipe.numbers]
        for text in recipe.commands:
            _check_names(text, ["seed", "variant", "options", "out"])
        _check_names(recipe.answer, numbers)
    except UserError as error:
        raise UserError(f"recipe {shown(path, 200)}: {error}") from error
    return recipe


def filled(text: str, values: Mapping[str, str]) -> str:
    """Return a text in which the names in braces are replaced by their values, if they have one."""
    return re.sub(r"\{([^{}]*)\}", lambda found: values.get(found[1], found[0]), text)


def _check_names(text: str, known: list[str]) -> None:
    """Raise UserError for braces around anything other than a known name."""
    for name in re.findall(r"\{([^{}]*)\}", text):
        if name not in known:
            raise UserError(
                f"unknown placeholder {{{shown(name, 40)}}} in {shown(text, 80)}; {choices(known, name)}"
            )
