"""Continuation of a landing from the goal box, with the motors cut, until the vehicle is at rest.

The goal box is above the slope, so that a successful flight has not landed yet. The continuation is
simulated in the MuJoCo plant, whichever plant the policy was flown in, with the rest criterion of
`plants.recorder`.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from inclined_landing.envs.flights import Flight, place_platform
from inclined_landing.models.geometry import SURFACES
from inclined_landing.models.plants import MujocoPlant
from inclined_landing.models.plants.recorder import Recorder, still

WATCH_TIME = 2.0  # s that a landing is watched after its motors are cut
STILL_TIME = 0.3  # s without motion that end it
_SLAB, _FLOOR = SURFACES.index("slab"), SURFACES.index("floor")


@dataclasses.dataclass(kw_only=True)
class LandedFlight(Flight):
    """A flight continued after the motor cut; rows from `cut` on have PWM 0 as their command."""

    cut: int  # row of the motor cut, the flight's last one
    settled: int  # row from which `ending` is true
    at_rest: bool  # on its feet
    ending: str  # the vehicle's outcome in words

    @property
    def duration(self) -> float:
        """Return the length of the policy's flight [s], up to the motor cut."""
        return float(self.t[self.cut])


def to_rest(flight: Flight) -> Flight:
    """Return the flight continued to rest as a `LandedFlight`, if its task cuts the motors.

    It continues for up to 2 s after the goal, until the vehicle has not moved for 0.3 s. A flight that did
    not succeed, or whose task cuts no motors, is returned unchanged.
    """
    if not (flight.success and flight.task.cut_at_success and flight.platform is not None):
        return flight
    vehicle = flight.task.vehicle
    plant = MujocoPlant(1, vehicle, torque_needs_motors=True, moving=flight.motion is not None)
    place_platform(plant, flight, flight.t[-1])
    recorder = Recorder(plant, flight.state[-1:])
    period = plant.control_period
    states, platforms, settled, steps = [], [], 0, 0
    while steps < round(WATCH_TIME / period) and steps - settled < round(STILL_TIME / period):
        recorder.step(np.zeros((1, 4)))
        steps += 1
        states.append(plant.state[0].copy())
        platforms.append(plant.platform[0].copy())
        if not still(plant.state, plant.platform)[0]:
            settled = steps
    cut = len(flight.t) - 1
    off = np.zeros((steps, flight.commands.shape[1]))
    commands = np.concatenate([flight.commands[:-1], off, off[:1]])
    extended = {
        "t": np.concatenate([flight.t, flight.t[-1] + period * np.arange(1, steps + 1)]),
        "state": np.concatenate([flight.state, states]),
        "platform": np.concatenate([flight.platform, platforms]),
        "actions": np.pad(flight.actions, [(0, steps), (0, 0)], mode="edge"),
        "commands": commands,
        "reward": np.pad(flight.reward, (0, steps)),
    }
    flown = {field.name: getattr(flight, field.name) for field in dataclasses.fields(Flight)}
    return LandedFlight(
        **flown | extended,
        cut=cut,
        settled=cut + min(settled + 1, steps),
        at_rest=bool(recorder.at_rest()[0]),
        ending=_outcome(recorder),
    )


def _outcome(recorder: Recorder) -> str:
    """Return the final state of the vehicle in words, from its motion and contacts."""
    plant = recorder.plant
    touch = plant.contacts.touch[0]
    if recorder.at_rest()[0]:
        return "at rest on its feet"
    if touch[_FLOOR].any():
        return "fell to the floor"
    if still(plant.state, plant.platform)[0]:
        return "at rest, but not on its feet alone"
    return "still sliding" if touch[_SLAB].any() else "still moving"
