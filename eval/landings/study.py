"""Reader of study files (TOML); README.md in this folder is their manual."""

from __future__ import annotations

import dataclasses
import functools
import hashlib
import json
import math
import os
from importlib import resources
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from inclined_landing.eval.landings.parameters import UNITS, Parameter, catalogue
from inclined_landing.models import storage
from inclined_landing.models.errors import UserError, shown
from inclined_landing.models.geometry import reach_below, shapes_of
from inclined_landing.models.parameters import Vehicle, load_vehicle
from inclined_landing.models.scene import compile_scene

SAMPLINGS = ("factorial", "latin-hypercube")
DISTRIBUTIONS = ("uniform", "log-uniform", "normal")
MOST_LANDINGS = 5_000_000
_KEYS = {"title", "question", "sampling", "samples", "seed", "maps", "start", "simulation", "parameters"}
_DURATION = (0.2, 20.0)  # s
_SHORTEST_STEP = 1e-5  # s
_TITLE, _QUESTION = 200, 5000  # characters
_NARROWEST, _WIDEST = 1e-6, 1e3  # a normal distribution's deviation over its range
_HUGE = 1e300  # for whole numbers that no float holds
_DECADES = 12  # of a logarithmic range


@dataclasses.dataclass(frozen=True)
class Levels:
    """The values [SI] of one parameter: one is fixed, several are a list or a range with a count."""

    name: str
    values: tuple[float, ...]
    unit: str  # as the study file writes it


@dataclasses.dataclass(frozen=True)
class Range:
    """A parameter drawn from a distribution on [low, high] [SI]."""

    name: str
    low: float
    high: float
    distribution: str
    mean: float  # of the normal distribution before it is cut to the range
    deviation: float
    unit: str


@dataclasses.dataclass(frozen=True)
class Study:
    """A study, resolved: everything that its landings depend on."""

    title: str
    question: str
    sampling: str
    samples: int  # of a Latin hypercube; 0 for a factorial
    seed: int
    maps: tuple[tuple[str, str], ...]
    policy: str | None  # whose goal-box entries the landings start from
    duration: float  # s
    timestep: float  # s
    parameters: tuple[Levels | Range, ...]  # those that the file names, in its order
    starts: tuple[tuple[float, ...], ...] = ()  # states (13,) of the entries, once they are flown
    vehicle: Vehicle = dataclasses.field(default_factory=load_vehicle)

    def to_dict(self) -> dict:
        """Plain data; `from_dict` gives the study back, bit for bit."""
        return dataclasses.asdict(self)

    @staticmethod
    def from_dict(data: dict) -> Study:
        """The study of `to_dict`."""
        data = dict(data)
        data["maps"] = tuple(tuple(pair) for pair in data["maps"])
        data["starts"] = tuple(tuple(row) for row in data["starts"])
        data["parameters"] = tuple(
            Levels(**entry | {"values": tuple(entry["values"])}) if "values" in entry else Range(**entry)
            for entry in data["parameters"]
        )
        if "vehicle" in data:
            given: dict[str, Any] = {
                k: tuple(v) if isinstance(v, list) else v for k, v in data["vehicle"].items()
            }
            data["vehicle"] = Vehicle(**given)
        return Study(**data)

    def fingerprint(self) -> str:
        """Of everything that decides the results' bits: the study, the vehicle, the engine."""
        data = self.to_dict()
        for words in ("title", "question", "maps"):
            del data[words]
        data["mujoco"] = mujoco.mj_versionString()
        data["numpy"] = np.__version__
        return hashlib.sha256(json.dumps(data, sort_keys=True).encode()).hexdigest()

    @property
    def varied(self) -> tuple[str, ...]:
        """Names of the parameters that vary."""
        return tuple(p.name for p in self.parameters if isinstance(p, Range) or len(p.values) > 1)


@functools.cache
def known_parameters(vehicle: Vehicle | None = None) -> dict[str, Parameter]:
    """What may vary, and the defaults of a vehicle (the shipped one)."""
    vehicle = vehicle or load_vehicle()
    return catalogue(vehicle, float(reach_below(shapes_of(compile_scene(vehicle)), part="feet")))


def shipped() -> dict[str, Path]:
    """The studies that come with the package, by name."""
    folder = Path(str(resources.files("inclined_landing.eval") / "landings"))
    return {path.stem: path for path in sorted(folder.glob("*.toml"))}


def read_study(name: str | Path, vehicle: Vehicle | None = None) -> Study:
    """Read a study file, or a shipped study by name, for a vehicle (default: the shipped one).

    Raises UserError, one sentence naming the file and the entry, for whatever is wrong.
    """
    path = shipped().get(str(name), Path(name))
    if not os.path.lexists(path):
        raise UserError(f"study {shown(path, 200)} does not exist (shipped ones: {', '.join(shipped())})")
    data = storage.read_toml(path, "study")
    try:
        return _parse(data, vehicle or load_vehicle())
    except UserError as error:
        raise UserError(f"study {path}: {error}") from error


