"""`landing-eval success POLICY --effects`: how a policy fares when the model lacks a physical effect.

One row for every effect of the library at its plausible size, and one for none. Only the vehicle in the
plant has the effect: the policy, its task and its goal know nothing of it. Landing policies fly from the
frozen grid, and where they arrive their motors are cut; set-point policies fly from 200 random starts.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping

import numpy as np
from rich.console import Console
from rich.progress import track

from inclined_landing.envs.flights import Flight, record_flights
from inclined_landing.envs.policy import Policy
from inclined_landing.envs.tasks import Start
from inclined_landing.eval.policies.judges import judge_of, report_of
from inclined_landing.models.attitude import LAG
from inclined_landing.models.effects import LIBRARY, Effect
from inclined_landing.models.errors import UserError
from inclined_landing.models.parameters import Vehicle
from inclined_landing.models.plants import make_plant


def evaluate(policy: Policy, *, plant: str = "mujoco", seed: int = 0) -> dict:
    """The report, as plain numbers; one entry of `effects` per effect, the first without any.

    plant: "mujoco", "hybrid" or "analytic". seed: of the random starts of a set-point policy.
    """
    cases = [(None, {}), *((effect, effect.plausible) for effect in LIBRARY.values())]
    judge = judge_of(policy.task)
    starts = judge.groups(policy.task, seed)[judge.frozen]
    rows = []
    for effect, values in track(cases, "flying", console=Console(stderr=True), transient=True):
        name = "none" if effect is None else effect.name
        vehicle = policy.task.vehicle if effect is None else effect.apply(policy.task.vehicle, values)
        try:
            flights = fly(policy, plant, vehicle, starts)
        except FloatingPointError as error:
            raise UserError(f"effect {name}: {error}") from error
        outcome = judge.effect(policy.task, flights, vehicle)
        rows.append(
            {"effect": name, "parameters": {} if effect is None else sizes(effect, values), **outcome}
        )
    return report_of("success --effects", policy, plant, seed) | {"effects": rows}


def sizes(effect: Effect, values: Mapping[str, float]) -> dict:
    """Values of an effect's parameters with their units, for a report."""
    units = {p.name: p.unit for p in effect.parameters}
    return {name: {"value": value, "unit": units[name]} for name, value in values.items()}


def fly(policy: Policy, plant: str, vehicle: Vehicle, starts: Start) -> list[Flight]:
    """Flights of `vehicle`, of which the policy knows nothing, from `starts` of its own vehicle."""
    task, starts = policy.task, dataclasses.replace(starts, state=starts.state.copy())
    starts.state[:, LAG] *= task.vehicle.thrust_lag_rate / vehicle.thrust_lag_rate  # the same load
    tilt = vehicle.platform_inclination - task.vehicle.platform_inclination
    fleet = make_plant(plant, len(starts), vehicle)
    return record_flights(policy, _Tilted(fleet, tilt) if tilt else fleet, starts, steps=task.judged_steps)


class _Tilted:
    """A plant whose platforms are inclined by `tilt` [rad] more than the task sets them."""

    def __init__(self, plant, tilt: float):
        self._plant, self._tilt = plant, tilt

    def __getattr__(self, name):
        return getattr(self._plant, name)

    def set_platform(self, ids, inclination, present=True, azimuth=0.0) -> None:
        self._plant.set_platform(ids, np.asarray(inclination) + self._tilt, present, azimuth)
