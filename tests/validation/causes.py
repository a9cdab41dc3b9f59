"""`causes`: known causes in measured flights of five laboratories against what the gap workflow names.

Someone changed something on purpose and recorded it: is it named, and how large? `causes.toml` lists the
flights and what was told.
"""

from __future__ import annotations

import dataclasses
import functools
import re
import time
import tomllib
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
import tyro
from msgspec import Meta

from inclined_landing.envs.shared.statistics import proportion
from inclined_landing.eval.gap import diagnose
from inclined_landing.eval.gap.answer.identification import Identification, identify
from inclined_landing.eval.gap.result import Diagnosis
from inclined_landing.eval.logs import FlightLog, read_log
from inclined_landing.models.base.errors import UserError
from inclined_landing.models.effects import LIBRARY
from inclined_landing.models.parameters import load_vehicle
from inclined_landing.models.vehicle import Vehicle

from .shared import check_folder, study, table, table_of

HALVES = ("development", "heldout", "fresh")
_RANGE = re.compile(r"\{(\d+)\.\.(\d+)\.\.(\d+)\}")


def command(
    data: tyro.conf.Positional[Path],
    /,
    out: Path,
    *,
    half: Literal["development", "heldout", "fresh", "all"] = "development",
    only: tuple[str, ...] = (),
    processes: Annotated[int, Meta(ge=1, le=64)] = 2,
) -> None:
    """Known causes in real flights of five laboratories: is the right one named, and how large (minutes)?

    Args:
        data: folder with the clones of the five repositories (docs/evidence/known_causes.md says which).
        out: folder for table.md and results.json; answers that are in it are kept.
        half: flights that the workflow was looked at with, those that were held out, or those that came last.
        only: names of repositories.
        processes: rows at a time.
    """
    rows = [r for r in known_rows() if half in (r.half, "all") and (not only or r.set in only)]
    if not rows:
        known = sorted({r.set for r in known_rows()})
        raise UserError(f"no rows; --only takes {', '.join(known)}, and not all have every half")
    check_folder(data)
    study(out, _answer, {row.key: (data, row) for row in rows}, processes, scored)


def scored(answers: Mapping[str, dict]) -> tuple[str, dict]:
    """Return the tables of shares and of rows, and what results.json has of them."""
    rows = list(answers.values())
    counted = {what: share for what, share in summary(rows).items() if share["of"]}
    text = table(["", "share [95 %]"], counted.items()) + "\n" + errors(rows) + "\n\n"
    return text + table_of(list(map(cells, rows))), {"rows": rows, "summary": counted}


def _answer(data: Path, row: Row) -> dict:
    """Return the answer to a row, or why there is none."""
    common = {key: getattr(row, key) for key in ("set", "name", "kind", "half", "dose")}
    try:
        return common | (dose_answer if row.kind == "dose" else answer)(data, row)
    except UserError as error:
        return common | {"error": str(error)}


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


def read(
    folder: Path, patterns: Sequence[str], above: float | None = None
) -> tuple[list[FlightLog], list[str]]:
    """Return the flights of a repository that can be used, and why others cannot.

    Raises UserError where there are none, or none can be used.
    """
    logs, refused = [], []
    for path in paths_of(folder, patterns):
        try:
            log = read_log(path, name=f"{path.parent.name}/{path.name}")
            if above is not None:
                log = log.rows(log.position[:, 2] > above)
            logs.append(log)
        except UserError as error:
            refused.append(str(error))
    if not logs:
        raise UserError(refused[0])
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
    logs, refused = read(folder, patterns, above)
    return logs, refused, identify(logs, vehicle)


def answer(data: Path, row: Row) -> dict:
    """Identify the reference, diagnose the flights; returns what the table needs.

    Raises UserError where flights are missing or none can be used.
    """
    began = time.perf_counter()
    above = row.reference_above or row.above
    reference, refused, known = _identified(data / row.set, row.reference, above, base_vehicle(row))
    flights, more = read(data / row.set, row.flights, row.above)
    d = diagnose(flights, known.vehicle, reference=known.reference)
    mean_pwm = float(np.mean([np.median(f.command[:, 0]) for f in flights]))
    gap = d.gap.get("analytic")
    return {
        "strength": row.strength,
        "told": dict(row.size) if row.size else None,
        "right": list(row.right),
        "flights": [len(reference), len(flights)],
        "refused": refused + more,
        "verdict": d.verdict,
        "named": [
            {"name": e.name, "class": list(e.members), "probability": e.probability, "sure": e.sure}
            | {"parameters": {k: [p.value, *p.ci95] for k, p in e.parameters.items()}}
            for e in d.effects
        ],
        "possible": d.possible,
        "inconsistent": _inconsistent(d),
        "found": _found(row, d, known.vehicle, mean_pwm),
        "before": gap.before if gap else None,
        "after": gap.after if gap else None,
        "seconds": time.perf_counter() - began,
        **judged(row, d),
    }


