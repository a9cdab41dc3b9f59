"""Draws docs/architecture.svg from the imports: make diagram.

Boxes are the packages and the subpackages of eval; an arrow says that one imports another. An arrow is
left out where others lead there anyway. The whole list of imports stands in the file as a comment, and a test
compares it with the code.
"""

from __future__ import annotations

import functools
from pathlib import Path

import grimp
import matplotlib

matplotlib.use("svg")
from matplotlib import pyplot
from matplotlib.patches import FancyArrowPatch, FancyBboxPatch

FILE = Path(__file__).with_name("architecture.svg")
ROOT = "inclined_landing"
INK, MUTED, RULE, ARROW = "#1f2733", "#5f6b7a", "#b9c6d4", "#7a8999"
COLOURS = {"train": "#fdf1e7", "eval": "#f1f6fc", "envs": "#e9f6f1", "models": "#f8eef4"}
# Box: its middle, width, and what it is for. y counts rows from the bottom.
BOXES = {
    "train": (-1.05, 2, 1.8, "PPO, curricula, sweeps"),
    "eval.cli": (4.75, 6, 8.8, "landing-eval: the table of commands"),
    "eval.replay": (6.85, 5, 1.0, "flights to see"),
    "eval.study": (8.6, 5, 1.9, "how well do policies do?"),
    "eval.gap": (4.85, 4, 1.9, "which effect is missing?"),
    "eval.landings": (1.47, 4, 1.7, "what happens on touching?"),
    "eval.machine": (3.1, 4, 1.4, "doctor, benchmark"),
    "eval.truth": (6.7, 4, 1.56, "is the simulator right?"),
    "eval.export": (3.1, 3, 1.4, "ONNX, C, NumPy"),
    "eval.logs": (5.55, 3, 1.9, "what flights say"),
    "eval.pictures": (7.5, 3, 1.7, "figures, videos"),
    "eval.base": (5.0, 2, 9.2, "options, pages, claims, style"),
    "envs": (
        3.825,
        1,
        11.55,
        "tasks, batch, Gymnasium and SB3 faces, policies, flights, rendering; shared by both programs",
    ),
    "models": (3.825, 0, 11.55, "vehicle file, equations, effects, MJCF scene, native plugins, plants"),
}
_PLACES = {  # x at the start and at the end of arrows that go beside other boxes
    ("eval.cli", "eval.truth"): (6.17, 6.17),
    ("eval.replay", "eval.gap"): (6.5, 5.6),
    ("eval.replay", "eval.pictures"): (7.3, 7.6),
    ("eval.study", "eval.pictures"): (8.0, 8.0),
}
_HIGH, _ROW = 0.62, 1.06


@functools.cache
def imports() -> tuple[tuple[str, str], ...]:
    """Pairs of boxes of which the first imports the second."""
    graph = grimp.build_graph(ROOT)
    found = set()
    for module in graph.modules:
        for other in graph.find_modules_directly_imported_by(module):
            pair = box(module), box(other)
            if None not in pair and pair[0] != pair[1]:
                found.add(pair)
    # The command line imports a room when its command is run.
    found |= {("eval.cli", name) for name in BOXES if name.startswith("eval.") and name != "eval.cli"}
    return tuple(sorted(found))


def box(module: str) -> str | None:
    """The box that a module is in; None for what has none."""
    parts = module.split(".")[1:]
    name = ".".join(parts[:2]) if parts[:1] == ["eval"] else ".".join(parts[:1])
    return name if name in BOXES else None


def drawn(pairs: tuple[tuple[str, str], ...]) -> list[tuple[str, str]]:
    """The pairs without those that others imply."""

    def reaches(start: str, end: str) -> bool:
        return any(b == end or reaches(b, end) for a, b in pairs if a == start)

    return [(a, c) for a, c in pairs if not any(b != c and reaches(b, c) for x, b in pairs if x == a)]


def comment() -> str:
    """The whole list, as it stands in the file."""
    return "<!-- imports\n" + "\n".join(f"{a} > {b}" for a, b in imports()) + "\n-->\n"


def draw() -> str:
    """The picture as SVG."""
    options = {"svg.fonttype": "none", "svg.hashsalt": ROOT, "font.family": "sans-serif"}
    with matplotlib.rc_context(options):
        figure, axes = pyplot.subplots(figsize=(12.1, 7.4))
        axes.set(xlim=(-2.1, 10), ylim=(-0.5, 6 * _ROW + 0.6), aspect="equal")
        axes.axis("off")
        low, high = 2 * _ROW - 0.5, 6 * _ROW + 0.5
        style = "round,pad=0,rounding_size=0.12"
        frame = FancyBboxPatch((0.2, low), 9.6, high - low, boxstyle=style, fc=COLOURS["eval"], ec=RULE, lw=1)
        axes.add_patch(frame)
        axes.text(9.6, high - 0.2, "eval", ha="right", va="center", size=13, weight="bold", color=MUTED)
        for a, b in drawn(imports()):
            _arrow(axes, a, b)
        for name, (x, row, width, words) in BOXES.items():
            floor, _, room = name.partition(".")
            corner = (x - width / 2, row * _ROW - _HIGH / 2)
            colour = "white" if room else COLOURS[floor]
            axes.add_patch(
                FancyBboxPatch(corner, width, _HIGH, boxstyle=style, fc=colour, ec=RULE, lw=1.2, zorder=3)
            )
            text = {"ha": "center", "va": "center", "zorder": 4}
            axes.text(x, row * _ROW + 0.12, room or floor, size=12, weight="bold", color=INK, **text)
            axes.text(x, row * _ROW - 0.14, words, size=8.5, color=MUTED, **text)
        figure.subplots_adjust(0.01, 0.01, 0.99, 0.99)
        figure.savefig(FILE, metadata={"Date": None, "Creator": None})
        pyplot.close(figure)
    return FILE.read_text("utf-8")


def _arrow(axes, a: str, b: str) -> None:
    (x, row, wide, _), (x2, row2, wide2, _) = BOXES[a], BOXES[b]
    # Straight down where the boxes overlap, else from middle to middle.
    left, right = max(x - wide / 2, x2 - wide2 / 2), min(x + wide / 2, x2 + wide2 / 2)
    if (a, b) in _PLACES:
        start, end = _PLACES[a, b]
    elif right - left > 0.6:
        start = end = min(max(x if wide <= wide2 else x2, left + 0.3), right - 0.3)
    else:
        start, end = x, x2
    arrow = FancyArrowPatch(
        (start, row * _ROW - _HIGH / 2),
        (end, row2 * _ROW + _HIGH / 2),
        arrowstyle="-|>",
        mutation_scale=11,
        color=ARROW,
        lw=1.3,
        shrinkA=0,
        shrinkB=1,
        zorder=2,
    )
    axes.add_patch(arrow)


if __name__ == "__main__":
    FILE.write_text(draw() + comment(), "utf-8")
    print(FILE)
