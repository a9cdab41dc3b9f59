"""What missions are worth: plain numbers, and their table."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from inclined_landing.envs.mission import ENDS, LANDING, LEGS, Leg, Mission, Plan
from inclined_landing.envs.shared import runs
from inclined_landing.envs.shared.statistics import proportion, spread
from inclined_landing.envs.shared.tables import count_words, new_table, say, show_table, spread_cell
from inclined_landing.models.attitude import STATE_SIZE, VX, VY, VZ, X, Y, Z

ROLES = ("setpoint", "landing", "touchdown")


def report_of(missions: Sequence[Mission]) -> dict:
    """Return success rates, times and hand-over errors of missions of one plan, and a record of each."""
    plan = missions[0].plan
    return {
        "command": "mission",
        "policies": {role: str(policy.path) for role, policy in zip(ROLES, plan.policies)},
        "trained": {role: policy.metadata for role, policy in zip(ROLES, plan.policies)},
        "inclination": plan.task.inclination,
        "hand_over": {
            "point": plan.point.tolist(),
            "near": plan.near,
            "slow": plan.slow,
            "dwell": plan.dwell,
            "hold": plan.hold,
        },
        "missions": len(missions),
        "at_rest": proportion(sum(m.success for m in missions), len(missions)),
        "ends": {end: sum(m.end == end for m in missions) for end in ENDS},
        "time": spread([m.t[-1] for m in missions if m.success]),
        "legs": {name: _leg_statistics(missions, name) for name in LEGS},
        "handed_over": _hand_over_errors(missions, plan),
        "rest": {"y": spread([abs(m.state[-1, Y]) for m in missions if m.success])},
        "flights": [_mission_json(m) for m in missions],
        "versions": runs.versions(),
    }


def _leg_statistics(missions: Sequence[Mission], name: str) -> dict:
    """Return the statistics of one leg over all missions: flown, lost, duration, contacts."""
    pairs = [(mission, leg) for mission in missions if (leg := mission.find_leg(name))]
    lost = Counter(mission.end for mission, leg in pairs if not leg.done)
    touched = Counter(surface for _, leg in pairs for surface in leg.touched)
    return {
        "flown": len(pairs),
        "lost": dict(lost),
        "done": proportion(sum(leg.done for _, leg in pairs), len(pairs)),
        "duration": spread([leg.duration for _, leg in pairs if leg.done]),
        "touched": dict(touched),
    }


def _hand_over_errors(missions: Sequence[Mission], plan: Plan) -> dict:
    """Return the errors of position and speed at the hand-over to the landing policy."""
    states = np.array([m.state[np.argmax(m.leg >= LANDING)] for m in missions if m.find_leg("landing")])
    states = states.reshape(-1, STATE_SIZE)
    return {
        "position": spread(np.linalg.norm(states[:, X : Z + 1] - plan.point, axis=1)),
        "speed": spread(np.linalg.norm(states[:, VX : VZ + 1], axis=1)),
        "y": spread(np.abs(states[:, Y])),
        "vy": spread(np.abs(states[:, VY])),
    }


def _mission_json(mission: Mission) -> dict:
    return {
        "start": mission.state[0, :3].tolist(),
        "end": mission.end,
        "time": float(mission.t[-1]),
        "place": mission.state[-1, :3].tolist(),
        "legs": [_leg_json(leg) for leg in mission.legs],
    }


def _leg_json(leg: Leg) -> dict:
    return {
        "name": leg.name,
        "began": leg.began,
        "duration": leg.duration,
        "done": leg.done,
        "touched": list(leg.touched),
        "state": leg.state.tolist(),
    }


def show(report: dict) -> None:
    """Print a report: the success rate, and a row for each leg."""
    count = report["missions"]
    title = f"{count} mission{'s' * (count != 1)}"
    names = ("leg", "policy", "flown", "lost", "time [s]", "touched")
    table = new_table(title, *names, left=2)
    for name, leg in report["legs"].items():
        role = name if name in ROLES else "setpoint"
        lost = ", ".join(f"{many} {end}" for end, many in leg["lost"].items()) or "0"
        touched = ", ".join(f"{surface} {many}" for surface, many in leg["touched"].items()) or "-"
        time = spread_cell(leg["duration"])
        table.add_row(name, Path(report["policies"][role]).stem, str(leg["flown"]), lost, time, touched)
    table.add_section()
    table.add_row(
        "all", "", str(count), str(count - report["at_rest"]["count"]), spread_cell(report["time"]), ""
    )
    over, rest = report["handed_over"], report["rest"]
    show_table(table)
    say(
        "Share with its 95 % Wilson interval; times of what went well: medians (5 to 95 %).",
        f"Handed over {spread_cell(over['position'], 1, 100.0)} cm from the point, |y| "
        f"{spread_cell(over['y'], 1, 100.0)} cm; at rest |y| {spread_cell(rest['y'], 1, 100.0)} cm.",
        f"At rest on the feet after {count_words(report['at_rest'], 'missions')}.",
    )
