"""Reader of recipes (TOML): what is trained and judged, with which seeds, and which numbers are the result.

train/recipes/README.md is their manual.
"""

from __future__ import annotations

import dataclasses
import itertools
import math
import re
import string
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from inclined_landing.models import storage
from inclined_landing.models.errors import UserError, shown

OVER = ("median", "mean", "worst")  # what of the seeds is held against the bar
BETTER = ("higher", "lower")
# What a command may name: of its run, of the whole sweep.
OF_A_RUN = ("run", "seed", "variant", "sweep", "here")
OF_THE_SWEEP = ("run", "runs", "sweep", "here")
OF_THE_PAGE = ("run", "sweep")
# What the sweep itself says to landing-train.
TAKEN = ("--seed", "--out", "--resume", "--threads", "--report", "--no-report")
# The commands of landing-eval that judge and draw policies and runs, and write nothing but --out. Others are
# not a recipe's: they fly a vehicle, open a radio or a window, or are about something else.
COMMANDS = (
    *("success", "touchdown", "mission", "robustness"),
    *("figure", "video", "replay", "curves"),
)
OLD_COMMANDS = ("vehicles", "slopes", "moving", "picture")  # of the last release, still read
# More than people use, few enough for tables and figures to be read.
MOST_SEEDS, MOST_VARIANTS, MOST_RUNS, MOST_NUMBERS = 100, 100, 1000, 50

_KEYS = {
    *("title", "question", "answer", "train", "seeds", "variants", "evaluate", "together"),
    *("numbers", "figure", "video", "result"),
}
_NUMBER_KEYS = {"title", "file", "path", "unit", "factor", "better", "bar", "over", "bar_for"}
_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_.-]{0,39}")
_LONGEST, _WORD, _MOST_WORDS = 1000, 500, 200  # characters of a text and of a word; words of a command
_TITLE, _UNIT = 120, 30  # characters of what stands in tables and figures
_MOST_COMMANDS = 50
_DEEPEST = 20  # steps of a path
_SEEDS = 2**32


@dataclasses.dataclass(frozen=True)
class Number:
    """One number of the result: where a run has it, and what it has to be."""

    name: str
    title: str
    file: str  # JSON, in the run folder
    path: tuple[str | int, ...]  # keys and places in it
    unit: str
    factor: float  # times what the file says
    better: str  # one of BETTER
    bar: float | None  # in the unit
    over: str  # one of OVER
    bar_for: tuple[str, ...] = ()  # variants that have to meet the bar; none: all

    def of(self, variant: str) -> Number:
        """The number as it is for a variant, which may have no bar to meet."""
        if not self.bar_for or variant in self.bar_for:
            return self
        return dataclasses.replace(self, bar=None)


@dataclasses.dataclass(frozen=True)
class Recipe:
    """A recipe as its file says it."""

    name: str
    title: str
    question: str
    answer: str  # with {number} or {variant.number}; may be empty
    train: tuple[str, ...] | None  # arguments of landing-train; None: nothing is trained
    seeds: tuple[int, ...]
    variants: dict[str, tuple[str, ...]]  # more arguments by name; {"": ()} without variants
    evaluate: tuple[tuple[str, ...], ...]  # arguments of landing-eval, for each run
    together: tuple[tuple[str, ...], ...]  # the same, once after all runs
    numbers: dict[str, Number]
    figure: str | None
    video: str | None
    result: dict[str, Any] | None  # table [result], checked by `measured.read`

    def runs(self) -> list[tuple[str, int]]:
        """Variant and seed of every run, all variants of a seed after each other."""
        return [(variant, seed) for seed in self.seeds for variant in self.variants]


def run_name(variant: str, seed: int) -> str:
    """The folder of a run in the folder of its sweep."""
    return f"{variant}-{seed}" if variant else f"seed-{seed}"


def read_recipe(path: str | Path) -> Recipe:
    """Read a recipe; raises UserError, one sentence naming the file and the entry, for whatever is wrong."""
    data = storage.read_toml(path, "recipe")
    try:
        return _parse(data, Path(path).stem)
    except UserError as error:
        raise UserError(f"recipe {path}: {error}") from error


def filled(words: Iterable[str], names: Mapping[str, str | list[str]]) -> list[str]:
    """A command with its names in braces filled in; a name that is a list stands as a word of its own."""
    texts = {name: text for name, text in names.items() if isinstance(text, str)}
    result = []
    for word in words:
        whole = names.get(word[1:-1]) if word[:1] == "{" and word[-1:] == "}" else None
        if isinstance(whole, list):
            result += whole
        else:
            result.append(re.sub(r"\{(\w+)\}", lambda found: texts[found[1]], word))
    return result


