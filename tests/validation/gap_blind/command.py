"""`gap-blind`: draw cases, identify and diagnose each as a user would, score the answers, and count."""

from __future__ import annotations

import importlib.util
from collections.abc import Callable, Mapping, Sequence
from typing import Annotated, Literal

from msgspec import Meta

from inclined_landing.envs.shared.statistics import proportion
from inclined_landing.eval.base.options import Folder, Seed
from inclined_landing.eval.gap import diagnose
from inclined_landing.eval.gap.answer.identification import Identification, identify
from inclined_landing.eval.gap.plan.reading import PlanInput
from inclined_landing.eval.gap.result import Diagnosis
from inclined_landing.models.base.errors import UserError
from inclined_landing.models.parameters import load_vehicle

from ..shared import study, table, table_of
from .cases import ROTORPY, SETS, Case, population
from .score import score_case

_ROTORPY = ("rotorpy", "torch", "torchdiffeq", "roma")


def command(
    out: Folder,
    sets: tuple[Literal["dev", "fresh", "rotorpy"], ...] = (),
    cases: Annotated[int, Meta(ge=1, le=10**4)] = 120,
    seed: Seed = 0,
    processes: Annotated[int, Meta(ge=1, le=256)] = 2,
) -> None:
    """Hidden causes in flights of independent simulators: what gap names (twenty minutes for 120 cases).

    Args:
        out: folder for an answer of each case, results.json and table.md; an interrupted run goes on in it.
        sets: dev (thresholds were chosen on it), fresh (shares no structure with dev), rotorpy (flights of
            RotorPy, if it is installed); default: all.
        cases: drawn at random from the plans of all these sets, some 90 each.
        seed: of cases and flights.
        processes: cases at a time.
    """
    missing = [name for name in _ROTORPY if importlib.util.find_spec(name) is None]
    if missing and ROTORPY in sets:
        raise UserError(f"--sets rotorpy needs {missing[0]}; pip install 'inclined-landing[baselines]'")
    chosen = sets or tuple(name for name in SETS if not (missing and name == ROTORPY))
    drawn = {case.name: (case,) for case in population(chosen, seed, cases)}
    study(out, answer, drawn, processes, scored, sets=chosen, seed=seed)


def scored(answers: Mapping[str, Mapping]) -> tuple[str, dict]:
    """Return the table of answers by the name of their case, and what results.json has of them."""
    rows = [{"case": name, "set": name.split("_")[0]} | row for name, row in answers.items()]
    return markdown(rows), {"shares": shares(rows), "cases": rows}


def answer(case: Case) -> dict:
    """Fly one case, identify its vehicle, diagnose the flights with the cause, and score the report."""
    healthy, flights = case.fly()
    try:
        known = identify(healthy, load_vehicle())
        d = diagnose(flights, known.vehicle, reference=known.reference)
    except UserError as error:
        return score_case(case.label(), {"verdict": f"failed: {error}", "effects": []}) | {"plan": False}
    errors = {"error": d.gap["analytic"].before if "analytic" in d.gap else None}
    errors["reference error"] = d.reference.error if d.reference else None
    return score_case(case.label(), d.to_json()) | errors | {"plan": _plan_takes(d, known)}


def _plan_takes(d: Diagnosis, known: Identification) -> bool:
    try:
        PlanInput.of(d, known.vehicle, known.reference)
    except (UserError, LookupError, ValueError):
        return False
    return True


def _single(row: Mapping, *sizes: str) -> bool:
    return row["kind"] == "single" and row["size"] in sizes


# What is counted: whether a row is in a share, None where the share is not about it, a list where it is about
# several of its names or numbers.
SHARES: dict[str, Callable[[Mapping], bool | list[bool] | None]] = {
    "sure names that are wrong": lambda r: [not right for right in r["sure"]],
    "one cause, medium or strong: sure and alone": lambda r: (
        r["sure alone"] if _single(r, "medium", "strong") else None
    ),
    "of these medium": lambda r: r["sure alone"] if _single(r, "medium") else None,
    "of these strong": lambda r: r["sure alone"] if _single(r, "strong") else None,
    "the same, sure or possible": lambda r: r["among"] if _single(r, "medium", "strong") else None,
    "one weak cause: named alone, sure or possible": lambda r: r["alone"] if _single(r, "weak") else None,
    "two causes: both named alone, sure or possible": lambda r: r["alone"] if r["kind"] == "pair" else None,
    "nothing hidden: `nothing`": lambda r: r["verdict"] == "nothing" if r["kind"] == "nothing" else None,
    "nothing hidden: no sure name": lambda r: not r["sure"] if r["kind"] == "nothing" else None,
    "answers `nothing` with a medium or strong cause hidden": lambda r: (
        r["kind"] in ("single", "pair", "outside") and r["size"] != "weak"
        if r["verdict"] == "nothing"
        else None
    ),
    "cause outside the library: `unknown`": lambda r: (
        r["verdict"] == "unknown" if r["kind"] == "outside" else None
    ),
    "only a disturbance: no wrong sure name": lambda r: (
        all(r["sure"]) if r["kind"] == "disturbance" else None
    ),
    "95 % intervals that hold the truth": lambda r: [
        x for held in r["covered"].values() for x in held.values()
    ],
    "`unknown` together with a right sure name": lambda r: (
        r["verdict"] == "unknown" if r["kind"] in ("single", "pair") and r["right sure"] else None
    ),
    "reports that `plan` takes": lambda r: r["plan"],
}
# Of these shares a case in which they are false, or true, has failed.
FAILED = dict.fromkeys(
    ("one cause, medium or strong: sure and alone", "nothing hidden: `nothing`", *list(SHARES)[10:13]), False
)
FAILED |= {"sure names that are wrong": True, "reports that `plan` takes": False}


def shares(rows: Sequence[Mapping]) -> dict[str, dict]:
    """Return the proportions of some cases by what is counted."""
    found = {}
    for words, hit in SHARES.items():
        hits = [x for row in rows for x in _listed(hit(row))]
        found[words] = proportion(sum(hits), len(hits))
    return found


def _listed(hit: bool | list[bool] | None) -> list[bool]:
    return hit if isinstance(hit, list) else [] if hit is None else [hit]


def markdown(rows: Sequence[Mapping]) -> str:
    """Return the table of shares, by set and of all, and one of the cases that failed in any of FAILED."""
    groups = {name: [row for row in rows if row["set"] == name] for name in SETS}
    groups = {name: some for name, some in groups.items() if some} | {"all": list(rows)}
    counted = {name: shares(some) for name, some in groups.items()}
    lines: list[list] = [["cases", *map(len, groups.values())]]
    lines += [[words, *(one[words] for one in counted.values())] for words in SHARES]
    wrong = [sum(row["possible wrong"] for row in some) / len(some) for some in groups.values()]
    lines.append(["wrong possible names per case", *wrong])
    failed = [
        {"case": row["case"], "failed": "; ".join(why), "verdict": row["verdict"]}
        | {"named": ", ".join(row["effects"]), "error [cm]": _cm(row, "error")}
        | {"reference": _cm(row, "reference error")}
        for row in rows
        if (why := [words for words, bad in FAILED.items() if bad in _listed(SHARES[words](row))])
    ]
    return table(["", *groups], lines) + ("\n" + table_of(failed) if failed else "")


def _cm(row: Mapping, key: str) -> str:
    return f"{100 * row[key]:.1f}" if row.get(key) is not None else ""
