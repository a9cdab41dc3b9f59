"""Reader of recipes (TOML): what is trained and judged, with which seeds, and which numbers are the result.

train/recipes/README.md is their manual.
"""

from __future__ import annotations

import itertools
import re
import string
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Annotated, Any, Literal

from msgspec import Meta, field, structs

from inclined_landing.models import schema, storage
from inclined_landing.models.errors import UserError, shown
from inclined_landing.models.schema import Real, Table

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

_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_.-]{0,39}")
_LINES = ("title", "question", "answer", "figure", "video")

Line = Annotated[str, Meta(max_length=120)]  # what stands in tables and figures
Text = Annotated[str, Meta(max_length=1000)]
Required = Meta(min_length=1, pattern=r"\S")
Word = Annotated[str, Meta(min_length=1, max_length=500)]
Command = Annotated[tuple[Word, ...], Meta(min_length=1, max_length=200)]
Commands = Annotated[tuple[Command, ...], Meta(max_length=50)]
Step = Annotated[str, Meta(min_length=1)] | int


class Entry(Table, frozen=True, kw_only=True):
    """A table [numbers.NAME]: one number of the result, where a run has it, and what it has to be."""

    title: Line = ""
    file: Annotated[Text, Required]  # JSON, in the run folder
    path: str | Annotated[tuple[Step, ...], Meta(min_length=1, max_length=20)]  # keys and places in it
    unit: Annotated[str, Meta(max_length=30), Required]
    factor: Annotated[float, Meta(gt=0, le=1e300)] = 1.0  # times what the file says
    better: Literal["higher", "lower"]
    bar: Real | None = None  # in the unit
    over: Literal["median", "mean", "worst"] = "median"  # what of the seeds is held against the bar
    bar_for: tuple[str, ...] = ()  # variants that have to meet the bar; none: all


class Number(Entry, frozen=True, kw_only=True):
    """One number of the result, with its name and its path in steps."""

    name: str
    path: tuple[str | int, ...]

    def of(self, variant: str) -> Number:
        """Return the number as it is for a variant, which may have no bar to meet."""
        if not self.bar_for or variant in self.bar_for:
            return self
        return structs.replace(self, bar=None)


class File(Table, frozen=True, kw_only=True):
    """What a recipe file holds."""

    title: Annotated[Line, Required]
    question: Annotated[Text, Required]
    answer: Text = ""  # with {number} or {variant.number}
    train: Command | None = None  # arguments of landing-train; None: nothing is trained
    seeds: Annotated[
        tuple[Annotated[int, Meta(ge=0, le=2**32 - 1)], ...], Meta(min_length=1, max_length=MOST_SEEDS)
    ]
    # More arguments by name.
    variants: Annotated[dict[str, tuple[Word, ...]], Meta(max_length=MOST_VARIANTS)] = field(
        default_factory=dict
    )
    evaluate: Commands = ()  # arguments of landing-eval, for each run
    together: Commands = ()  # the same, once after all runs
    numbers: Annotated[Mapping[str, Entry], Meta(min_length=1, max_length=MOST_NUMBERS)]
    figure: Annotated[Text, Required] | None = None
    video: Annotated[Text, Required] | None = None
    result: dict[str, Any] | None = None  # checked by `measured.read`


class Recipe(File, frozen=True, kw_only=True):
    """A recipe as its file says it; without variants it has the one of name "" and no arguments."""

    name: str
    numbers: dict[str, Number]

    def runs(self) -> list[tuple[str, int]]:
        """Return variant and seed of every run, all variants of a seed after each other."""
        return [(variant, seed) for seed in self.seeds for variant in self.variants]


def run_name(variant: str, seed: int) -> str:
    """Return the name of a run's folder in the folder of its sweep."""
    return f"{variant}-{seed}" if variant else f"seed-{seed}"


def read_recipe(path: str | Path) -> Recipe:
    """Read a recipe; raises UserError, one sentence naming the file and the entry, for whatever is wrong."""
    data = storage.read_toml(path, "recipe")
    try:
        return _parse(data, Path(path).stem)
    except UserError as error:
        raise UserError(f"recipe {path}: {error}") from error


def filled(words: Iterable[str], names: Mapping[str, str | list[str]]) -> list[str]:
    """Return a command with its names in braces filled in; a name that is a list is a word of its own."""
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
    """Return the names in braces of an answer; raises UserError for braces that hold none."""
    try:
        found = list(string.Formatter().parse(answer))
    except ValueError as error:
        raise UserError(f"answer: {error}") from error
    for _, name, form, conversion in found:
        if name is not None and (form or conversion or not name):
            raise UserError("answer: braces hold the name of a number, or VARIANT.NUMBER, and nothing else")
    return [name for _, name, _, _ in found if name is not None]


