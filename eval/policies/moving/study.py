"""The benchmark of moving platforms: flights of controllers through scenarios, and their study.

All are flown in the MuJoCo plant, RK4 in steps of 4 ms, one vehicle and one platform each, at 50 Hz, until
rest on the platform as the scenario says (see `eval.policies.rest`), the floor, or the end of its time.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import partial

import numpy as np
import pandas as pd

from inclined_landing.envs.shared import runs
from inclined_landing.envs.shared.tables import count_words
from inclined_landing.eval.policies.flying import summary
from inclined_landing.eval.policies.moving.controllers import Controller
from inclined_landing.eval.policies.moving.scenario import Scenario
from inclined_landing.eval.policies.rest import fly_to_rest
from inclined_landing.eval.policies.study import Study, fly_all, joined
from inclined_landing.eval.policies.tables import Panel
from inclined_landing.models.errors import UserError
from inclined_landing.models.plants import MujocoPlant
from inclined_landing.models.plants.recorder import STEP

COUNTED = ("at_rest", "time", "normal_speed", "tangential_speed", "tilt", "off_centre")
RULE = (
    "At rest means on the platform, on the feet alone, with motors at idle, for the time that the scenario "
    "states; in the frozen scenarios 0.3 s within 10 s, slower than 0.05 m/s relative to the platform. "
    "Shares have 95 % Wilson intervals. Speeds and tilt at the first touch, relative to the platform, and "
    "the time until rest are medians."
)
PARTLY = "Not all flights of the scenarios were flown, so this is not a benchmark result."


def fly(scenario: Scenario, controller: Controller, flights: int | None = None) -> pd.DataFrame:
    """Return a row for each flight of a scenario, or of its first flights, as `fly_to_rest` does."""
    vehicle, rest = controller.vehicle, scenario.success
    drawn, period = scenario.draw(vehicle, flights), vehicle.command_control_period
    ids = np.arange(len(drawn.start))
    plant = MujocoPlant(len(ids), vehicle, timestep=STEP, torque_needs_motors=True, moving=True)
    plant.set_platform(ids, drawn.inclination, azimuth=drawn.azimuth)
    plant.set_motion(ids, drawn.motion)
    plant.set_contact(ids, friction=scenario.deck.friction)
    try:
        return fly_to_rest(
            plant,
            drawn.start,
            controller.pilot(len(ids)),
            steps=round(rest.within / period),
            hold=math.ceil(rest.hold / period - 1e-9),
            speed=rest.speed,
            rate=rest.rate,
        )
    except UserError as error:
        raise UserError(f"scenario {scenario.name}: {error}") from error


def run(
    scenarios: Sequence[Scenario], controllers: Sequence[Controller], flights: int | None = None
) -> Study:
    """Return the study of controllers in scenarios; flights: of each at most, None: as many as it says."""
    flown = fly_all(
        {
            (controller.name, scenario.name): partial(fly, scenario, controller, flights)
            for scenario in scenarios
            for controller in controllers
        }
    )
    names = [controller.name for controller in controllers]
    counted = {key: summary(table, *COUNTED) for key, table in flown.items()}
    overall = {
        name: summary(pd.concat([flown[name, scenario.name] for scenario in scenarios]), "at_rest")
        for name in names
    }
    report = {
        "command": "moving",
        "controllers": [{"name": c.name, "kind": c.kind} for c in controllers],
        "scenarios": [
            {
                "name": scenario.name,
                "title": scenario.title,
                "fingerprint": scenario.fingerprint,
                "speed": scenario.motion.speed,
                "waves": bool(scenario.waves.amplitude.any()),
                "slope": scenario.inclination,
                "whole": flights is None or flights >= scenario.flights,
                "outcomes": [{"controller": name} | counted[name, scenario.name] for name in names],
            }
            for scenario in scenarios
        ],
        "all": [{"name": name} | share for name, share in overall.items()],
        "versions": runs.versions(),
    }
    whole = all(row["whole"] for row in report["scenarios"])  # type: ignore[index]
    answers = [
        f"{name} came to rest on the platform in {count_words(share['at_rest'])}."
        for name, share in overall.items()
    ]
    return Study(
        name="moving",
        title="Moving platforms",
        report=report,
        flights=joined(flown),
        heads=("scenario", "controller"),
        rows=[((s.name, name), counted[name, s.name]) for s in scenarios for name in names],
        panels=_panels(scenarios, names, counted),
        share="flights at rest on the platform",
        remarks=[RULE, *([] if whole else [PARTLY]), *answers],
    )


def _panels(
    scenarios: Sequence[Scenario], names: Sequence[str], counted: dict[tuple[str, str], dict]
) -> list[Panel]:
    """Return shares at rest over the speed of level platforms that travel, and in every other scenario."""
    level = [s for s in scenarios if not (s.waves.amplitude.any() or s.inclination)]
    level.sort(key=lambda scenario: scenario.motion.speed)
    others = [scenario for scenario in scenarios if scenario not in level]
    rest = {key: found["at_rest"] for key, found in counted.items()}
    speeds = {name: {s.motion.speed: rest[name, s.name] for s in level} for name in names}
    rows = {name: {s.name: rest[name, s.name] for s in others} for name in names}
    panels = [Panel("Level platforms at constant speed", speeds, "platform speed [m/s]")]
    return panels * bool(level) + [Panel("Slopes, waves, ships, cars", rows)] * bool(others)
