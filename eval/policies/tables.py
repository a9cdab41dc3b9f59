"""Tables of outcomes by policy and condition, and what `panels` draws of them, the same for every study.

An outcome is what `flying.summary` counts: shares with their intervals, medians with their quantiles, by the
names of `MEASURES`.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from inclined_landing.envs.shared.tables import share_cell, spread_cell
from inclined_landing.eval.base.claims import Table

Row = tuple[tuple[str, ...], Mapping[str, Any]]  # labels and outcome


def _median(found: dict, factor: float = 1.0) -> str:
    return "-" if found["median"] is None else f"{factor * found['median']:.2f}"


def _count(share: dict) -> str:
    return str(share["count"])


def _centimetres(key: str) -> Callable[[dict], str]:
    return lambda error: f"{100 * error[key]:.2f}"


STRICT = (
    "Strict success: the vehicle reaches the goal box within 300 steps without touching anything first. "
    "Shares have 95 % Wilson intervals."
)
# What may be counted: heading, and the text of a cell.
MEASURES: dict[str, tuple[str, Callable[[dict], str]]] = {
    "strict": ("strict [%]", share_cell),
    "success": ("success [%]", share_cell),
    "touched": ("touched", _count),
    "at_rest": ("at rest [%]", share_cell),
    "at_rest_on_feet": ("at rest on feet [%]", share_cell),
    "within": ("< 5 cm [%]", share_cell),
    "error": ("error after 3 s [cm]", _centimetres("mean")),
    "time_to_goal": ("time [s]", spread_cell),
    "time": ("time [s]", _median),
    "normal_speed": ("normal speed [m/s]", _median),
    "tangential_speed": ("tangential speed [m/s]", _median),
    "tilt": ("tilt [deg]", lambda found: _median(found, math.degrees(1.0))),
    "peak_normal_force": ("peak force [N]", _median),
    "reward": ("reward", spread_cell),
    "duration": ("duration [s]", spread_cell),
}


def outcomes_table(heads: Sequence[str], rows: Sequence[Row]) -> Table:
    """Return a table with a row for each outcome: labels under `heads`, number of flights, measures.

    In the first column, a label that repeats the one above is left out.
    """
    shown = [name for name in MEASURES if rows and name in rows[0][1]]
    counted = shown[0] if shown else ""
    cells, before = [], ""
    for labels, found in rows:
        first = "" if labels[0] == before and len(labels) > 1 else labels[0]
        before = labels[0]
        texts = (MEASURES[name][1](found[name]) if name in found else "-" for name in shown)
        cells.append((first, *labels[1:], str(found[counted]["of"]), *texts))
    return Table("", (*heads, "flights", *(MEASURES[name][0] for name in shown)), cells)


def size_words(parameters: dict) -> str:
    """Return parameter values with their units: "x 0.5, y -0.3 m/s"."""
    units = {p["unit"] for p in parameters.values()}
    common = units.pop() if len(units) == 1 else None
    texts = []
    for name, p in parameters.items():
        unit = "" if p["unit"] in ("1", common) else f" {p['unit']}"
        texts.append(f"{name} {p['value']:g}{unit}")
    return ", ".join(texts) + (f" {common}" if common not in (None, "1") else "")


def slope_words(options: dict) -> str:
    """Return the slopes of a task: "-25.7 deg", "up to +-25.7 deg" or "up to 30 deg, any heading"."""
    if options.get("steepest") is None:
        return f"{math.degrees(options['inclination']):.1f} deg"
    steepest = f"{math.degrees(options['steepest']):.3g} deg"
    return f"up to +-{steepest}" if options.get("dimensions", 2) == 2 else f"up to {steepest}, any heading"


@dataclasses.dataclass(frozen=True)
class Panel:
    """Shares with their 95 % intervals, of every policy by its name.

    Shares at numbers are drawn as lines over a quantity, shares under named conditions as marks in rows.
    """

    title: str
    shares: Mapping[str, Mapping[Any, dict]]  # by policy, by number or condition
    quantity: str = ""  # with its unit; "": of conditions with names
    logarithmic: bool = False

    @property
    def conditions(self) -> list[str]:
        """Return the names of the conditions of any policy."""
        return list(dict.fromkeys(name for found in self.shares.values() for name in found))
