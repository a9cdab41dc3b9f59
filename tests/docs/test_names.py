"""Names in backticks, of docstrings and documents, exist: identifiers, modules, options and files."""

import ast
import builtins
import functools
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests import ROOT, documents

FOLDERS = ("models", "envs", "eval", "train", "tests", "docs", "examples")
PROSE = re.compile(r"^ {0,3}```.*?^ {0,3}```", re.DOTALL | re.MULTILINE)  # blocks, which other tests run
SPAN = re.compile(r"(?<!`)`([^`\n]+)`(?!`)")
# Docstrings, which are what is checked, and comments.
NO_CODE = re.compile(r'^\s*r?"""(?:.|\n)*?"""|(?:^|\s)#.*$', re.MULTILINE)
NAME = re.compile(r"-{0,2}[A-Za-z_][\w./-]*(\(\))?")
SUFFIXES = (".py", ".toml", ".cc", ".h", ".in", ".j2", ".js", ".xml", ".yml", ".cff", ".txt", ".json", ".md")
# Names of other programs, and names that are put together from parts.
FOREIGN = {
    *"kalman_core.c estimator_complementary.c crtp_supervisor.c crtp_localization_service.c".split(),
    *"crtp_commander_generic.c supervisor_state_machine.c platform_defaults.h thrustLocked Commander".split(),
    *"CONFIG_ENABLE_THRUST_BAT_COMPENSATED send_setpoint _nr_of_retries clampctrl viscosity".split(),
    *"release.yml vVERSION ADDRESS stock.toml a_b x_mm m4 -pitch".split(),
    *"ulog2csv blackbox_decode arm-none-eabi-size NormalizeObservation".split(),
    *"FrameStackObservation TimeAwareObservation".split(),
    *("trajectory_1", "trajectory_2", *(f"touched_{part}" for part in ("slab", "base", "floor"))),
    *(f"platform_{part}" for part in ("x", "y", "z", "roll", "pitch", "yaw")),
}


def files(*suffixes: str) -> list[Path]:
    """Return the files of the repository with these suffixes."""
    found = [path for folder in FOLDERS for path in (ROOT / folder).rglob("*") if path.suffix in suffixes]
    return [path for path in [*found, *ROOT.glob("*")] if path.suffix in suffixes and path.is_file()]


def docstrings(tree: ast.AST) -> Iterator[ast.Constant]:
    """Yield the docstrings of a module, also those below fields."""
    nodes = [tree]
    while nodes:
        body = getattr(nodes.pop(), "body", ())
        for one in body if isinstance(body, list) else ():
            if not isinstance(one, ast.Expr):
                nodes.append(one)
            elif isinstance(one.value, ast.Constant) and isinstance(one.value.value, str):
                yield one.value


@functools.cache
def known() -> frozenset[str]:
    """Return every word that code, tables and configuration have, and the names of files and options."""
    words: set[str] = set(dir(builtins))
    for path in files(".py"):
        code = NO_CODE.sub("", path.read_text("utf-8"))
        words |= {*re.findall(r"[\w.-]+", code), *re.findall(r"\w+", code)}
    for path in files(*SUFFIXES[1:-1]):
        if path.stat().st_size < 500_000:
            words |= set(re.findall(r"[\w.-]+", path.read_text("utf-8")))
    words |= set(re.findall(r"[\w.-]+", (ROOT / "Makefile").read_text("utf-8")))
    for folder in FOLDERS:
        for path in (ROOT / folder).rglob("*"):
            words |= {path.name, path.stem}
    words |= documents.options("landing-train", None) | {path.name for path in ROOT.glob("*")}
    for name in documents.cli.COMMANDS:
        words |= documents.options("landing-eval", name)
    for name in documents.validation.COMMANDS:
        words |= documents.options("tests.validation", name)
    return frozenset(words | {word.replace("-", "_") for word in words} | FOREIGN)


def missing(text: str) -> list[str]:
    """Return the names in backticks of which a part is known nowhere."""
    found = []
    for span in SPAN.findall(PROSE.sub("", text)):
        if NAME.fullmatch(span) and "..." not in span:
            name = span.removesuffix("()")
            parts = [name] if name.startswith("-") else name.strip("/").split("/")
            if not all(part in known() or is_dotted(part) for part in parts):
                found.append(span)
    return found


def is_dotted(name: str) -> bool:
    """Return whether every part of module.Class.method is known; a file has to be known as a whole."""
    return Path(name).suffix not in SUFFIXES and known() >= set(name.split("."))


@pytest.mark.parametrize("folder", FOLDERS)
def test_names_in_docstrings_exist(folder):
    wrong = {}
    for path in (ROOT / folder).rglob("*.py"):
        for constant in docstrings(ast.parse(path.read_text("utf-8"))):
            for name in missing(constant.value):
                wrong[f"{path.relative_to(ROOT)}:{constant.lineno}"] = name
    assert not wrong


def test_names_in_documents_exist():
    wrong = {name: found for name in documents.documents() if (found := missing((ROOT / name).read_text()))}
    assert not wrong
