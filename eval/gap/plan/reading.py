"""Reader of a report folder of `landing-eval gap` for experiment design."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from msgspec import Meta, Struct, field

from inclined_landing.eval.gap.model.reference import VehiclePosterior, read_reference
from inclined_landing.eval.gap.plan.information import NoiseLevels
from inclined_landing.eval.gap.result import VERSION, ScoredSet
from inclined_landing.models import schema, storage
from inclined_landing.models.effects import LIBRARY
from inclined_landing.models.errors import UserError, shown
from inclined_landing.models.parameters import load_vehicle
from inclined_landing.models.schema import Real, Table
from inclined_landing.models.vehicle import Vehicle

ROOM = (
    *("arena_x", "arena_y", "arena_z", "platform_width", "platform_depth"),
    *("platform_inclination", "platform_surface_height"),
)
CHANNELS = ("x", "y", "z", "roll", "pitch", "yaw")


class _Set(Table, frozen=True):
    """An entry of `sets` or `unidentifiable_sets`."""

    effects: list[str]
    probability: Annotated[float, Meta(ge=0, le=1)]
    values: dict[str, dict[str, Real]] = field(default_factory=dict)
    standard_errors: dict[str, dict[str, Real]] = field(default_factory=dict)


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

    sets: Annotated[list[_Set], Meta(min_length=1)]
    unidentifiable_sets: list[_Set] = []
    platform: bool = False
    verdict: str = ""
    residual: _Residual = _Residual()
    disturbance: dict[str, _Disturbance] = {}


@dataclasses.dataclass(frozen=True)
class PlanInput:
    """The sets of a report, its vehicle, and noise and disturbance of its flights."""

    hypotheses: list[ScoredSet]  # without effects of contact, most probable first
    vehicle: Vehicle  # the one diagnosed
    noise_levels: NoiseLevels
    platform: bool  # the slab stood in the arena
    vary: tuple[str, ...]  # regressors of an unexplained residual
    reference: VehiclePosterior  # posterior of its identification
    arena: Path | None  # the vehicle's file, where its room is not that of the shipped one


def read_report(folder: Path, vehicle: Path | None = None) -> PlanInput:
    """Return the input of a plan from `report.json` and `run.json`; vehicle: file of the vehicle diagnosed.

    Raises UserError, naming file and entry, for what is missing or invalid.
    """
    if not folder.is_dir():
        raise UserError(f"{shown(folder)} is no folder; name the report folder that landing-eval gap wrote")
    path, run = folder / "report.json", folder / "run.json"
    data = schema.parse(storage.read_json(path, "report"), dict[str, Any], f"report {path}: ")
    options: dict[str, Any] = {}
    if run.is_file():
        options = schema.parse(storage.read_json(run, "record"), dict[str, Any], f"record {run}: ")
    if vehicle is None and isinstance(options.get("vehicle"), str):
        vehicle = Path(options["vehicle"])
    if data.get("version") != VERSION or "sets" not in data:
        raise UserError(f"report {path} is not from landing-eval gap of this version; run it again")
    platform = {"platform": options.get("platform", False)}
    report = schema.parse(platform | data, _Report, f"report {path}: ")
    diagnosed, shipped = load_vehicle(vehicle), load_vehicle()
    same = all(getattr(diagnosed, name) == getattr(shipped, name) for name in ROOM)
    return PlanInput(
        _hypotheses(report, f"report {path}: "),
        diagnosed,
        _noise_levels(report),
        report.platform,
        tuple(d.on for d in report.residual.depends_on) if report.verdict == "unknown" else (),
        read_reference(vehicle, diagnosed)[0],
        None if same else vehicle,
    )


def _hypotheses(report: _Report, where: str) -> list[ScoredSet]:
    """Return the sets of a report, the unidentifiable ones included, without effects of contact."""
    found: dict[tuple[str, ...], ScoredSet] = {}
    rows = [(f"{where}sets[{k}]", row) for k, row in enumerate(report.sets)]
    for what, row in [
        *rows,
        *((f"{where}unidentifiable_sets[{k}]", row) for k, row in enumerate(report.unidentifiable_sets)),
    ]:
        unknown = [n for n in row.effects if n not in LIBRARY]
        if unknown:
            raise UserError(f"{what} has the unknown effect {shown(repr(unknown[0]), 60)}")
        names = tuple(n for n in row.effects if not LIBRARY[n].contact)
        for name in names:
            if name not in row.values:
                raise UserError(f"{what}.values.{name} is missing")
            _check_parameters(f"{what}.values.{name}", name, row.values[name])
            _check_parameters(
                f"{what}.standard_errors.{name}", name, row.standard_errors.get(name, {}), bounds=False
            )
        probability = row.probability + (found[names].probability if names in found else 0.0)
        errors = {n: row.standard_errors.get(n, {}) for n in names}
        first = found.get(names, ScoredSet(names, 0.0, {n: row.values[n] for n in names}, errors))
        found[names] = dataclasses.replace(first, probability=probability)
    if sum(h.probability for h in found.values()) <= 0.0:
        raise UserError(f"{where}no set has a probability above 0")
    return sorted(found.values(), key=lambda h: -h.probability)


def _check_parameters(where: str, name: str, given: Mapping[str, float], bounds: bool = True) -> None:
    """Raise UserError for an unknown parameter of an effect, or a value out of bounds."""
    parameters = {p.name: p for p in LIBRARY[name].parameters}
    for key, value in given.items():
        if key not in parameters:
            raise UserError(f"{where} has the unknown parameter {shown(repr(key), 60)}")
        low, high = parameters[key].bounds
        if bounds and not low <= value <= high:
            unit = parameters[key].unit
            raise UserError(f"{where}.{key} is {value:g} {unit}; it must be from {low:g} to {high:g}")


def _noise_levels(report: _Report) -> NoiseLevels:
    """Return noise and disturbance of the flights by channel; typical levels where the report has none."""
    typical = NoiseLevels.typical()
    found = np.array([typical.noise, typical.disturbance, typical.time])
    for k, channel in enumerate(CHANNELS):
        one = report.disturbance.get(channel, _Disturbance())
        for j, level in enumerate((one.noise, one.size, one.time)):
            found[j, k] = found[j, k] if level is None else level
    return dataclasses.replace(typical, noise=found[0], disturbance=found[1], time=found[2])
