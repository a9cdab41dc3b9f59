"""`landing-eval robustness`: policies side by side under conditions that differ from what they know."""

from __future__ import annotations

import dataclasses
import shlex
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any

import tyro
from matplotlib.figure import Figure
from msgspec import Meta

from inclined_landing.envs.policy import SHIPPED, load_policy
from inclined_landing.envs.shared import runs
from inclined_landing.eval.base.claims import Section, show_sections
from inclined_landing.eval.base.options import MOST_COMPARED, Flag, Flat, NewFolder, PlantName, Seed
from inclined_landing.eval.base.page import embedded, png, render
from inclined_landing.eval.base.style import save_figure
from inclined_landing.eval.moving import report as moving
from inclined_landing.eval.moving.controllers import BASELINES, Controller, vehicle_flown
from inclined_landing.eval.moving.controllers import find as find_controller
from inclined_landing.eval.moving.flying import ride
from inclined_landing.eval.moving.scenario import read_scenario, shipped
from inclined_landing.eval.pictures import video
from inclined_landing.eval.robustness import changes, slopes, vehicles, words
from inclined_landing.eval.robustness.entries import Entry, parse_entries
from inclined_landing.eval.robustness.figures import (
    matrix_figure,
    slopes_figure,
    thrust_figure,
    vehicles_figure,
)
from inclined_landing.models import storage
from inclined_landing.models.effects import LIBRARY
from inclined_landing.models.errors import UserError, choices, shown
from inclined_landing.models.parameters import load_vehicle
from inclined_landing.models.plants import PLANTS

OVER = ("thrust", "effects", "slopes", "vehicles", "moving")
NAMED = ("crazyflie-2.0", "crazyflie-2.1", "crazyflie-2.1-brushless", "hummingbird")
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
    help_behavior_hint=f"(default: the Crazyflie 2.1; for --over vehicles {' '.join(NAMED)})",
)


@dataclasses.dataclass(frozen=True)
class Changes:
    """For --over thrust and effects, on the frozen grid of starts.

    Args:
        thrust: of the vehicle, times what the policies know.
        effect: of the library, each in three sizes.
    """

    thrust: Annotated[tuple[float, ...], tyro.conf.arg(metavar="X [X ...]")] = changes.THRUSTS
    effect: Annotated[tuple[str, ...], _EFFECTS] = tuple(LIBRARY)


@dataclasses.dataclass(frozen=True)
class Draws:
    """For --over vehicles.

    Args:
        ranges: file of ranges that vehicles are drawn from, or a shipped one.
        draws: vehicles drawn from it (0: none).
        starts: how many of the frozen grid each drawn vehicle flies from; a named one flies from all.
        seed: of the drawn vehicles and their starts; choose one that no policy was trained with.
    """

    ranges: Annotated[Path | None, tyro.conf.arg(metavar="FILE")] = Path("vehicles")
    draws: Annotated[int, Meta(ge=0, le=4096)] = 256
    starts: Annotated[int, Meta(ge=1, le=64)] = 4
    seed: Seed = 2_000_003


@dataclasses.dataclass(frozen=True)
class Moving:
    """For --over moving, the frozen benchmark of moving platforms.

    Args:
        scenario: of the benchmark, or scenario files (default: all of the benchmark).
        flights: only the first ones of each scenario, to try something.
        film: scenario whose first flight, of the first controller, becomes flight.gif.
    """

    scenario: Annotated[tuple[str, ...], tyro.conf.arg(metavar="NAME|FILE [...]")] = ()
    flights: Annotated[int, Meta(ge=1, le=100_000)] | None = None
    film: Annotated[str | None, tyro.conf.arg(metavar="NAME|FILE")] = None


# Figures of each report by file name, and what makes sections of the page from it.
_FIGURES: dict[str, dict[str, Callable[[dict[str, Any]], Figure]]] = {
    "robustness": {"robustness_thrust": thrust_figure, "robustness_matrix": matrix_figure},
    "slopes": {"slopes": slopes_figure},
    "vehicles": {"vehicles": vehicles_figure},
    "moving": {"moving": moving.figure},
}
_SECTIONS: dict[str, Callable[[dict[str, Any]], list[Section]]] = {
    "robustness": words.sections,
    "slopes": slopes.sections,
    "vehicles": vehicles.sections,
    "moving": moving.sections,
}


