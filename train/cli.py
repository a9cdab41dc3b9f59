"""`landing-train`: train a policy, then report on it."""

from __future__ import annotations

import sys

import tyro

from inclined_landing.models.errors import UserError
from inclined_landing.train.config import TrainConfig


def main(arguments: list[str] | None = None) -> int:
    """Entry point; returns the exit code (2 for wrong input)."""
    config = tyro.cli(TrainConfig, prog="landing-train", args=arguments)
    try:
        from inclined_landing.train.report import report
        from inclined_landing.train.run import train

        folder, metrics = train(config)
        if config.report:
            report(folder, metrics)
    except (UserError, ImportError) as error:
        print(f"landing-train: {error}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print(
            "landing-train: interrupted; continue from the last checkpoint with --resume and the same --out",
            file=sys.stderr,
        )
        return 130
    return 0
