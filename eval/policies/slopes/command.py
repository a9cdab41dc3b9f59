"""`landing-eval slopes`: landing policies over all slopes that they know.

Policies that observe the slope fly from the frozen set of starts over the angles (`envs/starts.py`), which
training never sees, in the plain MuJoCo plant. Beside the curve over the inclination stand single slopes,
from the frozen grid; a policy of one slope has that alone. Those that fly in space get a map over all
directions, and fly once more with headings that are drawn.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated

import tyro

from inclined_landing.envs.policy import SHIPPED, load_policy
from inclined_landing.eval.base import runs
from inclined_landing.eval.base.options import COMPARED, Flag, PlantName, Range, VehicleFile
from inclined_landing.eval.base.style import save_figure
from inclined_landing.eval.base.tables import new_table, printer, share_cell, spread_cell
from inclined_landing.eval.policies.slopes.figures import slopes_figure
from inclined_landing.eval.policies.slopes.study import evaluate
from inclined_landing.eval.policies.success_table import slope_words
from inclined_landing.models import storage
from inclined_landing.models.errors import UserError, shown
from inclined_landing.models.parameters import load_vehicle
from inclined_landing.models.plants import PLANTS

Policies = Annotated[
    tuple[str, ...],
    tyro.conf.Positional,
    tyro.conf.arg(
        metavar="POLICY [POLICY ...]",
        help=f"landing policies, files, shipped ones ({', '.join(SHIPPED)}) or run folders.",
    ),
    COMPARED,
]


def command(
    policies: Policies,
    /,
    out: Annotated[Path, tyro.conf.arg(metavar="DIR")],
    plant: PlantName = "mujoco",
    every: Annotated[int, Range(1, 250)] = 1,
    vehicle: VehicleFile = None,
    json: Flag = False,
) -> None:
    """Landing policies over all slopes that they know: curve over the angle, map of all directions.

    Args:
        policies: landing policies.
        out: new folder for slopes.json and the picture.
        plant: the physics to fly in.
        every: fly from each of so many starts only.
        vehicle: vehicle file (TOML), where it differs from the shipped one.
        json: print JSON, and nothing else, on standard output.
    """
    if not policies:
        raise UserError("name at least one policy")
    if plant not in PLANTS:
        raise UserError(f"unknown plant {shown(plant, 40)!r}; known are {', '.join(PLANTS)}")
    runs.check_new_run(out)
    known = None if vehicle is None else load_vehicle(vehicle)
    files = {_name(policy): _file(policy) for policy in policies}
    if len(files) < len(policies):
        raise UserError("two of the policies have the same name; the figure could not tell them apart")
    loaded = {name: load_policy(file, vehicle=known) for name, file in files.items()}
    report = evaluate(loaded, plant=plant, every=every)
    with runs.staged_run(out) as folder:
        figure = slopes_figure(report)
        save_figure(figure, folder / "slopes.png")
        save_figure(figure, folder / "slopes.pdf")
        storage.write_json(folder / "slopes.json", report)
    if json:
        print(storage.to_json(report))
    else:
        show(report)


def _file(policy: str) -> str:
    """The policy of a run folder; others as they are."""
    final = Path(policy) / "final.zip"
    return str(final) if policy not in SHIPPED and final.is_file() else policy


def _name(policy: str) -> str:
    """What a policy is called: a run's own by its folder."""
    path = Path(_file(policy))
    return path.parent.name if path.name in ("final.zip", "best.zip") and path.parent.name else path.stem


def show(report: dict) -> None:
    """Print the report of `evaluate`."""
    heads = ("policy", "slopes", "flights", "strict [%]", "success [%]", "touched", "time [s]")
    table = new_table(f"Slopes, {report['plant']} plant", *heads, left=2)
    for entry in report["policies"]:
        rows = {f"{math.degrees(row['inclination']):.1f} deg alone": row for row in entry["single"]}
        if "all" in entry:
            rows = {slope_words(entry["task_options"]): entry["all"]} | rows
        if "any_heading" in entry:
            rows["the same, any heading"] = entry["any_heading"]
        for k, (words, row) in enumerate(rows.items()):
            cells = share_cell(row["strict"]), share_cell(row["success"]), str(row["touched"]["count"])
            name = entry["name"] if k == 0 else ""
            table.add_row(name, words, str(row["strict"]["of"]), *cells, spread_cell(row["time_to_goal"]))
        table.add_section()
    table.caption = "strict: the goal box within 300 steps and no touch before; 95 % Wilson intervals"
    printer().print(table)
