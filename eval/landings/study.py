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
from typing import Annotated, Any, Literal

import mujoco
import numpy as np
from msgspec import Meta, field, structs

from inclined_landing.eval.landings.parameters import UNITS, Parameter, catalogue
from inclined_landing.models import schema, storage
from inclined_landing.models.errors import UserError, shown
from inclined_landing.models.geometry import reach_below, shapes_of
from inclined_landing.models.parameters import load_vehicle
from inclined_landing.models.scene import compile_scene
from inclined_landing.models.schema import Real, Table
from inclined_landing.models.vehicle import Vehicle

MOST_LANDINGS = 5_000_000
_NARROWEST, _WIDEST = 1e-6, 1e3  # a normal distribution's deviation over its range
_DECADES = 12  # of a logarithmic range


class Entry(Table, frozen=True):
    """A table of [parameters]: one of value, values, from and to, or mean and deviation; in `unit`."""

    unit: str
    value: Real | None = None
    values: Annotated[tuple[Real, ...], Meta(min_length=1)] | None = None
    start: Real | None = field(name="from", default=None)
    stop: Real | None = field(name="to", default=None)
    count: Annotated[int, Meta(ge=2, le=MOST_LANDINGS)] | None = None
    distribution: Literal["uniform", "log-uniform", "normal"] | None = None
    mean: Real | None = None
    deviation: Real | None = None


class Start(Table, frozen=True):
    """[start]: where landings begin, instead of at a touchdown."""

    policy: str | None = None


class Simulation(Table, frozen=True):
    """[simulation], in s."""

    duration: Annotated[float, Meta(ge=0.2, le=20)] = 2.0
    timestep: Annotated[float, Meta(ge=1e-5, le=1)] = 0.004


class File(Table, frozen=True):
    """What a study file holds."""

    sampling: Literal["factorial", "latin-hypercube"]
    parameters: dict[str, Entry]
    title: Annotated[str, Meta(max_length=200)] = ""
    question: Annotated[str, Meta(max_length=5000)] = ""
    samples: Annotated[int, Meta(ge=1, le=MOST_LANDINGS)] | None = None
    seed: Annotated[int, Meta(ge=0, le=2**63 - 1)] = 0
    maps: tuple[tuple[str, str], ...] = ()
    start: Start = Start()
    simulation: Simulation = Simulation()


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
        """Return the plain data; `from_dict` gives the study back, bit for bit."""
        return dataclasses.asdict(self)

    @staticmethod
    def from_dict(data: dict) -> Study:
        """Return the study of `to_dict`."""
        data = dict(data)
        data["maps"] = tuple(tuple(pair) for pair in data["maps"])
        data["starts"] = tuple(tuple(row) for row in data["starts"])
        data["parameters"] = tuple(
            Levels(**entry | {"values": tuple(entry["values"])}) if "values" in entry else Range(**entry)
            for entry in data["parameters"]
        )
        if "vehicle" in data:
            fields: dict[str, Any] = {
                name.replace("unrest_", "disturbance_"): tuple(value) if isinstance(value, list) else value
                for name, value in data["vehicle"].items()  # unrest: the old name
            }
            data["vehicle"] = Vehicle(**fields)
        return Study(**data)

    def fingerprint(self) -> str:
        """Return a hash of everything that the results depend on: study, vehicle, engine."""
        data = self.to_dict()
        for words in ("title", "question", "maps"):
            del data[words]
        data["mujoco"] = mujoco.mj_versionString()
        data["numpy"] = np.__version__
        return hashlib.sha256(json.dumps(data, sort_keys=True).encode()).hexdigest()

    @property
    def varied(self) -> tuple[str, ...]:
        """Return the names of the parameters that vary."""
        return tuple(p.name for p in self.parameters if isinstance(p, Range) or len(p.values) > 1)


@functools.cache
def known_parameters(vehicle: Vehicle | None = None) -> dict[str, Parameter]:
    """Return the parameters that may vary, with the defaults of a vehicle (the shipped one)."""
    vehicle = vehicle or load_vehicle()
    return catalogue(vehicle, float(reach_below(shapes_of(compile_scene(vehicle)), part="feet")))


def shipped() -> dict[str, Path]:
    """Return the studies that come with the package, by name."""
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
    file = schema.parse(data, File)
    hypercube, policy, timestep = (
        file.sampling == "latin-hypercube",
        file.start.policy,
        file.simulation.timestep,
    )
    if hypercube and file.samples is None:
        raise UserError("samples is missing: how many landings the Latin hypercube has")
    if not hypercube and file.samples is not None:
        raise UserError("samples belongs to a Latin hypercube; a factorial has as many as its levels make")
    period = vehicle.command_control_period
    if timestep > period or abs(period / timestep - round(period / timestep)) > 1e-9:
        raise UserError(f"timestep must divide the control period of {period:g} s; {timestep:g} does not")
    if not file.parameters:
        raise UserError("there is no table [parameters]")
    parameters = tuple(
        _parameter(vehicle, name, entry, hypercube, policy) for name, entry in file.parameters.items()
    )
    if ("restitution" in file.parameters) != ("contact_time" in file.parameters):
        raise UserError("restitution and contact_time belong together; give both or none")
    study = Study(
        title=shown(file.title.strip(), 200),
        question=file.question.strip(),
        sampling=file.sampling,
        samples=file.samples or 0,
        seed=file.seed,
        maps=(),
        policy=policy,
        duration=file.simulation.duration,
        timestep=timestep,
        parameters=parameters,
        vehicle=vehicle,
    )
    if not study.varied and not policy:
        raise UserError("no parameter varies: give at least one a list or a range")
    count = math.prod(len(p.values) for p in parameters if isinstance(p, Levels))
    if not hypercube and count > MOST_LANDINGS:
        raise UserError(f"the factorial has {count} landings, more than {MOST_LANDINGS}")
    return dataclasses.replace(study, maps=_maps(file.maps, study.varied))