def _parse(data: dict, vehicle: Vehicle) -> Study:
    _only(data, _KEYS, "the file")
    sampling = data.get("sampling")
    if sampling not in SAMPLINGS:
        raise UserError(f"sampling must be {_either(SAMPLINGS)}, not {shown(repr(sampling))}")
    hypercube = sampling == "latin-hypercube"
    samples = _whole(data, "samples", 0)
    if hypercube and not 1 <= samples <= MOST_LANDINGS:
        raise UserError(f"samples must be from 1 to {MOST_LANDINGS} for a Latin hypercube")
    if not hypercube and "samples" in data:
        raise UserError("samples belongs to a Latin hypercube; a factorial has as many as its levels make")
    start, simulation = data.get("start", {}), data.get("simulation", {})
    _only(start, {"policy"}, "[start]")
    _only(simulation, {"duration", "timestep"}, "[simulation]")
    duration, timestep = _number(simulation, "duration", 2.0), _number(simulation, "timestep", 0.004)
    if not _DURATION[0] <= duration <= _DURATION[1]:
        raise UserError(f"duration must be from {_DURATION[0]:g} to {_DURATION[1]:g} s, not {duration:g}")
    period = vehicle.command_control_period
    if not _SHORTEST_STEP <= timestep <= period or abs(period / timestep - round(period / timestep)) > 1e-9:
        raise UserError(
            f"timestep must divide the control period of {period:g} s and be at least {_SHORTEST_STEP:g} s; "
            f"{timestep:g} does not"
        )
    policy = start.get("policy")
    if not isinstance(policy, str | None):
        raise UserError("policy in [start] must be a policy file or the name of a shipped policy")
    entries = data.get("parameters")
    if not isinstance(entries, dict) or not entries:
        raise UserError("there is no table [parameters]")
    parameters = tuple(_parameter(vehicle, name, entry, hypercube, policy) for name, entry in entries.items())
    if ("restitution" in entries) != ("contact_time" in entries):
        raise UserError("restitution and contact_time belong together; give both or none")
    study = Study(
        title=shown(_text(data, "title", _TITLE), _TITLE),
        question=_text(data, "question", _QUESTION),
        sampling=sampling,
        samples=samples,
        seed=_whole(data, "seed", 0),
        maps=(),
        policy=policy,
        duration=duration,
        timestep=timestep,
        parameters=parameters,
        vehicle=vehicle,
    )
    if not study.varied and not policy:
        raise UserError("no parameter varies: give at least one a list or a range")
    count = math.prod(len(p.values) for p in parameters if isinstance(p, Levels))
    if not hypercube and count > MOST_LANDINGS:
        raise UserError(f"the factorial has {count} landings, more than {MOST_LANDINGS}")
    return dataclasses.replace(study, maps=_maps(data.get("maps", []), study.varied))


def _parameter(vehicle: Vehicle, name: str, entry, hypercube: bool, policy: str | None) -> Levels | Range:
    known = known_parameters(vehicle)
    if name not in known:
        raise UserError(f"unknown parameter {shown(repr(name), 40)}; known are {', '.join(known)}")
    parameter = known[name]
    if policy and parameter.at_touchdown:
        raise UserError(f"{name} cannot be set in a study that starts where a policy hands over")
    if not isinstance(entry, dict):
        raise UserError(
            f"parameter {name} must be a table such as {{ value = 1, unit = {parameter.unit!r} }}"
        )
    units = UNITS[parameter.kind]
    unit = entry.get("unit")
    if not isinstance(unit, str) or unit not in units:
        raise UserError(f"parameter {name} needs a unit, {_either(tuple(units))}, not {shown(repr(unit))}")
    factor = units[unit]
    forms = {"value", "values", "from", "mean"} & set(entry)
    if len(forms - {"mean"}) != 1 and forms != {"mean"}:
        raise UserError(f"parameter {name} needs one of value, values, from and to, or mean and deviation")
    if "value" in entry or "values" in entry:
        _only(entry, {"value", "values", "unit"}, f"parameter {name}")
        given = entry["values"] if "values" in entry else [entry["value"]]
        if not isinstance(given, list) or not given:
            raise UserError(f"parameter {name}: values must be a list with at least one number")
        values = tuple(_check(parameter, value, unit, factor) for value in given)
        if len(set(values)) < len(values):
            raise UserError(f"parameter {name}: a value stands twice in its list")
        return Levels(name, values, unit)
    _only(entry, {"from", "to", "count", "distribution", "mean", "deviation", "unit"}, f"parameter {name}")
    return _range(parameter, entry, unit, factor, hypercube)


