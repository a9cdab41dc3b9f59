"""`landing-eval robustness`: policies side by side under conditions that differ from what they know."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Annotated

import tyro
from msgspec import Meta

from inclined_landing.envs.policy import SHIPPED, load_policy
from inclined_landing.envs.shared import runs
from inclined_landing.eval.base.options import MOST_COMPARED, Flag, Flat, NewFolder, PlantName, Seed
from inclined_landing.eval.pictures import video
from inclined_landing.eval.policies import changes, slopes, vehicles
from inclined_landing.eval.policies.entrants import parse_entrants
from inclined_landing.eval.policies.moving import study as moving
from inclined_landing.eval.policies.moving.controllers import BASELINES, Controller, find_all
from inclined_landing.eval.policies.moving.flying import ride
from inclined_landing.eval.policies.moving.scenario import read_scenario, shipped
from inclined_landing.eval.policies.study import Study, write_studies
from inclined_landing.models import storage
from inclined_landing.models.effects import LIBRARY
from inclined_landing.models.errors import UserError, choices, shown
from inclined_landing.models.parameters import load_vehicle
from inclined_landing.models.plants import PLANTS

OVER = ("thrust", "effects", "slopes", "vehicles", "moving")
# Without --full: each 8th start, medium effects, few drawn vehicles, few flights of a scenario.
QUICK_EVERY, QUICK_DRAWS, QUICK_FLIGHTS, DRAWS = 8, 32, 4, 256
_FPS, _LOOK = 12.5, {"camera": "chase", "width": 400, "height": 226, "backend": "auto"}  # of the film

Policies = Annotated[
    tuple[str, ...],
    tyro.conf.Positional,
    tyro.conf.arg(
        metavar="[POLICY ...]",
        help=f"landing policies: files, run folders or shipped ones ({', '.join(SHIPPED)}); the others are "
        "compared with the first. With --over vehicles LABEL=A+B+C are seeds that count as one, "
        "LABEL@VEHICLE=A those of one vehicle. With --over moving policies in space, planner, or a "
        "controller of your own, module:NAME or file.py:NAME.",
        help_behavior_hint=f"(default, of moving alone: {' '.join(BASELINES)})",
    ),
    Meta(max_length=100),
]
Over = Annotated[tuple[str, ...], tyro.conf.arg(metavar="{thrust,effects,slopes,vehicles,moving} [...]")]
_EFFECTS = tyro.conf.arg(metavar="NAME [NAME ...]", help_behavior_hint="(default: all)")
_VEHICLE = tyro.conf.arg(
    metavar="VEHICLE [...]",
    help_behavior_hint=f"(default: the Crazyflie 2.1; for --over vehicles {' '.join(vehicles.NAMED)})",
)


@dataclasses.dataclass(frozen=True)
class ChangeOptions:
    """For --over thrust and effects, on the frozen grid of starts.

    Args:
        thrust: of the vehicle, times what the policies know.
        effect: of the library; with --full each in three sizes, otherwise at a plausible one.
    """

    thrust: Annotated[tuple[changes.ThrustScale, ...], tyro.conf.arg(metavar="X [X ...]")] = changes.THRUSTS
    effect: Annotated[tuple[str, ...], _EFFECTS] = tuple(LIBRARY)


@dataclasses.dataclass(frozen=True)
class DrawOptions:
    """For --over vehicles.

    Args:
        ranges: file of ranges that vehicles are drawn from, or a shipped one.
        draws: vehicles drawn from it, 0: none (default: 32; with --full 256).
        starts: how many of the frozen grid each drawn vehicle flies from.
        seed: of the drawn vehicles and their starts; choose one that no policy was trained with.
    """

    ranges: Annotated[Path | None, tyro.conf.arg(metavar="FILE")] = Path("vehicles")
    draws: Annotated[int, Meta(ge=0, le=4096)] | None = None
    starts: Annotated[int, Meta(ge=1, le=64)] = 4
    seed: Seed = 2_000_003


@dataclasses.dataclass(frozen=True)
class MovingOptions:
    """For --over moving, the frozen benchmark of moving platforms.

    Args:
        scenario: of the benchmark, or scenario files (default: all of the benchmark).
        flights: only the first ones of each scenario (default: 4; with --full all).
        film: scenario whose first flight, of the first controller, becomes flight.gif.
    """

    scenario: Annotated[tuple[str, ...], tyro.conf.arg(metavar="NAME|FILE [...]")] = ()
    flights: Annotated[int, Meta(ge=1, le=100_000)] | None = None
    film: Annotated[str | None, tyro.conf.arg(metavar="NAME|FILE")] = None


def command(
    policies: Policies = (),
    /,
    *,
    over: Over = ("thrust", "effects"),
    full: Flag = False,
    out: NewFolder = None,
    plant: PlantName = "hybrid",
    every: Annotated[int, Meta(ge=1, le=250)] | None = None,
    vehicle: Annotated[tuple[str, ...], _VEHICLE] = (),
    thrust_and_effects: Flat[ChangeOptions] = ChangeOptions(),
    drawn_vehicles: Flat[DrawOptions] = DrawOptions(),
    moving_platforms: Flat[MovingOptions] = MovingOptions(),
    json: Flag = False,
) -> None:
    """Policies under other thrusts, effects, slopes, vehicles or moving platforms: tables, figures, page.

    Quick by default; --full takes minutes and is what results are made with. Shares have 95 % Wilson
    intervals.

    Args:
        policies: landing policies.
        over: the conditions: thrust of the vehicle; effects of the library; all slopes that a policy knows;
            named and drawn vehicles; the frozen benchmark of moving platforms.
        full: all starts, sizes of effects, drawn vehicles and flights.
        out: new folder for index.html, the numbers as JSON, flights.csv, and the figures.
        plant: the physics to fly in; hybrid is MuJoCo near surfaces and the equations elsewhere. moving is
            always flown in mujoco.
        every: fly from every n-th start of the frozen sets (default: 8; with --full 1).
        vehicle: vehicle files, or shipped vehicles by name: the one that is flown, or those of --over
            vehicles.
        json: print JSON, and nothing else, on standard output; of several condition sets by their names.
    """
    over, vehicle, film = tuple(dict.fromkeys(over)), tuple(dict.fromkeys(vehicle)), moving_platforms.film
    _check(policies, over, plant, vehicle)
    _check_changes(thrust_and_effects)
    if out is not None:
        runs.check_new_run(out)
    if film is not None:
        read_scenario(film)
        if out is None or "moving" not in over:
            raise UserError("--film goes with --over moving and --out, the folder that the film is put into")
    every = every or (1 if full else QUICK_EVERY)
    controllers = find_all(policies) if "moving" in over else []
    found = _landings(policies, over, full, plant, every, vehicle, thrust_and_effects)
    if "vehicles" in over:
        draws = drawn_vehicles.draws
        options = dataclasses.asdict(drawn_vehicles)
        options["draws"] = (DRAWS if full else QUICK_DRAWS) if draws is None else draws
        entrants, named = parse_entrants(policies), vehicle or vehicles.NAMED
        found.append(vehicles.run(entrants, named, plant=plant, every=every, **options))
    if "moving" in over:
        names = moving_platforms.scenario or shipped()
        scenarios = [read_scenario(name) for name in dict.fromkeys(names)]
        flights = moving_platforms.flights or (None if full else QUICK_FLIGHTS)
        found.append(moving.run(scenarios, controllers, flights))
    if out is not None:
        with runs.staged_run(out) as folder:
            write_studies(folder, found)
            if film is not None:
                _write_film(folder, film, controllers[0])
    if json:
        reports = {study.name: study.report for study in found}
        print(storage.to_json(reports if len(found) > 1 else found[0].report))
        return
    for study in found:
        study.show()


def _check(policies: tuple[str, ...], over: tuple[str, ...], plant: str, vehicle: tuple[str, ...]) -> None:
    """Raise UserError for policies, conditions and vehicles that do not go together, before any work."""
    for name in over:
        if name not in OVER:
            raise UserError(f"--over {shown(name, 40)}: {choices(OVER, name)}; policies are named before it")
    if not (over and (policies or over == ("moving",))):
        raise UserError("name at least one policy, and with --over at least one set of conditions")
    if len(labels := {policy.partition("=")[0] for policy in policies}) > MOST_COMPARED:
        raise UserError(f"policies: at most {MOST_COMPARED} stand side by side, not {len(labels)}")
    if plant not in PLANTS:
        raise UserError(f"unknown plant {shown(plant, 40)!r}; known are {', '.join(PLANTS)}")
    if len(vehicle) > 1 and over != ("vehicles",):
        raise UserError("several --vehicle are compared by --over vehicles alone")
    if vehicle and over == ("moving",):
        raise UserError("--over moving is flown with the vehicle of the benchmark: leave --vehicle out")


def _check_changes(chosen: ChangeOptions) -> None:
    """Raise UserError for an unknown effect, or a thrust that is none."""
    for name in chosen.effect:
        if name not in LIBRARY:
            raise UserError(f"unknown effect {shown(name, 40)}; landing-eval effects lists them")


def _landings(
    policies: tuple[str, ...],
    over: tuple[str, ...],
    full: bool,
    plant: str,
    every: int,
    vehicle: tuple[str, ...],
    chosen: ChangeOptions,
) -> list[Study]:
    """Return the studies of landing policies over thrust and effects, and over slopes."""
    if not {"thrust", "effects", "slopes"} & set(over):
        return []
    known = load_vehicle(vehicle[0]) if vehicle else None
    loaded = {}
    for entrant in parse_entrants(policies):
        if entrant.vehicle is not None:
            raise UserError(f"{entrant.label}: LABEL@VEHICLE=POLICY goes with --over vehicles alone")
        loaded[entrant.label] = load_policy(entrant.only, vehicle=known)
    studies = []
    if {"thrust", "effects"} & set(over):
        cases = changes.changes(
            chosen.thrust if "thrust" in over else (),
            tuple(dict.fromkeys(chosen.effect)) if "effects" in over else (),
            tuple(changes.SIZES) if full else ("medium",),
        )
        studies.append(changes.run(loaded, cases, plant=plant, every=every))
    if "slopes" in over:
        studies.append(slopes.run(loaded, plant=plant, every=every))
    return studies


def _write_film(folder: Path, scenario: str, controller: Controller) -> None:
    """Write the first flight of a scenario as flight.gif."""
    frames, total, rate = video.film([ride(read_scenario(scenario), controller)], _FPS, 1.0, **_LOOK)
    video.write({folder / "flight.gif": 1}, frames, total, rate)
