"""Reader of a report folder of `landing-eval gap` for experiment design."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from msgspec import Meta, Struct, structs

from inclined_landing.eval.gap.model.reference import VehiclePosterior, read_reference
from inclined_landing.eval.gap.plan.information import NoiseLevels
from inclined_landing.eval.gap.result import REFERENCE, VERSION, Diagnosis, ScoredSet, marginal
from inclined_landing.models.base import schema, storage
from inclined_landing.models.base.errors import UserError, shown
from inclined_landing.models.effects import LIBRARY, Effect
from inclined_landing.models.parameters import load_vehicle
from inclined_landing.models.vehicle import Vehicle

ROOM = (
    *("arena_x", "arena_y", "arena_z", "platform_width", "platform_depth"),
    *("platform_inclination", "platform_surface_height"),
)
CHANNELS = ("x", "y", "z", "roll", "pitch", "yaw")


class _Disturbance(Struct, frozen=True):
    """An entry of `disturbance`; None: a typical level."""

    noise: Annotated[float, Meta(ge=1e-9, le=1e300)] | None = None
    size: Annotated[float, Meta(ge=0, le=1e300)] | None = None
    time: Annotated[float, Meta(ge=1e-3, le=1e300)] | None = None


class _Dependence(Struct, frozen=True):
    on: str = ""


class _Residual(Struct, frozen=True):
    depends_on: list[_Dependence] = []


class _Report(Struct, frozen=True):
    """The entries of report.json that a plan needs; all others are ignored."""

    sets: Annotated[list[ScoredSet], Meta(min_length=1)]
    unidentifiable_sets: list[ScoredSet] = []
    immaterial: list[str] = []
    platform: bool = False
    verdict: str = ""
    residual: _Residual = _Residual()
    disturbance: dict[str, _Disturbance] = {}


@dataclasses.dataclass(frozen=True)
class PlanInput:
    """The sets of a report, its vehicle, and noise and disturbance of its flights."""

    hypotheses: list[ScoredSet]  # without effects of contact or too small to matter, most probable first
    probabilities: dict[str, float]  # of every effect, marginal over the sets of the report
    vehicle: Vehicle  # the one diagnosed
    noise_levels: NoiseLevels
    platform: bool  # the slab stood in the arena
    vary: tuple[str, ...]  # regressors of an unexplained residual
    reference: VehiclePosterior  # posterior of the vehicle's identification

    @staticmethod
    def of(report: Diagnosis | _Report, vehicle: Vehicle, reference: VehiclePosterior) -> PlanInput:
        """Return the input from a diagnosis; vehicle: the one diagnosed, reference: its posterior."""
        hypotheses: dict[tuple[str, ...], ScoredSet] = {}
        for one in (*report.sets, *report.unidentifiable_sets):
            names = tuple(n for n in one.effects if not (LIBRARY[n].contact or n in report.immaterial))
            values = {n: one.values[n] for n in names}
            same = hypotheses.get(names, ScoredSet(names, 0.0, values, one.standard_errors))
            hypotheses[names] = structs.replace(same, probability=same.probability + one.probability)
        probabilities = {n: marginal(report.sets, (n,)) for one in report.sets for n in one.effects}
        for one in report.unidentifiable_sets:  # the best set and one effect more, which has its prior odds
            probabilities |= {n: one.probability for n in one.effects if n not in probabilities}
        typical = NoiseLevels.typical()
        levels = np.array([typical.noise, typical.disturbance, typical.time])
        for k, channel in enumerate(CHANNELS):
            if channel in report.disturbance:
                known = report.disturbance[channel]
                for j, level in enumerate((known.noise, known.size, known.time)):
                    levels[j, k] = levels[j, k] if level is None else level
        return PlanInput(
            hypotheses=sorted(hypotheses.values(), key=lambda h: -h.probability),
            probabilities=probabilities,
            vehicle=vehicle,
            noise_levels=NoiseLevels(*levels),
            platform=report.platform,
            vary=tuple(d.on for d in report.residual.depends_on) if report.verdict == "unknown" else (),
            reference=reference,
        )


def read_report(folder: Path, vehicle: Path | None = None) -> tuple[PlanInput, Path | None]:
    """Return the input of a plan from `report.json` and `run.json`; vehicle: file of the vehicle diagnosed.

    Without `vehicle` it is the one that gap identified and put into the folder, or else that of `run.json`.
    Also that file where its room is not that of the shipped vehicle. Raises UserError, naming file and entry,
    for what is missing or invalid.
    """
    if not folder.is_dir():
        raise UserError(
            f"{shown(folder)} is not a folder; name the report folder that landing-eval gap wrote"
        )
    path, run = folder / "report.json", folder / "run.json"
    data = schema.parse(storage.read_json(path, "report"), dict[str, Any], f"report {path}: ")
    options: dict[str, Any] = {}
    if run.is_file():
        options = schema.parse(storage.read_json(run, "record"), dict[str, Any], f"record {run}: ")
    if vehicle is None and (folder / REFERENCE).is_file():
        vehicle = folder / REFERENCE
    elif vehicle is None and isinstance(options.get("vehicle"), str):
        vehicle = Path(options["vehicle"])
    if data.get("version") != VERSION or "sets" not in data:
        raise UserError(f"report {path} was not written by this version of landing-eval gap; run gap again")
    diagnosed, shipped = load_vehicle(vehicle), load_vehicle()
    same = all(getattr(diagnosed, name) == getattr(shipped, name) for name in ROOM)
    where = f"report {path}: "
    content = schema.parse({"platform": options.get("platform", False)} | data, _Report, where)
    library = {name: effect.sized_for(diagnosed) for name, effect in LIBRARY.items()}
    _check(content.sets, library, f"{where}sets")
    _check(content.unidentifiable_sets, library, f"{where}unidentifiable_sets")
    if sum(one.probability for one in content.sets) <= 0.0:
        raise UserError(f"{where}no set has a probability above 0")
    found = PlanInput.of(content, diagnosed, read_reference(vehicle, diagnosed)[0])
    return found, None if same else vehicle


def _check(rows: Sequence[ScoredSet], library: Mapping[str, Effect], where: str) -> None:
    """Raise UserError for an unknown effect, or a value that is missing or out of bounds.

    library: its effects with the bounds that apply to the vehicle diagnosed.
    """
    for k, row in enumerate(rows):
        what = f"{where}[{k}]"
        unknown = [n for n in row.effects if n not in library]
        if unknown:
            raise UserError(f"{what} has the unknown effect {shown(repr(unknown[0]), 60)}")
        for name in (n for n in row.effects if not library[n].contact):
            if name not in row.values:
                raise UserError(f"{what}.values.{name} is missing")
            parameters = {p.name: p for p in library[name].parameters}
            for kind in ("values", "standard_errors"):
                given = getattr(row, kind).get(name, {})
                if unknown := [key for key in given if key not in parameters]:
                    at = f"{what}.{kind}.{name}"
                    raise UserError(f"{at} has the unknown parameter {shown(repr(unknown[0]), 60)}")
            for key, value in row.values[name].items():
                low, high = parameters[key].bounds
                if not low <= value <= high:
                    unit, at = parameters[key].unit, f"{what}.values.{name}.{key}"
                    raise UserError(f"{at} is {value:g} {unit}; it must be from {low:g} to {high:g}")
