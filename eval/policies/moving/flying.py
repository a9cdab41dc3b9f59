"""Flights of a controller through a scenario, judged relative to the platform.

All are flown in the MuJoCo plant, RK4 in steps of 4 ms, one vehicle and one platform each, at 50 Hz, until
rest on the platform as the scenario says (see `eval.policies.rest`), the floor, or the end of its time.
"""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pandas as pd

from inclined_landing.envs.flights import Flight
from inclined_landing.envs.tasks import StepContext, make_task
from inclined_landing.envs.tasks.touchdown import resting
from inclined_landing.eval.policies.moving.controllers import Controller
from inclined_landing.eval.policies.moving.scenario import DrawnFlights, Scenario
from inclined_landing.eval.policies.rest import fly_to_rest
from inclined_landing.models.attitude import PWM
from inclined_landing.models.errors import UserError
from inclined_landing.models.plants import MujocoPlant
from inclined_landing.models.plants.recorder import STEP
from inclined_landing.models.vehicle import Vehicle

RIDE = 1.5  # s that a film goes on for after rest


def fly(scenario: Scenario, controller: Controller, flights: int | None = None) -> pd.DataFrame:
    """Return a row for each flight of a scenario, or of its first flights, as `fly_to_rest` does."""
    drawn, period, rest = (
        scenario.draw(controller.vehicle, flights),
        controller.vehicle.command_control_period,
        scenario.success,
    )
    try:
        return fly_to_rest(
            _plant(scenario, drawn, controller.vehicle),
            drawn.start,
            controller.pilot(len(drawn.start)),
            steps=round(rest.within / period),
            hold=math.ceil(rest.hold / period - 1e-9),
            speed=rest.speed,
            rate=rest.rate,
        )
    except UserError as error:
        raise UserError(f"scenario {scenario.name}: {error}") from error


def _plant(scenario: Scenario, drawn: DrawnFlights, vehicle: Vehicle) -> MujocoPlant:
    """Return the plant of a scenario's flights, its platforms in motion; the vehicles are not there yet."""
    ids = np.arange(len(drawn.start))
    plant = MujocoPlant(len(ids), vehicle, timestep=STEP, torque_needs_motors=True, moving=True)
    plant.set_platform(ids, drawn.inclination, azimuth=drawn.azimuth)
    plant.set_motion(ids, drawn.motion)
    plant.set_contact(ids, friction=scenario.deck.friction)
    return plant


@dataclasses.dataclass(kw_only=True)
class Ride(Flight):
    """A flight that goes on after rest: the vehicle rides along."""

    rested: float  # s, when it had come to rest, or the end

    @property
    def duration(self) -> float:
        """Until rest [s]."""
        return self.rested


def ride(scenario: Scenario, controller: Controller) -> Ride:
    """Return the first flight of a scenario, to be filmed."""
    drawn, period = scenario.draw(controller.vehicle, 1), controller.vehicle.command_control_period
    plant, rest = _plant(scenario, drawn, controller.vehicle), scenario.success
    plant.reset([0], drawn.start)
    pilot = controller.pilot(1)
    states, platforms = [plant.state[0].copy()], [plant.platform[0].copy()]
    commanded: list[np.ndarray] = []
    rested_for, touched, rested = 0, False, math.inf
    while len(commanded) < min(round(rest.within / period), rested + round(RIDE / period)):
        context = StepContext(plant.state, plant.contacts, platform=plant.platform)
        commands = pilot(len(commanded) * period, context)
        plant.step(commands)
        commanded.append(commands[0])
        states.append(plant.state[0].copy())
        platforms.append(plant.platform[0].copy())
        touched |= bool(plant.contacts.platform[0])
        idle = commands[:, PWM] == 0.0
        still = resting(plant.state, plant.platform, idle, plant.contacts, rest.speed, rest.rate)[0]
        rested_for = rested_for + 1 if still else 0
        if rested_for * period >= rest.hold and math.isinf(rested):
            rested = len(commanded)
    task = make_task("touchdown", controller.vehicle, dimensions=3)
    return Ride(
        task=task,
        actions=np.zeros((len(states), len(task.action_names))),  # a controller has none
        reward=np.zeros(len(states)),
        success=not math.isinf(rested),
        touched=touched,
        rested=period * min(rested, len(commanded)),
        t=period * np.arange(len(states)),
        state=np.array(states),
        commands=np.array([*commanded, commanded[-1]]),
        inclination=scenario.inclination,
        platform=np.array(platforms),
        motion=drawn.motion,
    )
