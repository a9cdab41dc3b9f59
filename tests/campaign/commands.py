"""The commands of the product, what each needs to begin its work, and the names that things may have."""

import contextlib
import dataclasses
import inspect
import os
import typing
from importlib import resources
from pathlib import Path

from msgspec import Meta

from inclined_landing.eval import cli
from inclined_landing.train import cli as train
from inclined_landing.train.config import TrainConfig
from tests.campaign.flights import a_flight, text
from tests.campaign.judge import Case, Wrong, command, write
from tests.campaign.test_toml import STUDY

RECIPE = str(resources.files("inclined_landing.train") / "recipes" / "landing.toml")
REPORT = '{"sets": [{"effects": ["body_drag"], "probability": 1.0, "values": {"body_drag": {}}}]}'
# What each command needs, {place} being a folder with the files of `place`.
NEEDED = {
    "demo": ("--out", "{place}/out"),
    "success": ("landing",),
    "touchdown": ("touchdown",),
    "mission": (),
    "robustness": ("landing", "--out", "{place}/out"),
    "robustness slopes": ("landing-slopes", "--over=slopes", "--out", "{place}/out"),
    "robustness vehicles": ("landing", "--over=vehicles", "--out", "{place}/out"),
    "robustness moving": ("planner", "--over=moving", "--out", "{place}/out"),
    "export": ("landing", "--format", "numpy", "--out", "{place}/out"),
    "figure": ("landing", "--out", "{place}/out"),
    "video": ("landing", "--out", "{place}/out.mp4"),
    "figure whole": ("landing", "--whole", "--out", "{place}/out.png"),
    "replay": ("landing", "{place}/log.csv", "--out", "{place}/out.html"),
    "replay window": ("landing", "--window"),
    "curves": ("{place}", "--out", "{place}/out.png"),
    "equivalence": ("--out", "{place}/out"),
    "contact": ("--out", "{place}/out"),
    "landings": ("{place}/study.toml", "--out", "{place}/out"),
    "logs": ("{place}/log.csv",),
    "logs public": ("--public", "nanobench", "{place}/log.csv", "--out", "{place}/out"),
    "identify": ("{place}/log.csv", "--out", "{place}/out"),
    "gap": ("{place}/log.csv", "--out", "{place}/out"),
    "plan": ("{place}/report", "--out", "{place}/out"),
    "effects": (),
    "gap-example": ("--out", "{place}/out"),
    "crazyflie": ("--port=0", "--seconds=0.1"),
    "fly": ("--simulated", "--out", "{place}/out"),
    "benchmark": (),
    "doctor": (),
    "train": ("landing", "--steps=8", "--no-report", "--out", "{place}/out"),
    "train sweep": (RECIPE, "--out", "{place}/out"),
}
# What is written as one file, and what its name ends in.
SUFFIX = {"video": ".mp4", "figure whole": ".png", "curves": ".png", "replay": ".html", "crazyflie": ".csv"}
POLICIES = ("landing", "touchdown", "landing-slopes", "planner")  # of NEEDED
NAMES = (
    *(
        "a$b$c",
        "$\\frac{$",
        "{{7*7}}",
        "{0}",
        "%s%n",
        "new\nline",
        "quote\"'",
        "a b\t",
        "-x",
        "a+b",
        "~",
        "🚁",
    ),
    *("<script>alert(1)", "[bold]b[red]", "\x1b[31mred", "\u202eltr", os.fsdecode(b"\xff\xfe"), "x" * 240),
)


@dataclasses.dataclass(frozen=True)
class Range:
    """What a number may be."""

    low: float
    high: float
    open: bool


@dataclasses.dataclass(frozen=True)
class Option:
    """An option as a command's signature has it."""

    kind: object  # its type
    range: Range | None

    @property
    def number(self) -> bool:
        """Does it take numbers, and nothing else?"""
        return any(number in str(self.kind) for number in ("int", "float")) and "str" not in str(self.kind)


def find(name: str):
    """The function of a command, or the dataclass of the options of landing-train."""
    if name == "train sweep":
        from inclined_landing.train.sweep.command import command as sweep

        return sweep
    return TrainConfig if name == "train" else cli.find(name.split()[0])


def options(name: str) -> dict[str, Option]:
    """Options of a command, those of groups too."""
    function = find(name)
    hints = typing.get_type_hints(function, include_extras=True)
    if dataclasses.is_dataclass(function):
        return {_dashed(key): _option(hint) for key, hint in hints.items() if key not in ("task", "resume")}
    found = {}
    for key, parameter in inspect.signature(function).parameters.items():
        kind = typing.get_args(hints[key])[0] if hasattr(hints[key], "__metadata__") else hints[key]
        if dataclasses.is_dataclass(kind):
            fields = typing.get_type_hints(kind, include_extras=True)
            found |= {_dashed(field): _option(hint) for field, hint in fields.items()}
        elif parameter.kind != inspect.Parameter.POSITIONAL_ONLY and "Suppress" not in repr(hints[key]):
            found[_dashed(key)] = _option(hints[key])
    return {key: option for key, option in found.items() if key != "files"}


def _dashed(key: str) -> str:
    return "from" if key == "start_from" else key.replace("_", "-")


def _option(hint) -> Option:
    about = getattr(hint, "__metadata__", ())
    kind = typing.get_args(hint)[0] if about else hint
    return Option(kind, _range(hint))


def _range(hint) -> Range | None:
    for one in (*getattr(hint, "__metadata__", ()), *map(_range, typing.get_args(hint))):
        if isinstance(one, Range):
            return one
        if isinstance(one, Meta) and (one.ge is not None or one.gt is not None):
            ends = (one.gt, one.lt) if one.ge is None else (one.ge, one.le)
            return Range(*ends, one.ge is None)
    return None


def place(folder: Path) -> Path:
    """What `NEEDED` names."""
    write(folder / "log.csv", text(a_flight()))
    write(folder / "study.toml", STUDY)
    (folder / "report").mkdir()
    write(folder / "report/report.json", REPORT)
    (folder / "loop").symlink_to("loop")
    (folder / "link").symlink_to(folder / "nowhere" / "at" / "all")
    return folder


def called(name: str, words: list[str], folder: Path, needed: bool = True) -> str:
    """What a command prints, called in `folder` with what it needs and `words` ({place}: the folder).

    Words win over what is needed. Raises UserError where it is refused.
    """
    given = [word.replace("{place}", str(folder)) for word in NEEDED[name] if needed]
    more = [word.replace("{place}", str(folder)) for word in words]
    for option in {word.partition("=")[0] for word in more if word.startswith("--")} & set(given):
        at = given.index(option)
        del given[at : at + 2]
    first, *rest = name.split()
    with contextlib.chdir(folder):
        if first == "train":
            return command(train.main, [*rest, *given, *more])
        return command(cli.main, [first, *given, *more])


def accepted(printed: str) -> None:
    """For `works` of what must be refused."""
    raise Wrong(f"accepted: {printed[:300]}")


def refused(title: str, name: str, words: list[str], named: str = "") -> Case:
    """A case of a command that refuses `words`."""
    return Case(title, place, lambda folder: called(name, words, folder), accepted, named=named)
