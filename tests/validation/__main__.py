"""`python -m tests.validation COMMAND`, from the root of the repository: evidence that takes minutes.

A command is the function `command` of the module, or of the package with a module `command`, that is called
like it. Wrong input ends with one sentence on stderr and exit code 2.
"""

from __future__ import annotations

import difflib
import importlib
import importlib.util
import sys
from collections.abc import Callable, Sequence

from inclined_landing.envs.shared.command_line import bound, exit_code, parse
from inclined_landing.models.base.errors import UserError

PROGRAM = "python -m tests.validation"
COMMANDS = (
    *("gap-blind", "gap-agreement", "gap-example", "plan-loop", "causes", "identified"),
    *("flight-table", "tosses", "landings"),
)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a command; returns the exit code."""
    words = list(sys.argv[1:] if arguments is None else arguments)
    return exit_code(PROGRAM, lambda: _run(words))


def find(name: str) -> Callable:
    """Return the function of a command."""
    path = f"tests.validation.{name.replace('-', '_')}"
    spec = importlib.util.find_spec(path)
    if spec is not None and spec.submodule_search_locations is not None:
        path += ".command"
    return importlib.import_module(path).command


def _run(words: list[str]) -> int | None:
    name, *rest = words or [""]
    if name in ("-h", "--help"):
        print(f"usage: {PROGRAM} COMMAND [OPTIONS]\n\nCOMMAND is one of {', '.join(COMMANDS)};")
        print(f"{PROGRAM} COMMAND --help tells its options.")
        return 0
    if name not in COMMANDS:
        near = difflib.get_close_matches(name, COMMANDS, 1)
        wrong = f"unknown command {name!r}" if name else "no command"
        raise UserError(f"{wrong}{', perhaps ' + near[0] if near else ''}; see {PROGRAM} --help")
    return parse(bound(find(name)), f"{PROGRAM} {name}", rest)()


if __name__ == "__main__":
    sys.exit(main())
