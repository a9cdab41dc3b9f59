"""Reader of a report folder of `landing-eval gap` for experiment design."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from numbers import Real
from pathlib import Path
from typing import Any

import numpy as np

from inclined_landing.eval.gap.plan.information import NoiseLevels, ScoredSet
from inclined_landing.models import storage
from inclined_landing.models.effects import LIBRARY
from inclined_landing.models.errors import UserError, shown
from inclined_landing.models.parameters import Vehicle, load_vehicle

CHANNELS = ("x", "y", "z", "roll", "pitch", "yaw")


@dataclasses.dataclass(frozen=True)
class PlanInput:
    """The sets of a report, its vehicle, and noise and disturbance of its flights."""

    hypotheses: list[ScoredSet]  # of effects that show in flight, most probable first
    vehicle: Vehicle  # the one diagnosed
    noise_levels: NoiseLevels
    platform: bool  # the slab stood in the arena
    vary: tuple[str, ...]  # regressors of an unexplained residual


def read_report(folder: Path, vehicle: Path | None = None) -> PlanInput:
    """Read `report.json` and what `run.json` says of the flights; vehicle: file of the vehicle diagnosed.

    Raises UserError, naming file and entry, for what is missing or not what it should be.
    """
    if not folder.is_dir():
        raise UserError(f"{shown(folder)} is no folder; name the report folder that landing-eval gap wrote")
    path = folder / "report.json"
    report = _table(storage.read_json(path, "report"), f"report {path}")
    run = folder / "run.json"
    options = _table(storage.read_json(run, "record"), f"record {run}") if run.is_file() else {}
    if vehicle is None and isinstance(options.get("vehicle"), str):
        vehicle = Path(options["vehicle"])
    known = {"platform": options.get("platform", False)} | report
    return plan_input(known, load_vehicle(vehicle), f"report {path}")


def plan_input(report: Mapping, vehicle: Vehicle, name: str = "report") -> PlanInput:
    """Return the input of a plan from the contents of `report.json`; vehicle: the one diagnosed.

    Raises UserError that begins with `name`.
    """
    if "sets" not in report:
        raise UserError(f"{name} has no sets of effects; it is none of landing-eval gap")
    platform = report.get("platform", False)
    if not isinstance(platform, bool):
        raise UserError(f"{name}: platform must be true or false, not {shown(repr(platform), 40)}")
    sets, noise_levels = _read_hypotheses(report, name), _read_noise_levels(report, name)
    return PlanInput(sets, vehicle, noise_levels, platform, _read_dependences(report, name))


def _read_hypotheses(report: Mapping, name: str) -> list[ScoredSet]:
    """Return the sets of a report, the unidentifiable ones included, without effects of contact."""
    found: dict[tuple[str, ...], ScoredSet] = {}
    for what, row in [*_rows(report, "sets", name), *_rows(report, "unseen", name)]:
        names = row.get("effects")
        if not isinstance(names, (list, tuple)) or not all(isinstance(n, str) for n in names):
            raise UserError(f"{what}.effects must be a list of names of effects")
        unknown = [n for n in names if n not in LIBRARY]
        if unknown:
            raise UserError(f"{what} has the unknown effect {shown(repr(unknown[0]), 60)}")
        free_flight = tuple(n for n in names if not LIBRARY[n].contact)
        probability = _number(row.get("probability"), f"{what}.probability")
        if not 0.0 <= probability <= 1.0:
            raise UserError(f"{what}.probability is {probability:g}; it must be from 0 to 1")
        values = {n: _values(row, "values", n, what, needed=True) for n in free_flight}
        standard_errors = {n: _values(row, "deviations", n, what, needed=False) for n in free_flight}
        if free_flight in found:
            probability += found[free_flight].probability
            found[free_flight] = dataclasses.replace(found[free_flight], probability=probability)
        else:
            found[free_flight] = ScoredSet(free_flight, probability, values, standard_errors)
    if sum(h.probability for h in found.values()) <= 0.0:
        raise UserError(f"{name}: no set has a probability above 0")
    return sorted(found.values(), key=lambda h: -h.probability)


def _rows(report: Mapping, key: str, name: str) -> list[tuple[str, dict]]:
    """Return the tables of a list in a report, each with its name in error messages."""
    rows = report.get(key, ())
    if not isinstance(rows, (list, tuple)) or (key == "sets" and not rows):
        raise UserError(f"{name}: {key} must be a list of sets of effects")
    return [(f"{name}: {key}[{k}]", _table(row, f"{name}: {key}[{k}]")) for k, row in enumerate(rows)]


def _values(row: Mapping, key: str, name: str, what: str, *, needed: bool) -> dict[str, float]:
    """Return the numbers of the parameters of an effect in a set."""
    where = f"{what}.{key}.{name}"
    table = _table(row.get(key, {}), f"{what}.{key}")
    if name not in table and needed:
        raise UserError(f"{where} is missing")
    given = _table(table.get(name, {}), where)
    result = {}
    for p in LIBRARY[name].parameters:
        if p.name in given:
            result[p.name] = _number(given[p.name], f"{where}.{p.name}")
    unknown = set(given) - set(result)
    if unknown:
        raise UserError(f"{where} has the unknown parameter {shown(repr(min(unknown)), 60)}")
    if key == "values":
        for p in LIBRARY[name].parameters:
            low, high = p.bounds
            if not low <= result.get(p.name, p.neutral) <= high:
                raise UserError(
                    f"{where}.{p.name} is {result[p.name]:g} {p.unit}; it must be from {low:g} to {high:g}"
                )
    return result


def _read_dependences(report: Mapping, name: str) -> tuple[str, ...]:
    """Return the regressors that the residual of an `unknown` verdict depends on."""
    if report.get("verdict") != "unknown":
        return ()
    residual = _table(report.get("remainder", {}), f"{name}: remainder")
    rows = residual.get("depends_on", ())
    if not isinstance(rows, (list, tuple)):
        raise UserError(f"{name}: remainder.depends_on must be a list")
    found = []
    for k, row in enumerate(rows):
        on = _table(row, f"{name}: remainder.depends_on[{k}]").get("on")
        if not isinstance(on, str):
            raise UserError(f"{name}: remainder.depends_on[{k}].on must be a name of a quantity")
        found.append(on)
    return tuple(found)


def _read_noise_levels(report: Mapping, name: str) -> NoiseLevels:
    """Return noise and disturbance of the flights by channel; typical levels where the report has none."""
    usual = NoiseLevels.typical()
    noise = _table(report.get("noise", {}), f"{name}: noise")
    levels = _table(report.get("disturbance", report.get("unrest", {})), f"{name}: disturbance")
    found = np.array([usual.noise, usual.disturbance, usual.time])
    for k, channel in enumerate(CHANNELS):
        disturbance = _table(levels.get(channel, {}), f"{name}: disturbance.{channel}")
        for j, (given, key, where, least) in enumerate(
            (
                (noise, channel, f"noise.{channel}", 1e-9),
                (disturbance, "size", f"disturbance.{channel}.size", 0.0),
                (disturbance, "time", f"disturbance.{channel}.time", 1e-3),
            )
        ):
            found[j, k] = _number(given.get(key, found[j, k]), f"{name}: {where}")
            if found[j, k] < least:
                raise UserError(f"{name}: {where} is {found[j, k]:g}; it must be at least {least:g}")
    return dataclasses.replace(usual, noise=found[0], disturbance=found[1], time=found[2])


def _table(value: Any, what: str) -> dict:
    if not isinstance(value, dict):
        raise UserError(f"{what} must be a table of names and values, not {shown(repr(value), 40)}")
    return value


def _number(value: Any, what: str) -> float:
    if isinstance(value, bool) or not isinstance(value, Real) or not math.isfinite(value):
        raise UserError(f"{what} must be a finite number, not {shown(repr(value), 40)}")
    return float(value)
