"""`landing-eval success`: how often, how fast and how hard a policy reaches its goal.

Landing: the deterministic policy flies from the paper's three starts, from ten scattered starts
around each, and from the frozen grid (`landing_starts.py`). *Success* is reaching the goal box
(0.10, 0.10, 1.5, 1.5, 0.025) within 300 control steps; *strict* success also means that no part
touched the platform before. The goal box is not yet a landing, so the velocity at its entry is
reported too, and what happens when the motors are cut there (`motors_cut.py`).

Set-point: the position error after 3 s from 200 random starts.

With ``--effects`` the frozen grid (or the random starts) alone, once for every effect of the library
(`success_effects.py`).
"""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np

from inclined_landing.envs import starts as landing_starts
from inclined_landing.envs.flights import Flight, record_flights
from inclined_landing.envs.policy import Policy, load_policy
from inclined_landing.eval.base import runs
from inclined_landing.eval.base.statistics import mean, proportion, spread
from inclined_landing.eval.policies.motors_cut import cut_motors, split_velocity
from inclined_landing.models import storage
from inclined_landing.models.attitude import PITCH, VX, VZ
from inclined_landing.models.errors import UserError
from inclined_landing.models.parameters import load_vehicle
from inclined_landing.models.plants import PLANTS, make_plant

PAPER = ({"count": 28, "of": 30, "share": 28 / 30}, {"share": 0.867})
SETPOINT_STARTS = 200
SETPOINT_TIME = 3.0  # s
SETPOINT_TOLERANCE = 0.05  # m


def evaluate(
    policy: Policy, *, plant: str = "mujoco", thrust_scales: Sequence[float] = (1.0,), seed: int = 0
) -> dict:
    """The success report of a policy, as plain numbers; one entry of `conditions` per thrust scale.

    plant: "mujoco" or "analytic", always the plain one (no keep-out zone, RK4 at 4 ms).
    seed: of the random starts.
    """
    report, _ = _evaluate(policy, plant, thrust_scales, seed)
    return report


def run(
    policy: str,
    *,
    task: str | None = None,
    plant: str = "mujoco",
    thrust_scale: Sequence[float] = (1.0,),
    inclination: float | None = None,
    vehicle: Path | None = None,
    effects: bool = False,
    seed: int = 0,
    json: bool = False,
    out: Path | None = None,
) -> None:
    """The command; inclination in degrees. Prints a table, or JSON alone."""
    if plant not in PLANTS:
        raise UserError(f"unknown plant {plant!r}; known are {' and '.join(PLANTS)}")
    for scale in thrust_scale:
        if not (math.isfinite(scale) and 0 < scale <= 3):
            raise UserError(f"--thrust-scale must be above 0 and at most 3, not {scale:g}")
    if effects and tuple(thrust_scale) != (1.0,):
        raise UserError("give either --effects or --thrust-scale: an effect of the library scales the thrust")
    if seed < 0:
        raise UserError(f"--seed must not be negative, it is {seed}")
    if out is not None:
        runs.check_new_run(out)
    flown = load_vehicle(vehicle) if vehicle is not None else None
    angle = None if inclination is None else math.radians(inclination)
    if angle is not None:
        (flown or load_vehicle()).check_inclination(angle)
    loaded = load_policy(policy, task, vehicle=flown, inclination=angle)
    if loaded.task.name == "touchdown":
        raise UserError(f"policy {policy} is for the task touchdown: landing-eval touchdown judges it")
    if effects:
        from inclined_landing.eval.policies import success_effects

        report, flights = success_effects.evaluate(loaded, plant=plant, seed=seed, progress=True), None
    else:
        report, flights = _evaluate(loaded, plant, thrust_scale, seed, progress=True)
    report["vehicle"] = str(vehicle) if vehicle is not None else "crazyflie.toml"
    if out is not None:
        folder = runs.new_run(out)
        if flights is not None:
            storage.write_text(folder / "flights.csv", _flights_csv(flights))
        storage.write_json(folder / "success.json", report)
    if json:
        print(storage.to_json(report))
    else:
        from inclined_landing.eval.policies import success_table

        (success_table.show_effects if effects else success_table.show)(report)


def _evaluate(policy, plant, thrust_scales, seed, progress=False):
    judge = _landing if policy.task.name == "landing" else _setpoint
    scales: Iterable[float] = thrust_scales
    if progress:
        from rich.console import Console
        from rich.progress import track

        scales = track(list(scales), "flying", console=Console(stderr=True), transient=True)
    conditions, flights = [], []
    for scale in scales:
        try:
            condition, flown = judge(policy, plant, scale, seed)
        except FloatingPointError as error:
            raise UserError(f"thrust scale {scale:g}: {error}") from error
        conditions.append({"thrust_scale": float(scale), **condition})
        flights += [(scale, group, flight) for group, flight in flown]
    task = policy.task
    report = {
        "command": "success",
        "policy": str(policy.path),
        "trained": policy.metadata,
        "task": task.name,
        "task_options": task.options,
        "plant": plant,
        "seed": int(seed),
        "paper": PAPER if task.name == "landing" else None,
        "conditions": conditions,
        "versions": runs.versions(),
    }
    return report, flights