def _range(parameter: Parameter, entry: dict, unit: str, factor: float, hypercube: bool) -> Levels | Range:
    name = parameter.name
    distribution = entry.get("distribution", "uniform")
    if distribution not in DISTRIBUTIONS:
        raise UserError(f"parameter {name}: distribution must be {_either(DISTRIBUTIONS)}")
    normal = distribution == "normal"
    if normal != ("mean" in entry) or normal != ("deviation" in entry):
        raise UserError(f"parameter {name}: mean and deviation belong to the normal distribution, both")
    if not normal and not {"from", "to"} <= set(entry):
        raise UserError(f"parameter {name}: a range needs from and to")
    low = _check(parameter, entry["from"], unit, factor) if "from" in entry else parameter.low
    high = _check(parameter, entry["to"], unit, factor) if "to" in entry else parameter.high
    if low >= high:
        raise UserError(f"parameter {name}: the range from {low / factor:g} to {high / factor:g} is empty")
    if distribution == "log-uniform" and low < high / 10**_DECADES:
        raise UserError(
            f"parameter {name}: a log-uniform range must start above 0, {_DECADES} decades at most"
        )
    mean = deviation = 0.0
    if normal:
        where = f"parameter {name}: "
        mean, deviation = (factor * _number(entry, key, math.nan, where) for key in ("mean", "deviation"))
        if not _NARROWEST <= deviation / (high - low) <= _WIDEST or not low <= mean <= high:
            raise UserError(
                f"parameter {name}: the mean must be in the range, and the deviation {_NARROWEST:g} to "
                f"{_WIDEST:g} times as wide"
            )
    if hypercube:
        if "count" in entry:
            raise UserError(f"parameter {name}: count belongs to a factorial")
        return Range(name, low, high, distribution, mean, deviation, unit)
    count = entry.get("count")
    if normal:
        raise UserError(f"parameter {name}: a normal distribution belongs to a Latin hypercube")
    if type(count) is not int or not 2 <= count <= MOST_LANDINGS:
        raise UserError(f"parameter {name}: the range of a factorial needs a count, 2 to {MOST_LANDINGS}")
    space = np.geomspace if distribution == "log-uniform" else np.linspace
    return Levels(name, tuple(float(x) for x in space(low, high, count)), unit)


def _check(parameter: Parameter, value, unit: str, factor: float) -> float:
    if not _is_number(value):
        raise UserError(f"parameter {parameter.name}: {shown(repr(value))} is not a number")
    value = float(min(max(value, -_HUGE), _HUGE))
    low, high = parameter.low, parameter.high
    if not low - 1e-12 <= factor * value <= high + 1e-12:
        raise UserError(
            f"parameter {parameter.name} must be from {low / factor:g} to {high / factor:g} {unit}, "
            f"not {value:g}".replace(" 1, not", ", not")
        )
    return min(max(factor * float(value), low), high)


def _maps(given, varied: tuple[str, ...]) -> tuple[tuple[str, str], ...]:
    if not isinstance(given, list):
        raise UserError("maps must be a list of pairs of parameters")
    for pair in given:
        if not isinstance(pair, list) or len(pair) != 2 or pair[0] == pair[1]:
            raise UserError("each of the maps must be a pair of two parameters")
        for name in pair:
            if name not in varied:
                x, y, name = (shown(item, 40) for item in (*pair, name))
                raise UserError(f"the map of {x} and {y} needs {name} to vary")
        if given.count(pair) > 1:
            raise UserError(f"the map of {pair[0]} and {pair[1]} stands twice among the maps")
    return tuple((pair[0], pair[1]) for pair in given)


def _only(table, known: set[str], where: str) -> None:
    if not isinstance(table, dict):
        raise UserError(f"{where} must be a table")
    unknown = sorted(set(table) - known)
    if unknown:
        raise UserError(
            f"unknown entry {shown(repr(unknown[0]), 40)} in {where}; known are {', '.join(sorted(known))}"
        )


def _is_number(value) -> bool:
    return type(value) in (int, float) and abs(value) < math.inf  # whole numbers of any length too


def _number(table: dict, key: str, default: float, where: str = "") -> float:
    value = table.get(key, default)
    if not _is_number(value):
        raise UserError(f"{where}{key} must be a number, not {shown(repr(value))}")
    return float(min(max(value, -_HUGE), _HUGE))


def _whole(table: dict, key: str, default: int) -> int:
    value = table.get(key, default)
    if type(value) is not int or not 0 <= value < 2**63:
        raise UserError(f"{key} must be a whole number from 0, below 2^63, not {shown(repr(value))}")
    return value


def _text(table: dict, key: str, longest: int) -> str:
    value = table.get(key, "")
    if not isinstance(value, str) or len(value) > longest:
        raise UserError(f"{key} must be text of at most {longest} characters")
    return value.strip()


def _either(names) -> str:
    return " or ".join(repr(name) for name in names)