def _parse(data: dict, name: str) -> Recipe:
    file = schema.parse(data, File)
    _check_name(name, "its name")
    variants = file.variants or {"": ()}
    seeds, most = len(file.seeds), f"a recipe has at most {MOST_RUNS}"
    if seeds * len(variants) > MOST_RUNS:
        raise UserError(f"{seeds} seeds of {len(variants)} variants are {seeds * len(variants)} runs; {most}")
    if len(set(file.seeds)) < seeds:
        raise UserError("seeds: a seed is listed twice")
    if file.train is None and not file.evaluate:
        raise UserError("it has neither train nor evaluate: there is nothing to do")
    _check_words(file.train or (), "train", (), train=True)
    for variant, words in file.variants.items():
        _check_name(variant, "variants")
        trained = file.train is not None
        _check_words(words, f"variant {variant}", () if trained else OF_A_RUN, train=trained)
    _check_commands(file.evaluate, "evaluate", OF_A_RUN)
    _check_commands(file.together, "together", OF_THE_SWEEP)
    lines = {key: _line(text) for key in _LINES if (text := getattr(file, key))}
    _check_picture(lines.get("figure"), "figure", ".png")
    _check_picture(lines.get("video"), "video", ".gif")
    numbers = {number: _number(number, entry, variants) for number, entry in file.numbers.items()}
    known = {f"{v}.{number}" if v else number for v, number in itertools.product(variants, numbers)}
    for word in named_in(lines.get("answer", "")):
        if word not in known:
            raise UserError(f"answer: {{{shown(word, 60)}}} is no number of it; write {{{min(known)}}}")
    return Recipe(**structs.asdict(file) | lines | {"name": name, "variants": variants, "numbers": numbers})


def _line(text: str) -> str:
    """Return a text as one printable line."""
    return shown(" ".join(text.split()), len(text))


def _check_words(words: Iterable[str], where: str, names: Iterable[str], train: bool = False) -> None:
    """Raise UserError for words that no command has, or with other `names` in braces.

    train: of landing-train, to which the sweep says some options itself.
    """
    for word in words:
        if not word.isprintable():
            raise UserError(f"{where}: {shown(repr(word), 40)} must be printable, as on a command line")
        _check_names(word, names, where)
        if train and word.partition("=")[0].replace("_", "-") in TAKEN:
            raise UserError(f"{where}: {shown(word, 40)} is not the recipe's to say: the sweep does")


def _check_names(word: str, names: Iterable[str], where: str) -> None:
    """Raise UserError for braces around anything but one of `names`, and for single ones."""
    for name in re.findall(r"\{[^{}]*\}|[{}]", word):
        if name[1:-1] not in names:
            known = ", ".join(f"{{{n}}}" for n in names)
            raise UserError(f"{where}: {shown(name, 40)} is not known there; {known or 'no name'} is")
        if name == "{runs}" and word != "{runs}":
            raise UserError(f"{where}: {{runs}} must be a word of its own")


def _check_commands(commands: tuple[tuple[str, ...], ...], where: str, names: Iterable[str]) -> None:
    for k, words in enumerate(commands, 1):
        _check_words(words, f"{where} {k}", names)
        if words[0] not in (*COMMANDS, *OLD_COMMANDS):
            raise UserError(
                f"{where} {k}: {shown(repr(words[0]), 40)} is no command that a recipe may run: those are "
                f"{', '.join(COMMANDS)}"
            )


def _check_name(name: str, where: str) -> None:
    if not _NAME.fullmatch(name):
        said = shown(repr(name), 60)
        raise UserError(f"{where}: {said} must be made of at most 40 letters, digits, dots, - and _")


def _number(name: str, entry: Entry, variants: Iterable[str]) -> Number:
    _check_name(name, "numbers")
    where, file, path = f"[numbers.{name}]", _line(entry.file), entry.path
    _check_names(file, (), f"{where} file")
    if not file.endswith(".json") or Path(file).is_absolute() or ".." in Path(file).parts:
        raise UserError(f"{where} file must be a JSON file in the run folder, not {shown(repr(file), 60)}")
    if not set(entry.bar_for) <= set(variants):
        raise UserError(
            f"{where} bar_for must be a list of variants, not {shown(repr([*entry.bar_for]), 60)}"
        )
    if isinstance(path, str):
        steps = path.split(".")
        if not all(steps) or len(steps) > 20:
            raise UserError(f'{where} path must be 1 to 20 keys and places, like "conditions.0.grid.strict"')
        path = tuple(int(step) if re.fullmatch("[0-9]{1,8}", step) else step for step in steps)
    found = {"title": _line(entry.title) or name, "file": file, "path": path, "unit": _line(entry.unit)}
    return Number(**structs.asdict(entry) | found | {"name": name})


def _check_picture(path: str | None, key: str, suffix: str) -> None:
    if path is None:
        return
    _check_names(path, OF_THE_PAGE, key)
    inside = path.startswith(("{run}/", "{sweep}/")) and ".." not in Path(path).parts
    if not inside or not path.endswith(suffix):
        raise UserError(
            f"{key} must be a {suffix} file in {{run}}/ or {{sweep}}/, not {shown(repr(path), 60)}"
        )
