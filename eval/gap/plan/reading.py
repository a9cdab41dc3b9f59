"""Reader of a report folder of `landing-eval gap` for experiment design."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from msgspec import Meta, Struct, structs

from inclined_landing.eval.gap.model.prediction import POSE_CHANNELS
from inclined_landing.eval.gap.model.reference import VehiclePosterior, read_reference
from inclined_landing.eval.gap.plan.information import NoiseLevels
from inclined_landing.eval.gap.result import REFERENCE, VERSION, Diagnosis, ScoredSet, marginal
from inclined_landing.models.base import schema, storage
from inclined_landing.models.base.errors import UserError, shown
from inclined_landing.models.effects import LIBRARY
from inclined_landing.models.parameters import load_vehicle
from inclined_landing.models.vehicle import Vehicle

ROOM = (  # fields of a vehicle file that say where it flies
    "arena_x arena_y arena_z platform_width platform_depth platform_inclination platform_surface_height"
).split()
Positive = Annotated[float, Meta(ge=1e-9, le=1e300)]


class _Level(Struct, frozen=True):
    noise: Positive
    size: Annotated[float, Meta(ge=0, le=1e300)]
    time: Positive


class _Report(Struct, frozen=True):
    """The entries of report.json that a plan needs; all others are ignored."""

    sets: Annotated[list[ScoredSet], Meta(min_length=1)]
    immaterial: list[str] = []
    platform: bool = False
    disturbance: dict[str, _Level] = {}


@dataclasses.dataclass(frozen=True)
class PlanInput:
    """The sets of a report, its vehicle, and noise and disturbance of its flights."""

    hypotheses: list[ScoredSet]  # without effects of contact or too small to matter, most probable first
    probabilities: dict[str, float]  # of every effect, marginal over the sets of the report
    vehicle: Vehicle  # the one diagnosed
    noise_levels: NoiseLevels
    platform: bool  # the slab stood in the arena
    reference: VehiclePosterior  # posterior of the vehicle's identification

    @staticmethod
    def of(report: Diagnosis | _Report, vehicle: Vehicle, reference: VehiclePosterior) -> PlanInput:
        """Return the input from a diagnosis; vehicle: the one diagnosed, reference: its posterior."""
        hypotheses: dict[tuple[str, ...], ScoredSet] = {}
        for one in report.sets:
            names = tuple(n for n in one.effects if not (LIBRARY[n].contact or n in report.immaterial))
            values = {n: one.values[n] for n in names}
            same = hypotheses.get(names, ScoredSet(names, 0.0, values, one.standard_errors))
            hypotheses[names] = structs.replace(same, probability=same.probability + one.probability)
        probabilities = {n: marginal(report.sets, (n,)) for one in report.sets for n in one.effects}
        typical = NoiseLevels.typical()
        levels = np.array([typical.noise, typical.disturbance, typical.time])
        for k, channel in enumerate(POSE_CHANNELS):
            if known := report.disturbance.get(channel):
                levels[:, k] = known.noise, known.size, known.time
        return PlanInput(
            hypotheses=sorted(hypotheses.values(), key=lambda h: -h.probability),
            probabilities=probabilities,
            vehicle=vehicle,
            noise_levels=NoiseLevels(*levels),
            platform=report.platform,
            reference=reference,
        )


def read_report(folder: Path) -> tuple[PlanInput, Path | None]:
    """Return the input of a plan from a report's folder, and the vehicle file if its room is another.

    Raises UserError, naming file and entry, for what is missing or invalid.
    """
    if not folder.is_dir():
        raise UserError(
            f"{shown(folder)} is not a folder; name the report folder that landing-eval gap wrote"
        )
    path = folder / "report.json"
    where = f"report {path}: "
    data = schema.parse(storage.read_json(path, "report"), dict[str, Any], where)
    if data.get("version") != VERSION or "sets" not in data:
        raise UserError(f"report {path} was not written by this version of landing-eval gap; run gap again")
    vehicle = folder / REFERENCE if (folder / REFERENCE).is_file() else None
    diagnosed, shipped = load_vehicle(vehicle), load_vehicle()
    usual = all(getattr(diagnosed, name) == getattr(shipped, name) for name in ROOM)
    content = schema.parse(data, _Report, where)
    _check(content.sets, diagnosed, f"{where}sets")
    if sum(one.probability for one in content.sets) <= 0.0:
        raise UserError(f"{where}no set has a probability above 0")
    found = PlanInput.of(content, diagnosed, read_reference(vehicle, diagnosed)[0])
    return found, None if usual else vehicle


def _check(rows: Sequence[ScoredSet], vehicle: Vehicle, where: str) -> None:
    """Raise UserError for an effect or parameter that is unknown or missing, or a value out of bounds."""
    library = {name: effect.sized_for(vehicle) for name, effect in LIBRARY.items()}
    for k, row in enumerate(rows):
        for name in row.effects:
            if name not in library:
                raise UserError(f"{where}[{k}] has the unknown effect {shown(repr(name), 60)}")
            if library[name].contact:
                continue
            if name not in row.values:
                raise UserError(f"{where}[{k}].values.{name} is missing")
            bounds = {p.name: p.bounds for p in library[name].parameters}
            for key, value in row.values[name].items():
                low, high = bounds.get(key, (0.0, -1.0))
                if not low <= value <= high:
                    at = f"{where}[{k}].values.{name}.{shown(key, 60)}"
                    must = f"must be from {low:g} to {high:g}" if key in bounds else "is unknown"
                    raise UserError(f"{at} is {value:g}; it {must}")