def named_in(answer: str) -> list[str]:
    """The names in braces of an answer; raises UserError for braces that hold none."""
    try:
        found = list(string.Formatter().parse(answer))
    except ValueError as error:
        raise UserError(f"answer: {error}") from error
    for _, name, form, conversion in found:
        if name is not None and (form or conversion or not name):
            raise UserError("answer: braces hold the name of a number, or VARIANT.NUMBER, and nothing else")
    return [name for _, name, _, _ in found if name is not None]


def only(table: Mapping, known: Iterable[str], where: str) -> None:
    """Raise UserError for a key that is unknown."""
    unknown = sorted(set(table) - set(known))
    if unknown:
        raise UserError(f"{where} has an unknown entry {shown(repr(unknown[0]), 40)}")


def _parse(data: dict, name: str) -> Recipe:
    only(data, _KEYS, "it")
    if not _NAME.fullmatch(name):
        raise UserError("its name is not made of letters, digits, dots, - and _")
    train = data.get("train")
    if train is not None:
        train = _words(train, "train", ())
        _check_taken(train, "train")
    variants = _variants(data.get("variants", {}), train is not None)
    seeds = _seeds(data.get("seeds"))
    if len(seeds) * len(variants) > MOST_RUNS:
        raise UserError(
            f"{len(seeds)} seeds of {len(variants)} variants are {len(seeds) * len(variants)} runs; a recipe "
            f"has at most {MOST_RUNS}"
        )
    evaluate = _commands(data.get("evaluate", []), "evaluate", OF_A_RUN)
    if train is None and not evaluate:
        raise UserError("it has neither train nor evaluate: there is nothing to do")
    recipe = Recipe(
        name=name,
        title=_text(data, "title", required=True, longest=_TITLE),
        question=_text(data, "question", required=True),
        answer=_text(data, "answer"),
        train=train,
        seeds=seeds,
        variants=variants,
        evaluate=evaluate,
        together=_commands(data.get("together", []), "together", OF_THE_SWEEP),
        numbers=_numbers(data.get("numbers"), variants),
        figure=_picture(data, "figure", ".png"),
        video=_picture(data, "video", ".gif"),
        result=_table(data.get("result"), "result") if "result" in data else None,
    )
    known = {
        f"{variant}.{number}" if variant else number
        for variant, number in itertools.product(variants, recipe.numbers)
    }
    for word in named_in(recipe.answer):
        if word not in known:
            raise UserError(f"answer: {{{shown(word, 60)}}} is no number of it; write {{{min(known)}}}")
    return recipe


def _table(value, where: str) -> dict:
    if not isinstance(value, dict):
        raise UserError(f"{where} must be a table, not {shown(repr(value), 40)}")
    return value


def _text(table: dict, key: str, required: bool = False, where: str = "", longest: int = _LONGEST) -> str:
    value = table.get(key, "")
    if not isinstance(value, str) or len(value) > longest:
        raise UserError(f"{where}{key} must be text of at most {longest} characters")
    text = " ".join(value.split())
    if required and not text:
        raise UserError(f"{where}{key} is missing")
    return shown(text, longest)


def _words(value, where: str, names: Iterable[str]) -> tuple[str, ...]:
    """A command as a list of words, in which `names` may stand in braces."""
    if not isinstance(value, list) or not 0 < len(value) <= _MOST_WORDS:
        raise UserError(f"{where} must be a list of 1 to {_MOST_WORDS} words, like a command line")
    for word in value:
        if not isinstance(word, str) or not word or len(word) > _WORD or not word.isprintable():
            raise UserError(
                f"{where}: {shown(repr(word), 40)} must be text, as on a command line, "
                f"of at most {_WORD} printable characters"
            )
        _check_names(word, names, where)
    return tuple(value)


def _check_names(word: str, names: Iterable[str], where: str) -> None:
    """Raise UserError for braces around anything but one of `names`, and for single ones."""
    for name in re.findall(r"\{[^{}]*\}|[{}]", word):
        if name[1:-1] not in names:
            known = ", ".join(f"{{{n}}}" for n in names)
            raise UserError(f"{where}: {shown(name, 40)} is not known there; {known or 'no name'} is")
        if name == "{runs}" and word != "{runs}":
            raise UserError(f"{where}: {{runs}} must be a word of its own")


def _check_taken(words: Iterable[str], where: str) -> None:
    for word in words:
        if word.partition("=")[0].replace("_", "-") in TAKEN:
            raise UserError(f"{where}: {shown(word, 40)} is not the recipe's to say: the sweep does")


def _commands(value, where: str, names: Iterable[str]) -> tuple[tuple[str, ...], ...]:
    if not isinstance(value, list) or len(value) > _MOST_COMMANDS:
        raise UserError(f"{where} must be a list of at most {_MOST_COMMANDS} commands, each a list of words")
    commands = tuple(_words(words, f"{where} {k}", names) for k, words in enumerate(value, 1))
    for k, (command, *_) in enumerate(commands, 1):
        if command not in (*COMMANDS, *OLD_COMMANDS):
            raise UserError(
                f"{where} {k}: {shown(repr(command), 40)} is no command that a recipe may run: those are "
                f"{', '.join(COMMANDS)}"
            )
    return commands


