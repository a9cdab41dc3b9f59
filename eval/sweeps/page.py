"""One page of what sweeps found, for the browser and for the documentation: `landing-train sweep --page`.

A sweep is its folder, or a recipe in which its result stands (`landing-train sweep --record`). Figure and
video are those that its commands made; of a recipe alone, those that the documentation has of it already.
"""

from __future__ import annotations

import base64
import dataclasses
import os
import re
from collections.abc import Sequence
from pathlib import Path

from inclined_landing.envs.shared import measured, runs
from inclined_landing.envs.shared.measured import VERDICTS, Measured, Result, bar_words
from inclined_landing.envs.shared.recipe import Number, Recipe, read_recipe, run_name
from inclined_landing.envs.shared.statistics import number as rounded
from inclined_landing.envs.shared.tables import say
from inclined_landing.eval.base import page as base_page
from inclined_landing.eval.base.markdown import literal, table
from inclined_landing.eval.sweeps.picture import variants_figure
from inclined_landing.models import storage
from inclined_landing.models.errors import UserError, shown

TITLE = "Beyond the paper"
INTRODUCTION = (
    "What the paper did not do, as recipes that anybody can run again. Medians and ranges are over seeds "
    "that were never used before, means have a 95 % interval. Each bar was set beforehand; it says which of "
    "median, mean and worst seed has to meet it."
)
NAME = "beyond"  # of the page and of the folder of its pictures
LARGEST = {".png": 2_000_000, ".gif": 1_258_291}  # bytes of a figure and of a video, 1.2 MB
_SIGNATURES = {".png": b"\x89PNG\r\n\x1a\n", ".gif": b"GIF8"}


@dataclasses.dataclass(frozen=True)
class Found:
    """What the page shows of one sweep."""

    recipe: Recipe
    result: Result
    pictures: dict[str, bytes]  # by suffix, .png and .gif

    @property
    def answer(self) -> str:
        """Return the answer in one sentence, its numbers filled in; "" where the recipe has none."""
        return self.result.answer(self.recipe.answer)

    @property
    def anchor(self) -> str:
        """Return the anchor of its section, as Markdown makes it of the title."""
        return re.sub(r"[-\s]+", "-", re.sub(r"[^\w\s-]", "", self.recipe.title.lower()).strip())

    @property
    def verdict(self) -> str:
        """Return how many of its bars are met."""
        return self.result.verdict

    @property
    def heads(self) -> tuple[str, ...]:
        """Return the headings of its table."""
        if self._by_variant:
            return ("variant", *map(_heading, self.recipe.numbers.values()))
        variant = ("variant",) if "" not in self.recipe.variants else ()
        return (*variant, "number", "median (range)", "mean [95 %]", "bar", "")

    @property
    def rows(self) -> list[tuple[str, ...]]:
        """Return its table: a row for each variant, or for each number of each."""
        recipe, result = self.recipe, self.result
        if self._by_variant:
            return [
                (variant, *(_cell(result.of(variant, name)) for name in recipe.numbers))
                for variant in recipe.variants
            ]
        rows: list[tuple[str, ...]] = [
            (m.variant, m.number.title, m.words, m.interval_words, bar_words(m.number), VERDICTS[m.met])
            for m in result.measured
        ]
        return rows if "" not in recipe.variants else [row[1:] for row in rows]

    @property
    def _by_variant(self) -> bool:
        return len(self.recipe.variants) > len(self.recipe.numbers)

    @property
    def runs(self) -> str:
        """Return how often it was done, and what that took."""
        seeds = self.recipe.seeds
        named = ", ".join(map(str, seeds[:12])) + (" ..." if len(seeds) > 12 else "")
        variants = f"{len(self.recipe.variants)} variants. " if len(self.recipe.variants) > 1 else ""
        return f"{variants}{'Seeds' if len(seeds) > 1 else 'Seed'} {named}. {self.result.cost}"


def write_page(sweeps: Sequence[Path], out: Path | None, site: Path | None) -> None:
    """Write the page of sweeps; print the names of its files and the answers.

    sweeps: folders of sweeps, or recipes with a result. out: new folder for beyond.html, which holds its
    pictures, and for these as files. site: folder of a documentation: beyond.md there, pictures in its folder
    beyond; what is there is replaced. Raises UserError for what is no sweep.
    """
    if out is not None:
        runs.check_new_run(out)
    if site is not None:
        if not os.path.isdir(site):
            raise UserError(f"--site {shown(site, 60)} is no folder")
        storage.check_file(site / f"{NAME}.md")
        storage.check_folder(site / NAME)
    found = [_find(path, None if site is None else site / NAME) for path in sweeps]
    for what, names in (
        ("recipe", [one.recipe.name for one in found]),
        ("title", [one.anchor for one in found]),
    ):
        if twice := sorted({name for name in names if names.count(name) > 1}):
            raise UserError(f"the {what} {twice[0]} is there twice")
    written: list[Path] = []
    if site is not None:
        (site / NAME).mkdir(parents=True, exist_ok=True)
        written += _write_pictures(found, site / NAME)
        storage.write_text(site / f"{NAME}.md", markdown(found))
        written.append(site / f"{NAME}.md")
    if out is not None:
        with runs.staged_run(out) as folder:
            _write_pictures(found, folder)
            storage.write_text(folder / f"{NAME}.html", html(found))
        written.append(out / f"{NAME}.html")
    for path in written:
        print(path)
    for one in found:
        answer = f" {one.answer}" if one.answer else ""
        say(f"{one.recipe.title}: {one.verdict}.{answer}")