def _landing(policy: Policy, plant: str, scale: float, seed: int):
    task = policy.task
    frozen = landing_starts.grid()
    grid = landing_starts.clear(task, frozen)
    groups = {
        "paper_starts": landing_starts.paper(),
        "scattered_starts": landing_starts.scattered(seed),
        "grid": grid,
    }
    starts = np.concatenate(list(groups.values()))
    flights = _fly(policy, plant, scale, landing_starts.at_rest(task, starts))
    condition, flown, first = {}, [], 0
    for name, group in groups.items():
        members = flights[first : first + len(group)]
        first += len(group)
        condition[name] = landing_summary(members)
        flown += [(name, flight) for flight in members]
    condition["grid"]["left_out"] = len(frozen) - len(grid)  # too close at this inclination
    arrived = [f for f in flights[-len(grid) :] if f.success]
    condition["entry"] = _entry(arrived)
    condition["motors_cut"] = _motors_cut(arrived, task, scale)
    return condition, flown


def landing_summary(flights: Sequence[Flight]) -> dict:
    """Success, strict success, platform touches and time to the goal box of landing flights."""
    n = len(flights)
    return {
        "success": proportion(sum(f.success for f in flights), n),
        "strict": proportion(sum(f.strict for f in flights), n),
        "touched": proportion(sum(f.touched for f in flights), n),
        "time_to_goal": spread([f.duration for f in flights if f.success]),
    }


def _entry(arrived: Sequence[Flight]) -> dict | None:
    """Velocities [m/s] and pitch error [rad] of the flights at the entry into the goal box."""
    if not arrived:
        return None
    state = np.array([f.state[-1] for f in arrived])
    velocity = state[:, VX : VZ + 1]
    away, along = split_velocity(velocity, arrived[0].inclination)
    return {
        "speed": spread(np.linalg.norm(velocity, axis=1)),
        "normal_speed": spread(-away),  # towards the surface
        "tangential_speed": spread(along),
        "moving_away": proportion((away > 0).sum(), len(arrived)),
        "pitch_error": spread(np.abs(state[:, PITCH] - arrived[0].inclination)),
    }


def _motors_cut(arrived: Sequence[Flight], task, scale: float) -> dict | None:
    if not arrived:
        return None
    states = np.array([f.state[-1] for f in arrived])
    after = cut_motors(states, task.inclination, task.vehicle, scale)
    return {
        "touchdown": proportion(after.touched.sum(), len(arrived)),
        "normal_speed": spread(after.normal_speed),
        "tangential_speed": spread(after.tangential_speed),
        "at_rest_on_feet": proportion(after.at_rest.sum(), len(arrived)),
    }


def _setpoint(policy: Policy, plant: str, scale: float, seed: int):
    starts, steps = setpoint_starts(policy.task, seed)
    flights = _fly(policy, plant, scale, starts, steps=steps)
    return setpoint_summary(policy.task, flights), [("random", flight) for flight in flights]


def setpoint_starts(task, seed: int) -> tuple[np.ndarray, int]:
    """The random starts (200, 13) of a set-point task, and for how many control steps they are flown."""
    starts = task.sample(np.random.default_rng(seed), SETPOINT_STARTS).state
    return starts, round(SETPOINT_TIME / task.vehicle.command_control_period)


def setpoint_summary(task, flights: Sequence[Flight]) -> dict:
    """Position error [m] at the end of the flights, and the share within 5 cm."""
    error = task.position_error(np.array([f.state[-1] for f in flights]))
    return {
        "error": mean(error) | spread(error),
        "within": proportion((error < SETPOINT_TOLERANCE).sum(), len(error)),
    }


def _fly(policy: Policy, plant: str, scale: float, states: np.ndarray, **options) -> list[Flight]:
    fleet = make_plant(plant, len(states), policy.task.vehicle)
    if scale != 1.0:
        fleet.perturb(thrust_scale=scale)
    return record_flights(policy, fleet, states, **options)


def _flights_csv(flights) -> str:
    """One row per flight; times in s, positions in m."""
    text = io.StringIO()
    table = csv.writer(text, lineterminator="\n")
    table.writerow("thrust_scale starts x y z success touched time end_x end_y end_z".split())
    for scale, group, f in flights:
        row = [*f.state[0, :3], int(f.success), int(f.touched), f.duration, *f.state[-1, :3]]
        table.writerow([f"{scale:g}", group, *(f"{value:.6g}" for value in row)])
    return text.getvalue()
