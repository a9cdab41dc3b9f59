"""`landing-eval robustness`: policies side by side, over thrust and under every effect of the library.

Each policy flies from the frozen grid in a plant whose vehicle has another thrust, or one effect of the
library that the policy knows nothing of: medium is its plausible size, weak half as far from neutral, strong
twice. Where it reaches the goal box the motors are cut, and what becomes of it there is the touchdown.
"""

from __future__ import annotations

import shlex
import sys
from pathlib import Path
from typing import Annotated

import pandas as pd
import tyro

from inclined_landing.envs.policy import SHIPPED, load_policy
from inclined_landing.eval.base import runs
from inclined_landing.eval.base.options import COMPARED, Flag, PlantName, Range, VehicleFile
from inclined_landing.eval.base.page import embedded, png, render
from inclined_landing.eval.base.style import save_figure
from inclined_landing.eval.base.tables import new_table, printer
from inclined_landing.eval.policies.robustness import words
from inclined_landing.eval.policies.robustness.figures import matrix_figure, thrust_figure
from inclined_landing.eval.policies.robustness.study import THRUSTS, evaluate
from inclined_landing.models import storage
from inclined_landing.models.effects import LIBRARY
from inclined_landing.models.errors import UserError, shown
from inclined_landing.models.parameters import load_vehicle
from inclined_landing.models.plants import PLANTS

Policies = Annotated[
    tuple[str, ...],
    tyro.conf.Positional,
    tyro.conf.arg(
        metavar="POLICY [POLICY ...]",
        help=f"landing policies, files or shipped ones ({', '.join(SHIPPED)}); the first is what the others "
        "are compared with.",
    ),
    COMPARED,
]

_EFFECTS = tyro.conf.arg(metavar="NAME [NAME ...]", help_behavior_hint="(default: all)")


def command(
    policies: Policies,
    /,
    out: Annotated[Path, tyro.conf.arg(metavar="DIR")],
    plant: PlantName = "hybrid",
    every: Annotated[int, Range(1, 250)] = 1,
    thrust: Annotated[tuple[float, ...], tyro.conf.arg(metavar="X [X ...]")] = THRUSTS,
    effect: Annotated[tuple[str, ...], _EFFECTS] = tuple(LIBRARY),
    vehicle: VehicleFile = None,
    json: Flag = False,
) -> None:
    """Landing policies over thrust and under every effect of the library: curve, matrix, page (minutes).

    Args:
        policies: landing policies.
        out: new folder for index.html, results.md, robustness.json, conditions.csv and the pictures.
        plant: the physics to fly in; hybrid is MuJoCo near surfaces and the equations elsewhere.
        every: fly from each of so many starts of the frozen grid only.
        thrust: of the plant, times what the policies know.
        effect: of the library.
        vehicle: vehicle file (TOML) that thrust and effects change, where it differs from the shipped one.
        json: print JSON, and nothing else, on standard output.
    """
    if not (policies and thrust and effect):
        raise UserError("name at least one policy, one --thrust and one --effect")
    for name in effect:
        if name not in LIBRARY:
            raise UserError(f"unknown effect {shown(name, 40)}; landing-eval effects lists them")
    for scale in thrust:
        if not 0 < scale <= 3:
            raise UserError(f"--thrust must be above 0 and at most 3, not {scale:g}")
    if plant not in PLANTS:
        raise UserError(f"unknown plant {shown(plant, 40)!r}; known are {', '.join(PLANTS)}")
    runs.check_new_run(out)
    known = None if vehicle is None else load_vehicle(vehicle)
    loaded = [load_policy(policy, vehicle=known) for policy in policies]
    report = evaluate(loaded, plant=plant, every=every, thrusts=thrust, effects=tuple(dict.fromkeys(effect)))
    made = f"{shlex.join(['landing-eval', *sys.argv[1:]])} · {plant} plant, {report['starts']} starts"
    with runs.staged_run(out) as folder:
        images = {"thrust": thrust_figure(report), "matrix": matrix_figure(report)}
        for name, figure in images.items():
            save_figure(figure, folder / f"robustness_{name}.png")
            save_figure(figure, folder / f"robustness_{name}.pdf")
        page = render(
            __package__,
            "robustness.html.j2",
            title="Robustness of landing policies",
            sentences=words.sentences(report),
            summary=words.summary(report),
            thrust=words.thrust(report),
            effects=words.effects(report),
            enough=f"{100 * words.ENOUGH:.0f}",
            images={name: embedded(png(figure)) for name, figure in images.items()},
            run=made,
            versions=report["versions"],
        )
        storage.write_text(folder / "index.html", page)
        storage.write_text(folder / "results.md", words.markdown(report))
        storage.write_text(folder / "conditions.csv", table(report))
        storage.write_json(folder / "robustness.json", report)
    if json:
        print(storage.to_json(report))
    else:
        show(report)


def table(report: dict) -> str:
    """One row for each policy and condition: shares with their counts, touchdown speed [m/s]."""
    rows = []
    for row in (*report["thrust"], *report["effects"]):
        size = "; ".join(f"{name} {p['value']:g} {p['unit']}" for name, p in row["parameters"].items())
        for policy, outcome in zip(report["policies"], row["outcomes"]):
            rows.append(
                {
                    "policy": policy["name"],
                    "effect": row["effect"],
                    "size": row["size"],
                    "parameters": size,
                    "starts": outcome["strict"]["of"],
                    "strict": outcome["strict"]["count"],
                    "success": outcome["success"]["count"],
                    "touched": outcome["touched"]["count"],
                    "at_rest_on_feet": outcome["at_rest_on_feet"]["count"],
                    "normal_speed_median": outcome["normal_speed"]["median"],
                    "normal_speed_p95": outcome["normal_speed"]["p95"],
                }
            )
    return pd.DataFrame(rows).to_csv(index=False, float_format="%.6g")


def show(report: dict) -> None:
    """Print the report of `evaluate`."""
    console = printer()
    title = f"Strict success, {report['starts']} starts, {report['plant']} plant"
    summary = words.summary(report)
    across = tuple(zip(summary["heads"], *summary["rows"]))  # a column for each policy
    few = 1 + len(report["policies"])  # columns: what strict success is of each effect
    tables = {
        title: ({"heads": across[0], "rows": across[1:]}, None),
        "Over thrust": (words.thrust(report, brief=True), None),
        "Effects: weak / medium / strong": (words.effects(report), few),
    }
    for name, (found, columns) in tables.items():
        printed = new_table(name, *found["heads"][:columns])
        for row in found["rows"]:
            printed.add_row(*row[:columns])
        console.print(printed)
    for sentence in words.sentences(report):
        console.print(sentence)
