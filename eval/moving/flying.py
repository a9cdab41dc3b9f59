"""Flights of a controller through a scenario, judged relative to the platform.

All are flown in the MuJoCo plant, RK4 in steps of 4 ms, one vehicle and one platform each, at 50 Hz. A
vehicle under PWM 0 has no attitude torque. A flight ends with rest on the platform as the scenario says, on
the floor, or with its time.
"""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pandas as pd

from inclined_landing.envs.flights import Flight
from inclined_landing.envs.tasks import StepContext, make_task
from inclined_landing.envs.tasks.touchdown import resting
from inclined_landing.eval.moving.controllers import Controller
from inclined_landing.eval.moving.scenario import Drawn, Scenario
from inclined_landing.models import surface
from inclined_landing.models.attitude import (
    PWM,
)
from inclined_landing.models.errors import UserError
from inclined_landing.models.plants import MujocoPlant
from inclined_landing.models.plants.recorder import STEP, Recorder
from inclined_landing.models.vehicle import Vehicle

FIELDS = ("at_rest", "time", "normal_speed", "tangential_speed", "tilt", "off_centre")


RIDE = 1.5  # s that a film goes on for after rest


def plant_of(scenario: Scenario, drawn: Drawn, vehicle: Vehicle) -> MujocoPlant:
    """The plant of a scenario's flights, with its platforms in motion; the vehicles are not there yet."""
    ids = np.arange(len(drawn.start))
    plant = MujocoPlant(len(ids), vehicle, timestep=STEP, torque_needs_motors=True, moving=True)
    plant.set_platform(ids, drawn.inclination, azimuth=drawn.azimuth)
    plant.set_motion(ids, drawn.motion)
    plant.set_contact(ids, friction=scenario.deck.friction)
    return plant


def fly(scenario: Scenario, controller: Controller, flights: int | None = None) -> pd.DataFrame:
    """Fly a scenario, or its first flights; one row each.

    at_rest; time [s] until it was held; at the first touch, relative to the platform: normal_speed into it
    and tangential_speed along it [m/s], tilt [rad] between the vehicle's axis and the platform's normal;
    off_centre [m]: from the platform's centre at rest. NaN where there was none.
    """
    drawn = scenario.draw(controller.vehicle, flights)
    n, period, rest = len(drawn.start), controller.vehicle.command_control_period, scenario.success
    plant = plant_of(scenario, drawn, controller.vehicle)
    recorder = Recorder(plant, drawn.start)
    pilot = _begun(controller, scenario, n)
    held, ended = np.zeros(n, int), np.zeros(n, bool)
    time, off_centre = np.full(n, np.nan), np.full(n, np.nan)
    for tick in range(round(rest.within / period)):
        commands = _asked(
            pilot, tick * period, StepContext(plant.state, plant.contacts, platform=plant.platform), scenario
        )
        recorder.step(commands, np.flatnonzero(~ended))
        held = np.where(_rests(scenario, plant, commands), held + 1, 0)
        rests = ~ended & (held >= math.ceil(rest.hold / period - 1e-9))
        time[rests] = (tick + 1) * period
        off_centre[rests] = np.linalg.norm(surface.relative(plant.state, plant.platform)[0], axis=1)[rests]
        ended |= rests | plant.contacts.touch[:, 2].any(axis=1)
        if ended.all():
            break
    columns = (~np.isnan(time), time, *_touch(recorder), off_centre)
    return pd.DataFrame(dict(zip(FIELDS, columns)))


@dataclasses.dataclass(kw_only=True)
class Ride(Flight):
    """A flight that goes on after rest: the vehicle rides along."""

    rested: float  # s, when it had come to rest, or the end

    @property
    def duration(self) -> float:
        """Until rest [s]."""
        return self.rested


def ride(scenario: Scenario, controller: Controller) -> Ride:
    """The first flight of a scenario, to be filmed."""
    drawn, period = scenario.draw(controller.vehicle, 1), controller.vehicle.command_control_period
    plant = plant_of(scenario, drawn, controller.vehicle)
    plant.reset([0], drawn.start)
    pilot, held, left, touched = controller.pilot(1), 0, math.inf, False
    rows = [(plant.state[0].copy(), plant.platform[0].copy())]
    given: list[np.ndarray] = []
    while len(given) * period < scenario.success.within and left > 0:
        commands = pilot(
            len(given) * period, StepContext(plant.state, plant.contacts, platform=plant.platform)
        )
        plant.step(commands)
        given.append(commands[0])
        rows.append((plant.state[0].copy(), plant.platform[0].copy()))
        touched |= bool(plant.contacts.platform[0])
        held = held + 1 if _rests(scenario, plant, commands)[0] else 0
        if held * period >= scenario.success.hold and math.isinf(left):
            left = RIDE
        left -= period
    state, platform = map(np.array, zip(*rows))
    task = make_task("touchdown", controller.vehicle, dimensions=3)
    success = not math.isinf(left)
    return Ride(
        task=task,
        actions=np.zeros((len(rows), len(task.action_names))),  # a controller has none
        reward=np.zeros(len(rows)),
        success=success,
        touched=touched,
        rested=period * (len(given) - (round(RIDE / period) if success else 0)),
        t=period * np.arange(len(rows)),
        state=state,
        commands=np.array([*given, given[-1]]),
        inclination=scenario.inclination,
        platform=platform,
        motion=drawn.motion,
    )


def _rests(scenario: Scenario, plant: MujocoPlant, commands: np.ndarray) -> np.ndarray:
    """(n,) bool: at rest on the platform now, as the scenario says."""
    success, idle = scenario.success, commands[:, PWM] == 0.0
    return resting(plant.state, plant.platform, idle, plant.contacts, success.speed, success.rate)


def _begun(controller: Controller, scenario: Scenario, n: int):
    return _named(lambda: controller.pilot(n), scenario)


def _asked(pilot, t: float, context: StepContext, scenario: Scenario) -> np.ndarray:
    return _named(lambda: pilot(t, context), scenario)


def _named(work, scenario: Scenario):
    """What `work` answers; its UserError says in which scenario."""
    try:
        return work()
    except UserError as error:
        raise UserError(f"scenario {scenario.name}: {error}") from error


def _touch(recorder: Recorder) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Normal and tangential speed and tilt (n,) at the first touch, from the last state before it."""
    touch = recorder.touch
    tilt = np.full(len(touch.time), np.nan)
    own = np.flatnonzero(recorder.touched)
    if len(own):
        normal = surface.normals(recorder.plant.platform_at(np.nan_to_num(touch.time - STEP)))[own]
        w, x, y, z = touch.qpos[own, 3:7].T
        upright = np.column_stack([2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)])
        tilt[own] = np.arccos(np.clip((upright * normal).sum(axis=1), -1.0, 1.0))
    return *recorder.touch_speeds(), tilt
