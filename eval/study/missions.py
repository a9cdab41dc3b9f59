"""Set-point flight, landing and touchdown as one flight: plans, progress, counts, pictures."""

from __future__ import annotations

import dataclasses
import math
import time
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.progress import Progress

from inclined_landing.envs.mission import ENDS, LANDING, LEGS, Mission, MissionPlan, fly_missions
from inclined_landing.envs.policy import load_policy
from inclined_landing.envs.shared import runs
from inclined_landing.envs.shared.statistics import proportion, spread
from inclined_landing.envs.shared.tables import count_words, printer, spread_cell
from inclined_landing.eval.base.claims import Section, Table, show_sections
from inclined_landing.eval.base.options import Look
from inclined_landing.eval.base.style import save_figure
from inclined_landing.eval.pictures import film
from inclined_landing.eval.pictures.figures.mission import mission_figure
from inclined_landing.eval.pictures.frames import FPS, strobe, write_picture
from inclined_landing.eval.study.engine import LONG
from inclined_landing.eval.study.options import HandOver
from inclined_landing.models.attitude import STATE_SIZE, VX, VY, VZ, X, Y, Z
from inclined_landing.models.base.errors import UserError, shown
from inclined_landing.models.parameters import load_vehicle

TYPICAL = 5.0  # s of flight
ROLES = ("setpoint", "landing", "touchdown")


def fly_with_progress(plan: MissionPlan, starts: np.ndarray) -> list[Mission]:
    """Return the missions from `starts` (n, 3); stderr shows progress, and an estimate if they take long.

    The estimate is made after the first second of flight, for missions of `TYPICAL` length.
    """
    console = printer(Console(stderr=True, markup=False, highlight=False))
    steps, began = 0, time.monotonic()
    with Progress(console=console, transient=True, disable=not console.is_terminal) as progress:
        bar = progress.add_task("missions", total=len(starts))

        def advance(ended: int) -> None:
            nonlocal steps
            steps += 1
            progress.update(bar, completed=ended)
            expected = TYPICAL * (time.monotonic() - began)
            if steps == round(1.0 / plan.vehicle.command_control_period) and expected > LONG:
                progress.console.print(f"{len(starts)} missions: about {expected / 60:.0f} min")

        return fly_missions(plan, starts, advance)


def make_plan(
    policies: tuple[str, str, str], hand_overs: HandOver, inclination: float | None, vehicle: Path | None
) -> MissionPlan:
    """Return the plan of the options. Raises UserError for invalid ones."""
    loaded = load_vehicle(vehicle) if vehicle is not None else None
    slope = None if inclination is None else math.radians(inclination)
    if slope is not None:
        (loaded or load_vehicle()).check_inclination(slope)
    setpoint, landing, touchdown = policies
    x, z = point(hand_overs.hand_over, "hand-over", "X,Z")
    return MissionPlan(
        load_policy(setpoint, "setpoint", vehicle=loaded),
        load_policy(landing, vehicle=loaded, inclination=slope),
        load_policy(touchdown, "touchdown", vehicle=loaded, inclination=slope),
        (x, z),
        *(hand_overs.near, hand_overs.slow, hand_overs.dwell, not hand_overs.drift),
    )


def point(text: str, option: str, form: str) -> tuple[float, ...]:
    """Return the numbers of an option written as `form`."""
    try:
        numbers = tuple(float(part) for part in text.split(","))
    except ValueError:
        numbers = ()
    if len(numbers) != form.count(",") + 1 or not all(map(math.isfinite, numbers)):
        raise UserError(f"--{option} must be {form} in metres, not {shown(text)!r}")
    return numbers


def draw(missions: list[Mission], folder: Path, look: Look | None) -> None:
    """Write the figure of missions into the folder; with a look also video and picture of the first one."""
    figure = mission_figure(missions[0], missions[1:])
    for suffix in (".png", ".pdf"):
        save_figure(figure, folder / f"mission{suffix}")
    if look is None:
        return
    how = dataclasses.asdict(look)
    write_picture(folder / "flight.png", strobe(missions[0], **how))
    frames, total, rate = film.film(missions[:1], FPS, 1.0, **how)
    film.write({folder / "flight.mp4": 1, folder / "flight.gif": 2}, frames, total, rate)


