"""The rows of the table: which flights, what was told, what the workflow answers."""

from __future__ import annotations

import dataclasses
import functools
import re
import time
import tomllib
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from inclined_landing.eval.gap import diagnose
from inclined_landing.eval.gap.answer.identify import Identification, identify
from inclined_landing.eval.gap.result import Diagnosis, NamedEffect
from inclined_landing.eval.logs import FlightLog, read_log
from inclined_landing.models.effects import LIBRARY
from inclined_landing.models.errors import UserError
from inclined_landing.models.parameters import load_vehicle
from inclined_landing.models.vehicle import Vehicle

from . import baselines

HALVES = ("development", "heldout", "fresh")
_RANGE = re.compile(r"\{(\d+)\.\.(\d+)\.\.(\d+)\}")


@dataclasses.dataclass(frozen=True)
class Row:
    """Flights of a reference and flights with a cause that is told."""

    set: str  # folder of the repository
    name: str
    kind: str  # cause, nothing, unknown, or dose: the flights are identified, and nothing is diagnosed
    half: str  # of HALVES
    reference: tuple[str, ...]  # patterns of paths
    flights: tuple[str, ...]
    vehicle: str
    mass: float | None = None  # kg, in place of the vehicle file's
    right: tuple[str, ...] = ()
    beside: tuple[str, ...] = ()
    strength: str = "medium"
    size: Mapping[str, Any] | None = None
    dose: float | None = None
    parameter: str = ""  # of a dose: the field of `Vehicle` that is identified
    above: float | None = None  # m: only rows of all flights above this height
    reference_above: float | None = None
    inconsistent: tuple[str, ...] = ()  # flights that must be found inconsistent

    @property
    def key(self) -> str:
        """Return a name for a file."""
        plain = re.sub(r"[^a-z0-9]+", "-", f"{self.set} {self.name}".lower()).strip("-")
        return f"{self.half}-{plain}"


def known_rows() -> list[Row]:
    """Return the rows of causes.toml, one for every half and dose."""
    table = tomllib.loads((Path(__file__).parent / "causes.toml").read_text("utf-8"))
    return [row for entry in table["rows"] for row in _rows_of(entry, table["sets"][entry["set"]])]


def _rows_of(entry: Mapping, common: Mapping) -> Iterator[Row]:
    given = {k: tuple(v) if isinstance(v, list) else v for k, v in (common | entry).items()}
    doses = given.pop("doses", ({},))
    halves = {half: given.pop(half) for half in HALVES if half in given}
    for half, paths in halves.items():
        for dose in doses:
            folder = dose.get("folder", "")
            flights = tuple(p.replace("{folder}", folder) for p in paths["flights"])
            more = {k: v for k, v in dose.items() if k != "folder"}
            yield Row(
                **{**given, **more, "name": given["name"].format(**dose)},
                half=half,
                reference=tuple(paths.get("reference", ())),
                flights=flights,
            )


def paths_of(folder: Path, patterns: Sequence[str]) -> list[Path]:
    """Return the files of a repository that match some patterns. Raises UserError where there are none."""
    found: list[Path] = []
    for pattern in patterns:
        for one in _expanded(pattern):
            found += sorted(folder.glob(one))
    found = [p for p in dict.fromkeys(found) if p.is_file() and p.stat().st_size]
    if not found:
        raise UserError(f"{folder}: no file like {patterns[0]}")
    return found


def _expanded(pattern: str) -> list[str]:
    """Return a pattern with {from..to..step} written out, zeros kept."""
    match = _RANGE.search(pattern)
    if not match:
        return [pattern]
    first, last, step = match.groups()
    numbers = range(int(first), int(last) + 1, int(step))
    return [_RANGE.sub(str(n).zfill(len(first)), pattern) for n in numbers]


def read(paths: Sequence[Path], above: float | None) -> tuple[list[FlightLog], list[str]]:
    """Return the flights that can be used, and why others cannot."""
    logs, refused = [], []
    for path in paths:
        try:
            log = read_log(path, name=f"{path.parent.name}/{path.name}")
            if above is not None:
                log = log.rows(log.position[:, 2] > above)
            logs.append(log)
        except UserError as error:
            refused.append(str(error))
    return logs, refused


def base_vehicle(row: Row) -> Vehicle:
    """Return the vehicle whose constants are identified."""
    vehicle = load_vehicle(row.vehicle)
    return vehicle if row.mass is None else vehicle.changed(body_mass=row.mass)


@functools.lru_cache(maxsize=2)
def _identified(
    folder: Path, patterns: tuple[str, ...], above: float | None, vehicle: Vehicle
) -> tuple[list[FlightLog], list[str], Identification]:
    """Return reference flights, why others cannot be used, and what they identify; rows of a set share it."""
    logs, refused = read(paths_of(folder, patterns), above)
    if not logs:
        raise UserError(refused[0])
    return logs, refused, identify(logs, vehicle)