def command(
    policies: Policies = (),
    /,
    *,
    over: Over = ("thrust", "effects"),
    out: NewFolder = None,
    plant: PlantName = "hybrid",
    every: Annotated[int, Meta(ge=1, le=250)] = 1,
    vehicle: Annotated[tuple[str, ...], _VEHICLE] = (),
    thrust_and_effects: Flat[Changes] = Changes(),
    drawn_vehicles: Flat[Draws] = Draws(),
    moving_platforms: Flat[Moving] = Moving(),
    json: Flag = False,
) -> None:
    """Policies under other thrusts, effects, slopes, vehicles or moving platforms: tables, figures, page.

    Takes minutes. Shares have 95 % Wilson intervals.

    Args:
        policies: landing policies.
        over: the conditions: thrust of the vehicle; effects of the library; all slopes that a policy knows;
            named and drawn vehicles; the frozen benchmark of moving platforms.
        out: new folder for index.html, the numbers as JSON and CSV, and the figures.
        plant: the physics to fly in; hybrid is MuJoCo near surfaces and the equations elsewhere. moving is
            always flown in mujoco.
        every: fly from every n-th start only; for thrust, effects and slopes.
        vehicle: vehicle files, or shipped vehicles by name: the one that is flown, or those of --over
            vehicles, each flown from the whole frozen grid.
        json: print JSON, and nothing else, on standard output; of several condition sets by their names.
    """
    over, vehicle = tuple(dict.fromkeys(over)), tuple(dict.fromkeys(vehicle))
    _check(policies, over, plant, vehicle)
    _check_options(over, thrust_and_effects, drawn_vehicles, moving_platforms, out)
    if out is not None:
        runs.check_new_run(out)
    controllers = _controllers(policies) if "moving" in over else []
    entries = parse_entries(policies) if over != ("moving",) else []
    reports: dict[str, dict[str, Any]] = {}
    texts: dict[str, str] = {}  # by file name
    if {"thrust", "effects", "slopes"} & set(over):
        known = load_vehicle(vehicle[0]) if vehicle else None
        loaded = {entry.label: load_policy(_only(entry), vehicle=known) for entry in entries}
        if {"thrust", "effects"} & set(over):
            chosen = thrust_and_effects
            report = reports["robustness"] = changes.evaluate(
                loaded,
                plant=plant,
                every=every,
                thrusts=chosen.thrust if "thrust" in over else (),
                effects=tuple(dict.fromkeys(chosen.effect)) if "effects" in over else (),
            )
            texts = {"results.md": words.markdown(report), "conditions.csv": words.conditions_csv(report)}
        if "slopes" in over:
            reports["slopes"] = slopes.evaluate(loaded, plant=plant, every=every)
    if "vehicles" in over:
        drawn = dataclasses.asdict(drawn_vehicles)
        reports["vehicles"] = vehicles.evaluate(entries, vehicle or NAMED, plant=plant, **drawn)
    if "moving" in over:
        names = moving_platforms.scenario or shipped()
        scenarios = [read_scenario(name) for name in dict.fromkeys(names)]
        reports["moving"], flown = moving.evaluate(scenarios, controllers, moving_platforms.flights)
        texts["flights.csv"] = flown.to_csv(index=False, float_format="%.6g")
    if out is not None:
        with runs.staged_run(out) as folder:
            _write(folder, reports, texts)
            if moving_platforms.film is not None:
                film = [ride(read_scenario(moving_platforms.film), controllers[0])]
                frames, total, rate = video.film(film, _FPS, 1.0, **_LOOK)
                video.write({folder / "flight.gif": 1}, frames, total, rate)
    if json:
        print(storage.to_json(reports if len(reports) > 1 else next(iter(reports.values()))))
        return
    for name, report in reports.items():
        if name == "robustness":
            words.show(report)
        else:
            show_sections(_SECTIONS[name](report))


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


def _check_options(
    over: tuple[str, ...], changed: Changes, drawn: Draws, platforms: Moving, out: Path | None
) -> None:
    """Raise UserError for options of condition sets that are wrong, or whose set is not flown."""
    of_sets = {("thrust", "effects"): changed, ("vehicles",): drawn, ("moving",): platforms}
    for sets, given in of_sets.items():
        names = [key for key, value in vars(given).items() if value != getattr(type(given), key)]
        if names and not set(sets) & set(over):
            raise UserError(f"--{names[0]} is an option of --over {' and '.join(sets)}")
    if not (changed.thrust and changed.effect):
        raise UserError("name at least one --thrust and one --effect")
    for name in changed.effect:
        if name not in LIBRARY:
            raise UserError(f"unknown effect {shown(name, 40)}; landing-eval effects lists them")
    for scale in changed.thrust:
        if not 0 < scale <= 3:
            raise UserError(f"--thrust must be above 0 and at most 3, not {scale:g}")
    if platforms.film is not None:
        if out is None:
            raise UserError("--film needs --out, the folder that the film is put into")
        read_scenario(platforms.film)


def _only(entry: Entry) -> str:
    """Return the policy of an entry; raises UserError where it has several, or one vehicle."""
    if len(entry.policies) > 1 or entry.vehicle is not None:
        raise UserError(f"{entry.label}: LABEL=A+B and LABEL@VEHICLE=A go with --over vehicles alone")
    return entry.policies[0]


def _controllers(names: tuple[str, ...]) -> list[Controller]:
    """Return the controllers by their names; raises UserError where two are called the same."""
    vehicle = vehicle_flown()
    found = [find_controller(name, vehicle) for name in dict.fromkeys(names or BASELINES)]
    called = [controller.name for controller in found]
    if twice := [name for name in called if called.count(name) > 1]:
        raise UserError(f"two controllers are called {twice[0]}; rename one")
    return found


def _write(folder: Path, reports: dict[str, dict[str, Any]], texts: dict[str, str]) -> None:
    """Write numbers, texts, figures and one page of all reports into a folder."""
    sections, images = [], {}
    for name, text in texts.items():
        storage.write_text(folder / name, text)
    for name, report in reports.items():
        storage.write_json(folder / f"{name}.json", report)
        of_page = _SECTIONS[name](report)
        shown_there = {figure for section in of_page for figure in section.figures}
        sections += of_page
        for figure in sorted(shown_there):
            drawn = _FIGURES[name][figure](report)
            save_figure(drawn, folder / f"{figure}.png")
            save_figure(drawn, folder / f"{figure}.pdf")
            images[figure] = embedded(png(drawn))
    page = render(
        __package__,
        "robustness.html.j2",
        title="Robustness of landing policies",
        sentences=words.sentences(reports["robustness"]) if "robustness" in reports else [],
        sections=sections,
        images=images,
        run=shlex.join(["landing-eval", *sys.argv[1:]]),
        versions=next(iter(reports.values()))["versions"],
    )
    storage.write_text(folder / "index.html", page)
