"""`landing-eval plan`: from a report to set-points and commands of the most informative flight."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import tyro
from msgspec import Meta

from inclined_landing.eval.base.options import RunFolder
from inclined_landing.eval.gap.plan import SECONDS


def command(
    report: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="REPORT")],
    /,
    out: RunFolder,
    seconds: Annotated[float, Meta(ge=8.0, le=120.0)] = SECONDS,
) -> None:
    """Plan a safe flight that best separates the candidate explanations of a report.

    Takes about a minute. If no flight would separate them, it prints what would and writes nothing.
    Fly the plan with landing-eval fly --plan.

    Args:
        report: report folder that landing-eval gap wrote.
        out: new folder for flight.csv and plan.json.
        seconds: duration of the flight.
    """
    from inclined_landing.envs.shared import runs
    from inclined_landing.envs.shared.progress import stages
    from inclined_landing.envs.shared.tables import say
    from inclined_landing.eval.gap import thresholds
    from inclined_landing.eval.gap.plan import sentences
    from inclined_landing.eval.gap.plan.design import design
    from inclined_landing.eval.gap.plan.reading import read_report
    from inclined_landing.eval.gap.report import words
    from inclined_landing.models.base import storage

    plan_input, arena = read_report(report)
    best = plan_input.hypotheses[0]
    if best.probability >= thresholds.DECIDED:
        probability = words.probability(best.probability)
        say(f"No flight is needed: {sentences.set_label(best)} has a probability of {probability}.")
        return
    with stages() as tick:
        plan = design(plan_input, seconds=seconds, tick=tick)
    found = sentences.effects_in_doubt(plan_input, plan.discrimination, plan.expected)
    beyond = sentences.measured_otherwise(found)
    if not sentences.is_worth_flying(found, plan.gain):
        say(*sentences.in_doubt(found), *beyond)
        say("No flight was planned, because no safe flight would distinguish these.")
        return
    lines = [*sentences.in_doubt(found), *sentences.outcome(found), *beyond, *sentences.why_near(plan)]
    with runs.staged_run(out) as folder:
        storage.write_text(folder / "flight.csv", plan.points.csv())
        content = sentences.to_json(plan, plan_input, found, report) | {"text": lines}
        storage.write_json(folder / "plan.json", content)
    flight = out / "flight.csv"
    say(*sentences.flight(plan), *lines)
    command = sentences.fly_command(flight, plan_input.platform, arena)
    print(f"To simulate it: {command} --simulated")
    print(f"To fly it: {command} --uri URI --mocap TYPE:HOST:BODY")
    say(f"The most informative flight is {flight}.", style="bold")
