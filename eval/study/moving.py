"""The benchmark of moving platforms: flights of policies and a planner in scenarios.

All flights are in the MuJoCo plant (RK4, steps of 4 ms) with one vehicle and one platform each, controlled at
50 Hz, until the vehicle rests on the platform (see `eval.study.rest`), reaches the floor, or the time is
over.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import TypeAlias

import numpy as np
import pandas as pd

from inclined_landing.envs.policy import Policy, load_policy
from inclined_landing.envs.shared.measures import alone, count_words, median_of, share_of
from inclined_landing.eval.study.engine import Case, Panel, Results, Study, View
from inclined_landing.eval.study.flights import named_policies
from inclined_landing.eval.study.options import BASELINES, PLANNER
from inclined_landing.eval.study.planner import Planner
from inclined_landing.eval.study.rest import TOUCH, Pilot, PolicyPilot, fly_to_rest
from inclined_landing.eval.study.scenarios import FLIGHTS, Scenario
from inclined_landing.models.base.errors import UserError
from inclined_landing.models.parameters import load_vehicle
from inclined_landing.models.plants import MujocoPlant
from inclined_landing.models.plants.recorder import STEP
from inclined_landing.models.vehicle import Vehicle

ANGLE_LIMIT = math.radians(55.0)  # of attitude commands: slopes of up to 50 deg, and 5 deg for control
# A vehicle is at rest if it stands on its feet alone, with idle motors, and stays slower than SPEED and RATE
# relative to the platform for HOLD. A flight lasts at most WITHIN.
SPEED, RATE, HOLD, WITHIN = 0.05, 1.0, 0.3, 10.0  # m/s, rad/s, s, s
MakePilot: TypeAlias = Callable[[int], Pilot]  # begins n flights
AT_REST = share_of(
    "at_rest",
    "at rest",
    said="came to rest on the platform",
    note=f"at rest means on the platform, on the feet alone, with motors at idle, for {HOLD:g} s within "
    f"{WITHIN:g} s, slower than {SPEED:g} m/s relative to it",
)
_NOTE = "speeds and tilt at the first touch, relative to the platform"
MEASURES = (
    *(AT_REST, *TOUCH),
    median_of("tilt", "tilt", "rad", cell=alone, note=_NOTE, shown_unit="deg", factor=math.degrees(1.0)),
    median_of("off_centre", "off centre", "m", cell=alone),
)
PARTLY = "Not all flights of the scenarios were flown, so this is not a benchmark result."


def vehicle_flown() -> Vehicle:
    """Return the vehicle of the benchmark: the shipped one, with attitude commands up to 55 deg."""
    return load_vehicle().changed(command_angle_limit=ANGLE_LIMIT)


def find_pilots(names: Sequence[str]) -> dict[str, MakePilot]:
    """Return pilots by name, of policies and the planner; the baselines if none are given."""
    named = named_policies(tuple(dict.fromkeys(names)) or BASELINES)
    return {
        label: planner if name == PLANNER else pilot_of(load_policy(name)) for label, name in named.items()
    }


def planner(n: int) -> Pilot:
    """Return the planner for n flights."""
    return Planner(vehicle_flown())


def pilot_of(policy: Policy) -> MakePilot:
    """Return the pilot of a policy; raises UserError for one that flies in a plane or does not land."""
    if not policy.task.has_platform:
        raise UserError(f"policy {policy.path} is for {policy.task.name}, which has no platform to land on")
    if "roll" not in policy.task.action_names:
        raise UserError(
            f"policy {policy.path} flies in a plane; the scenarios need one in three dimensions, such as "
            "those of landing-train touchdown --dimensions 3"
        )
    return partial(PolicyPilot, policy)


def fly(scenario: Scenario, make_pilot: MakePilot, flights: int | None = None) -> pd.DataFrame:
    """Return a row for each flight of a scenario, or of its first flights, as `fly_to_rest` does."""
    vehicle = vehicle_flown()
    start, period = scenario.draw(vehicle, flights), vehicle.command_control_period
    ids = np.arange(len(start))
    plant = MujocoPlant(len(ids), vehicle, timestep=STEP, torque_needs_motors=True, moving=True)
    plant.set_platform(ids, start.inclination, azimuth=start.azimuth)
    assert start.motion is not None and start.contact is not None
    plant.set_motion(ids, start.motion)
    plant.set_contact(ids, **start.contact)
    return fly_to_rest(
        plant,
        start.state,
        make_pilot(len(ids)),
        steps=round(WITHIN / period),
        hold=math.ceil(HOLD / period - 1e-9),
        speed=SPEED,
        rate=RATE,
    )


def study(
    chosen: Mapping[str, Scenario], pilots: Mapping[str, MakePilot], flights: int | None = None
) -> Study:
    """Return the study of pilots in scenarios, by their names.

    flights: the number flown in each scenario; None for all.
    """
    whole = flights is None or flights >= FLIGHTS
    level = {name: s.speed for name, s in chosen.items() if not (s.waves or s.inclination_deg)}
    return Study(
        name="moving",
        title="Moving platforms",
        cases=[
            Case(
                {"scenario": name, "policy": policy, "together": "all scenarios"}
                | ({"speed": level[name]} if name in level else {}),
                partial(fly, scenario, make_pilot, flights),
            )
            for name, scenario in chosen.items()
            for policy, make_pilot in pilots.items()
        ],
        views=[
            View(("scenario", "policy"), MEASURES, "scenarios"),
            View(("speed", "policy"), (AT_REST,)),
            View(("together", "policy"), (AT_REST,)),
        ],
        panels=[
            Panel("Level platforms at constant speed", AT_REST, "speed", "platform speed [m/s]"),
            Panel(
                "Slopes, waves, ships, cars",
                AT_REST,
                "scenario",
                kept=lambda results: [name for name in results.labels("scenario") if name not in level],
            ),
        ],
        remarks=partial(_remarks, whole),
    )


def _remarks(whole: bool, results: Results) -> list[str]:
    """Return sentences on whether this is a full result of the benchmark, and on each policy."""
    rows = results.all(AT_REST, scenario=None, speed=None)
    return [f"{row['policy']} {AT_REST.said} in {count_words(row)}." for row in rows] + [PARTLY] * (not whole)
