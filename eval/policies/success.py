"""`landing-eval success`: how often, how fast and how hard policies reach their goals.

Landing: the deterministic policy flies from the paper's three starts, from ten scattered starts
around each, and from the frozen grid (`envs/starts.py`); one that observes the slope from the frozen set over
its slopes. *Success* is reaching the goal box
(0.10, 0.10, 1.0, 1.0, 0.025) within 300 control steps; *strict* success also means that no part
touched the platform before. The goal box is not yet a landing, so the velocity at its entry is
reported too, and what happens when the motors are cut there (`rest.py`).

Set-point: the position error after 3 s from 200 random starts. Other tasks: success by their own rule,
reward and duration, from as many.

With ``--effects`` the frozen grid (or the random starts) alone, once for every effect of the library.
"""

from __future__ import annotations

import dataclasses
import itertools
import math
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import pandas as pd
import tyro
from msgspec import Meta

from inclined_landing.envs.policy import SHIPPED, Policy
from inclined_landing.envs.shared import runs
from inclined_landing.envs.shared.tables import count_words, share_cell, spread_cell
from inclined_landing.envs.tasks.landing import PAPER_RESULTS
from inclined_landing.eval.base.claims import Section, Table, show_sections
from inclined_landing.eval.base.options import MOST_COMPARED, Flag, Flat, Flown, NewFolder, Seed
from inclined_landing.eval.policies.changes import ThrustScale, sizes
from inclined_landing.eval.policies.flying import (
    LANDINGS,
    condition_outcome,
    effect_outcome,
    fly,
    fly_groups,
    frozen_starts,
)
from inclined_landing.eval.policies.study import Key, csv, fly_all, joined, named_policies
from inclined_landing.eval.policies.tables import outcomes_table, size_words, slope_words
from inclined_landing.models.effects import LIBRARY
from inclined_landing.models.errors import UserError

ENOUGH = 0.95  # share of landings at which an effect is survived
Policies = Annotated[
    tuple[str, ...],
    tyro.conf.Positional,
    tyro.conf.arg(
        metavar="POLICY [...]",
        help=f"policy files, run folders or shipped policies ({', '.join(SHIPPED)}), each flown on its task. "
        "LABEL=POLICY gives a name, LABEL@VEHICLE=POLICY a name and a vehicle.",
    ),
    Meta(max_length=MOST_COMPARED),
]
Scales = Annotated[
    tuple[tuple[ThrustScale, ...], ...], tyro.conf.UseAppendAction, tyro.conf.arg(metavar="X [X ...]")
]
_GROUPS = {
    "paper's three": "paper_starts",
    "paper's +-0.1 m": "scattered_starts",
    "frozen grid": "grid",
    "frozen set": "slopes",
}
_CAPTIONS = {
    "strict": "success: the vehicle reaches the goal box within 300 steps; strict: without touching anything "
    "first; time to the goal: median (5 % to 95 %)",
    "at_rest_on_feet": "at rest on feet: 2 s after the motors are cut in the goal box",
    "reward": "reward and duration: median (5 % to 95 %)",
}
_ENTRY: dict[str, tuple[str, str, Callable[[dict], str]]] = {
    "speed [m/s]": ("entry", "speed", spread_cell),
    "towards the slope [m/s]": ("entry", "normal_speed", spread_cell),
    "along the slope [m/s]": ("entry", "tangential_speed", spread_cell),
    "pitch error [rad]": ("entry", "pitch_error", partial(spread_cell, digits=3)),
    "moving away [%]": ("entry", "moving_away", share_cell),
    "after the cut: touches the slope [%]": ("motors_cut", "touchdown", share_cell),
    "after the cut: normal touchdown speed [m/s]": ("motors_cut", "normal_speed", spread_cell),
    "after the cut: tangential touchdown speed [m/s]": ("motors_cut", "tangential_speed", spread_cell),
    "after the cut: at rest on feet after 2 s [%]": ("motors_cut", "at_rest_on_feet", share_cell),
}


