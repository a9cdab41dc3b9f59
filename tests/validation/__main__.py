"""`python -m tests.validation COMMAND`, from the root of the repository: evidence that takes minutes."""

from __future__ import annotations

import sys
from collections.abc import Sequence

import tyro

from inclined_landing.envs.shared.command_line import bound, exit_code

from . import causes, gap_example, identified, tosses
from .gap_blind import command as gap_blind

PROGRAM = "python -m tests.validation"
COMMANDS = {
    "gap-blind": gap_blind.command,
    "gap-example": gap_example.command,
    "causes": causes.command,
    "identified": identified.command,
    "tosses": tosses.command,
}


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a command; returns the exit code."""
    calls = {name: bound(command) for name, command in COMMANDS.items()}
    parse = tyro.extras.subcommand_cli_from_dict
    return exit_code(PROGRAM, lambda: parse(calls, prog=PROGRAM, args=arguments)())


if __name__ == "__main__":
    sys.exit(main())
