"""The success report as tables for people."""

from __future__ import annotations

import math

from rich.table import Table

from inclined_landing.envs.shared.tables import (
    count_words,
    new_table,
    say,
    share_cell,
    show_table,
    spread_cell,
)

_GROUPS = {
    "paper_starts": "paper's three",
    "scattered_starts": "paper's +-0.1 m",
    "grid": "frozen grid",
    "slopes": "frozen, all slopes",
}
ENOUGH = 0.95  # share of landings at which an effect is survived


def _interval(error: dict) -> str:
    low, high = error["interval"]
    return f"{100 * low:.2f} to {100 * high:.2f}"


# By the `table` of a task: columns, and what they show of a summary, where it has that.
_COLUMNS = {
    "goal_box": (
        ("flights", "success", lambda share: str(share["of"])),
        ("success [%]", "success", share_cell),
        ("strict [%]", "strict", share_cell),
        ("touched", "touched", lambda share: str(share["count"])),
        ("time [s]", "time_to_goal", spread_cell),
        ("at rest on feet [%]", "at_rest_on_feet", share_cell),
    ),
    "error": (
        ("flights", "within", lambda share: str(share["of"])),
        ("error after 3 s [cm]", "error", lambda error: f"{100 * error['mean']:.2f}"),
        ("95 % interval", "error", _interval),
        ("p95 [cm]", "error", lambda error: f"{100 * error['p95']:.2f}"),
        ("< 5 cm [%]", "within", share_cell),
    ),
    "flights": (
        ("flights", "success", lambda share: str(share["of"])),
        ("success [%]", "success", share_cell),
        ("reward", "reward", spread_cell),
        ("duration [s]", "duration", spread_cell),
    ),
}
_COLUMNS["slopes"] = _COLUMNS["goal_box"]
_CAPTIONS = {
    "goal_box": "success: the goal box within 300 steps; strict: and no touch before; "
    "95 % Wilson intervals; time to the goal: median (5 % to 95 %)",
    "error": "",
    "flights": "95 % Wilson interval; reward and duration: median (5 % to 95 %)",
}


def show(report: dict) -> None:
    """Print the report of `success.evaluate` or of `success.evaluate_effects`."""
    kind = report["table"]
    labels: tuple[str, ...]
    blocks: list[list[tuple[tuple[str, ...], dict]]]
    if "effects" in report:
        labels = ("effect", "size")
        of_effects = [((row["effect"], size_words(row["parameters"])), row) for row in report["effects"]]
        blocks = [list(of_effects[:1]), list(of_effects[1:])]
    elif any(name in report["conditions"][0] for name in _GROUPS):
        labels = ("starts", "thrust")
        blocks = [
            [
                ((label, _thrust(condition)), condition[name])
                for name, label in _GROUPS.items()
                if name in condition
            ]
            for condition in report["conditions"]
        ]
    else:
        labels = ("thrust",)
        blocks = [[((_thrust(condition),), condition) for condition in report["conditions"]]]
    shown = [column for column in _COLUMNS[kind] if column[1] in blocks[0][0][1]]
    table = new_table(_title(report), *labels, *(name for name, *_ in shown), left=len(labels))
    for block in blocks:
        for label, row in block:
            table.add_row(*label, *(text(row[key]) for _, key, text in shown))
        table.add_section()
    for result in report.get("paper") or ():
        share = f"{100 * result['share']:.1f}"
        if "of" in result:
            share += f" ({result['count']} of {result['of']})"
        of_which = "three" if "of" in result else "+-0.1 m"
        table.add_row(f"in the paper, {of_which}", "", "", share)
    caption = _CAPTIONS["goal_box" if kind == "slopes" else kind]
    if "at_rest_on_feet" in blocks[0][0][1]:
        caption += "; at rest on feet: 2 s after the motors were cut in the goal box"
    table.caption = caption or None
    show_table(table)
    if "entry" in report.get("conditions", [{}])[0]:
        show_table(_entry(report["conditions"]))
    say(answer(report))


