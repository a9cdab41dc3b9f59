"""`landing-eval`: the commands of the packages, in groups.

A command is the function `command` of a module; its signature and docstring are the options and the help.
Slow imports are in its body, so that `--help` and wrong options are handled at once. Wrong input ends with
one sentence on stderr and exit code 2.
"""

from __future__ import annotations

import ast
import difflib
import importlib
import sys
from collections.abc import Callable, Sequence
from pathlib import Path

from inclined_landing.envs.shared.command_line import exit_code, parse, versions
from inclined_landing.models.base.errors import UserError

# The modules of the commands, by groups; a command has the name of its module or of the package of `command`.
GROUPS = {
    "Start": ("demo", "machine.doctor", "machine.benchmark"),
    "Policies": (
        *("study.success", "study.robustness", "study.touchdown", "study.mission"),
        "export.command",
    ),
    "Pictures": (
        *("pictures.figure", "pictures.picture", "pictures.video"),
        *("replay.command", "pictures.curves"),
    ),
    "Physics": ("truth.equivalence.command", "truth.contact.command", "landings.command"),
    "Flight logs and the gap to the model": (
        *("logs.command", "gap.identify", "gap.command", "gap.plan.command", "gap.gap_example"),
    ),
    "A real vehicle": ("flying.fly",),
}


def _name(module: str) -> str:
    return module.removesuffix(".command").rpartition(".")[2].replace("_", "-")


COMMANDS = {_name(module): module for group in GROUPS.values() for module in group}  # modules by command


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a command and return the exit code."""
    words = list(sys.argv[1:] if arguments is None else arguments)
    return exit_code("landing-eval", lambda: _run(words))


def find(name: str) -> Callable:
    """Return the function of a command; imports its package."""
    return importlib.import_module(f"inclined_landing.eval.{COMMANDS[name]}").command


def summary(name: str) -> str:
    """Return the first line of a command's docstring, read from its source, which is quicker to import."""
    source = Path(__file__).parent.joinpath(*COMMANDS[name].split(".")).with_suffix(".py").read_text("utf-8")
    functions = [node for node in ast.parse(source).body if isinstance(node, ast.FunctionDef)]
    (docstring,) = (ast.get_docstring(function) for function in functions if function.name == "command")
    return (docstring or "").partition("\n")[0]


def _run(words: list[str]) -> int | None:
    name = words[0] if words else ""
    if name in ("-h", "--help"):
        print(_help())
        return 0
    if name == "--version":
        print(versions("landing-eval"))
        return 0
    if name not in COMMANDS:
        near = difflib.get_close_matches(name, COMMANDS, 1)
        wrong = f"unknown command {name!r}" if name else "no command"
        meant = f"; did you mean {near[0]}? See" if near else "; see"
        raise UserError(f"{wrong}{meant} landing-eval --help")
    return parse(find(name), f"landing-eval {name}", words[1:])()


def _help() -> str:
    width = max(map(len, COMMANDS))
    lines = ["usage: landing-eval COMMAND [OPTIONS]", "", "Evaluate policies and models."]
    for title, modules in GROUPS.items():
        lines += ["", f"{title}:", *(f"  {name:{width}}  {summary(name)}" for name in map(_name, modules))]
    lines += ["", "landing-eval COMMAND --help lists the options. --version prints the versions."]
    return "\n".join(lines)
