"""`landing-eval vehicles`: one landing policy on many quadrotors, beside one policy for each.

Policies fly from the frozen grid on every named vehicle, and on vehicles drawn from a file of ranges with a
seed that no training has. A policy that is told its vehicle (`--observe-vehicle`) is told the one it flies;
what PWM an action commands is what it was in training, or the hover of each vehicle where it was trained so.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import tyro

from inclined_landing.eval.base import runs
from inclined_landing.eval.base.options import COMPARED, AtMost, Flag, NewFolder, PlantName, Range, Seed
from inclined_landing.eval.base.style import save_figure
from inclined_landing.eval.base.tables import new_table, printer, share_cell
from inclined_landing.eval.policies.vehicles.figure import vehicles_figure
from inclined_landing.eval.policies.vehicles.study import evaluate, parse_entry
from inclined_landing.models import storage
from inclined_landing.models.errors import UserError, shown
from inclined_landing.models.plants import PLANTS

NAMED = ("crazyflie-2.0", "crazyflie-2.1", "crazyflie-2.1-brushless", "hummingbird")
_POLICIES = tyro.conf.arg(
    metavar="POLICY [POLICY ...]",
    help="landing policies; LABEL=A+B+C are seeds that count as one, LABEL@VEHICLE=A those of one vehicle.",
)


def command(
    policies: Annotated[tuple[str, ...], tyro.conf.Positional, _POLICIES, AtMost(100)],
    /,
    vehicle: Annotated[tuple[str, ...], tyro.conf.arg(metavar="VEHICLE [VEHICLE ...]")] = NAMED,
    ranges: Annotated[Path | None, tyro.conf.arg(metavar="FILE")] = Path("vehicles"),
    draws: Annotated[int, Range(0, 4096)] = 256,
    starts: Annotated[int, Range(1, 64)] = 4,
    plant: PlantName = "hybrid",
    seed: Seed = 2_000_003,
    json: Flag = False,
    out: NewFolder = None,
) -> None:
    """One landing policy on many quadrotors, named and drawn, beside one policy for each (a minute).

    Args:
        policies: landing policies.
        vehicle: vehicle files, or shipped vehicles by name, each flown from the whole frozen grid.
        ranges: file of ranges that vehicles are drawn from, or a shipped one.
        draws: vehicles drawn from it (0: none).
        starts: of the frozen grid that each drawn vehicle flies from.
        plant: the physics to fly in; hybrid is MuJoCo near surfaces and the equations elsewhere.
        seed: of the drawn vehicles and their starts; choose one that no policy was trained with.
        json: print JSON, and nothing else, on standard output.
        out: new folder for vehicles.json and vehicles.png.
    """
    if not policies:
        raise UserError("name at least one policy")
    if plant not in PLANTS:
        raise UserError(f"unknown plant {shown(plant, 40)!r}; known are {', '.join(PLANTS)}")
    if out is not None:
        runs.check_new_run(out)
    entries = [parse_entry(text) for text in policies]
    if (labels := len({entry.label for entry in entries})) > COMPARED.count:
        raise UserError(f"policies: at most {COMPARED.count} labels stand side by side, not {labels}")
    named = tuple(dict.fromkeys(vehicle))
    options = {"draws": draws, "starts": starts, "plant": plant, "seed": seed}
    report = evaluate(entries, named, None if ranges is None else str(ranges), **options)
    if out is not None:
        with runs.staged_run(out) as folder:
            save_figure(vehicles_figure(report), folder / "vehicles.png")
            storage.write_json(folder / "vehicles.json", report)
    runs.hand_over(report, show, json, None)


def show(report: dict) -> None:
    """Print the report of `evaluate`."""
    labels = report["labels"]
    title = f"Strict success [%], {report['plant']} plant, 95 % Wilson intervals"
    table = new_table(title, "vehicle", "mass [g]", "thrust/weight", *labels)
    for row in report["vehicles"]:
        cells = [_cell(row["outcomes"].get(label)) for label in labels]
        table.add_row(row["vehicle"], f"{1e3 * row['mass']:.1f}", f"{row['thrust_to_weight']:.2f}", *cells)
    draws = report["draws"]
    if draws is not None:
        cells = [_cell(draws["outcomes"].get(label)) for label in labels]
        mass, power = ([m[key] for m in draws["members"]] for key in ("mass", "thrust_to_weight"))
        table.add_section()
        table.add_row(
            f"{draws['count']} drawn, {draws['starts_each']} starts each",
            f"{1e3 * min(mass):.1f} to {1e3 * max(mass):.0f}",
            f"{min(power):.2f} to {max(power):.2f}",
            *cells,
        )
    console = printer()
    console.print(table)


def _cell(outcome: dict | None) -> str:
    return "-" if outcome is None else share_cell(outcome["strict"])
