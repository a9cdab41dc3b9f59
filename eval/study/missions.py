"""Set-point flight, landing and touchdown as one flight: the study of missions.

Its table has a row for each flown leg and one for each whole mission: `leg` ("mission" for the whole),
`policy`, `mission` (its number), `done` (whether it was handed over or came to rest), `time` [s] of those,
the `end` of the mission, and `touched_slab`, `touched_base`, `touched_floor`. Whole missions also have start
and end [m], and the state at the hand-over to the landing policy: `distance` from the hand-over point [m],
`speed` [m/s], and `aside`, `aside_speed` along y.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Container, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from inclined_landing.envs.mission import LANDING, LEGS, Mission, MissionPlan, fly_missions
from inclined_landing.envs.policy import load_policy
from inclined_landing.envs.shared.measures import Row, count_words, counted, median_of, share_of
from inclined_landing.envs.shared.progress import stages
from inclined_landing.eval.base.options import Look
from inclined_landing.eval.base.style import save_figure
from inclined_landing.eval.pictures.figures.mission import mission_figure
from inclined_landing.eval.pictures.frames import FPS, renderer_for, strobe, write_film, write_picture
from inclined_landing.eval.pictures.starts import read_point
from inclined_landing.eval.study.engine import Results, Study, View, evaluate, fact
from inclined_landing.eval.study.flights import policy_facts
from inclined_landing.models.attitude import VX, VY, VZ, X, Y, Z
from inclined_landing.models.geometry import SURFACES
from inclined_landing.models.parameters import load_vehicle

ROLES = ("setpoint", "landing", "touchdown")
WHOLE = "mission"  # the leg of a row on a whole mission
DONE = share_of("done", "done", note="done: the leg handed over, or the mission ended at rest on the feet")
TIME = median_of("time", "time", "s")
TOUCHED = [share_of(f"touched_{name}", f"touch {name}", cell=counted, shown_unit="") for name in SURFACES]
_CM: dict[str, Any] = {"shown_unit": "cm", "factor": 100.0, "digits": 1}
HANDED_OVER = (
    median_of("distance", "hand-over: distance from the point", "m", among="handed_over", **_CM),
    median_of("speed", "hand-over: speed", "m/s", among="handed_over"),
    median_of("aside", "hand-over: |y|", "m", among="handed_over", **_CM),
    median_of("aside_speed", "hand-over: |vy|", "m/s", among="handed_over"),
    median_of("rest_aside", "at rest: |y|", "m", among="rests", **_CM),
)


def fly(plan: MissionPlan, starts: np.ndarray) -> list[Mission]:
    """Return the missions from `starts` (n, 3); progress is shown on stderr."""
    with stages(len(starts), "missions") as tick:
        return fly_missions(plan, starts, lambda ended: tick(done=ended))


def study(missions: Sequence[Mission], facts: Sequence[Row] = (), look: Look | None = None) -> Results:
    """Return the study of missions of one plan; look: that of the film of the first one, None for no film."""
    plan = missions[0].plan
    x, z = plan.hand_over
    about = {"inclination": math.degrees(plan.task.inclination), "x": x, "z": z}
    units = {"inclination": "deg", "x": "m", "z": "m"}
    described = Study(
        name="mission",
        title=f"{len(missions)} mission{'s' * (len(missions) != 1)}",
        cases=(),
        views=[
            View(("leg", "policy"), (DONE, TIME, *TOUCHED), "legs"),
            View((), HANDED_OVER, "hand-over and rest", across=True),
        ],
        remarks=_remarks,
        facts=[
            *policy_facts(dict(zip(ROLES, plan.policies))),
            *(fact("hand-over", name, value, units[name]) for name, value in about.items()),
            *facts,
        ],
        draw=partial(_draw, missions, look),
    )
    return evaluate(described, table_of(missions))


def table_of(missions: Sequence[Mission]) -> pd.DataFrame:
    """Return a row for each leg of missions, in the order of the legs, then one for each whole mission."""
    rows = [
        {"leg": name, "policy": mission.plan.policies[max(k - 1, 0)].name, "mission": number}
        | _outcome(leg.done, leg.duration, mission.end, leg.touched)
        for k, name in enumerate(LEGS)
        for number, mission in enumerate(missions)
        if (leg := mission.find_leg(name)) is not None
    ]
    for number, m in enumerate(missions):
        touched = {surface for leg in m.legs for surface in leg.touched}
        row = {"leg": WHOLE, "policy": "", "mission": number}
        row |= _outcome(m.success, m.t[-1], m.end, touched) | _handed_over(m)
        row |= dict(zip(("x", "y", "z", "end_x", "end_y", "end_z"), (*m.state[0, :3], *m.state[-1, :3])))
        rows.append(row | {"rests": m.success, "rest_aside": abs(m.state[-1, Y])})
    table = pd.DataFrame(rows)
    flags = ["handed_over", "rests"]
    return table.assign(**{name: table[name] == True for name in flags})  # noqa: E712 (NaN of a leg)


def _outcome(done: bool, duration: float, end: str, touched: Container[str]) -> dict[str, Any]:
    """Return the columns common to legs and missions; the time is given for successful ones."""
    touches = {f"touched_{name}": name in touched for name in SURFACES}
    return {"done": done, "time": float(duration) if done else math.nan, "end": end} | touches


def _handed_over(mission: Mission) -> dict[str, Any]:
    """Return the errors of position and speed at the hand-over to the landing policy, if there was one."""
    if mission.find_leg("landing") is None:
        return {"handed_over": False}
    state = mission.state[np.argmax(mission.leg >= LANDING)]
    return {
        "handed_over": True,
        "distance": np.linalg.norm(state[X : Z + 1] - mission.plan.point),
        "speed": np.linalg.norm(state[VX : VZ + 1]),
        "aside": abs(state[Y]),
        "aside_speed": abs(state[VY]),
    }


def _remarks(results: Results) -> list[str]:
    """Return sentences on how missions ended."""
    flights = results.flights
    lost = flights[(flights["leg"] != WHOLE) & ~flights["done"]]
    ends = Counter(f"{end} in the {leg}" for end, leg in zip(lost["end"], lost["leg"]))
    lost_words = ", ".join(f"{many} {how}" for how, many in ends.items())
    said = f"At rest on the feet after {count_words(results.one(DONE, leg=WHOLE), 'missions')}"
    return [f"{said}; lost: {lost_words}." if ends else f"{said}."]


def _draw(missions: Sequence[Mission], look: Look | None, folder: Path) -> Mapping[str, str]:
    """Write the figure of missions into the folder; with a look also video and picture of the first one."""
    figure = mission_figure(missions[0], missions[1:])
    for suffix in (".png", ".pdf"):
        save_figure(figure, folder / f"mission{suffix}")
    captions = {"mission.png": "The first mission, and the paths of the others."}
    if look is None:
        return captions
    with renderer_for(missions[:1], look) as renderer:
        write_picture(folder / "flight.png", strobe(missions[0], renderer))
        write_film({folder / "flight.mp4": 1, folder / "flight.gif": 2}, missions[:1], renderer, FPS)
    return captions | {"flight.png": "The first mission."}


def make_plan(
    policies: tuple[str, str, str], hand_over: str, inclination: float | None, vehicle: Path | None
) -> MissionPlan:
    """Return the plan of the options. Raises UserError for invalid ones."""
    slope = None if inclination is None else math.radians(inclination)
    if slope is not None:
        load_vehicle(vehicle).check_inclination(slope)
    setpoint, landing, touchdown = policies
    x, z = read_point(hand_over, "hand-over", "xz")
    return MissionPlan(
        load_policy(setpoint, "setpoint", vehicle=vehicle),
        load_policy(landing, vehicle=vehicle, inclination=slope),
        load_policy(touchdown, "touchdown", vehicle=vehicle, inclination=slope),
        (x, z),
    )
