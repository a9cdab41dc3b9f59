"""Flights until rest on the platform, in the MuJoCo plant (RK4, 4 ms).

A vehicle is at rest if it is slow relative to the platform, only on its feet, with motors at idle, for the
required time. The floor ends a flight. A vehicle under PWM 0 has no attitude torque.

For policies that hand over, `cut_motors` continues from given states with PWM 0 for two seconds and evaluates
every engine step. It stops early if the outcome is known: on the floor, or 0.15 s almost without motion.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any, Protocol, TypeVar

import numpy as np
import pandas as pd

from inclined_landing.envs.history import History
from inclined_landing.envs.policy import Policy
from inclined_landing.envs.shared.measures import alone, median_of
from inclined_landing.envs.tasks import StepContext, touchdown
from inclined_landing.envs.tasks.landing import GOAL_SIZE
from inclined_landing.models import surface
from inclined_landing.models.attitude import PWM, VX, WX
from inclined_landing.models.plants import MujocoPlant, Plant
from inclined_landing.models.plants.recorder import STEP, STILL_RATE, STILL_SPEED, Recorder
from inclined_landing.models.vehicle import Vehicle

DURATION = 2.0  # s after a motor cut
_STILL = 0.15  # s
# A share of the speeds of rest. A vehicle that slides away at constant acceleration, and is slower than this
# share for _STILL, has not reached those speeds after DURATION, as (1 + DURATION / _STILL) / 15 < 1.
_SLOW = 1 / 15
_LOOK = 5 * STEP  # s, after which it is asked which vehicles are at rest


# Of flights to rest: when it was held, and the speeds of the first touch relative to the platform.
TOUCH = (
    median_of("time", "time", "s", cell=alone),
    median_of("normal_speed", "normal speed", "m/s", cell=alone),
    median_of("tangential_speed", "tangential speed", "m/s", cell=alone),
)
P = TypeVar("P", bound=Plant)


class Pilot(Protocol):
    """A pilot of n vehicles in one scenario, called once every control period."""

    def __call__(self, t: float, context: StepContext) -> np.ndarray:
        """Return commands (n, 4) at time t [s], for the present states, contacts and platforms."""


class PolicyPilot:
    """Flies a policy; if its task ends in a goal box, the motors are cut there."""

    def __init__(self, policy: Policy, n: int):
        self._policy, self._task = policy, policy.task
        self._past = History(self._task, n)
        self.cut = np.zeros(n, bool)  # the vehicles whose motors have been cut

    def __call__(self, t: float, context: StepContext) -> np.ndarray:
        """Return commands (n, 4)."""
        observation = self._task.observe(context)
        if t == 0.0:
            self._past.reset(slice(None), observation)
        actions = self._policy.predict(self._past.stack(observation)).astype(float)
        self._past.record(observation, actions)
        commands = self._task.body_commands(self._task.commands(actions), context.state, context.platform)
        if self._task.cut_at_success:
            self.cut |= self._task.in_goal(context.state, GOAL_SIZE, context.platform)
            commands[self.cut, PWM] = 0.0
        return commands


def fly_to_rest(
    plant: MujocoPlant,
    states: np.ndarray,
    pilot: Pilot,
    *,
    steps: int,
    hold: int,
    speed: float = touchdown.REST_SPEED,
    rate: float = touchdown.REST_RATE,
    after_cut: int | None = None,
) -> pd.DataFrame:
    """Return a row for each flight from `states` (n, 13), of at most `steps` control steps.

    hold: control steps of rest that end a flight; speed, rate: limits of rest [m/s, rad/s].
    after_cut: steps that a vehicle has once the pilot has cut its motors, instead of `steps`.

    Columns: `at_rest`; `time` [s] until rest was held; at the first touch, relative to the platform,
    `normal_speed` into it and `tangential_speed` along it [m/s], and `tilt` [rad] between the vehicle's axis
    and the platform's normal; `off_centre` [m], from the platform's centre at rest; `peak_normal_force` on
    the feet [N]. NaN if there was none.
    """
    n, period = len(states), plant.control_period
    recorder = Recorder(plant, states)
    rested_for, ended, was_cut = np.zeros(n, int), np.zeros(n, bool), np.zeros(n, bool)
    last = np.full(n, steps)
    time, off_centre = np.full(n, np.nan), np.full(n, np.nan)
    for tick in range(1, steps + (after_cut or 0) + 1):
        context = StepContext(plant.state, plant.contacts, platform=plant.platform)
        commands = pilot((tick - 1) * period, context)
        if after_cut is not None:
            cut = getattr(pilot, "cut", was_cut)
            last[cut & ~was_cut] = tick - 1 + after_cut
            was_cut = cut.copy()
        recorder.step(commands, np.flatnonzero(~ended))
        idle = commands[:, PWM] == 0.0
        holding = touchdown.resting(plant.state, plant.platform, idle, plant.contacts, speed, rate)
        rested_for = np.where(holding, rested_for + 1, 0)
        rests = (rested_for >= hold) & ~ended
        time[rests] = tick * period
        off_centre[rests] = np.linalg.norm(surface.relative(plant.state, plant.platform)[0], axis=1)[rests]
        ended |= rests | (tick >= last) | plant.contacts.floor
        if ended.all():
            break
    into, along = recorder.touch_speeds()
    return pd.DataFrame(
        {
            "at_rest": ~np.isnan(time),
            "time": time,
            "normal_speed": into,
            "tangential_speed": along,
            "tilt": _tilt_at_touch(recorder),
            "off_centre": off_centre,
            "peak_normal_force": np.where(recorder.touched, recorder.feet_force, np.nan),
        }
    )


def _tilt_at_touch(recorder: Recorder) -> np.ndarray:
    """Return the angle (n,) [rad] to the platform's normal in the last state before the first touch."""
    touch = recorder.touch
    tilt = np.full(len(touch.time), np.nan)
    touched = np.flatnonzero(recorder.touched)
    if len(touched):
        normal = surface.normals(recorder.plant.platform_at(np.nan_to_num(touch.time - STEP)))[touched]
        w, x, y, z = touch.qpos[touched, 3:7].T
        upright = np.column_stack([2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)])
        tilt[touched] = np.arccos(np.clip((upright * normal).sum(axis=1), -1.0, 1.0))
    return tilt