def _parameter(
    vehicle: Vehicle, name: str, entry: Entry, hypercube: bool, policy: str | None
) -> Levels | Range:
    known = known_parameters(vehicle)
    if name not in known:
        raise UserError(f"unknown parameter {shown(repr(name), 40)}; known are {', '.join(known)}")
    parameter = known[name]
    if policy and parameter.at_touchdown:
        raise UserError(f"{name} cannot be set in a study that starts where a policy hands over")
    units = UNITS[parameter.kind]
    if entry.unit not in units:
        either = " or ".join(map(repr, units))
        raise UserError(f"parameter {name} needs a unit, {either}, not {shown(repr(entry.unit))}")
    factor = units[entry.unit]
    given = {key for key, value in structs.asdict(entry).items() if value is not None} - {"unit"}
    if not (
        given in ({"value"}, {"values"}) or (given & {"start", "mean"} and not given & {"value", "values"})
    ):
        raise UserError(f"parameter {name} needs one of value, values, from and to, or mean and deviation")
    if given & {"start", "mean"}:
        return _range(parameter, entry, factor, hypercube)
    numbers = entry.values if entry.value is None else (entry.value,)
    values = tuple(_check(parameter, number, entry.unit, factor) for number in numbers or ())
    if len(set(values)) < len(values):
        raise UserError(f"parameter {name}: a value is listed twice")
    return Levels(name, values, entry.unit)


def _range(parameter: Parameter, entry: Entry, factor: float, hypercube: bool) -> Levels | Range:
    name, distribution, where = (
        parameter.name,
        entry.distribution or "uniform",
        f"parameter {parameter.name}:",
    )
    normal = distribution == "normal"
    if normal != (entry.mean is not None) or normal != (entry.deviation is not None):
        raise UserError(f"{where} mean and deviation belong to the normal distribution, both")
    if not normal and (entry.start is None or entry.stop is None):
        raise UserError(f"{where} a range needs from and to")
    low, high = (
        end if number is None else _check(parameter, number, entry.unit, factor)
        for number, end in ((entry.start, parameter.low), (entry.stop, parameter.high))
    )
    if low >= high:
        raise UserError(f"{where} the range from {low / factor:g} to {high / factor:g} is empty")
    if distribution == "log-uniform" and low < high / 10**_DECADES:
        raise UserError(f"{where} a log-uniform range must start above 0, {_DECADES} decades at most")
    mean = deviation = 0.0
    if entry.mean is not None and entry.deviation is not None:
        mean, deviation = factor * entry.mean, factor * entry.deviation
        if not _NARROWEST <= deviation / (high - low) <= _WIDEST or not low <= mean <= high:
            raise UserError(
                f"{where} the mean must be in the range, and the deviation {_NARROWEST:g} to {_WIDEST:g} "
                "times as wide"
            )
    if hypercube:
        if entry.count is not None:
            raise UserError(f"{where} count belongs to a factorial")
        return Range(name, low, high, distribution, mean, deviation, entry.unit)
    if normal:
        raise UserError(f"{where} a normal distribution belongs to a Latin hypercube")
    if entry.count is None:
        raise UserError(f"{where} the range of a factorial needs a count")
    space = np.geomspace if distribution == "log-uniform" else np.linspace
    return Levels(name, tuple(float(x) for x in space(low, high, entry.count)), entry.unit)


def _check(parameter: Parameter, value: float, unit: str, factor: float) -> float:
    """Return a value of the file in SI units; raises UserError beyond the parameter's bounds."""
    low, high = parameter.low, parameter.high
    if not low - 1e-12 <= factor * value <= high + 1e-12:
        raise UserError(
            f"parameter {parameter.name} must be from {low / factor:g} to {high / factor:g} {unit}, "
            f"not {value:g}".replace(" 1, not", ", not")
        )
    return min(max(factor * value, low), high)


def _maps(given: tuple[tuple[str, str], ...], varied: tuple[str, ...]) -> tuple[tuple[str, str], ...]:
    for pair in given:
        if pair[0] == pair[1]:
            raise UserError("each of the maps must be a pair of two parameters")
        for name in pair:
            if name not in varied:
                x, y, name = (shown(item, 40) for item in (*pair, name))
                raise UserError(f"the map of {x} and {y} needs {name} to vary")
        if given.count(pair) > 1:
            raise UserError(f"the map of {pair[0]} and {pair[1]} is listed twice")
    return given
