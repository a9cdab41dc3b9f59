"""`landing-train`: train a policy, then report on it."""

from __future__ import annotations

import contextlib
import signal
import sys
import threading
from collections.abc import Iterator
from typing import TYPE_CHECKING

from inclined_landing.envs.shared import command_line
from inclined_landing.models.errors import UserError, shown

if TYPE_CHECKING:
    from inclined_landing.train.config import TrainConfig
    from inclined_landing.train.run import Run


def main(arguments: list[str] | None = None) -> int:
    """Run `landing-train` and return its exit code.

    2 for wrong input, 3 for a run that ended without the success that was to end it, 130 and 143 after Ctrl-C
    and SIGTERM.
    """
    caught: list[int] = []
    begun: list[TrainConfig] = []

    def work() -> int:
        with _signals(caught):
            return _train(arguments, begun)

    try:
        return command_line.exit_code("landing-train", work, "train")
    except KeyboardInterrupt:
        words = sys.argv[1:] if arguments is None else arguments
        go_on = "interrupted; --resume with the same --out goes on from the last checkpoint"
        if words[:1] == ["sweep"]:
            go_on = "interrupted; the same command goes on"
        elif begun and not begun[0].resumable:
            go_on = f"interrupted; {begun[0].algorithm} keeps no checkpoint to go on from"
        print(f"landing-train: {go_on}", file=sys.stderr)
        return 128 + (caught or [signal.SIGINT])[0]


def _train(arguments: list[str] | None, begun: list[TrainConfig]) -> int:
    """Do the work of `main` and return the exit code; the configuration of the run is noted in `begun`."""
    words = sys.argv[1:] if arguments is None else arguments
    if words and words[0] == "--version":
        print(command_line.versions("landing-train"))
        return 0
    if words and words[0] == "sweep":
        from inclined_landing.train.sweep.command import command

        return command_line.parse(command_line.bound(command), "landing-train sweep", words[1:])()
    from inclined_landing.train.config import TrainConfig

    if words and words[0].partition("=")[0] == "--print-completion":
        print(
            command_line.completion(command_line.shell_of(words), "landing-train", {"": TrainConfig}), end=""
        )
        return 0
    if any(word in ("-h", "--help", "--help-all") for word in words):
        from inclined_landing.train.config import HELP

        groups = HELP if "--help-all" in words else {"options": next(iter(HELP.values()))}
        print(command_line.grouped_help(TrainConfig, "landing-train", groups))
        print("\nlanding-train --help-all tells all options." * ("--help-all" not in words))
        return 0
    config = command_line.parse(TrainConfig, "landing-train", arguments)
    from inclined_landing.train.run import NOT_REACHED, Run

    run = Run(config)
    begun.append(run.config)
    due = config.report and run.config.report and not (run.metrics and "success" in run.metrics)
    if run.metrics is not None:
        print(f"the run in {shown(run.folder)} is finished{'; its report is missing' if due else ''}")
    metrics = run.execute()
    if due:
        _report(run, metrics)
    if metrics.get("reached") is not False:
        word = "Training succeeded" if metrics.get("reached") else "Training"
        print(f"{word}: {metrics['ended']}. The policy is {shown(run.folder / 'final.zip', 100)}.")
        return 0
    more = "" if metrics["finished"] or not run.config.resumable else "; --resume with the same --out goes on"
    print(f"landing-train: {metrics['ended']}{more}", file=sys.stderr)
    return NOT_REACHED


def _report(run: Run, metrics: dict) -> None:
    """Report on a run that has ended, or say why there is no report."""
    from inclined_landing.train.evaluation import look_up
    from inclined_landing.train.run import VEHICLE

    try:
        report = look_up("report")
    except UserError as error:
        more = "; the same command with --resume then reports on the run" * run.config.resumable
        print(f"landing-train: no report, as {error}{more}", file=sys.stderr)
        return
    vehicle = run.folder / VEHICLE if run.config.vehicle is not None else None
    report(run.folder, metrics, vehicle, run.curriculum.stages())


@contextlib.contextmanager
def _signals(caught: list[int]) -> Iterator[None]:
    """Let SIGTERM end the work as Ctrl-C does, by KeyboardInterrupt; the signal is noted in `caught`."""

    def stop(number, frame):
        caught.append(number)
        raise KeyboardInterrupt

    before = {}
    if threading.current_thread() is threading.main_thread():
        for number in (signal.SIGINT, signal.SIGTERM):
            if signal.getsignal(number) is not signal.SIG_IGN:  # as nohup and background jobs ask for
                before[number] = signal.signal(number, stop)
    try:
        yield
    except BaseException as error:
        if caught:  # whatever the interruption became on its way through other libraries
            raise KeyboardInterrupt from error
        raise
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
