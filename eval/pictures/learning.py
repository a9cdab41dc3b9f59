"""Learning curves of training runs of one task."""

from __future__ import annotations

import dataclasses
import io
import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import msgspec
import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from matplotlib.ticker import LogLocator, NullLocator

from inclined_landing.envs.hover import TOLERANCE
from inclined_landing.envs.tasks.base import VEHICLE_KINDS, kind_column
from inclined_landing.eval.base.colours import BLUE, GREEN, MUTED, ORANGE, PURPLE
from inclined_landing.eval.base.style import styled
from inclined_landing.models.base import storage
from inclined_landing.models.base.errors import UserError, shown

_LARGEST = 1e12  # number in the tables of a run


class _Run(NamedTuple):
    """The data of a training run for the figure."""

    task: str
    learning: pd.DataFrame
    evaluations: pd.DataFrame


@dataclasses.dataclass(frozen=True)
class Curve:
    """A column of a run's tables, and how it is plotted."""

    column: str
    label: str
    factor: float = 100.0
    limits: tuple[float, float] | None = (-3.0, 108.0)
    reference: tuple[float, str] | None = None  # value and what it is
    logarithmic: bool = False


# What `Task.score` returns besides "score" says more; the first of these columns that a run has is shown.
_SCORES = (
    Curve("strict_success", "goal box reached, strict [%]"),
    Curve("at_rest", "at rest on the slope [%]"),
    Curve(
        "mean_error",
        "mean error after 3 s [cm]",
        limits=None,
        reference=(100.0 * TOLERANCE, f"tolerance: {100 * TOLERANCE:g} cm"),
        logarithmic=True,
    ),
    Curve("score", "success [%]"),
)
_LEAST = 3  # evaluations of a run that make a curve
_LEVEL = Curve("level", "curriculum level", 1.0, (-0.03, 1.08))
_LENGTH = Curve("episode_length", "episode length [steps]", 1.0, None)
_REWARD = Curve("episode_reward", "episode reward", 1.0, None)
_LEARNING = {_LEVEL: PURPLE, _LENGTH: GREEN, _REWARD: ORANGE}  # curves of learning.csv, and their colours


def _read_run(folder: str | Path) -> _Run:
    """Return a training run from its folder; raises UserError, naming the file, if it is not one."""
    folder = Path(folder)
    if not folder.is_dir():
        raise UserError(f"the run folder {folder} does not exist")
    record = storage.read_json(folder / "run.json", "run")
    try:
        task = msgspec.convert(record["config"]["task"], str)
    except (TypeError, KeyError, msgspec.ValidationError) as error:
        raise UserError(f"{folder / 'run.json'} does not name the trained task") from error
    learning = _read_table(folder / "learning.csv", ["steps", *(curve.column for curve in _LEARNING)])
    scores = [curve.column for curve in _SCORES]
    scores += [kind_column(column, kind) for column in scores for kind in VEHICLE_KINDS]
    evaluations = _read_table(folder / "evaluations.csv", ["steps"], scores)
    if not set(scores) & set(evaluations):
        raise UserError(f"{folder / 'evaluations.csv'} lacks the column score")
    if learning.empty:
        raise UserError(f"{folder / 'learning.csv'} has no rows yet; the run is too short for curves")
    return _Run(task, learning, evaluations)


def _score_curve(tables: Sequence[pd.DataFrame]) -> Curve:
    """Return the most informative score that all evaluations have, as a curve."""
    flown = [table for table in tables if not table.empty]
    shared = [curve for curve in _SCORES if flown and all(curve.column in table for table in flown)]
    return shared[0] if shared else _SCORES[-1]


