"""`landing-eval curves`: learning curves of training runs of one task."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import tyro

from inclined_landing.eval.base.options import File
from inclined_landing.models.base import storage


def command(
    runs: Annotated[tuple[Path, ...], tyro.conf.Positional, tyro.conf.arg(metavar="DIR [DIR ...]")],
    /,
    out: File,
) -> None:
    """Plot the learning curves of training runs of one task; seeds as median and range.

    Args:
        runs: run folders of landing-train.
        out: .png or .pdf file.
    """
    from inclined_landing.envs.shared.tables import say
    from inclined_landing.eval.base.style import save_figure
    from inclined_landing.eval.pictures.learning import learning_curves

    storage.check_file(out)
    save_figure(learning_curves(runs), out)
    say(f"The learning curves are in {out}.")
