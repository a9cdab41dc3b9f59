"""`landing-eval plan`: from a report to set-points, commands and a figure of the most informative flight."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Annotated

import numpy as np
import tyro
from msgspec import Meta

from inclined_landing.envs.shared import runs
from inclined_landing.envs.shared.tables import say
from inclined_landing.eval.base.options import Folder, Seed, VehicleFile
from inclined_landing.eval.base.progress import stages
from inclined_landing.eval.base.style import save_figure, styled
from inclined_landing.eval.gap import thresholds
from inclined_landing.eval.gap.plan import words
from inclined_landing.eval.gap.plan.design import SECONDS, Plan, design
from inclined_landing.eval.gap.plan.picture import picture
from inclined_landing.eval.gap.plan.reading import read_report
from inclined_landing.models import storage


def command(
    report: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="REPORT")],
    /,
    out: Folder,
    seconds: Annotated[float, Meta(ge=8.0, le=120.0)] = SECONDS,
    vehicle: VehicleFile = None,
    seed: Seed = 0,
) -> None:
    """Plan a safe flight that best separates the candidate explanations of a report.

    Takes about a minute. Where no flight would separate them, it says what would instead and writes nothing.
    landing-eval fly --plan flies it.

    Args:
        report: folder that landing-eval gap wrote.
        out: new folder for flight.csv, plan.json and plan.png.
        seconds: duration of the flight.
        vehicle: vehicle file (TOML) of the report, where it has been moved.
        seed: of the search.
    """
    runs.check_new_run(out)
    plan_input = read_report(report, vehicle)
    best = plan_input.hypotheses[0]
    if best.probability >= thresholds.DECIDED and not plan_input.vary:
        say(f"No flight is needed: {best.text} has a probability of {best.probability:.2f}.")
        return
    with stages() as tick:
        plan = design(
            plan_input.hypotheses,
            plan_input.vehicle,
            noise_levels=plan_input.noise_levels,
            vary=plan_input.vary,
            seconds=seconds,
            platform=plan_input.platform,
            reference=plan_input.reference,
            seed=seed,
            tick=tick,
        )
    confounded_lines = words.indistinguishable(plan.discrimination, plan.expected)
    if plan.gain < thresholds.LEAST_GAIN and not plan_input.vary:
        say(words.competing_sets(plan.discrimination), *confounded_lines)
        say("No flight was planned: none within the safe space would tell these apart.")
        return
    lines = [
        words.competing_sets(plan.discrimination),
        words.outcome(plan.discrimination, plan.expected),
        *confounded_lines,
    ]
    if plan_input.vary:
        lines.append(words.variation(plan_input.vary))
    lines += words.why_near(plan)
    with styled():
        figure = picture(plan, plan_input.platform)
    with runs.staged_run(out) as folder:
        storage.write_text(folder / "flight.csv", plan.points.reference.csv())
        content = to_json(plan, report, seed) | {"platform": plan_input.platform, "text": lines}
        storage.write_json(folder / "plan.json", content)
        save_figure(figure, folder / "plan.png")
    flight, arena = str(out / "flight.csv"), plan_input.arena
    fly = words.next_command(flight, plan_input.platform, None if arena is None else str(arena))
    say(*words.flight(plan), *lines[1:])
    print(f"To fly it: {fly}")
    say(f"{lines[0]} The flight that separates them best is {flight}.")


def to_json(plan: Plan, report: Path, seed: int) -> dict:
    """Return the contents of plan.json."""
    states = np.concatenate([s.reshape(-1, s.shape[-1]) for s in plan.trajectories])
    sets = [
        {
            "effects": h.effects,
            "probability": h.probability,
            "expected": float(plan.expected[k, k]),
            "values": h.values,
        }
        for k, h in enumerate(plan.discrimination.hypotheses)
    ]
    return {
        "report": str(report),
        "seconds": plan.path.seconds,
        "seed": seed,
        "sets": sets,
        "expected": plan.expected_accuracy,
        "gain": plan.gain,
        "pieces": [
            {"kind": s.piece.kind, "start": s.start, "stop": s.stop, "text": s.piece.text}
            | {"parameters": s.piece.parameters}
            for s in plan.path.spans
        ],
        "simulated": {
            "flights": sum(len(s) for s in plan.trajectories),
            "speed": float(np.linalg.norm(states[:, 3:6], axis=1).max()),
            "tilt": float(np.abs(states[:, 6:8]).max()),
            "lowest": float(states[:, 2].min()),
        },
        "refused": [dataclasses.asdict(v) for v in plan.refused],
        "versions": runs.versions(),
    }
