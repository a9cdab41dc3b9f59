"""What the benchmark says: one report, shown as table, figure and page."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from rich.console import Console
from rich.progress import track

from inclined_landing.eval.base import runs
from inclined_landing.eval.base.statistics import proportion, spread
from inclined_landing.eval.base.style import BLUE, GREEN, MUTED, ORANGE, PURPLE, literal, styled
from inclined_landing.eval.base.tables import new_table, printer, share_cell
from inclined_landing.eval.moving.controllers import Controller
from inclined_landing.eval.moving.flying import FIELDS, fly
from inclined_landing.eval.moving.scenario import Scenario

_COLOURS = (ORANGE, BLUE, GREEN, PURPLE, MUTED)
_MARKS = ("o", "s", "^", "D", "v")
_ROW, _APART = 0.3, 0.13  # in, and rows between controllers


def evaluate(
    scenarios: Sequence[Scenario], controllers: Sequence[Controller], flights: int | None = None
) -> tuple[dict, pd.DataFrame]:
    """The report, plain numbers, and a table of all flights.

    flights: of each scenario at most; None: as many as it says.
    """
    rows, flown = [], []
    work = [(scenario, controller) for scenario in scenarios for controller in controllers]
    console = Console(stderr=True)
    quiet = not console.is_terminal
    for scenario, controller in track(work, "flying", console=console, transient=True, disable=quiet):
        found = fly(scenario, controller, flights)
        flown.append(found.assign(scenario=scenario.name, controller=controller.name))
        rows.append({"controller": controller.name, **_summary(found)})
    each = len(controllers)
    return {
        "command": "moving",
        "controllers": [{"name": c.name, "kind": c.kind} for c in controllers],
        "scenarios": [
            {
                "name": scenario.name,
                "title": scenario.title,
                "fingerprint": scenario.fingerprint,
                "speed": scenario.motion.speed,
                "waves": bool(scenario.waves.amplitude.any()),
                "slope": scenario.inclination,
                "whole": flights is None or flights >= scenario.flights,
                "outcomes": rows[each * k : each * (k + 1)],
            }
            for k, scenario in enumerate(scenarios)
        ],
        "all": [
            {"name": c.name, "at_rest": proportion(rests.sum(), len(rests))}
            for c in controllers
            for rests in [pd.concat([f for f in flown if f["controller"].iloc[0] == c.name])["at_rest"]]
        ],
        "versions": runs.versions(),
    }, pd.concat(flown, ignore_index=True)


def _summary(flights: pd.DataFrame) -> dict:
    rest = proportion(flights["at_rest"].sum(), len(flights))
    return {"at_rest": rest} | {name: spread(flights[name]) for name in FIELDS[1:]}


def heads(report: dict) -> list[str]:
    """Of the columns of `cells`."""
    return [
        "scenario",
        "controller",
        "at rest [%]",
        "after [s]",
        "into it [m/s]",
        "along it [m/s]",
        "tilt [deg]",
    ]


def cells(report: dict) -> list[list[str]]:
    """One row for each scenario and controller: share at rest, medians of the touch."""
    rows = []
    for scenario in report["scenarios"]:
        for k, outcome in enumerate(scenario["outcomes"]):
            medians = [outcome[name]["median"] for name in ("time", "normal_speed", "tangential_speed")]
            tilt = outcome["tilt"]["median"]
            rows.append(
                [
                    scenario["name"] if k == 0 else "",
                    outcome["controller"],
                    share_cell(outcome["at_rest"]),
                    *("-" if value is None else f"{value:.2f}" for value in medians),
                    "-" if tilt is None else f"{math.degrees(tilt):.0f}",
                ]
            )
    return rows


def show(report: dict) -> None:
    """Print the report."""
    console = printer()
    shown = new_table("At rest on a moving deck", *heads(report), left=2)
    for row in cells(report):
        if row[0] and shown.row_count:
            shown.add_section()
        shown.add_row(*row)
    shown.caption = (
        "95 % Wilson intervals. Speeds and tilt at the first touch, relative to the deck, and the time until "
        "rest: medians"
    )
    console.print(shown)
    for row in report["all"]:
        console.print(f"{row['name']}: {share_cell(row['at_rest'])} % of all flights at rest")
    if not all(scenario["whole"] for scenario in report["scenarios"]):
        console.print("fewer flights than the scenarios have: not a result of the benchmark")


def steady(report: dict) -> list[dict]:
    """The scenarios of level decks that travel steadily, by speed."""
    level = [s for s in report["scenarios"] if not s["waves"] and s["slope"] == 0.0]
    return sorted(level, key=lambda scenario: scenario["speed"])


def figure(report: dict) -> Figure:
    """Share at rest over the deck's speed, and in every other scenario; a colour for each controller."""
    names = [controller["name"] for controller in report["controllers"]]
    level = steady(report)
    others = [s for s in report["scenarios"] if s not in level]
    wide = [1.0] * bool(level) + [1.25] * bool(others)
    with styled():
        high = max(3.6, 1.3 + _ROW * len(others))
        drawn = Figure(figsize=(4.3 * sum(wide), high), layout="constrained")
        panels = list(drawn.subplots(1, len(wide), squeeze=False, width_ratios=wide)[0])
        handles = []
        if level:
            axes = panels.pop(0)
            axes.grid(True)
            speeds = [scenario["speed"] for scenario in level]
            for k, name in enumerate(names):
                share, low, top = _shares(level, k)
                colour = _COLOURS[k % len(_COLOURS)]
                axes.fill_between(speeds, low, top, color=colour, alpha=0.2, lw=0)
                mark = _MARKS[(k + k // 5) % 5]
                handles += axes.plot(speeds, share, "-", color=colour, marker=mark, ms=4, label=literal(name))
            axes.set_title("Level decks that travel steadily", loc="left")
            axes.set_xlabel("speed of the deck [m/s]")
            axes.set_ylabel("at rest on the deck [%]")
            axes.set_ylim(-3, 103)
        if others:
            axes = panels.pop(0)
            axes.grid(True, axis="x")
            rows = np.arange(len(others))
            for k, name in enumerate(names):
                share, low, top = _shares(others, k)
                at = rows + _APART * (k - 0.5 * (len(names) - 1))
                style = {"color": _COLOURS[k % len(_COLOURS)], "fmt": _MARKS[(k + k // 5) % 5]}
                around = np.maximum(0.0, [share - low, top - share])
                bars = axes.errorbar(share, at, xerr=around, ms=4, lw=1.2, label=literal(name), **style)
                handles += [bars] * (not level)
            axes.set_yticks(rows, [literal(s["name"].replace("_", " ")) for s in others])
            axes.set_ylim(len(others) - 0.5, -0.5)
            axes.set_xlim(-3, 103)
            axes.set_title("Slopes, waves, ships, cars", loc="left")
            axes.set_xlabel("at rest on the deck [%]")
        labels = [literal(name) for name in names]
        drawn.legend(
            [*handles, Patch(fc=MUTED, alpha=0.35)], [*labels, "95 % interval"],
            loc="outside upper center", ncols=min(5, len(names) + 1),
        )  # fmt: skip
    return drawn


def _shares(scenarios: list[dict], k: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Share at rest of controller k in scenarios, lower and upper end of its interval [%]."""
    found = [scenario["outcomes"][k]["at_rest"] for scenario in scenarios]
    low, top = np.array([p["interval"] for p in found]).T
    return 100 * np.array([p["share"] for p in found]), 100 * low, 100 * top