def _read_table(path: Path, columns: list[str], optional: Sequence[str] = ()) -> pd.DataFrame:
    """Return columns of a CSV table of a run, NaN in empty cells; raise UserError for text in them."""
    text = storage.read_text(path, "table", storage.LARGEST_JSON)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error", pd.errors.ParserWarning)  # rows longer than the header
            table = pd.read_csv(io.StringIO(text), index_col=False) if text.strip() else pd.DataFrame()
    except (ValueError, pd.errors.ParserWarning) as error:
        raise UserError(
            f"{path} is not a table: rows differ in length, or a quotation mark is open"
        ) from error
    if table.empty:
        return pd.DataFrame(columns=[*columns, *(curve.column for curve in _SCORES)], dtype=float)
    numbers = {}
    for column in (*columns, *(name for name in optional if name in table)):
        if column not in table:
            raise UserError(f"{path} lacks the column {column}")
        values = pd.to_numeric(table[column], errors="coerce").astype(float)
        missing = table[column].isna() & (column != "steps")
        wrong = ~(values.abs() <= _LARGEST) & ~missing | (values < 0.0) & (column == "steps")
        if wrong.any():
            row = int(wrong.to_numpy().argmax())
            value = shown(table[column].iloc[row], 40)
            raise UserError(f"{path}: {column} is {value} in row {row + 1}, which is not a valid value")
        numbers[column] = values
    return pd.DataFrame(numbers)


def learning_curves(runs: Sequence[str | Path]) -> Figure:
    """Return a figure of score, curriculum level, episode length and reward over environment steps.

    runs: run folders of one task, usually one for each seed. Each is a thin line; for two or more, the median
    is a thick line and the range a band, up to the shortest run. Curriculum level and episode length are
    omitted if they never change, and so is the score of runs that finish their curriculum with fewer than
    three evaluations. The steps in which the level still changes are shaded, because the reward of a learning
    policy may then decrease. Raises UserError for no runs, runs of different tasks and folders that are not
    runs.
    """
    if not runs:
        raise UserError("learning curves need at least one run folder")
    loaded = [_read_run(folder) for folder in runs]
    tasks = sorted({run.task for run in loaded})
    if len(tasks) > 1:
        raise UserError(f"the runs are of different tasks ({' and '.join(tasks)}); choose runs of one task")
    evaluations = [run.evaluations for run in loaded]
    score = _score_curve(evaluations)
    curves = [(score, BLUE, evaluations)]
    if any(run.learning["level"].nunique() > 1 for run in loaded) and not any(
        len(run.evaluations) >= _LEAST for run in loaded
    ):
        curves.clear()  # the level shows how the runs learned
    for curve, colour in _LEARNING.items():
        if curve is _REWARD or any(run.learning[curve.column].nunique() > 1 for run in loaded):
            curves.append((curve, colour, [run.learning for run in loaded]))
    with styled():
        columns = 2 if len(curves) == 4 else len(curves)  # two to four
        rows = len(curves) // columns
        figure = Figure(figsize=(3.4 * columns, 0.45 + 2.05 * rows), layout="constrained")
        grid = figure.subplots(rows, columns, sharex=True, squeeze=False)
        for axes, (curve, colour, tables) in zip(grid.ravel(), curves):
            columns_of = _score_columns(curve, tables) if curve is score else {curve.column: ""}
            for (column, name), shade, dashes in zip(columns_of.items(), (colour, ORANGE), ("-", "--")):
                _draw_curves(axes, dataclasses.replace(curve, column=column), shade, tables, dashes)
                if name:
                    axes.plot([], [], color=shade, lw=2.0, ls=dashes, label=name)
            _format_axes(axes, curve)
        for axes in grid[-1]:
            axes.set_xlabel("environment steps [10⁶]")
        final = max(run.learning["steps"].max() for run in loaded) / 1e6
        grid[0, 0].set_xlim(0, 1.01 * final)
        if changing := max(_curriculum_end(run.learning) for run in loaded):
            for axes in grid.ravel():
                axes.axvspan(0, changing / 1e6, color=PURPLE, alpha=0.1, lw=0, gid="curriculum")
            label = "curriculum level still rising: the task gets harder, and the reward may fall"
            patch = Patch(color=PURPLE, alpha=0.1, lw=0, label=label)
            figure.legend(handles=[patch], loc="outside lower center")
        if len(loaded) > 1:
            handles = [
                *grid[0, 0].plot([], [], color=MUTED, lw=2.2, label=f"median of {len(loaded)} seeds"),
                grid[0, 0].fill_between([], [], color=MUTED, alpha=0.25, lw=0, label="lowest to highest"),
                *grid[0, 0].plot([], [], color=MUTED, lw=0.7, alpha=0.7, label="each seed"),
            ]
            figure.legend(handles=handles, loc="outside upper center", ncols=3)
    return figure