def answer(data: Path, row: Row) -> dict:
    """Identify the reference, diagnose the flights; returns what table, figures and page need.

    Raises UserError where flights are missing or none can be used.
    """
    if row.kind == "dose":
        return dose_answer(data, row)
    began = time.perf_counter()
    above = row.reference_above or row.above
    reference, refused, known = _identified(data / row.set, row.reference, above, base_vehicle(row))
    flights, more = read(paths_of(data / row.set, row.flights), row.above)
    if not flights:
        raise UserError(more[0])
    d = diagnose(flights, known.vehicle, reference=known.reference)
    mean_pwm = float(np.mean([np.median(f.command[:, 0]) for f in flights]))
    gap = d.gap.get("analytic")
    return {
        "set": row.set,
        "name": row.name,
        "kind": row.kind,
        "half": row.half,
        "strength": row.strength,
        "dose": row.dose,
        "told": dict(row.size) if row.size else None,
        "right": list(row.right),
        "flights": [len(reference), len(flights)],
        "refused": refused + more,
        "verdict": d.verdict,
        "named": [_named(e) for e in d.effects],
        "possible": d.possible,
        "inconsistent": _inconsistent(d),
        "found": _found(row, d, known.vehicle, mean_pwm),
        "before": gap.before if gap else None,
        "after": gap.after if gap else None,
        "seconds": time.perf_counter() - began,
        "tuning": _tuning(row, flights, known.vehicle),
        "rough": _rough(row, reference, flights),
        **judged(row, d),
    }


def dose_answer(data: Path, row: Row) -> dict:
    """Return what is identified of one parameter, against what was told; raises UserError as `answer`."""
    flights, refused = read(paths_of(data / row.set, row.flights), row.above)
    if not flights:
        raise UserError(refused[0])
    found = identify(flights, base_vehicle(row))
    (p,) = [p for p in found.parameters if p.field == row.parameter]
    return {
        "set": row.set,
        "name": row.name,
        "kind": row.kind,
        "half": row.half,
        "dose": row.dose,
        "parameter": p.name,
        "flights": [len(found.flights)],
        "refused": refused,
        "found": {"value": p.value, "ci95": list(p.ci95)},
    }


def _tuning(row: Row, flights: Sequence[FlightLog], vehicle: Vehicle) -> dict | None:
    """Return what parameter tuning names on the same flights."""
    right, allowed = set(row.right), set(row.right) | set(row.beside)
    try:
        names = baselines.tune(flights, vehicle)
    except UserError:
        return None
    return {"right": bool(names & right), "wrong": len(names - allowed), "names": sorted(names)}


def _rough(row: Row, reference: Sequence[FlightLog], flights: Sequence[FlightLog]) -> float | None:
    """Return what a rough regression says of the told size, or of the dose of rotor M3."""
    if row.dose is not None:
        return baselines.request(reference, flights, 2)
    if row.size is None:
        return None
    return {"thrust": baselines.thrust, "wind": baselines.wind}[row.size["of"]](reference, flights)


def _inconsistent(d: Diagnosis) -> list[str]:
    return [name for one in d.inconsistent_flights for name in one.flights]


def _named(e: NamedEffect) -> dict:
    return {
        "name": e.name,
        "class": list(e.members),
        "probability": e.probability,
        "sure": e.sure,
        "cost": e.cost,
        "parameters": {
            k: {"value": p.value, "ci95": list(p.ci95), "unit": p.unit} for k, p in e.parameters.items()
        },
    }


def judged(row: Row, d: Diagnosis) -> dict:
    """Return whether the right name is there, and which sure names are wrong."""
    right, allowed = set(row.right), set(row.right) | set(row.beside)
    hits = [e for e in d.effects if set(e.members) & right]
    told, found = set(row.inconsistent), {Path(name).name for name in _inconsistent(d)}
    return {
        "right sure": any(e.sure for e in hits),
        "right possible": bool(hits) or bool(right & set(d.possible)),
        "sure names": sum(e.sure for e in d.effects),
        "wrong": [e.name for e in d.effects if e.sure and not set(e.members) & allowed],
        "flagged": d.verdict == "unknown" or bool(row.inconsistent and told <= found),
    }


def specific_thrust(vehicle: Vehicle, pwm: float) -> float:
    """Return the steady thrust over the mass [m/s2] at a command, bias and sag included."""
    # (c PWM + bias) (1 - sag (PWM/reference - 1)) / m
    sag = 1.0 - vehicle.effects_battery_sag * (pwm / vehicle.effects_battery_reference - 1.0)
    mass = vehicle.body_mass + vehicle.effects_load_mass
    return (vehicle.thrust_per_pwm * pwm + vehicle.effects_thrust_bias) * sag / mass


def _found(row: Row, d: Diagnosis, vehicle: Vehicle, pwm: float) -> dict | None:
    """Return value and interval of what was told, or of a dose, from the named effects."""
    hits = [e for e in d.effects if e.name in row.right]
    if not hits or not (row.size or row.dose is not None):
        return None
    if row.size is None or row.size["of"] == "wind":
        parameter = "x" if row.size else next(iter(hits[0].parameters))
        p, sign = hits[0].parameters[parameter], -1.0 if row.size else 1.0
        low, high = sorted(sign * x for x in p.ci95)
        return {"value": sign * p.value, "ci95": [low, high]}
    values = {name: values for e in hits for name, values in e.fitted.items()}
    before = specific_thrust(vehicle, pwm)

    def ratio(changed: Mapping[str, Mapping[str, float]]) -> float:
        corrected = vehicle
        for name, numbers in changed.items():
            corrected = LIBRARY[name].apply(corrected, numbers)
        return specific_thrust(corrected, pwm) / before

    main = hits[0]
    name, p = next(iter(main.parameters.items()))
    ends = [ratio({**values, main.name: {**values[main.name], name: x}}) for x in p.ci95]
    return {"value": ratio(values), "ci95": sorted(ends)}
