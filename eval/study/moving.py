"""The benchmark of moving platforms: flights of controllers through scenarios.

All are flown in the MuJoCo plant, RK4 in steps of 4 ms, one vehicle and one platform each, at 50 Hz, until
rest on the platform (see `eval.study.rest`), the floor, or the end of the time.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import partial

import numpy as np
import pandas as pd

from inclined_landing.envs.shared.measures import alone, count_words, median_of, share_of
from inclined_landing.eval.study.engine import Case, Panel, Results, Study, View
from inclined_landing.eval.study.platforms.controllers import Controller
from inclined_landing.eval.study.platforms.scenario import FLIGHTS, HOLD, RATE, SPEED, WITHIN, Scenario
from inclined_landing.eval.study.rest import fly_to_rest
from inclined_landing.models.plants import MujocoPlant
from inclined_landing.models.plants.recorder import STEP

AT_REST = share_of(
    "at_rest",
    "at rest",
    said="came to rest on the platform",
    note=f"at rest means on the platform, on the feet alone, with motors at idle, for {HOLD:g} s within "
    f"{WITHIN:g} s, slower than {SPEED:g} m/s relative to it",
)
MEASURES = (
    AT_REST,
    median_of(
        "time", "time", "s", cell=alone, note="speeds and tilt at the first touch, relative to the platform"
    ),
    median_of("normal_speed", "normal speed", "m/s", cell=alone),
    median_of("tangential_speed", "tangential speed", "m/s", cell=alone),
    median_of("tilt", "tilt", "rad", cell=alone, shown_unit="deg", factor=math.degrees(1.0)),
    median_of("off_centre", "off centre", "m", cell=alone),
)
PARTLY = "Not all flights of the scenarios were flown, so this is not a benchmark result."


def fly(scenario: Scenario, controller: Controller, flights: int | None = None) -> pd.DataFrame:
    """Return a row for each flight of a scenario, or of its first flights, as `fly_to_rest` does."""
    vehicle = controller.vehicle
    drawn, period = scenario.draw(vehicle, flights), vehicle.command_control_period
    ids = np.arange(len(drawn.start))
    plant = MujocoPlant(len(ids), vehicle, timestep=STEP, torque_needs_motors=True, moving=True)
    plant.set_platform(ids, drawn.inclination, azimuth=drawn.azimuth)
    plant.set_motion(ids, drawn.motion)
    plant.set_contact(ids, friction=scenario.friction)
    return fly_to_rest(
        plant,
        drawn.start,
        controller.pilot(len(ids)),
        steps=round(WITHIN / period),
        hold=math.ceil(HOLD / period - 1e-9),
        speed=SPEED,
        rate=RATE,
    )


def study(
    scenarios: Sequence[Scenario], controllers: Sequence[Controller], flights: int | None = None
) -> Study:
    """Return the study of controllers in scenarios; flights: of each at most, None: as many as it has."""
    whole = flights is None or flights >= FLIGHTS
    level = {s.name: s.speed for s in scenarios if not (s.waves.amplitude.any() or s.inclination)}
    return Study(
        name="moving",
        title="Moving platforms",
        cases=[
            Case(
                {"scenario": scenario.name, "policy": controller.name, "together": "all scenarios"}
                | ({"speed": level[scenario.name]} if scenario.name in level else {}),
                partial(fly, scenario, controller, flights),
            )
            for scenario in scenarios
            for controller in controllers
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
    """Return whether this is a result of the benchmark, and a sentence on each controller."""
    rows = results.all(AT_REST, scenario=None, speed=None)
    return [f"{row['policy']} {AT_REST.said} in {count_words(row)}." for row in rows] + [PARTLY] * (not whole)