@dataclasses.dataclass(frozen=True)
class VariantChoice:
    """Which vehicle and thrust scale each of the flights that are simulated together has."""

    vehicle: Vehicle
    pool: Sequence[Vehicle] = ()
    number: np.ndarray = dataclasses.field(default_factory=lambda: np.zeros(1, int))  # see `Plant.assign`
    thrust_scale: np.ndarray = dataclasses.field(default_factory=lambda: np.ones(1))  # like `number`

    def __getitem__(self, ids) -> VariantChoice:
        """Return the choice of the flights `ids`."""
        return dataclasses.replace(self, number=self.number[ids], thrust_scale=self.thrust_scale[ids])

    def begin(self, plant: P) -> P:
        """Give a plant of its `vehicle` and `pool` the chosen vehicles and the scales of their thrust."""
        if self.pool:
            plant.assign(np.arange(plant.n), self.number)
        if (self.thrust_scale != 1.0).any():
            plant.set_thrust_scale(self.thrust_scale)
        return plant


def cut_motors(states: np.ndarray, inclination: float | np.ndarray, variants: VariantChoice) -> pd.DataFrame:
    """Return a row for each flight in which the motors are cut at `states` (n, 13).

    inclination: that of the platforms, (n,) or one for all [rad]. The scaled thrust is the one that still
    decays.

    Columns: `touchdown`, whether any part reached the slab; the speeds of the centre of mass up to 8 ms
    before, `normal_speed` into the surface and `tangential_speed` along it, unsigned [m/s], NaN without a
    touchdown; `at_rest_on_feet`, whether it is still at the end, with the feet and nothing else on the slab.
    """
    n = len(states)
    options: dict[str, Any] = {"control_period": _LOOK, "timestep": STEP, "torque_needs_motors": True}
    plant = variants.begin(MujocoPlant(n, variants.vehicle, pool=variants.pool, **options))
    plant.set_platform(np.arange(n), inclination)
    recorder = Recorder(plant, states)
    at_rest_for, flying = np.zeros(n), np.arange(n)
    for _ in range(round(DURATION / _LOOK)):
        recorder.step(np.zeros((n, 4)), flying)
        speed, rate = (np.linalg.norm(plant.state[:, k : k + 3], axis=1) for k in (VX, WX))
        slow = (speed < _SLOW * STILL_SPEED) & (rate < _SLOW * STILL_RATE)
        at_rest_for = np.where(recorder.at_rest() & slow, at_rest_for + _LOOK, 0.0)
        flying = np.flatnonzero(~_decided(at_rest_for, plant.contacts.floor))
        if not len(flying):
            break
    into, along = recorder.touch_speeds()
    return pd.DataFrame(
        {
            "touchdown": recorder.touched,
            "normal_speed": into,
            "tangential_speed": along,
            "at_rest_on_feet": recorder.at_rest(),
        }
    )


def _decided(at_rest_for: np.ndarray, on_floor: np.ndarray) -> np.ndarray:
    """Return (n,) bool: whether the end of a flight is known."""
    return (at_rest_for >= _STILL) | on_floor
