"""`landing-eval curves`: what trainings learned."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import tyro

from inclined_landing.eval.base.options import File
from inclined_landing.eval.pictures.figures import learning_curves, save_figure
from inclined_landing.models import storage


def command(
    runs: Annotated[tuple[Path, ...], tyro.conf.Positional, tyro.conf.arg(metavar="DIR [DIR ...]")],
    /,
    out: File,
) -> None:
    """Learning curves of training runs of one task; seeds with median and range.

    Args:
        runs: run folders of landing-train.
        out: .png or .pdf file.
    """
    storage.check_file(out)
    print(save_figure(learning_curves(runs), out))