def answer(report: dict) -> str:
    """Return in one sentence what came out, of the report of `success.evaluate` or `evaluate_effects`."""
    if "effects" in report:
        rows = report["effects"][1:]
        counted, what = ("within", "Within 5 cm") if report["table"] == "error" else ("strict", "Lands")
        poor = [row for row in rows if row[counted]["share"] < ENOUGH]
        said = f"{what} in {100 * ENOUGH:.0f} % or more under {len(rows) - len(poor)} of {len(rows)} effects"
        worst = min(rows, key=lambda row: row[counted]["share"], default=None)
        return (
            f"{said}; least under {worst['effect']}: {count_words(worst[counted])}." if worst else f"{said}."
        )
    parts = []
    for condition in report["conditions"]:
        name = next((name for name in ("grid", "slopes") if name in condition), None)
        row = condition if name is None else condition[name]
        if report["table"] == "error":
            part = (
                f"{100 * row['error']['mean']:.1f} cm off after 3 s; within 5 cm {count_words(row['within'])}"
            )
        elif "strict" in row:
            part = f"landed in {count_words(row['strict'])}, without touching the platform before"
        else:
            part = f"succeeded in {count_words(row['success'])}"
        parts.append(part if len(report["conditions"]) == 1 else f"at thrust {_thrust(condition)}: {part}")
    return ("; ".join(parts) + ".").capitalize() if len(parts) == 1 else "; ".join(parts).capitalize() + "."


def _title(report: dict) -> str:
    plant = {"mujoco": "MuJoCo"}.get(report["plant"], report["plant"])
    effects = " with one effect each" if "effects" in report else ""
    title = f"{report['policy']}: {report['task']}{effects}, {plant} plant, seed {report['seed']}"
    if "inclination" in report["task_options"]:
        title += f", {slope_words(report['task_options'])}"
    return title


def slope_words(options: dict) -> str:
    """The slopes of a task by its options: "-25.7 deg", "to +-25.7 deg" or "to 30 deg all around"."""
    if options.get("steepest") is None:
        return f"{math.degrees(options['inclination']):.1f} deg"
    steepest = f"{math.degrees(options['steepest']):.3g} deg"
    return f"to +-{steepest}" if options.get("dimensions", 2) == 2 else f"to {steepest} all around"


def _thrust(condition: dict) -> str:
    return f"x {condition['thrust_scale']:g}"


def size_words(parameters: dict) -> str:
    """Parameter values with their units: "x 0.5, y -0.3 m/s"."""
    units = {p["unit"] for p in parameters.values()}
    common = units.pop() if len(units) == 1 else None
    texts = []
    for name, p in parameters.items():
        unit = "" if p["unit"] in ("1", common) else f" {p['unit']}"
        texts.append(f"{name} {p['value']:g}{unit}")
    return ", ".join(texts) + (f" {common}" if common not in (None, "1") else "")


def _entry(conditions: list[dict]) -> Table:
    title = "At goal-box entry, and after cutting the motors there (frozen starts)"
    table = new_table(title, "", *(f"thrust {_thrust(condition)}" for condition in conditions))

    def row(label, source, key, text=spread_cell, **options):
        found = [condition[source] for condition in conditions]
        table.add_row(label, *(text(values[key], **options) if values else "-" for values in found))

    row("speed [m/s]", "entry", "speed")
    row("towards the slope [m/s]", "entry", "normal_speed")
    row("along the slope [m/s]", "entry", "tangential_speed")
    row("pitch error [rad]", "entry", "pitch_error", digits=3)
    row("moving away [%]", "entry", "moving_away", share_cell)
    table.add_section()
    row("cut: touches the slope [%]", "motors_cut", "touchdown", share_cell)
    row("cut: touchdown, into it [m/s]", "motors_cut", "normal_speed")
    row("cut: touchdown, along it [m/s]", "motors_cut", "tangential_speed")
    row("cut: 2 s later at rest on feet [%]", "motors_cut", "at_rest_on_feet", share_cell)
    return table
