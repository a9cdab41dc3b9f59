"""`landing-eval curves`: what trainings learned."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import tyro

from inclined_landing.envs.shared.tables import say
from inclined_landing.eval.base.options import File
from inclined_landing.eval.pictures.figures import (
    comparison_curves,
    final_scores,
    learning_curves,
    save_figure,
)
from inclined_landing.models import storage


def command(
    runs: Annotated[tuple[Path, ...], tyro.conf.Positional, tyro.conf.arg(metavar="DIR [DIR ...]")],
    /,
    out: File,
    by: Annotated[tuple[str, ...], tyro.conf.arg(metavar="OPTION [OPTION ...]")] = (),
) -> None:
    """Learning curves of training runs of one task; seeds with median and range.

    Args:
        runs: run folders of landing-train.
        out: .png or .pdf file.
        by: compare kinds of runs that differ in these options, like algorithm: the score of each kind, over
            environment steps and over CPU time. The runs may then be of several tasks.
    """
    storage.check_file(out)
    names = [name.removeprefix("--").replace("-", "_") for name in by]
    save_figure(comparison_curves(runs, names) if by else learning_curves(runs), out)
    scores = final_scores(runs)
    say(*scores[:-1], f"{scores[-1]} The curves are in {out}.")