def dose_answer(data: Path, row: Row) -> dict:
    """Return what is identified of one parameter, against what was told; raises UserError as `answer`."""
    flights, refused = read(data / row.set, row.flights, row.above)
    found = identify(flights, base_vehicle(row))
    (p,) = [p for p in found.parameters if p.field == row.parameter]
    return {
        "parameter": p.name,
        "flights": [len(found.flights)],
        "refused": refused,
        "found": {"value": p.value, "ci95": list(p.ci95)},
    }


def _inconsistent(d: Diagnosis) -> list[str]:
    """Return the flights that contradict the others, or themselves: these are set aside."""
    others = [name for one in d.inconsistent_flights for name in one.flights]
    return [*others, *(one.flight for one in d.set_aside)]


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


def summary(results: Sequence[dict]) -> dict[str, dict]:
    """Return what the answers are counted by, each as a proportion."""
    rows = [r for r in results if "error" not in r and r["kind"] != "dose"]
    kinds = {kind: [r for r in rows if r["kind"] == kind] for kind in ("cause", "nothing", "unknown")}
    clear = [r for r in kinds["cause"] if r["strength"] != "weak"]
    told = [r for r in kinds["cause"] if r["told"]]
    sure = sum(r["sure names"] for r in rows)

    def share(words: str, some: Sequence[dict], hit: Callable[[dict], Any]) -> dict[str, dict]:
        return {words: proportion(sum(map(bool, map(hit, some))), len(some))}

    return {
        **share("causes of medium size or more that are named sure", clear, lambda r: r["right sure"]),
        **share("the same, sure or possible", clear, lambda r: r["right possible"]),
        "sure names that are wrong": proportion(sum(len(r["wrong"]) for r in rows), sure),
        **share("recorded sizes within the 95 % interval", told, _holds),
        **share("nothing changed, and a sure name", kinds["nothing"], lambda r: r["sure names"]),
        **share("causes outside the library that are flagged", kinds["unknown"], lambda r: r["flagged"]),
        **share("verdict unknown for a known cause", kinds["cause"], lambda r: r["verdict"] == "unknown"),
        **share("the same, nothing changed", kinds["nothing"], lambda r: r["verdict"] == "unknown"),
    }


def _holds(r: dict) -> bool:
    """Return whether interval and recorded size, with what it is uncertain by, overlap."""
    if r["found"] is None:
        return False
    low, high = r["found"]["ci95"]
    return low - r["told"]["tolerance"] <= r["told"]["value"] <= high + r["told"]["tolerance"]


def errors(results: Sequence[dict]) -> str:
    """Return the median error one second ahead, before and after, where a right name is sure."""
    rows = [r for r in results if "error" not in r and r["kind"] == "cause" and r["right sure"]]
    ends = [[r[when] for r in rows if r[when] is not None] for when in ("before", "after")]
    before, after = (f"{100 * np.median(one):.0f}" if one else "-" for one in ends)
    return f"Error after 1 s where a right name is sure, median: {before} to {after} cm."


def cells(r: dict) -> dict[str, str]:
    """Return a row as a line of the table."""
    line = dict.fromkeys(("set", "told", "flights", "verdict", "sure", "possible"), "")
    line |= dict.fromkeys(("recorded size", "found", "error after 1 s [cm]"), "")
    line |= {"set": r["set"], "told": r["name"]}
    if "error" in r:
        return line | {"verdict": f"not read: {r['error']}"}
    line["flights"] = " and ".join(map(str, r["flights"]))
    if r["found"]:
        line["found"] = _sized(r["found"]["value"], *r["found"]["ci95"])
    if r["kind"] == "dose":
        return line | {"recorded size": f"{r['parameter']} at {r['dose']:g}"}
    odd = f"; inconsistent: {', '.join(r['inconsistent'])}" if r["inconsistent"] else ""
    return line | {
        "verdict": r["verdict"] + odd,
        "sure": "; ".join(_names(r, True)),
        "possible": ", ".join([*_names(r, False), *r["possible"]]),
        "recorded size": f"{r['told']['of']} {r['told']['value']:g}" if r["told"] else "",
        "error after 1 s [cm]": f"{100 * r['before']:.0f} to {100 * r['after']:.0f}" if r["before"] else "",
    }


def _names(r: dict, sure: bool) -> list[str]:
    named = [e for e in r["named"] if e["sure"] == sure]
    return [f"{e['name']} {', '.join(_sized(*p) for p in e['parameters'].values())}" for e in named]


def _sized(value: float, low: float, high: float) -> str:
    return f"{value:.3g} [{low:.3g}, {high:.3g}]"
