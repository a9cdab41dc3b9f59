"""The model files of a report's folder: vehicle file, posterior and MJCF."""

from __future__ import annotations

import dataclasses
import json
import math
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from inclined_landing.eval.gap.answer.identification import Identification, Identified
from inclined_landing.eval.gap.infer.fit import field_half_widths
from inclined_landing.eval.gap.model.reference import VehiclePosterior, posterior_path
from inclined_landing.eval.gap.report.words import interval
from inclined_landing.eval.gap.result import Diagnosis, Disturbance, NamedEffect
from inclined_landing.models import effects
from inclined_landing.models.base import storage
from inclined_landing.models.parameters import load_vehicle, locate_vehicle, write_vehicle
from inclined_landing.models.vehicle import Vehicle

VEHICLE, MJCF = "vehicle.toml", "landing.xml"
Uncertainty = float | tuple[float, ...] | str  # half-width of a 95 % interval, of each number, or "not known"


def write_corrected(d: Diagnosis, vehicle: Vehicle, folder: Path, *, base: Path | None = None) -> None:
    """Write vehicle.toml and landing.xml of the corrected vehicle into `folder`.

    vehicle: the one diagnosed, as the vehicle file `base` (default: the shipped one) gives it.
    """
    from inclined_landing.models.scene import build_spec

    sources, uncertainties = provenance(d, vehicle)
    corrected = rounded_fields(d.corrected, sources)
    disturbance, widths = disturbance_fields(d.disturbance)
    estimated = f"estimated by landing-eval gap from {len(d.flights)} flight{'s' * (len(d.flights) != 1)}"
    sources |= dict.fromkeys(disturbance, estimated)
    uncertainties |= widths
    names = ", ".join(effect.name for effect in d.effects) or "no effect"
    write_vehicle(
        folder / VEHICLE,
        dataclasses.replace(corrected, **disturbance),
        sources,
        uncertainties,
        base=base,
        heading=f"Corrected by landing-eval gap: {names}.\nEvery command accepts it with --vehicle.",
    )
    spec = build_spec(corrected)
    spec.compile()  # to_xml needs it
    storage.write_text(folder / MJCF, spec.to_xml())


def write_identified(found: Identification, folder: Path, *, base: Path | None = None) -> None:
    """Write vehicle.toml and its posterior into `folder`; base: the vehicle file that it started from."""
    heading = "Identified by landing-eval identify.\nEvery command accepts it with --vehicle."
    sources, uncertainties = sources_and_uncertainties(found)
    write_vehicle(folder / VEHICLE, as_written(found), sources, uncertainties, base=base, heading=heading)
    write_posterior(folder / VEHICLE, found.reference)


def write_reference(file: Path, found: Identification | None, given: Path | None) -> Path | None:
    """Write the vehicle that flights were compared with to `file`; return what its correction is based on.

    found: its identification. Without one it is the file `given`; else the shipped one, which is not written.
    """
    if found is not None:
        file.parent.mkdir()
        write_identified(found, file.parent, base=given)
        return file
    if given is not None:
        file.parent.mkdir()
        source = locate_vehicle(given)
        for original, copy in ((source, file), (posterior_path(source), posterior_path(file))):
            if original.is_file():
                storage.write_bytes(copy, original.read_bytes())
    return given


def write_posterior(vehicle: Path, reference: VehiclePosterior) -> None:
    """Write the posterior of an identified vehicle next to its file."""
    text = json.dumps(reference.to_json(load_vehicle(vehicle)), allow_nan=False, separators=(",", ":"))
    storage.write_text(posterior_path(vehicle), text + "\n")


def as_written(found: Identification) -> Vehicle:
    """Return the identified vehicle as its file gives it: digits that a person can read, and disturbance."""
    disturbance, _ = disturbance_fields(found.disturbance)
    return dataclasses.replace(rounded_fields(found.vehicle, found.fields), **disturbance)


def sources_and_uncertainties(found: Identification) -> tuple[dict[str, str], dict[str, Any]]:
    """Return the source and the uncertainty of every field of an identified vehicle that was fitted."""
    by_field: dict[str, list[Identified]] = {}
    for p in found.parameters:
        by_field.setdefault(p.field, []).append(p)
    sources = {
        field: f"identified by landing-eval identify from {len(found.flights)} flights"
        + "".join(f"; {p.name} {interval(p.ci95, p.unit)}, 95 % interval" for p in by_field.get(field, []))
        for field in found.fields
    }
    disturbance, widths = disturbance_fields(found.disturbance)
    lines = f"estimated by landing-eval identify from {len(found.flights)} flights"
    fitted = {field: rounded(width) for field, width in found.fields.items()}
    return sources | dict.fromkeys(disturbance, lines), fitted | widths