def command(
    policies: Policies,
    /,
    *,
    flown: Flat[Flown] = Flown(),
    thrust_scale: Scales = (),
    effects: Flag = False,
    disturbance: Flag = False,
    seed: Seed = 0,
    json: Flag = False,
    out: NewFolder = None,
) -> None:
    """Compare policies: how often, how fast and how hard they reach their goals.

    Args:
        policies: policy files.
        thrust_scale: factors on the total thrust, one row for each (default: 1).
        effects: one row for each physical effect of the library at a plausible size, which the policies were
            not trained with; flown from the frozen grid only (four minutes).
        disturbance: fly in the air disturbance of the vehicle file, as landing-eval gap writes it.
        seed: seed for the random starts.
        json: print only JSON on standard output; several policies are entries by name.
        out: new folder for success.json and flights.csv.
    """
    if not policies:
        raise UserError("name at least one policy")
    scales = tuple(dict.fromkeys(itertools.chain(*thrust_scale))) or (1.0,)
    if effects and (scales != (1.0,) or disturbance):
        raise UserError("--effects cannot be combined with --thrust-scale or --disturbance")
    loaded, vehicles = {}, {}
    for name, path in named_policies(policies).items():
        vehicle = "" if name == Path(path).stem else name.partition("@")[2]
        its = dataclasses.replace(flown, vehicle=Path(vehicle)) if vehicle else flown
        loaded[name], vehicles[name] = its.load(path), str(its.vehicle or "crazyflie.toml")
    for policy in loaded.values():
        air = policy.task.vehicle
        if disturbance and not any((*air.disturbance_acceleration, *air.disturbance_angular)):
            raise UserError("--disturbance needs a --vehicle whose table [disturbance] is not all zero")
    options: dict[str, Any] = {"thrust_scales": scales, "effects": effects, "disturbance": disturbance}
    reports, flights = evaluate_all(loaded, plant=flown.plant, seed=seed, **options)
    for name, report in reports.items():
        report["vehicle"] = vehicles[name]
    whole: dict[str, Any] = {"command": "success", "policies": reports, "versions": runs.versions()}
    (first, *others) = reports.values()
    runs.hand_over(
        whole if others else first, lambda _: show(reports), json, out, {"flights.csv": csv(flights)}
    )


def evaluate(policy: Policy, **options: Any) -> dict[str, Any]:
    """Return the success report of one policy; options as of `evaluate_all`."""
    reports, _ = evaluate_all({"policy": policy}, **options)
    return reports["policy"]


def evaluate_all(
    policies: Mapping[str, Policy],
    *,
    plant: str = "mujoco",
    thrust_scales: Sequence[float] = (1.0,),
    effects: bool = False,
    disturbance: bool = False,
    seed: int = 0,
) -> tuple[dict[str, dict[str, Any]], pd.DataFrame]:
    """Return the success reports of policies as plain numbers, by their names, and all flights.

    A report has an entry of `conditions` per thrust scale. Or, with `effects`, one of `effects` per effect,
    the first without any: only the vehicle in the plant has it, at its plausible size; policy, task and goal
    do not depend on it. Then landing policies fly from the frozen grid, others from random starts.

    plant: "mujoco", "hybrid" or "analytic", always the plain one (no keep-out zone, RK4 at 4 ms).
    disturbance: fly in that of the task's vehicle, the same in every call. seed: for the random starts.
    """
    work: dict[Key, Callable[[], pd.DataFrame]] = {}
    for name, policy in policies.items():
        if not effects:
            for scale in thrust_scales:
                fly_it = partial(fly_groups, policy, plant, float(scale), disturbance, seed)
                work[name, f"thrust x {scale:g}"] = fly_it
            continue
        known, starts = policy.task.vehicle, frozen_starts(policy.task, seed)
        for effect in ("none", *LIBRARY):
            vehicle = LIBRARY[effect].apply(known, LIBRARY[effect].plausible) if effect in LIBRARY else known
            work[name, effect] = partial(fly, policy, starts, plant, vehicle=vehicle)
    flown = fly_all(work)
    reports = {}
    for name, policy in policies.items():
        report: dict[str, Any] = {
            "command": "success --effects" if effects else "success",
            "policy": str(policy.path),
            "trained": policy.metadata,
            "task": policy.task.name,
            "table": policy.task.table,
            "task_options": policy.task.options,
            "plant": plant,
            "seed": int(seed),
            "versions": runs.versions(),
        }
        if effects:
            report["effects"] = [_of_effect(policy, e, flown[name, e]) for e in ("none", *LIBRARY)]
        else:
            report["paper"] = PAPER_RESULTS if policy.task.table == "goal_box" else None
            report["conditions"] = [
                {"thrust_scale": float(scale)}
                | condition_outcome(policy.task, flown[name, f"thrust x {scale:g}"])
                for scale in thrust_scales
            ]
        reports[name] = report | ({"disturbance": True} if disturbance else {})
    return reports, joined(flown)


def _of_effect(policy: Policy, name: str, flights: pd.DataFrame) -> dict[str, Any]:
    parameters = sizes(LIBRARY[name], LIBRARY[name].plausible) if name in LIBRARY else {}
    return {"effect": name, "parameters": parameters} | effect_outcome(policy.task, flights)