def _curriculum_end(learning: pd.DataFrame) -> float:
    """Return the steps after which the curriculum's level is constant, 0 if it never moves."""
    rows = learning[["steps", "level"]].dropna().to_numpy(float)
    moving = np.flatnonzero(rows[:, 1] != rows[-1:, 1])
    return float(rows[moving[-1] + 1, 0]) if len(moving) else 0.0


def _score_columns(curve: Curve, tables: Sequence[pd.DataFrame]) -> dict[str, str]:
    """Return the columns of evaluations to show, and the vehicles of each; "" for all flights."""
    of_kind = {kind_column(curve.column, kind): name for kind, name in VEHICLE_KINDS.items()}
    return of_kind if all(column in table for column in of_kind for table in tables) else {curve.column: ""}


def _draw_curves(
    axes: Axes, curve: Curve, colour: str, tables: Sequence[pd.DataFrame], dashes: str = "-"
) -> None:
    """Draw the curves of several seeds as thin lines; for two or more, with median and range."""
    lines = []
    for table in tables:
        rows = table[["steps", curve.column]].dropna()
        if len(rows):
            values = rows.to_numpy(float)
            lines.append((values[:, 0] / 1e6, curve.factor * values[:, 1]))
    several = len(lines) > 1
    for x, y in lines:
        style: dict[str, Any] = {"lw": 0.7, "alpha": 0.6} if several else {"lw": 2.0}
        style |= {"marker": "o", "ms": 3.5} if not several and len(x) < 16 else {}
        axes.plot(x, y, color=colour, ls=dashes, gid="run", **style)
    if several:
        x, middle, low, high = median_and_range(lines)
        axes.fill_between(x, low, high, color=colour, alpha=0.2, lw=0, gid="band")
        axes.plot(x, middle, color=colour, lw=2.2, ls=dashes, gid="median")


def _format_axes(axes: Axes, curve: Curve) -> None:
    """Set labels, limits and scale of axes, and draw the reference value of their curve."""
    axes.grid(True)
    axes.set_ylabel(curve.label)
    if not axes.lines:
        axes.text(0.5, 0.5, "no evaluations yet", transform=axes.transAxes, ha="center", color=MUTED)
    if curve.reference:
        value, text = curve.reference
        axes.axhline(value, color="black", lw=1.1, ls=(0, (5, 2)), zorder=1.5, gid="reference", label=text)
    if axes.get_legend_handles_labels()[1]:
        axes.legend(loc="upper right" if curve.logarithmic else "lower right")
    if curve.limits:
        axes.set_ylim(*curve.limits)
    if curve.logarithmic:
        axes.set_yscale("log")
        axes.yaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
        axes.yaxis.set_major_formatter("{x:g}")
        axes.yaxis.set_minor_locator(NullLocator())


def median_and_range(
    lines: Sequence[tuple[np.ndarray, np.ndarray]],
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return common abscissae (m,) of curves (x, y), and their median, lowest and highest values there.

    Curves are interpolated linearly; only the range that all of them cover is used.
    """
    start, end = max(x[0] for x, _ in lines), min(x[-1] for x, _ in lines)
    steps = np.unique(np.concatenate([x for x, _ in lines]))
    steps = steps[(steps >= start) & (steps <= end)]
    values = np.array([np.interp(steps, x, y) for x, y in lines])
    return steps, np.median(values, axis=0), values.min(axis=0), values.max(axis=0)
