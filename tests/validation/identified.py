"""`identified`: those vehicles of models/vehicles, made anew from public flights and judged on others."""

from __future__ import annotations

import dataclasses
import textwrap
import tomllib
from collections.abc import Mapping, Sequence
from datetime import date
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
import tyro

from inclined_landing.eval.gap.answer.identification import Identification, identify
from inclined_landing.eval.gap.answer.rollout import measure_gap
from inclined_landing.eval.gap.report.files import as_written, sources_and_uncertainties, write_posterior
from inclined_landing.eval.logs import FlightLog
from inclined_landing.models.base import storage
from inclined_landing.models.base.errors import UserError
from inclined_landing.models.parameters import load_vehicle, write_vehicle
from inclined_landing.models.vehicle import Vehicle

from .causes import read
from .shared import check_folder, table_of

DIGITS = 5  # of a value in the file: fewer than any interval allows, and readable
DRAWS = 2000  # of the bootstrap over flights


def vehicles() -> dict[str, dict]:
    """Return the entries of identified.toml by name of the vehicle."""
    return tomllib.loads((Path(__file__).parent / "identified.toml").read_text("utf-8"))["vehicles"]


def command(data: tyro.conf.Positional[Path], /, out: Path, *, only: tuple[str, ...] = ()) -> None:
    """Vehicles identified from public flights, and how far they predict flights left out (a minute).

    Args:
        data: folder with the clones of the repositories (docs/evidence/known_causes.md says which).
        out: folder for NAME.toml and NAME.posterior.json, as they stand in models/vehicles, and table.md.
        only: names of vehicles.
    """
    chosen = {name: entry for name, entry in vehicles().items() if not only or name in only}
    if unknown := set(only) - set(chosen):
        raise UserError(f"unknown vehicle {min(unknown)!r}; choose from {', '.join(vehicles())}")
    check_folder(data)
    storage.check_folder(out)
    out.mkdir(parents=True, exist_ok=True)
    rows = []
    for name, entry in chosen.items():
        flights = _flights(data, entry, entry["fitted"])
        base = load_vehicle(entry["base"]).changed(body_mass=entry["mass"])
        found = _rounded(identify(flights, base))
        judged = [_judged(data, entry, one, base, found.vehicle) for one in entry["judged"]]
        write(out / f"{name}.toml", name, entry, found, judged)
        rows += [
            {"vehicle": f"`{name}`", "judged on": j["name"], "flights": j["flights"]}
            | {"base file": _cm(j, 0), "identified": _cm(j, 1)}
            for j in judged
        ]
    storage.write_text(out / "table.md", table_of(rows))
    print(table_of(rows))
    print(f"{len(chosen)} vehicles were identified and judged; the table is {out / 'table.md'}.")


def _flights(data: Path, entry: Mapping, patterns: Sequence[str]) -> list[FlightLog]:
    """Return the flights of some patterns. Raises UserError where none can be used."""
    return read(data / entry["repository"].rpartition("/")[2], patterns)[0]


def _rounded(found: Identification) -> Identification:
    """Return the identification with values that a person can read, and its posterior likewise."""
    values = {name: _short(getattr(found.vehicle, name), DIGITS) for name in found.fields}
    widths = {name: _short(width, 3) for name, width in found.fields.items()}
    r = found.reference
    shorter = dataclasses.replace(
        r, mean=np.array(_short(r.mean.tolist(), 9)), covariance=np.array(_short(r.covariance.tolist(), 9))
    )
    return dataclasses.replace(
        found, vehicle=found.vehicle.changed(**values), fields=widths, reference=shorter
    )


def _short(value: Any, digits: int) -> Any:
    if isinstance(value, (tuple, list)):
        return type(value)(_short(x, digits) for x in value)
    return float(f"{value:.{digits}g}")


def _judged(data: Path, entry: Mapping, one: Mapping, *vehicles: Vehicle) -> dict:
    """Return the position errors [m] after one second, open loop, of vehicles on flights left out.

    errors: of each vehicle [root mean square, its 95 % interval by a bootstrap over flights]
    """
    flights = _flights(data, entry, one["flights"])
    vehicles = tuple(v.changed(body_mass=one.get("mass", entry["mass"])) for v in vehicles)
    squares, windows = [], []
    for log in flights:
        try:
            gaps = [measure_gap(v, [log]) for v in vehicles]
        except UserError:  # no stretch of a second
            continue
        windows.append(gaps[0]["windows"])
        squares.append([g["windows"] * g["error"] ** 2 for g in gaps])
    draws = np.random.default_rng(0).integers(len(windows), size=(DRAWS, len(windows)))
    square, count = np.array(squares), np.array(windows)
    drawn = np.sqrt(square[draws].sum(axis=1) / count[draws].sum(axis=1)[:, None])
    error = np.sqrt(square.sum(axis=0) / count.sum())
    low, high = np.quantile(drawn, (0.025, 0.975), axis=0)
    return {
        "name": one["name"],
        "flights": len(windows),
        "errors": [[float(e), float(a), float(b)] for e, a, b in zip(error, low, high)],
    }


def _cm(judged: Mapping, k: int) -> str:
    error, low, high = (100.0 * x for x in judged["errors"][k])
    return f"{error:.1f} cm [{low:.1f}, {high:.1f}]"


def write(path: Path, name: str, entry: Mapping, found: Identification, judged: Sequence[Mapping]) -> None:
    """Write the vehicle file with where it comes from, and its posterior beside it."""
    vehicle, (sources, widths) = as_written(found), sources_and_uncertainties(found)
    write_vehicle(
        path,
        vehicle,
        {**sources, "body_mass": entry["mass_source"]},
        {**widths, "body_mass": 0.0005},
        base=entry["base"],
        heading=heading(name, entry, found, judged),
        brief=True,
    )
    write_posterior(path, found.reference)


def heading(name: str, entry: Mapping, found: Identification, judged: Sequence[Mapping]) -> str:
    """Return the comment on top of a file: where it comes from, what it reaches, what it does not know."""
    paragraphs = [
        f"{entry['what']}. Identified from {len(found.flights)} flights of others; not flown by us.",
        f"Flights: {entry['repository']}, commit {entry['commit']}, licence: {entry['licence']}. "
        f"{', '.join(found.flights)}; {entry['command']}.",
        f"Made by `python -m tests.validation identified DATA --only {name}` (landing-eval identify from "
        f"{entry['base']} with a mass of {entry['mass']:g} kg), version {version('inclined-landing')}, "
        f"{date.today().isoformat()}. Its posterior is next to it.",
        "Position error one second after an open-loop start, on flights left out, from the base file with "
        "this mass to this one: "
        + "; ".join(f"{_cm(j, 0)} to {_cm(j, 1)} ({j['name']}, {j['flights']} flights)" for j in judged)
        + ".",
        f"Not identified: {entry['missing']}.",
    ]
    if entry["lean"]:
        paragraphs.append(
            "The attitude loops are those of a Lee controller, a form that the library does not have: "
            "estimator_lean stands for what is missing there. The firmware's PID has another gain and lag."
        )
    return "\n\n".join(
        textwrap.fill(p, 110, break_long_words=False, break_on_hyphens=False) for p in paragraphs
    )
