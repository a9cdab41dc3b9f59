"""Learning curves of training runs: seeds of one kind, or kinds beside each other."""

from __future__ import annotations

import io
import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, NullLocator

from inclined_landing.envs.tasks import is_path, known, task_class
from inclined_landing.envs.tasks.base import ScoreCurve
from inclined_landing.eval.base.style import BLUE, GREEN, INK, MUTED, ORANGE, PURPLE, literal, styled
from inclined_landing.models import storage
from inclined_landing.models.errors import UserError, shown

_LARGEST = 1e12  # number in the tables of a run


class _Against(NamedTuple):
    """What curves are drawn against."""

    column: str
    unit: float
    label: str


_STEPS = _Against("steps", 1e6, "environment steps [10⁶]")
_AGAINST = (_STEPS, _Against("cpu_seconds", 1.0, "CPU time of the training [s]"))
_COLOURS = (BLUE, ORANGE, GREEN, PURPLE, INK, MUTED)

_LEVEL = ScoreCurve("level", "curriculum level", 1.0, (-0.03, 1.08))
_LENGTH = ScoreCurve("episode_length", "episode length [steps]", 1.0, None)
_REWARD = ScoreCurve("episode_reward", "episode reward", 1.0, None)
# By table of a run: what is shown of it, and in which colour; of the evaluations the score of the task.
_LEARNING = {_LEVEL: PURPLE, _LENGTH: GREEN, _REWARD: ORANGE}


def read_run(
    folder: str | Path, against: Sequence[_Against] = (_STEPS,)
) -> tuple[str, dict[str, pd.DataFrame]]:
    """The task of a run folder, and its tables `learning` and `evaluations`.

    against: what they are drawn against. Raises UserError, naming the file, if it is not one.
    """
    folder = Path(folder)
    if not folder.is_dir():
        raise UserError(f"the run folder {folder} does not exist")
    record = storage.read_json(folder / "run.json", "run")
    try:
        task = record["config"]["task"]
        drawn = {"learning": _LEARNING, "evaluations": (_score_curve(task),)}
    except (TypeError, KeyError, UserError) as error:
        raise UserError(f"{folder / 'run.json'} does not say which task was trained") from error
    tables = {
        name: _table(
            folder / f"{name}.csv", [*(axis.column for axis in against), *(curve.column for curve in curves)]
        )
        for name, curves in drawn.items()
    }
    if tables["learning"].empty:
        raise UserError(f"{folder / 'learning.csv'} holds no rows yet: the run has not learned anything")
    return task, tables


def _score_curve(task: str) -> ScoreCurve:
    """The task's; of a task of one's own that was not imported what every task has."""
    return ScoreCurve() if is_path(task) and not known(task) else task_class(task).score_curve


def _table(path: Path, columns: list[str]) -> pd.DataFrame:
    """The columns of a table of a run, NaN where there is no value; UserError for what is no number."""
    text = storage.read_text(path, "table", storage.LARGEST_JSON)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error", pd.errors.ParserWarning)  # rows longer than the header
            table = pd.read_csv(io.StringIO(text), index_col=False) if text.strip() else pd.DataFrame()
    except (ValueError, pd.errors.ParserWarning) as error:
        raise UserError(f"{path} is not a table: {error}") from error
    if table.empty:
        return pd.DataFrame({column: [] for column in columns}, dtype=float)
    numbers = {}
    for column in columns:
        if column not in table:
            raise UserError(f"{path} lacks the column {column}")
        values = pd.to_numeric(table[column], errors="coerce").astype(float)
        missing = table[column].isna() & (column != "steps")
        wrong = ~(values.abs() <= _LARGEST) & ~missing | (values < 0.0) & (column == "steps")
        if wrong.any():
            row = int(wrong.to_numpy().argmax())
            value = shown(table[column].iloc[row], 40)
            raise UserError(f"{path}: {column} is {value} in row {row + 1}, which no run writes")
        numbers[column] = values
    return pd.DataFrame(numbers)


def learning_curves(runs: Sequence[str | Path]) -> Figure:
    """Figure of success, curriculum, episodes and reward against environment steps.

    runs: run folders of one task, usually one for each seed. Each is a thin line; from two on, the
    median is a thick line and the range from the lowest to the highest a band, as far as all runs
    reach. The curriculum's level and the episodes' length are left out where they never change.
    Raises UserError for no runs, runs of different tasks and folders that are no runs.
    """
    if not runs:
        raise UserError("learning curves need at least one run folder")
    named, read = zip(*map(read_run, runs))
    tasks = sorted(set(named))
    if len(tasks) > 1:
        raise UserError(f"the runs are of different tasks ({' and '.join(tasks)}); choose runs of one")
    curves = [("evaluations", _score_curve(tasks[0]), BLUE)]
    for curve, colour in _LEARNING.items():
        if curve is _REWARD or any(run["learning"][curve.column].nunique() > 1 for run in read):
            curves.append(("learning", curve, colour))
    with styled():
        columns = 2 if len(curves) == 4 else len(curves)  # two to four
        rows = len(curves) // columns
        figure = Figure(figsize=(3.4 * columns, 0.45 + 2.05 * rows), layout="constrained")
        grid = figure.subplots(rows, columns, sharex=True, squeeze=False)
        for axes, (table, curve, colour) in zip(grid.ravel(), curves):
            _draw(axes, curve, colour, [run[table] for run in read], _STEPS)
            _frame(axes, curve)
        for axes in grid[-1]:
            axes.set_xlabel(_STEPS.label)
        final = max(run["learning"]["steps"].max() for run in read) / 1e6
        grid[0, 0].set_xlim(0, 1.01 * final)
        if len(read) > 1:
            handles = [
                *grid[0, 0].plot([], [], color=MUTED, lw=2.2, label=f"median of {len(read)} seeds"),
                grid[0, 0].fill_between([], [], color=MUTED, alpha=0.25, lw=0, label="lowest to highest"),
                *grid[0, 0].plot([], [], color=MUTED, lw=0.7, alpha=0.7, label="each seed"),
            ]
            figure.legend(handles=handles, loc="outside upper center", ncols=3)
    return figure


