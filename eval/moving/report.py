"""The report of the benchmark, shown as table and figure."""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import partial
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from inclined_landing.envs.shared import runs
from inclined_landing.envs.shared.statistics import proportion, spread
from inclined_landing.envs.shared.tables import count_words, share_cell
from inclined_landing.eval.base.claims import Section, Table, show_sections
from inclined_landing.eval.base.conditions import fly_all
from inclined_landing.eval.base.style import MUTED, colour, literal, marker, percent, share_curve, styled
from inclined_landing.eval.moving.controllers import Controller
from inclined_landing.eval.moving.flying import FIELDS, fly
from inclined_landing.eval.moving.scenario import Scenario

HEADS = (
    *("scenario", "controller", "at rest [%]", "after [s]", "into it [m/s]", "along it [m/s]"),
    "tilt [deg]",
)
CAPTION = (
    "95 % Wilson intervals. Speeds and tilt at the first touch, relative to the platform, and the time until "
    "rest: medians"
)
_ROW, _APART = 0.3, 0.13  # in, and rows between controllers


def evaluate(
    scenarios: Sequence[Scenario], controllers: Sequence[Controller], flights: int | None = None
) -> tuple[dict[str, Any], pd.DataFrame]:
    """Return the report as plain numbers, and a table of all flights.

    flights: of each scenario at most; None: as many as it says.
    """
    flown = fly_all(
        {
            (scenario.name, controller.name): partial(fly, scenario, controller, flights)
            for scenario in scenarios
            for controller in controllers
        }
    )
    table = pd.concat([found.assign(scenario=s, controller=c) for (s, c), found in flown.items()])
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
                "outcomes": [
                    {"controller": c.name, **_summary(flown[scenario.name, c.name])} for c in controllers
                ],
            }
            for scenario in scenarios
        ],
        "all": [
            {"name": c.name, "at_rest": proportion(rests.sum(), len(rests))}
            for c in controllers
            for rests in [table.loc[table["controller"] == c.name, "at_rest"]]
        ],
        "versions": runs.versions(),
    }, table.reset_index(drop=True)


def _summary(flights: pd.DataFrame) -> dict[str, Any]:
    rest = proportion(flights["at_rest"].sum(), len(flights))
    return {"at_rest": rest} | {name: spread(flights[name]) for name in FIELDS[1:]}


def cells(report: dict[str, Any]) -> list[list[str]]:
    """Return one row, under HEADS, for each scenario and controller: share at rest, medians of the touch."""
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


def show(report: dict[str, Any]) -> None:
    """Print the report."""
    show_sections(sections(report))


def sections(report: dict[str, Any]) -> list[Section]:
    """Return the sections of the page."""
    rule = (
        "A flight counts when the vehicle rests on the platform, on its feet alone, motors idle, as long as "
        "its scenario says; in the frozen ones for 0.3 s within 10 s, slower than 0.05 m/s relative to the "
        "platform."
    )
    partly = "Fewer flights than the scenarios have were flown: this is not a result of the benchmark."
    whole = all(scenario["whole"] for scenario in report["scenarios"])
    figure = {"moving": "Share of the flights at rest on the platform, with 95 % intervals."}
    flown = [(s["name"], s["title"], s["fingerprint"][:12]) for s in report["scenarios"]]
    overall = [
        f"{row['name']} came to rest on the platform in {count_words(row['at_rest'])}."
        for row in report["all"]
    ]
    tables = [
        Table("", HEADS, [tuple(row) for row in cells(report)]),
        Table("What was flown", ("scenario", "platform", "fingerprint"), flown),
    ]
    return [
        Section(
            "moving",
            "Moving platforms",
            rule,
            [],
            tables,
            figure,
            [CAPTION + ".", *([] if whole else [partly]), *overall],
        )
    ]


def steady(report: dict[str, Any]) -> list[dict]:
    """Return the scenarios of level platforms that travel steadily, by speed."""
    level = [s for s in report["scenarios"] if not s["waves"] and s["slope"] == 0.0]
    return sorted(level, key=lambda scenario: scenario["speed"])


def figure(report: dict[str, Any]) -> Figure:
    """Return the figure of the share at rest over the platform's speed, and in every other scenario."""
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
                handles += share_curve(axes, speeds, _at_rest(level, k), k, name)
            axes.set_title("Level platforms that travel steadily", loc="left")
            axes.set_xlabel("speed of the platform [m/s]")
            axes.set_ylabel("at rest on the platform [%]")
            axes.set_ylim(-3, 103)
        if others:
            axes = panels.pop(0)
            axes.grid(True, axis="x")
            rows = np.arange(len(others))
            for k, name in enumerate(names):
                share, low, top = percent(_at_rest(others, k))
                at = rows + _APART * (k - 0.5 * (len(names) - 1))
                style = {"color": colour(k), "fmt": marker(k)}
                around = np.maximum(0.0, [share - low, top - share])
                bars = axes.errorbar(share, at, xerr=around, ms=4, lw=1.2, label=literal(name), **style)
                handles += [bars] * (not level)
            axes.set_yticks(rows, [literal(s["name"].replace("_", " ")) for s in others])
            axes.set_ylim(len(others) - 0.5, -0.5)
            axes.set_xlim(-3, 103)
            axes.set_title("Slopes, waves, ships, cars", loc="left")
            axes.set_xlabel("at rest on the platform [%]")
        labels = [literal(name) for name in names]
        drawn.legend(
            [*handles, Patch(fc=MUTED, alpha=0.35)], [*labels, "95 % interval"],
            loc="outside upper center", ncols=min(5, len(names) + 1),
        )  # fmt: skip
    return drawn


def _at_rest(scenarios: list[dict], k: int) -> list[dict]:
    """Return the share at rest of controller k in each scenario."""
    return [scenario["outcomes"][k]["at_rest"] for scenario in scenarios]