def provenance(d: Diagnosis, vehicle: Vehicle) -> tuple[dict[str, str], dict[str, Uncertainty]]:
    """Return source and half-width of the 95 % interval of every vehicle field that the effects change."""
    sources: dict[str, str] = {}
    half_widths: dict[str, Any] = {}
    of_effects = {effect.name: _half_widths(effect, vehicle) for effect in d.effects}
    for effect in d.effects:
        for field, width in of_effects[effect.name].items():
            sources[field] = f"{sources[field]}; " if field in sources else "identified by landing-eval gap: "
            sources[field] += _source(effect)
            half_widths[field] = np.hypot(half_widths.get(field, 0.0), width)
    for field in d.half_widths:
        names = [name for name, fields in of_effects.items() if field in fields]
        sources[field] = "; ".join(["estimated by landing-eval gap jointly with all constants", *names])
    uncertainties = {n: _uncertainty(width) for n, width in (half_widths | dict(d.half_widths)).items()}
    return sources, uncertainties


def disturbance_fields(disturbance: Mapping[str, Disturbance]) -> tuple[dict[str, Any], dict[str, Any]]:
    """Return the fields of the vehicle's disturbance, and the half-widths of their 95 % intervals.

    A channel without disturbance, or not logged, has zero.
    """
    fields: dict[str, Any] = {}
    widths: dict[str, Any] = {}
    none = Disturbance(0.0, 0.0, (0.0, 0.0), 0.0, (0.0, 0.0), "")
    for name, channels in (("acceleration", "x y z"), ("angular", "roll pitch yaw")):
        known = [disturbance.get(c, none) for c in channels.split()]
        known = [d if d.size else none for d in known]
        for field, of in ((f"disturbance_{name}", "size"), (f"disturbance_{name}_time", "time")):
            fields[field] = tuple(rounded(getattr(d, of)) for d in known)
            ends = [getattr(d, f"{of}_ci95") for d in known]
            widths[field] = tuple(rounded(round(0.5 * (high - low), 9)) for low, high in ends)
    return fields, widths


def rounded_fields(vehicle: Vehicle, names: Iterable[str]) -> Vehicle:
    """Return the vehicle with six digits of the numbers in these fields: a file that a person can read."""
    return dataclasses.replace(vehicle, **{name: rounded(getattr(vehicle, name), 6) for name in names})


def rounded(value: float | tuple[float, ...], digits: int = 3) -> Any:
    """Return a number, or each of several, with so many significant digits and never as -0."""
    if isinstance(value, tuple):
        return tuple(rounded(x, digits) for x in value)
    return float(f"{value:.{digits}g}") + 0.0


def _source(effect: NamedEffect) -> str:
    return f"{effect.name} " + ", ".join(
        f"{name} {p.value:.5g}{'' if p.unit == '1' else ' ' + p.unit}, "
        f"95 % interval {p.ci95[0]:.5g} to {p.ci95[1]:.5g}"
        for name, p in effect.parameters.items()
    )


def _half_widths(effect: NamedEffect, vehicle: Vehicle) -> dict[str, float | tuple[float, ...]]:
    """Return the half-width of every field that the effect changes, from its intervals; NaN if not known."""
    corrected = effects.apply(vehicle, effect.fitted)
    moved = []
    for name, p in effect.parameters.items():
        if effect.parts or not np.all(np.isfinite(p.ci95)):
            return dict.fromkeys(field_half_widths(vehicle, corrected, []), math.nan)
        end = max(p.ci95, key=lambda end: abs(end - p.value))  # the farther one, where a bound is near
        moved.append(effects.apply(vehicle, {effect.name: effect.fitted[effect.name] | {name: end}}))
    return field_half_widths(vehicle, corrected, moved)


def _uncertainty(width: Any) -> Uncertainty:
    """Return the half-width of a field as its file gives it; width: a number, or one for each of several."""
    if not np.all(np.isfinite(width)):
        return "not known"
    return rounded(tuple(map(float, width)) if np.ndim(width) else float(width))
