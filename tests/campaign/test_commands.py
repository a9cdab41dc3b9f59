"""Every command and option with values that are never right, outputs nowhere, and files of any name.

Commands come from `COMMANDS` of `eval/cli.py`, their options from their signatures, and what they need to
begin from the command lines of `tests/eval/test_answers.py`.
"""

import contextlib
import dataclasses
import functools
import inspect
import os
import tempfile
import typing
from pathlib import Path

import hypothesis.strategies as st
import pytest
from hypothesis import given

from inclined_landing.eval import cli
from inclined_landing.models.base.errors import UserError
from inclined_landing.train import cli as train
from inclined_landing.train.config import TrainConfig
from tests.campaign import damage
from tests.campaign.inputs import place
from tests.eval.test_answers import LONG, QUICK

LINES = {line.split()[0]: line for line in [*LONG, *QUICK] if "/20/" not in line and "/run" not in line}
LINES |= {name: f"{name} {{place}}/log.csv --out {{place}}/out" for name in ("gap", "identify")}
LINES |= {"curves": "curves {place} --out {place}/out.png"}
LINES |= {"replay": "replay {place}/log.csv --out {place}/a.html"}
NUMBERS = ("nan", "inf", "-inf", "1e300", "9" * 400, "heavy", "", "１２", "1,2", "0x10", "1j", "None!",
           "\x1b[31m\n")  # fmt: skip
NAMES = ("a$b$c", "$\\frac{$", "{{7*7}}", "{0}", "%s%n", "new\nline", "quote\"'", "a b\t", "-x", "~", "🚁",
         "<script>alert(1)", "[bold]b[red]", "\x1b[31mred", "\u202eltr", os.fsdecode(b"\xff\xfe"),
         "x" * 200)  # fmt: skip
TEXTS = (*NAMES, "no-such", "x" * 5000, "/proc/none", "/dev/zero", "", "LANDING")
OUTPUTS = ("", "/", "{place}/log.csv/out", "{place}/log.csv/a/b/out", "{place}/" + "x" * 300, "{place}/a\0b",
           "/proc/none/out", "/dev/null/out", "{place}/link/out", "{place}/loop/out")  # fmt: skip
WRITTEN = ("out", "site", "page")


@functools.cache
def options(name: str) -> dict[str, bool]:
    """Return the options of a command that take a value, and whether it is a number."""
    target = TrainConfig if name == "train" else cli.find(name)
    hints = typing.get_type_hints(target, include_extras=True)
    found = {}
    for key, parameter in inspect.signature(target).parameters.items():
        kind = hints[key]
        plain = typing.get_args(kind)[0] if hasattr(kind, "__metadata__") else kind
        if dataclasses.is_dataclass(plain):
            found |= typing.get_type_hints(plain, include_extras=True)
        elif parameter.kind != inspect.Parameter.POSITIONAL_ONLY and "Suppress" not in repr(kind):
            found[key] = kind
    found = {key: str(kind) for key, kind in found.items()}
    plain = {"start_from": "from"}
    return {
        plain.get(key, key).replace("_", "-"): not any(word in kind for word in ("str", "Path", "Literal"))
        for key, kind in found.items()
        if not any(word in kind for word in ("Positional", "bool", "Suppress"))
    }


def run(line: str, folder: Path) -> str:
    """Return what a command line prints in a folder; raises UserError where it is refused."""
    first, *rest = (word.replace("{place}", str(folder)) for word in line.split("\t"))
    with contextlib.chdir(folder):
        if first == "train":
            return damage.command(train.main, rest)
        return damage.command(cli.main, [first, *rest])


def refused(name: str, option: str, value: str) -> None:
    """Fail unless a command refuses a value of an option, by its name, before it writes anything."""
    words = LINES.get(name, name).split()
    if f"--{option}" in words:
        at = words.index(f"--{option}")
        del words[at : at + 2]

    def accepted(printed: str) -> None:
        raise AssertionError(f"accepted: {printed[-300:]}")

    with tempfile.TemporaryDirectory() as folder:
        place(Path(folder))
        line = "\t".join([*words, f"--{option}={value}"])
        said = damage.used_or_refused(Path(folder), lambda: run(line, Path(folder)), accepted)
        named = option, value[-10:], Path(value).parent.name  # one of these, or a folder on the way
        assert not value.isprintable() or any(name in said for name in named), said


def of(keep) -> st.SearchStrategy[tuple[str, str]]:
    """Draw a command and one of its options."""
    names = (*cli.COMMANDS, "train")
    drawn = lambda: [(name, o) for name in names for o, number in options(name).items() if keep(o, number)]  # noqa: E731
    return st.deferred(lambda: st.sampled_from(drawn()))


KINDS = {
    "numbers": (of(lambda o, number: number and o not in WRITTEN), NUMBERS),
    "texts": (of(lambda o, number: not number and o not in WRITTEN), TEXTS),
    "outputs": (of(lambda o, number: o in WRITTEN), OUTPUTS),
}


@pytest.mark.parametrize("kind", KINDS)
@damage.examples(8)
@given(data=st.data())
def test_values_that_are_never_right_are_refused_before_any_work(kind, data):
    where, values = KINDS[kind]
    refused(*data.draw(where), data.draw(st.sampled_from(values)))


@damage.examples(2)
@given(st.sampled_from([line for line in QUICK if "{place}" in line]), st.sampled_from(NAMES))
def test_folders_of_any_name_work(line, name):
    with tempfile.TemporaryDirectory() as folder:
        run("\t".join(line.split()), place(Path(folder) / name))


@pytest.mark.parametrize("name", ["", "x" * 5000, *NAMES])
def test_unknown_commands_are_refused(name):
    with pytest.raises(UserError, match="command"):
        damage.command(cli.main, [name])