def _seeds(value) -> tuple[int, ...]:
    if not isinstance(value, list) or not 0 < len(value) <= MOST_SEEDS:
        raise UserError(f"seeds must be a list of 1 to {MOST_SEEDS} whole numbers")
    for seed in value:
        if type(seed) is not int or not 0 <= seed < _SEEDS:
            raise UserError(f"seeds: {shown(repr(seed), 40)} is not a whole number from 0, below 2^32")
    if len(set(value)) < len(value):
        raise UserError("seeds: a seed is listed twice")
    return tuple(value)


def _variants(value, trained: bool) -> dict[str, tuple[str, ...]]:
    if not _table(value, "variants"):
        return {"": ()}
    if len(value) > MOST_VARIANTS:
        raise UserError(f"variants: {len(value)} of them; a recipe has at most {MOST_VARIANTS}")
    found = {}
    for name, words in value.items():
        _check_name(name, "variants")
        if words != []:
            words = _words(words, f"variant {name}", () if trained else OF_A_RUN)
            _check_taken(words if trained else (), f"variant {name}")
        found[name] = tuple(words)
    return found


def _check_name(name: str, where: str) -> None:
    if not _NAME.fullmatch(name):
        said = shown(repr(name), 60)
        raise UserError(f"{where}: {said} must be made of at most 40 letters, digits, dots, - and _")


def _numbers(value, variants: Iterable[str]) -> dict[str, Number]:
    if not isinstance(value, dict) or not value:
        raise UserError("there is no table [numbers.NAME]: a recipe has at least one number")
    if len(value) > MOST_NUMBERS:
        raise UserError(f"numbers: {len(value)} of them; a recipe has at most {MOST_NUMBERS}")
    for name in value:
        _check_name(name, "numbers")
    return {name: _number(name, _table(entry, f"number {name}"), variants) for name, entry in value.items()}


def _number(name: str, entry: dict, variants: Iterable[str]) -> Number:
    where = f"number {name}: "
    only(entry, _NUMBER_KEYS, f"number {name}")
    file = _text(entry, "file", required=True, where=where)
    _check_names(file, (), f"{where}file")
    if not file.endswith(".json") or Path(file).is_absolute() or ".." in Path(file).parts:
        raise UserError(f"{where}file must be a JSON file in the run folder, not {shown(repr(file), 60)}")
    bar = entry.get("bar")
    if bar is not None:
        bar = _real(bar, f"{where}bar")
    held = entry.get("bar_for", [])
    if not isinstance(held, list) or not all(isinstance(v, str) and v in variants for v in held):
        raise UserError(f"{where}bar_for must be a list of variants, not {shown(repr(held), 60)}")
    factor = _real(entry.get("factor", 1), f"{where}factor")
    if not factor > 0:
        raise UserError(f"{where}factor must be above 0, not {factor:g}")
    return Number(
        name=name,
        title=_text(entry, "title", where=where, longest=_TITLE) or name,
        file=file,
        path=_path(entry.get("path"), where),
        unit=_text(entry, "unit", required=True, where=where, longest=_UNIT),
        factor=factor,
        better=_one_of(entry.get("better"), BETTER, f"{where}better"),
        bar=bar,
        over=_one_of(entry.get("over", OVER[0]), OVER, f"{where}over"),
        bar_for=tuple(held),
    )


def _path(value, where: str) -> tuple[str | int, ...]:
    steps = value.split(".") if isinstance(value, str) else value
    good = isinstance(steps, list) and 0 < len(steps) <= _DEEPEST
    if not good or not all(type(step) in (str, int) and step != "" for step in steps):
        raise UserError(
            f'{where}path must be keys and places, like "conditions.0.grid.strict", or a list of them'
        )
    if isinstance(value, list):
        return tuple(value)
    return tuple(int(step) if step.isascii() and step.isdigit() and len(step) < 9 else step for step in steps)


def _one_of(value, known: tuple[str, ...], where: str) -> str:
    if value not in known:
        raise UserError(f"{where} must be {' or '.join(known)}, not {shown(repr(value), 40)}")
    return value


def _real(value, where: str) -> float:
    if type(value) not in (int, float) or not abs(value) <= 1e300 or math.isnan(value):
        raise UserError(f"{where} must be a number, not {shown(repr(value), 40)}")
    return float(value)


def _picture(data: dict, key: str, suffix: str) -> str | None:
    if key not in data:
        return None
    path = _text(data, key, required=True)
    _check_names(path, OF_THE_PAGE, key)
    inside = path.startswith(("{run}/", "{sweep}/")) and ".." not in Path(path).parts
    if not inside or not path.endswith(suffix):
        raise UserError(
            f"{key} must be a {suffix} file in {{run}}/ or {{sweep}}/, not {shown(repr(path), 60)}"
        )
    return path
