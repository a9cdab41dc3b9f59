"""What a plan needs of a report folder of `landing-eval gap`."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from numbers import Real
from pathlib import Path
from typing import Any

import numpy as np

from inclined_landing.eval.gap.plan.information import Hypothesis, Quiet
from inclined_landing.models import storage
from inclined_landing.models.effects import LIBRARY
from inclined_landing.models.errors import UserError, shown
from inclined_landing.models.parameters import Vehicle, load_vehicle

CHANNELS = ("x", "y", "z", "roll", "pitch", "yaw")


@dataclasses.dataclass(frozen=True)
class Doubt:
    """What a report holds for possible, and the flights it comes from."""

    hypotheses: list[Hypothesis]  # of effects that show in flight, most probable first
    vehicle: Vehicle  # the one diagnosed
    quiet: Quiet
    platform: bool  # the slab stood in the arena


def read_report(folder: Path, vehicle: Path | None = None) -> Doubt:
    """Read `report.json` and what `run.json` says of the flights; vehicle: file of the vehicle diagnosed.

    Raises UserError, naming file and entry, for what is missing or not what it should be.
    """
    if not folder.is_dir():
        raise UserError(f"{shown(folder)} is no folder; name the report folder that landing-eval gap wrote")
    path = folder / "report.json"
    report = _table(storage.read_json(path, "report"), f"report {path}")
    if "sets" not in report:
        raise UserError(f"report {path} has no sets of effects; it is none of landing-eval gap")
    run = folder / "run.json"
    options = _table(storage.read_json(run, "record"), f"record {run}") if run.is_file() else {}
    if vehicle is None and isinstance(options.get("vehicle"), str):
        vehicle = Path(options["vehicle"])
    platform = report.get("platform", options.get("platform", False))
    if not isinstance(platform, bool):
        raise UserError(f"report {path}: platform must be true or false, not {shown(repr(platform), 40)}")
    return Doubt(_hypotheses(report["sets"], path), load_vehicle(vehicle), _quiet(report, path), platform)


def _hypotheses(sets: Any, path: Path) -> list[Hypothesis]:
    """The sets of a report, what shows in touchdowns only taken out of them."""
    if not isinstance(sets, list) or not sets:
        raise UserError(f"report {path}: sets must be a list of at least one set of effects")
    found: dict[tuple[str, ...], Hypothesis] = {}
    for k, row in enumerate(sets):
        what = f"report {path}: sets[{k}]"
        row = _table(row, what)
        names = row.get("effects")
        if not isinstance(names, list) or not all(isinstance(n, str) for n in names):
            raise UserError(f"{what}.effects must be a list of names of effects")
        unknown = [n for n in names if n not in LIBRARY]
        if unknown:
            raise UserError(f"{what} has the unknown effect {shown(repr(unknown[0]), 60)}")
        flown = tuple(n for n in names if not LIBRARY[n].contact)
        probability = _number(row.get("probability"), f"{what}.probability")
        if not 0.0 <= probability <= 1.0:
            raise UserError(f"{what}.probability is {probability:g}; it must be from 0 to 1")
        values = {n: _values(row, "values", n, what, needed=True) for n in flown}
        deviations = {n: _values(row, "deviations", n, what, needed=False) for n in flown}
        if flown in found:
            found[flown] = dataclasses.replace(
                found[flown], probability=found[flown].probability + probability
            )
        else:
            found[flown] = Hypothesis(flown, probability, values, deviations)
    if sum(h.probability for h in found.values()) <= 0.0:
        raise UserError(f"report {path}: no set has a probability above 0")
    return sorted(found.values(), key=lambda h: -h.probability)


def _values(row: Mapping, key: str, name: str, what: str, *, needed: bool) -> dict[str, float]:
    """Numbers of the parameters of an effect in a set."""
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


def _quiet(report: Mapping, path: Path) -> Quiet:
    """Noise of the flights; the usual one where the report has none."""
    usual = Quiet.usual()
    noise = _table(report.get("noise", {}), f"report {path}: noise")
    own = np.array(
        [_number(noise.get(c, x), f"report {path}: noise.{c}") for c, x in zip(CHANNELS, usual.noise)]
    )
    if (own <= 0.0).any():
        worst = CHANNELS[int(np.argmin(own))]
        raise UserError(f"report {path}: noise.{worst} is {own.min():g}; it must be above 0")
    return Quiet(own)


def _table(value: Any, what: str) -> dict:
    if not isinstance(value, dict):
        raise UserError(f"{what} must be a table of names and values, not {shown(repr(value), 40)}")
    return value


def _number(value: Any, what: str) -> float:
    if isinstance(value, bool) or not isinstance(value, Real) or not math.isfinite(value):
        raise UserError(f"{what} must be a finite number, not {shown(repr(value), 40)}")
    return float(value)
