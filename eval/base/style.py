"""Fonts, colours and files of all figures."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
from matplotlib import patheffects
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.legend import Legend
from matplotlib.transforms import ScaledTranslation

from inclined_landing.eval.base.colours import BLUE, GREEN, INK, MUTED, ORANGE, PURPLE, RULE
from inclined_landing.models.base import storage
from inclined_landing.models.base.errors import UserError, shown

STAMP_DPI = 500  # of rendered vehicles in a PDF
PNG_DPI = 200
_COLOURS = (ORANGE, BLUE, GREEN, PURPLE, MUTED)
_MARKERS = ("o", "s", "^", "D", "v")

STYLE: dict[Any, Any] = {
    "font.family": "DejaVu Sans",  # comes with matplotlib
    "font.size": 9.0,
    "axes.titlesize": 10.0,
    "axes.labelsize": 9.5,
    "axes.labelcolor": INK,
    "axes.edgecolor": INK,
    "axes.linewidth": 0.9,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.axisbelow": True,
    "text.color": INK,
    "xtick.color": INK,
    "ytick.color": INK,
    "grid.color": RULE,
    "grid.linewidth": 0.7,
    "legend.frameon": False,
    "legend.fontsize": 8.5,
    "lines.linewidth": 1.8,
    "figure.facecolor": "white",
    "pdf.fonttype": 42,  # text stays text
    "image.composite_image": False,  # each vehicle its own picture, not one over the whole page
}

# But the backend, which no figure here uses: matplotlib resolves it when it is read.
_DEFAULTS: dict[Any, Any] = {n: v for n, v in matplotlib.rcParamsDefault.items() if n != "backend"}


def literal(name: str) -> str:
    """Return a name escaped for matplotlib, in which text between two dollar signs is a formula."""
    return shown(name).replace("$", r"\$")


def colour(k: int) -> str:
    """Return the colour of the k-th policy in every figure."""
    return _COLOURS[k % len(_COLOURS)]


def marker(k: int) -> str:
    """Return the marker of the k-th policy; it differs if a colour repeats."""
    return _MARKERS[(k + k // len(_COLOURS)) % len(_MARKERS)]


def styled():
    """Return the context in which figures are made and saved, independent of any matplotlibrc."""
    return matplotlib.rc_context({**_DEFAULTS, **STYLE})


def time_colours(share) -> np.ndarray:
    """Return RGB (k, 3) for shares of the flight path (k,): dark violet at 0 to orange at 1."""
    return matplotlib.colormaps["plasma"](0.02 + 0.76 * np.asarray(share, float))[..., :3]


def halo(width: float) -> list:
    """Return path effects that surround a line with a white one, `width` points wide."""
    return [patheffects.Stroke(linewidth=width, foreground="white", alpha=0.85), patheffects.Normal()]


def panel(figure: Figure, left: float, bottom: float, width: float, height: float, **options) -> Axes:
    """Return axes whose box is given in inches from the lower left corner of the figure."""
    w, h = figure.get_size_inches()
    return figure.add_axes((left / w, bottom / h, width / w, height / h), **options)


def legend_below(axes: Axes, **options) -> Legend:
    """Return the legend of axes, drawn below their x label."""
    lower = axes.transAxes + ScaledTranslation(0, -0.54, axes.figure.dpi_scale_trans)
    settings = {
        "ncols": 2,
        "columnspacing": 1.4,
        "handlelength": 1.8,
        "borderaxespad": 0,
        "borderpad": 0,
    } | options
    return axes.legend(loc="upper center", bbox_to_anchor=(0.5, 0.0), bbox_transform=lower, **settings)


def save_figure(figure: Figure, path: str | Path) -> Path:
    """Write the figure as .png or .pdf, atomically; returns the path.

    Raises UserError for any other suffix, and if the file cannot be written.
    """
    path = Path(path)
    kind = path.suffix.lower()
    if kind not in (".png", ".pdf"):
        raise UserError(f"a figure must be a .png or .pdf file, not {path.name!r}")
    metadata = {"CreationDate": None} if kind == ".pdf" else {}
    with storage.made(path.parent), styled(), storage.atomic(path) as part:
        figure.savefig(part, dpi=STAMP_DPI if kind == ".pdf" else PNG_DPI, metadata=metadata)
    return path