def html(found: list[Found]) -> str:
    """Return the page, with its pictures in it."""
    kinds = {".png": "image/png", ".gif": "image/gif"}
    pictures = {
        (one.recipe.name, suffix): f"data:{kinds[suffix]};base64,{base64.b64encode(data).decode('ascii')}"
        for one in found
        for suffix, data in one.pictures.items()
    }
    return base_page.render(
        __package__,
        "beyond.html.j2",
        title=TITLE,
        introduction=INTRODUCTION,
        short=[(one.recipe.title, one.answer, one.verdict) for one in found],
        found=found,
        pictures=pictures,
        versions=runs.versions(),
    )


def markdown(found: list[Found]) -> str:
    """Return the same for the documentation; pictures lie in the folder `beyond` beside it."""
    lines = [f"# {TITLE}", "", INTRODUCTION, ""]
    rows: list[tuple[str, ...]] = [
        (f"[{literal(one.recipe.title)}](#{one.anchor})", literal(one.answer), literal(one.verdict))
        for one in found
    ]
    lines += table(("what", "answer", "bars"), rows, str)
    for one in found:
        recipe = one.recipe
        lines += ["", f"## {literal(recipe.title)}", "", f"*{literal(recipe.question)}*", ""]
        lines += [literal(one.answer), ""] if one.answer else []
        lines += table(one.heads, one.rows, literal)
        for suffix, what in ((".png", "figure"), (".gif", "a flight")):
            if suffix in one.pictures:
                lines += ["", f"![{literal(recipe.title)}: {what}]({NAME}/{recipe.name}{suffix})"]
        lines += ["", f"{one.runs} Once more:", "", "```sh", one.result.command, "```"]
    return "\n".join(lines) + "\n"


def _find(path: Path, pictures: Path | None) -> Found:
    """Return what there is of a sweep: its folder, or a recipe with a result. pictures: where more may be."""
    if not path.is_dir():
        recipe = read_recipe(path)
        return Found(recipe, measured.read(recipe, recipe.result), _kept(recipe.name, pictures))
    recipes = list(path.glob("*.toml"))
    if len(recipes) != 1:
        raise UserError(f"{path} is no folder of a sweep: it holds {len(recipes)} recipes, not one")
    recipe = read_recipe(recipes[0])
    if not (path / "result.json").is_file():
        raise UserError(f"the sweep in {path} is not finished; landing-train sweep goes on with it")
    result = measured.read(recipe, storage.read_json(path / "result.json", "result"))
    places = {"run": path / run_name(*recipe.runs()[0]), "sweep": path}
    made = {}
    for suffix, wanted in ((".png", recipe.figure), (".gif", recipe.video)):
        if wanted is not None:
            place, _, rest = wanted.partition("/")
            made[suffix] = _picture(places[place.strip("{}")] / rest, suffix)
    if recipe.figure is None and len(recipe.variants) > 1:
        made[".png"] = base_page.png(variants_figure(recipe, result))
    return Found(recipe, result, _kept(recipe.name, pictures) | made)


def _heading(number: Number) -> str:
    unit = f" [{number.unit}]" if number.unit != "1" else ""
    bar = f", {bar_words(number)}" if number.bar is not None else ""
    return f"{number.title}{unit}: median (range) [95 % of the mean]{bar}"


def _cell(m: Measured) -> str:
    ends = "" if m.interval is None else f" [{', '.join(map(rounded, m.interval))}]"
    verdict = "" if m.met is None else f", {VERDICTS[m.met]}"
    return f"{m.range_words}{ends}{m.never_words}{verdict}"


def _kept(name: str, folder: Path | None) -> dict[str, bytes]:
    """Return the pictures that the documentation has of a recipe."""
    files = {} if folder is None else {suffix: folder / f"{name}{suffix}" for suffix in LARGEST}
    return {suffix: _picture(file, suffix) for suffix, file in files.items() if file.is_file()}


def _picture(path: Path, suffix: str) -> bytes:
    data = storage.read_bytes(path, "picture", LARGEST[suffix])
    if not data.startswith(_SIGNATURES[suffix]):
        raise UserError(f"picture {path} is no {suffix[1:].upper()} file")
    return data


def _write_pictures(found: list[Found], folder: Path) -> list[Path]:
    """Write the pictures as files, named after their recipes, and return their paths."""
    paths = []
    for one in found:
        for suffix, data in one.pictures.items():
            paths.append(folder / f"{one.recipe.name}{suffix}")
            storage.write_bytes(paths[-1], data)
    return paths
