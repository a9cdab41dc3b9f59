"""The success report as tables for people."""

from __future__ import annotations

import math

from rich import box
from rich.console import Console
from rich.table import Table

_GROUPS = {
    "paper_starts": "paper's three",
    "scattered_starts": "paper's +-0.1 m",
    "grid": "frozen grid",
}
_PIPED_WIDTH = 120  # columns


def show(report: dict) -> None:
    """Print the report of `success.evaluate`."""
    console = Console(markup=False, highlight=False)
    if not console.is_terminal:
        console.width = _PIPED_WIDTH
    plant = {"mujoco": "MuJoCo", "analytic": "analytic"}[report["plant"]]
    title = f"{report['policy']}: {report['task']}, {plant} plant, seed {report['seed']}"
    if report["task"] == "landing":
        angle = math.degrees(report["task_options"]["inclination"])
        title += f", {angle:.1f} deg"
        console.print(_landing(report, title))
        console.print(_entry(report))
    else:
        console.print(_setpoint(report, title))


def show_effects(report: dict) -> None:
    """Print the report of `success_effects.evaluate`."""
    console = Console(markup=False, highlight=False)
    if not console.is_terminal:
        console.width = _PIPED_WIDTH
    landing = report["task"] == "landing"
    plant = {"mujoco": "MuJoCo", "analytic": "analytic"}[report["plant"]]
    title = f"{report['policy']}: {report['task']} with one effect each, {plant} plant, seed {report['seed']}"
    columns = ("strict [%]", "touched", "time [s]", "at rest on feet [%]")
    columns = columns if landing else ("error after 3 s [cm]", "p95 [cm]", "< 5 cm [%]")
    table = _table(title, "effect", "size", *columns)
    table.columns[1].justify = "left"
    for row in report["effects"]:
        if landing:
            numbers = [
                _share(row["strict"]),
                str(row["touched"]["count"]),
                _spread(row["time_to_goal"]),
                _share(row["at_rest_on_feet"]),
            ]
        else:
            error = row["error"]
            numbers = [f"{100 * error['mean']:.2f}", f"{100 * error['p95']:.2f}", _share(row["within"])]
        table.add_row(row["effect"], _size(row["parameters"]), *numbers)
        if row["effect"] == "none":
            table.add_section()
    if landing:
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


def _table(title: str, *columns: str) -> Table:
    table = Table(title=title, box=box.SIMPLE_HEAD, title_justify="left", title_style="bold")
    for k, column in enumerate(columns):
        table.add_column(column, justify="left" if k == 0 else "right")
    return table


def _landing(report: dict, title: str) -> Table:
    table = _table(title, "starts", "thrust", "flights", "success [%]", "strict [%]", "touched", "time [s]")
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
    return table


def _entry(report: dict) -> Table:
    scales = [condition["thrust_scale"] for condition in report["conditions"]]
    table = _table(
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


def _setpoint(report: dict, title: str) -> Table:
    table = _table(
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
    return table


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
