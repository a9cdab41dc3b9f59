"""The success report as tables for people."""

from __future__ import annotations

import math

from rich.table import Table

from inclined_landing.envs.tasks import TASKS
from inclined_landing.eval.base.tables import new_table, printer

_GROUPS = {
    "paper_starts": "paper's three",
    "scattered_starts": "paper's +-0.1 m",
    "grid": "frozen grid",
}


def show(report: dict) -> None:
    """Print the report of `success.evaluate`."""
    console = printer()
    plant = {"mujoco": "MuJoCo", "analytic": "analytic"}[report["plant"]]
    title = f"{report['policy']}: {report['task']}, {plant} plant, seed {report['seed']}"
    if "inclination" in report["task_options"]:
        title += f", {math.degrees(report['task_options']['inclination']):.1f} deg"
    for table in _TABLES[TASKS[report["task"]].table](report, title):
        console.print(table)


def show_effects(report: dict) -> None:
    """Print the report of `success_effects.evaluate`."""
    console = printer()
    kind = TASKS[report["task"]].table
    plant = {"mujoco": "MuJoCo", "analytic": "analytic"}[report["plant"]]
    title = f"{report['policy']}: {report['task']} with one effect each, {plant} plant, seed {report['seed']}"
    columns, numbers = _EFFECTS[kind]
    table = new_table(title, "effect", "size", *columns, left=2)
    for row in report["effects"]:
        table.add_row(row["effect"], _size(row["parameters"]), *numbers(row))
        if row["effect"] == "none":
            table.add_section()
    if "at_rest_on_feet" in report["effects"][0]:
        flights = report["effects"][0]["success"]["of"]
        table.caption = (
            f"{flights} flights from the frozen grid; strict: the goal box within 300 steps and no touch "
            "before; at rest on feet: 2 s after the motors were cut in the goal box; 95 % Wilson intervals"
        )
    console.print(table)


def _size(parameters: dict) -> str:
    """Parameter values with their units: "x 0.5, y -0.3 m/s"."""
    units = {p["unit"] for p in parameters.values()}
    common = units.pop() if len(units) == 1 else None
    texts = []
    for name, p in parameters.items():
        unit = "" if p["unit"] in ("1", common) else f" {p['unit']}"
        texts.append(f"{name} {p['value']:g}{unit}")
    return ", ".join(texts) + (f" {common}" if common not in (None, "1") else "")


def _landing(report: dict, title: str) -> tuple[Table, Table]:
    table = new_table(
        title, "starts", "thrust", "flights", "success [%]", "strict [%]", "touched", "time [s]"
    )
    for condition in report["conditions"]:
        scale = f"x {condition['thrust_scale']:g}"
        for name, label in _GROUPS.items():
            row = condition[name]
            table.add_row(
                label,
                scale,
                str(row["success"]["of"]),
                _share(row["success"]),
                _share(row["strict"]),
                str(row["touched"]["count"]),
                _spread(row["time_to_goal"]),
            )
        table.add_section()
    for result in report["paper"]:
        share = f"{100 * result['share']:.1f}"
        if "of" in result:
            share += f" ({result['count']} of {result['of']})"
        table.add_row("paper's results", "", "", share)
    table.caption = (
        "success: the goal box within 300 steps; strict: and no touch before; "
        "95 % Wilson intervals; time to the goal: median (5 % to 95 %)"
    )
    return table, _entry(report)


def _entry(report: dict) -> Table:
    scales = [condition["thrust_scale"] for condition in report["conditions"]]
    table = new_table(
        "At goal-box entry, and after cutting the motors there (frozen grid)",
        "",
        *(f"thrust x {scale:g}" for scale in scales),
    )
    entries = [condition["entry"] for condition in report["conditions"]]
    cuts = [condition["motors_cut"] for condition in report["conditions"]]

    def row(label, sources, key, text):
        table.add_row(label, *(text(source[key]) if source else "-" for source in sources))

    row("speed [m/s]", entries, "speed", _spread)
    row("towards the slope [m/s]", entries, "normal_speed", _spread)
    row("along the slope [m/s]", entries, "tangential_speed", _spread)
    row("pitch error [rad]", entries, "pitch_error", lambda s: _spread(s, 3))
    row("moving away [%]", entries, "moving_away", _share)
    table.add_section()
    row("cut: touches the slope [%]", cuts, "touchdown", _share)
    row("cut: touchdown, into it [m/s]", cuts, "normal_speed", _spread)
    row("cut: touchdown, along it [m/s]", cuts, "tangential_speed", _spread)
    row("cut: 2 s later at rest on feet [%]", cuts, "at_rest_on_feet", _share)
    return table


def _error(report: dict, title: str) -> tuple[Table]:
    table = new_table(
        title, "thrust", "flights", "error after 3 s [cm]", "95 % interval", "p95 [cm]", "< 5 cm [%]"
    )
    for condition in report["conditions"]:
        error, within = condition["error"], condition["within"]
        low, high = error["interval"]
        table.add_row(
            f"x {condition['thrust_scale']:g}",
            str(within["of"]),
            f"{100 * error['mean']:.2f}",
            f"{100 * low:.2f} to {100 * high:.2f}",
            f"{100 * error['p95']:.2f}",
            _share(within),
        )
    return (table,)


def _flights(report: dict, title: str) -> tuple[Table]:
    table = new_table(title, "thrust", "flights", "success [%]", "reward", "duration [s]")
    for condition in report["conditions"]:
        count = str(condition["success"]["of"])
        table.add_row(f"x {condition['thrust_scale']:g}", count, *_of_flights(condition))
    table.caption = "95 % Wilson interval; reward and duration: median (5 % to 95 %)"
    return (table,)


def _of_flights(row: dict) -> list[str]:
    return [_share(row["success"]), _spread(row["reward"]), _spread(row["duration"])]


def _of_errors(row: dict) -> list[str]:
    error = row["error"]
    return [f"{100 * error['mean']:.2f}", f"{100 * error['p95']:.2f}", _share(row["within"])]


def _of_landings(row: dict) -> list[str]:
    strict, rest = _share(row["strict"]), _share(row["at_rest_on_feet"])
    return [strict, str(row["touched"]["count"]), _spread(row["time_to_goal"]), rest]


def _share(value: dict) -> str:
    if value["share"] is None:
        return "-"
    low, high = value["interval"]
    return f"{100 * value['share']:.1f} [{100 * low:.1f}, {100 * high:.1f}]"


def _spread(value: dict, digits: int = 2) -> str:
    if value["median"] is None:
        return "-"
    f = f".{digits}f"
    return f"{value['median']:{f}} ({value['p5']:{f}} to {value['p95']:{f}})"


# By the `table` of a task: its tables, and with effects its columns and what stands in them.
_TABLES = {"landing": _landing, "error": _error, "flights": _flights}
_EFFECTS = {
    "landing": (("strict [%]", "touched", "time [s]", "at rest on feet [%]"), _of_landings),
    "error": (("error after 3 s [cm]", "p95 [cm]", "< 5 cm [%]"), _of_errors),
    "flights": (("success [%]", "reward", "duration [s]"), _of_flights),
}
