"""`plan-loop`: one planned flight, or one ordinary flight more, where a first flight leaves a cause in doubt.

A cause of the library is hidden in a reality of the development families (`gap_blind.cases`). The vehicle is
identified from flights without it, and diagnosed from a short one with it. Where the cause is not sure, the
same reality flies what `plan` designs, and both flights are diagnosed; beside it, after the same first
flight, with an ordinary flight of as many seconds in the place of the planned one.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Annotated

import numpy as np
from msgspec import Meta

from inclined_landing.eval.base.options import Folder
from inclined_landing.eval.flying.tracking import thrust_and_angles
from inclined_landing.eval.gap import diagnose, thresholds
from inclined_landing.eval.gap.answer.identification import Identification, identify
from inclined_landing.eval.gap.plan import SECONDS, design, pieces
from inclined_landing.eval.gap.plan.pieces import Setpoints
from inclined_landing.eval.gap.plan.reading import PlanInput
from inclined_landing.eval.gap.result import Diagnosis
from inclined_landing.models.base.errors import UserError
from inclined_landing.models.parameters import load_vehicle
from tests.validation import simulator
from tests.validation.simulator import Recording, control
from tests.validation.simulator.vehicle import PILOT_RATE

from .gap_blind import cases, generate, score
from .gap_blind.causes import FREE_FLIGHT, SIZES
from .shared import study, table_of

HEALTHY = 6  # flights that identify the vehicle
FIRST = 8.0  # s, of the first flight with the cause
ANSWERS = ("right", "wrong", "in doubt")  # sure and right; a sure name is wrong; neither
ROUNDS = {"first": "one flight", "planned": "and a planned one", "ordinary": "and an ordinary one"}


def command(
    out: Folder,
    first: Annotated[int, Meta(ge=1)] = 1,
    last: Annotated[int, Meta(ge=1)] = 84,
    processes: Annotated[int, Meta(ge=1, le=256)] = 2,
) -> None:
    """What a planned flight settles that a first flight leaves in doubt, beside an ordinary one (minutes).

    Args:
        out: folder for the answers, results.json and table.md; an interrupted run goes on in it.
        first: first seed; each draws a vehicle, and the causes take turns.
        last: last seed.
        processes: seeds at a time.
    """
    calls = {f"seed_{seed}": (seed,) for seed in range(first, last + 1)}
    study(out, two_rounds, calls, processes, scored)


def scored(answers: Mapping[str, dict]) -> tuple[str, dict]:
    """Return the table of the answers of all seeds, and what results.json has of them."""
    rows = list(answers.values())
    return markdown(rows), {"rows": rows}


def drawn(seed: int) -> cases.Case:
    """Return the case of a seed: the causes take turns, of weak size, then medium, then strong."""
    turn, number = divmod(seed - 1, len(FREE_FLIGHT))
    cause = list(FREE_FLIGHT)[number]
    return cases.draw("dev", cause, SIZES[turn % len(SIZES)], (9053, seed))


def two_rounds(seed: int) -> dict:
    """Return the answers of one case: after one flight, with the planned one, with an ordinary one."""
    case = drawn(seed)
    rng = np.random.default_rng(case.entropy)
    usual, hidden = case.worlds()
    healthy = generate.fly_all(usual, rng, case.reality, count=HEALTHY)
    (first,) = generate.fly_all(hidden, rng, case.reality, count=1, seconds=FIRST)
    (ordinary,) = generate.fly_all(hidden, rng, case.reality, count=1, seconds=SECONDS)
    known = identify(generate.logs(healthy, voltage=case.voltage), load_vehicle())
    d = _diagnosis(case, [first], known)
    row = {"seed": seed, "family": case.reality.family, "cause": case.causes[0], "size": case.size}
    row["first"] = answer(case, d)
    if row["first"]["answer"] != "in doubt":
        return row
    row["ordinary"] = answer(case, _diagnosis(case, [first, ordinary], known))
    if plan := planned(d, known):
        rng = np.random.default_rng((*case.entropy, 2))
        way = path_of(plan.points, case.reality.constants)
        flight = simulator.fly(way, hidden.world_of(rng), rng, case.reality)
        row["planned"] = answer(case, _diagnosis(case, [first, flight], known))
        row["pieces"] = [span.piece.text for span in plan.path.spans]
        row["gain"] = plan.gain
        row["lowest"] = float(flight.truth[:, 2].min())
        rows = np.minimum(np.rint(flight.t * pieces.RATE).astype(int), len(plan.path.position) - 1)
        row["astray"] = float(np.linalg.norm(flight.truth[:, :3] - plan.path.position[rows], axis=1).max())
    return row


def _diagnosis(case: cases.Case, recordings: Sequence[Recording], known: Identification) -> Diagnosis:
    logs = generate.logs(recordings, voltage=case.voltage)
    return diagnose(logs, known.vehicle, reference=known.reference)


def planned(d: Diagnosis, known: Identification) -> design.Plan | None:
    """Return the flight that `landing-eval plan` would write for a diagnosis; None where it writes none."""
    given = PlanInput.of(d, known.vehicle, known.reference)
    if given.hypotheses[0].probability >= thresholds.DECIDED:
        return None
    try:
        plan = design.design(given)
    except UserError:  # no safe flight
        return None
    return plan if plan.gain >= thresholds.LEAST_GAIN else None


def path_of(points: Setpoints, c: simulator.Constants) -> np.ndarray:
    """Return set-points as the reference (k, REF_SIZE) of the simulator's pilot, who knows the constants c.

    As `landing-eval fly --plan` does, he adds to the plan's commands what his controller asks for beyond the
    plan's acceleration.
    """
    path = points.path
    size, angles = thrust_and_angles(points.acceleration, path.yaw, c.gravity)
    rows = np.zeros((len(path.yaw), control.REF_SIZE))
    for column, values in (
        (control.REF_POSITION, path.position),
        (control.REF_VELOCITY, points.velocity),
        (control.REF_ACCELERATION, points.acceleration),
        (control.REF_ROLL, points.command[:, 1:3] * c.attitude_gain - angles),
        (control.REF_PWM, points.command[:, :1] - c.mass * size[:, None] / c.thrust_per_pwm),
    ):
        rows[:, column : column + values.shape[1]] = values
    rows[:, control.REF_YAW] = path.yaw
    rows[:, control.REF_YAW_RATE] = points.command[:, 3]
    return rows[:: round(pieces.RATE / PILOT_RATE)]


def answer(case: cases.Case, d: Diagnosis) -> dict:
    """Return which of ANSWERS a diagnosis is, its sure names, and the probability of the right sets."""
    report = d.to_json()
    sure = sorted(effect.name for effect in d.effects if effect.sure)
    wrong = not all(score.score_case(case.label(), report)["sure"])
    right = any(option <= set(sure) for option in score.accepted(case.causes[0]))
    found = "wrong" if wrong else "right" if right else "in doubt"
    truth = score.belief(case.label(), report)
    return {"answer": found, "verdict": d.verdict, "sure": sure, "truth": truth}


def markdown(rows: Sequence[Mapping]) -> str:
    """Return counts of the answers, and a table of the cases that the first flight leaves in doubt."""
    doubt = [row for row in rows if row["first"]["answer"] == "in doubt"]
    every = {"one flight, all cases": [row["first"] for row in rows]}
    # Where no flight is planned the first answer stays.
    every |= {
        f"{words}, in doubt before": [row.get(k, row["first"]) for row in doubt]
        for k, words in ROUNDS.items()
    }
    counts = [
        {"flights": words, "cases": len(some)} | {a: sum(one["answer"] == a for one in some) for a in ANSWERS}
        for words, some in every.items()
    ]
    cells = [
        {"hidden": f"{row['cause']}, {row['size']}"}
        | {words: _cell(row.get(k)) for k, words in ROUNDS.items()}
        for row in doubt
    ]
    return table_of(counts) + ("\n" + table_of(cells) if cells else "")


def _cell(one: Mapping | None) -> str:
    return "none planned" if one is None else f"{one['answer']}, {one['truth']:.2f}"
