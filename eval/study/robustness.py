"""`landing-eval robustness`: policies compared under conditions that differ from their training."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, Annotated, Literal

import tyro
from msgspec import Meta

from inclined_landing.envs.ids import SHIPPED
from inclined_landing.eval.base.options import MOST_COMPARED, Flag, NewFolder, PlantName, only_with
from inclined_landing.eval.study.options import BASELINES, THRUSTS, VEHICLES
from inclined_landing.models.base.errors import UserError
from inclined_landing.models.effects import LIBRARY

if TYPE_CHECKING:
    from inclined_landing.envs.policy import Policy
    from inclined_landing.eval.study.engine import Study

# Without --full: each 12th start, medium effects, few drawn vehicles, few flights of a scenario.
QUICK_EVERY, QUICK_DRAWS, QUICK_FLIGHTS, DRAWS = 12, 32, 4, 256

Policies = Annotated[
    tuple[str, ...],
    tyro.conf.Positional,
    tyro.conf.arg(
        metavar="[POLICY ...]",
        help=f"landing policies: files, run folders or shipped ones ({', '.join(SHIPPED)}). All are compared "
        "with the first. LABEL=POLICY gives a name. --over moving takes 3D policies and planner.",
        help_behavior_hint=f"(default with --over moving: {' '.join(BASELINES)})",
    ),
    Meta(max_length=100),
]
Over = Literal["thrust", "effects", "slopes", "vehicles", "moving"]
_FROM_GRID = only_with("over", "thrust", "effects", "slopes", "vehicles")
_VEHICLE = tyro.conf.arg(
    metavar="VEHICLE [...]",
    help_behavior_hint=f"(default: Crazyflie 2.1; with --over vehicles: {' '.join(VEHICLES)})",
)


def command(
    policies: Policies = (),
    /,
    *,
    over: tuple[Over, ...] = ("thrust", "effects"),
    full: Flag = False,
    out: NewFolder = None,
    plant: Annotated[PlantName, _FROM_GRID] = "hybrid",
    every: Annotated[Annotated[int, Meta(ge=1, le=250)] | None, _FROM_GRID] = None,
    vehicle: Annotated[tuple[str, ...], _VEHICLE] = (),
    draws: Annotated[Annotated[int, Meta(ge=0, le=4096)] | None, only_with("over", "vehicles")] = None,
    json: Flag = False,
) -> None:
    """Test policies at other thrusts, under effects, on slopes, vehicles or moving platforms.

    Writes tables, and with --out figures and a page. Quick by default; --full takes minutes and reproduces
    the published results. Shares have 95 % Wilson intervals.

    Args:
        policies: landing policies.
        over: conditions to test: thrust of the vehicle, effects of the library, all slopes of a policy's
            training, named and drawn vehicles, the frozen benchmark of moving platforms.
        full: use all starts, sizes of effects, drawn vehicles and flights.
        out: new folder for index.html, the numbers as JSON, flights.csv, and the figures.
        plant: simulated physics; hybrid is MuJoCo near surfaces and the equations elsewhere. --over moving
            always uses mujoco.
        every: fly from every n-th start of the frozen sets (default: 12; with --full 1).
        vehicle: vehicle files or names of shipped vehicles; more than one only with --over vehicles.
        draws: number of vehicles to draw from the shipped ranges, 0 for none (default: 32; with --full 256).
        json: print only JSON on standard output.
    """
    over, vehicle = tuple(dict.fromkeys(over)), tuple(dict.fromkeys(vehicle))
    _check(policies, over, vehicle)
    from inclined_landing.envs.policy import load_policy
    from inclined_landing.eval.study import changes, moving, slopes, vehicles
    from inclined_landing.eval.study.engine import run
    from inclined_landing.eval.study.flights import named_policies
    from inclined_landing.eval.study.scenarios import scenarios
    from inclined_landing.eval.study.show import hand_over
    from inclined_landing.models.parameters import load_vehicle
    from inclined_landing.models.plants import check_plant

    check_plant(plant)
    every = every or (1 if full else QUICK_EVERY)
    pilots = moving.find_pilots(policies) if "moving" in over else {}
    found: list[Study] = []
    if {"thrust", "effects", "slopes"} & set(over):
        cases = changes.changes(
            THRUSTS if "thrust" in over else (),
            tuple(LIBRARY) if "effects" in over else (),
            tuple(changes.SIZES) if full else ("medium",),
        )
        known = load_vehicle(vehicle[0]) if vehicle else None
        loaded = {x: load_policy(policy, vehicle=known) for x, policy in named_policies(policies).items()}
        if {"thrust", "effects"} & set(over):
            check_one_slope(loaded)
            found.append(changes.study(loaded, cases, plant=plant, every=every))
        if "slopes" in over:
            found.append(slopes.study(loaded, plant=plant, every=every))
    if "vehicles" in over:
        count = (DRAWS if full else QUICK_DRAWS) if draws is None else draws
        named = named_policies(policies), vehicle or VEHICLES
        found.append(vehicles.study(*named, draws=count, plant=plant, every=every))
    if "moving" in over:
        found.append(moving.study(scenarios(), pilots, None if full else QUICK_FLIGHTS))
    hand_over("robustness", run(found), json=json, out=out)


def check_one_slope(policies: Mapping[str, Policy]) -> None:
    """Raise UserError for policies of different tasks or slopes, or that `success` does not evaluate."""
    first = next(iter(policies.values())).task
    for policy in policies.values():
        task = policy.task
        other = task.measures != first.measures or task.evaluated_by != "success"
        if other or task.observes_slope:
            what = f"is for {task.name}" if other else "observes the slope"
            raise UserError(
                f"policy {policy.path} {what}; --over thrust and effects needs policies of one task, and "
                "landings on one slope"
            )
        if not math.isclose(task.inclination, first.inclination):
            raise UserError(f"policy {policy.path} was trained for a different inclination than the first")


def _check(policies: tuple[str, ...], over: tuple[str, ...], vehicle: tuple[str, ...]) -> None:
    """Raise UserError for incompatible policies, conditions and vehicles, before any work."""
    if not (over and (policies or over == ("moving",))):
        raise UserError("name at least one policy, and with --over at least one set of conditions")
    if len(labels := {policy.partition("=")[0] for policy in policies}) > MOST_COMPARED:
        raise UserError(f"policies: at most {MOST_COMPARED} can be compared, not {len(labels)}")
    if vehicle and (over == ("moving",) or (len(vehicle) > 1 and over != ("vehicles",))):
        raise UserError(
            "--vehicle takes one vehicle, or several with --over vehicles; --over moving takes none"
        )