def comparison_curves(runs: Sequence[str | Path], by: Sequence[str]) -> Figure:
    """Figure of score and curriculum level against environment steps and CPU seconds of the training.

    runs: run folders; those with the same values of the options `by`, as run.json calls them, are seeds of
    one group and have one colour: thin lines, their median, and the range from the lowest to the highest.
    Tasks have a row each, and one for the level where it moves. Raises UserError for folders that are no
    runs, unknown options and too many groups.
    """
    if not runs:
        raise UserError("curves need at least one run folder")
    runs_read = [(*read_run(folder, _AGAINST), _group(Path(folder), by)) for folder in runs]
    tasks, groups = (list(dict.fromkeys(run[k] for run in runs_read)) for k in (0, 2))
    if len(groups) > len(_COLOURS):
        raise UserError(f"the runs are of {len(groups)} kinds; at most {len(_COLOURS)} are told apart")
    rows = []
    for task in tasks:
        rows.append((task, "evaluations", _score_curve(task)))
        if any(of == task and tables["learning"]["level"].nunique() > 1 for of, tables, _ in runs_read):
            rows.append((task, "learning", _LEVEL))
    with styled():
        figure = Figure(figsize=(6.8, 0.75 + 1.9 * len(rows)), layout="constrained")
        grid = figure.subplots(len(rows), len(_AGAINST), sharex="col", sharey="row", squeeze=False)
        for line, (task, name, curve) in zip(grid, rows):
            for axes, against in zip(line, _AGAINST):
                for group, colour in zip(groups, _COLOURS):
                    tables = [read[name] for of, read, g in runs_read if (of, g) == (task, group)]
                    _draw(axes, curve, colour, tables, against)
                _frame(axes, curve)
                axes.set_xlim(left=0)
            line[1].set_ylabel("")
            if curve is not _LEVEL:
                line[0].set_title(task, loc="left")
        for axes, against in zip(grid[-1], _AGAINST):
            axes.set_xlabel(against.label)
        handles = []
        for group, colour in zip(groups, _COLOURS):
            count = sum(of == group for *_, of in runs_read)
            label = f"{literal(group)}, {count} run{'s' if count > 1 else ''}"
            handles += grid[0, 0].plot([], [], color=colour, lw=2.2, label=label)
        figure.legend(handles=handles, loc="outside upper center", ncols=min(3, len(handles)))
    return figure


def _group(folder: Path, by: Sequence[str]) -> str:
    """The values of options of a run, in words."""
    config = storage.read_json(folder / "run.json", "run").get("config", {})
    for name in by:
        if name not in config:
            raise UserError(f"the run {folder} has no option {shown(name, 40)!r}")
    return ", ".join("-" if config[name] is None else shown(config[name], 40) for name in by)


def _draw(axes: Axes, curve: ScoreCurve, colour: str, tables: list[pd.DataFrame], against: _Against) -> None:
    """Curves of several seeds: a thin line each, from two on their median and range."""
    lines = []
    for table in tables:
        rows = table[[against.column, curve.column]].dropna() if curve.column in table else table.iloc[:0]
        if len(rows):
            values = rows.to_numpy(float)
            lines.append((values[:, 0] / against.unit, curve.factor * values[:, 1]))
    several = len(lines) > 1
    for x, y in lines:
        style = {"lw": 0.7, "alpha": 0.6} if several else {"lw": 2.0}
        style |= {"marker": "o", "ms": 3.5} if not several and len(x) < 16 else {}
        axes.plot(x, y, color=colour, gid="run", **style)
    if several:
        x, middle, low, high = band(lines)
        axes.fill_between(x, low, high, color=colour, alpha=0.2, lw=0, gid="band")
        axes.plot(x, middle, color=colour, lw=2.2, gid="median")


def _frame(axes: Axes, curve: ScoreCurve) -> None:
    """Labels, limits and what the curves are compared with."""
    axes.grid(True)
    axes.set_ylabel(curve.label)
    if not axes.lines:
        axes.text(0.5, 0.5, "no evaluations yet", transform=axes.transAxes, ha="center", color=MUTED)
    if curve.reference:
        value, text = curve.reference
        axes.axhline(value, color="black", lw=1.1, ls=(0, (5, 2)), zorder=1.5, gid="reference")
        axes.annotate(
            text, (0.02, value), xycoords=axes.get_yaxis_transform(), xytext=(0, 2), size=8.5,
            textcoords="offset points", ha="left", va="bottom",
        )  # fmt: skip
    if curve.limits:
        axes.set_ylim(*curve.limits)
    if curve.logarithmic:
        axes.set_yscale("log")
        axes.yaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
        axes.yaxis.set_major_formatter("{x:g}")
        axes.yaxis.set_minor_locator(NullLocator())


def band(lines: Sequence[tuple[np.ndarray, np.ndarray]]):
    """Common steps and the median, lowest and highest value there of curves (x, y).

    Curves are interpolated linearly; only the range that all of them cover is used.
    """
    start, end = max(x[0] for x, _ in lines), min(x[-1] for x, _ in lines)
    steps = np.unique(np.concatenate([x for x, _ in lines]))
    steps = steps[(steps >= start) & (steps <= end)]
    values = np.array([np.interp(steps, x, y) for x, y in lines])
    return steps, np.median(values, axis=0), values.min(axis=0), values.max(axis=0)
