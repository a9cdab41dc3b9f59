"""`landing-train`: train a policy, then report on it."""

from __future__ import annotations

import dataclasses
import re
import sys
from typing import TYPE_CHECKING

from inclined_landing.envs.shared import command_line
from inclined_landing.models.base.errors import UserError, shown

if TYPE_CHECKING:
    from inclined_landing.train.run import Run

NOT_REACHED = 3  # exit code


def main(arguments: list[str] | None = None) -> int:
    """Run `landing-train` and return its exit code.

    The code is 2 for wrong input, 3 for a run that ended without reaching the success rate, and 130, 143 and
    129 after Ctrl-C, SIGTERM and the end of its terminal.
    """
    arguments = list(sys.argv[1:] if arguments is None else arguments)

    def interrupted() -> str:
        if arguments[:1] == ["sweep"]:
            return "interrupted; repeat the command to continue"
        return "interrupted; add --resume with the same --out to continue from the last checkpoint"

    return command_line.exit_code("landing-train", lambda: _train(arguments), "train", interrupted)


def _train(arguments: list[str]) -> int:
    """Run the command and return the exit code; called by `main`."""
    if arguments and arguments[0] == "--version":
        print(command_line.versions("landing-train"))
        return 0
    if arguments and arguments[0] == "sweep":
        from inclined_landing.train.sweep.command import command

        return command_line.parse(command, "landing-train sweep", arguments[1:])()
    from inclined_landing.train.config import TrainConfig, flag_of

    if any(word in ("-h", "--help", "--help-all") for word in arguments):
        print(help_page("--help-all" in arguments))
        return 0
    config = command_line.parse(TrainConfig, "landing-train", arguments)
    from inclined_landing.train.run import Run

    # The options that were typed: with --resume only these may contradict the run.
    flags = command_line.given(arguments)
    run = Run(config, {field.name for field in dataclasses.fields(config) if flag_of(field.name) in flags})
    # --no-report counts whether this command has it or, with --resume, the one that began the run.
    due = config.report and run.config.report and not run.is_reported
    if run.metrics is not None:
        print(f"the run in {shown(run.folder)} is finished{'; its report is missing' if due else ''}")
    metrics = run.execute()
    reached = metrics.get("reached")  # None: the run has a fixed length
    missed = reached is False
    if missed:
        more = "" if metrics["finished"] else "; add --resume with the same --out to continue"
        print(f"landing-train: {metrics['ended']}{more}", file=sys.stderr)
    else:
        word = "Training succeeded" if reached else "Training"
        print(
            f"{word}: {metrics['ended']}. The policy is {shown(run.folder / 'final.zip', 100)}.", flush=True
        )
    if due:
        _report(run, metrics)
    return NOT_REACHED if missed else 0


def help_page(complete: bool) -> str:
    """Return the page of --help-all, or of --help with the common options only."""
    from inclined_landing.train.config import COMMON, TrainConfig, flag_of

    page = command_line.help_page(TrainConfig, "landing-train")
    if complete:
        return page
    head, *options = re.split(r"\n(?=  --)", page)
    flags = [flag_of(name) for name in COMMON]
    chosen = [option for option in options if re.match(r"  (--[a-z-]+)", option)[1] in flags]  # type: ignore
    return "\n".join([head, *chosen, "\nlanding-train --help-all lists all options."])


def _report(run: Run, metrics: dict) -> None:
    """Report on a run that has ended, or print why there is no report."""
    from inclined_landing.train.config import COPIED
    from inclined_landing.train.record import REPORT, look_up

    try:
        report = look_up(REPORT)
    except UserError as error:
        again = "; after that, the same command with --resume writes it"
        print(f"landing-train: no report, because {error}{again}", file=sys.stderr)
        return
    vehicle = run.folder / COPIED["vehicle"] if run.config.vehicle is not None else None
    report(run.folder, metrics, vehicle)
