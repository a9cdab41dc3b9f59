"""`landing-train`: train a policy, then report on it."""

from __future__ import annotations

import contextlib
import shlex
import signal
import sys
import threading
from collections.abc import Iterator


def main(arguments: list[str] | None = None) -> int:
    """Entry point; returns the exit code: 2 for wrong input, 130 and 143 after Ctrl-C and SIGTERM."""
    caught: list[int] = []
    try:
        with _signals(caught):
            return _train(arguments)
    except BaseException as error:
        if not caught and not isinstance(error, KeyboardInterrupt):
            raise
        # Whatever the interruption became on its way through other libraries.
        print("landing-train: interrupted; the same command with --resume goes on", file=sys.stderr)
        return 128 + (caught or [signal.SIGINT])[0]


def _train(arguments: list[str] | None) -> int:
    from inclined_landing.eval.base.command_line import exit_code, parse

    def work() -> None:
        from inclined_landing.train.config import TrainConfig

        config = parse(TrainConfig, "landing-train", arguments)
        from inclined_landing.train.report import report
        from inclined_landing.train.run import Run

        run = Run(config)
        if run.metrics is not None:
            print(f"the run in {shlex.quote(str(run.folder))} is finished")
        metrics = run.execute()
        if config.report and run.config.report and "success" not in metrics:
            report(run.folder, metrics)

    return exit_code("landing-train", work, "train")


@contextlib.contextmanager
def _signals(caught: list[int]) -> Iterator[None]:
    """SIGTERM and Ctrl-C both raise KeyboardInterrupt, and are noted in `caught`."""

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
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