def show(reports: Mapping[str, dict[str, Any]]) -> None:
    """Print success reports by the names of policies: tables, and a sentence on each policy."""
    kinds: dict[str, dict[str, dict]] = {}  # policies with the same columns share a table
    for name, report in reports.items():
        kind = "landing" if report["table"] in LANDINGS else report["table"]
        kinds.setdefault(kind, {})[name] = report
    sections = []
    for kind, of_kind in kinds.items():
        rows = [row for name, report in of_kind.items() for row in _rows(name, report)]
        first = next(iter(of_kind.values()))
        heads = ("policy", "effect", "size") if "effects" in first else ("policy", "starts", "thrust")
        captions = [text for key, text in _CAPTIONS.items() if key in rows[0][1]]
        remarks = ["; ".join([*captions, "95 % Wilson intervals"]) + "."]
        if paper := first.get("paper"):
            shares = " and ".join(f"{100 * result['share']:.1f} %" for result in paper)
            remarks.append(f"The paper reports {shares} from its three starts and within 0.1 m around them.")
        title = f"{first['task']}, {first['plant']} plant, starts drawn with seed {first['seed']}"
        sections.append(Section(kind, title, [], [], [outcomes_table(heads, rows)], remarks=remarks))
        if kind == "landing" and "conditions" in first:
            title = "At entry into the goal box, and after cutting the motors there (frozen starts)"
            sections.append(Section("entry", title, [], [], [_entry(of_kind)]))
    sections[-1].remarks.extend(
        " ".join(filter(None, (answer(name, report), sign_hint(report)))) for name, report in reports.items()
    )
    show_sections(sections)


def _rows(name: str, report: dict[str, Any]) -> list[tuple[tuple[str, ...], dict]]:
    """Return labels and outcome for each row of a policy's table."""
    if "effects" in report:
        return [((name, row["effect"], size_words(row["parameters"])), row) for row in report["effects"]]
    rows: list[tuple[tuple[str, ...], dict]] = []
    for condition in report["conditions"]:
        thrust = f"x {condition['thrust_scale']:g}"
        for label, key in _GROUPS.items():
            if key in condition:
                slopes = f"{label}, {slope_words(report['task_options'])}"
                rows.append(((name, slopes, thrust), condition[key]))
        if not any(key in condition for key in _GROUPS.values()):
            rows.append(((name, "random", thrust), condition))
    return rows


def _entry(reports: Mapping[str, dict[str, Any]]) -> Table:
    conditions = [
        (f"{name} x {condition['thrust_scale']:g}", condition)
        for name, report in reports.items()
        for condition in report["conditions"]
    ]
    rows = [
        (label, *(text(c[source][key]) if c[source] else "-" for _, c in conditions))
        for label, (source, key, text) in _ENTRY.items()
    ]
    return Table("", ("", *(name for name, _ in conditions)), rows)


def answer(name: str, report: dict[str, Any]) -> str:
    """Return the result of the policy of this name in one sentence."""
    key, what = {"error": ("within", "was within 5 cm"), "flights": ("success", "succeeded")}.get(
        report["table"], ("strict", "landed")
    )
    if "effects" in report:
        rows = report["effects"][1:]
        good = sum(row[key]["share"] >= ENOUGH for row in rows)
        worst = min(rows, key=lambda row: row[key]["share"])
        return (
            f"{name} {what} in {100 * ENOUGH:.0f} % or more under {good} of {len(rows)} effects; the worst "
            f"is {worst['effect']} with {count_words(worst[key])}."
        )
    parts = []
    for condition in report["conditions"]:
        row = condition.get("grid", condition.get("slopes", condition))
        part = f"{what} in {count_words(row[key])}"
        if report["table"] == "error":
            centimetres = f"{100 * row['error']['mean']:.1f} cm"
            part = f"was {centimetres} off after 3 s, within 5 cm in {count_words(row[key])}"
        scale = condition["thrust_scale"]
        parts.append(part if scale == 1.0 else f"at thrust x {scale:g} it {part}")
    return f"{name} {'; '.join(parts)}."


def sign_hint(report: dict[str, Any]) -> str:
    """Return a sentence if nothing succeeded on a slope whose sign is not that of the training, else ""."""
    trained = report["trained"].get("task_options", {}).get("inclination")
    flown = report["task_options"].get("inclination")
    rows = [condition.get("grid", {}) for condition in report.get("conditions", ())]
    if not (trained and flown and trained * flown < 0 and rows) or any(
        row.get("strict", {"count": 1})["count"] for row in rows
    ):
        return ""
    trained, flown = math.degrees(trained), math.degrees(flown)
    return (
        f"It was trained at {trained:.1f} deg, and {flown:g} deg slopes the other way: "
        f"try --inclination {-flown:g}."
    )