def report_of(missions: Sequence[Mission]) -> dict[str, Any]:
    """Return success rates, times and hand-over errors of missions of one plan, and a record of each."""
    plan = missions[0].plan
    landed = [mission for mission in missions if mission.success]
    return {
        "command": "mission",
        "policies": {role: str(policy.path) for role, policy in zip(ROLES, plan.policies)},
        "trained": {role: policy.metadata for role, policy in zip(ROLES, plan.policies)},
        "inclination": plan.task.inclination,
        "hand_over": {
            "point": plan.point.tolist(),
            **{name: getattr(plan, name) for name in ("near", "slow", "dwell", "hold")},
        },
        "missions": len(missions),
        "at_rest": proportion(len(landed), len(missions)),
        "ends": {end: sum(m.end == end for m in missions) for end in ENDS},
        "time": spread([m.t[-1] for m in landed]),
        "legs": {name: _leg_statistics(missions, name) for name in LEGS},
        "handed_over": _hand_over_errors(missions, plan),
        "rest": {"y": spread([abs(m.state[-1, Y]) for m in landed])},
        "flights": [
            {
                "start": m.state[0, :3].tolist(),
                "end": m.end,
                "time": float(m.t[-1]),
                "place": m.state[-1, :3].tolist(),
                "legs": [
                    vars(leg) | {"touched": list(leg.touched), "state": leg.state.tolist()} for leg in m.legs
                ],
            }
            for m in missions
        ],
        "versions": runs.versions(),
    }


def _leg_statistics(missions: Sequence[Mission], name: str) -> dict[str, Any]:
    """Return the statistics of one leg over all missions: flown, lost, duration, contacts."""
    pairs = [(mission, leg) for mission in missions if (leg := mission.find_leg(name))]
    return {
        "flown": len(pairs),
        "lost": dict(Counter(mission.end for mission, leg in pairs if not leg.done)),
        "done": proportion(sum(leg.done for _, leg in pairs), len(pairs)),
        "duration": spread([leg.duration for _, leg in pairs if leg.done]),
        "touched": dict(Counter(surface for _, leg in pairs for surface in leg.touched)),
    }


def _hand_over_errors(missions: Sequence[Mission], plan: MissionPlan) -> dict[str, Any]:
    """Return the errors of position and speed at the hand-over to the landing policy."""
    states = np.array([m.state[np.argmax(m.leg >= LANDING)] for m in missions if m.find_leg("landing")])
    states = states.reshape(-1, STATE_SIZE)
    return {
        "position": spread(np.linalg.norm(states[:, X : Z + 1] - plan.point, axis=1)),
        "speed": spread(np.linalg.norm(states[:, VX : VZ + 1], axis=1)),
        "y": spread(np.abs(states[:, Y])),
        "vy": spread(np.abs(states[:, VY])),
    }


def show(report: dict[str, Any]) -> None:
    """Print a report: the success rate, and a row for each leg."""
    count, rest = report["missions"], report["at_rest"]
    rows = []
    for name, leg in report["legs"].items():
        policy = Path(report["policies"][name if name in ROLES else "setpoint"]).stem
        lost = ", ".join(f"{many} {end}" for end, many in leg["lost"].items()) or "0"
        touched = ", ".join(f"{surface} {many}" for surface, many in leg["touched"].items()) or "-"
        rows.append((name, policy, str(leg["flown"]), lost, spread_cell(leg["duration"]), touched))
    rows.append(("all", "", str(count), str(count - rest["count"]), spread_cell(report["time"]), ""))
    table = Table("", ("leg", "policy", "flown", "lost", "time [s]", "touched"), rows)
    over = report["handed_over"]
    position, aside, at_rest = (
        spread_cell(found, 1, 100.0) for found in (over["position"], over["y"], report["rest"]["y"])
    )
    remarks = [
        "Shares have 95 % Wilson intervals; times are medians (5 % to 95 %) over successful legs.",
        f"Distance at hand-over: {position} cm, |y| {aside} cm; |y| at rest: {at_rest} cm.",
        f"At rest on the feet after {count_words(rest, 'missions')}.",
    ]
    title = f"{count} mission{'s' * (count != 1)}"
    show_sections([Section("mission", title, [], [], [table], remarks=remarks)])
