"""`landing-eval beyond`: the old name of `landing-train sweep --page`, until the next release."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated

import tyro

from inclined_landing.eval.base.options import NewFolder
from inclined_landing.eval.sweeps.page import write_page
from inclined_landing.models.errors import UserError


def command(
    sweeps: Annotated[tuple[Path, ...], tyro.conf.Positional, tyro.conf.arg(metavar="SWEEP [SWEEP ...]")],
    /,
    out: NewFolder = None,
    site: NewFolder = None,
) -> None:
    """The results of sweeps on one page; now landing-train sweep SWEEP [SWEEP ...] --page DIR.

    Args:
        sweeps: folders of landing-train sweep, or recipes with a result.
        out: as --page.
        site: as --site.
    """
    now = "landing-eval beyond is now: landing-train sweep SWEEP [SWEEP ...] --page DIR"
    print(f"{now}; the old name works until the next release", file=sys.stderr)
    if out is None and site is None:
        raise UserError("give --out for a page, --site for the documentation, or both")
    write_page(sweeps, out, site)
