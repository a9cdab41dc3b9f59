"""Reader of study files (TOML); README.md in this folder is their manual."""

from __future__ import annotations

import dataclasses
import hashlib
import json
import math
import os
from importlib import resources
from pathlib import Path
from typing import Annotated, Literal

import mujoco
import numpy as np
from msgspec import Meta, field, structs

from inclined_landing.eval.landings.parameters import UNITS, Parameter, known_parameters
from inclined_landing.models.base import schema, storage
from inclined_landing.models.base.errors import UserError, choices, shown
from inclined_landing.models.base.schema import Real, Table
from inclined_landing.models.parameters import load_vehicle
from inclined_landing.models.vehicle import Vehicle

MOST_LANDINGS = 5_000_000


class Varied(Table, frozen=True):
    """A table of [parameters]: one of value, values, from and to, or mean and deviation; in `unit`."""

    unit: str
    value: Real | None = None
    values: Annotated[tuple[Real, ...], Meta(min_length=1)] | None = None
    start: Real | None = field(name="from", default=None)
    stop: Real | None = field(name="to", default=None)
    count: Annotated[int, Meta(ge=2, le=MOST_LANDINGS)] | None = None
    distribution: Literal["uniform", "normal"] | None = None
    mean: Real | None = None
    deviation: Annotated[float, Meta(gt=0, le=1e300)] | None = None


class StudyStart(Table, frozen=True):
    """Table [start]: where landings begin, if not just above the slope."""

    policy: str | None = None


class Simulation(Table, frozen=True):
    """Table [simulation], in s."""

    duration: Annotated[float, Meta(ge=0.2, le=20)] = 2.0
    timestep: Annotated[float, Meta(ge=1e-5, le=1)] = 0.004


class StudyFile(Table, frozen=True):
    """The content of a study file."""

    sampling: Literal["factorial", "latin-hypercube"]
    parameters: Annotated[dict[str, Varied], Meta(min_length=1)]
    title: Annotated[str, Meta(max_length=200)] = ""
    question: Annotated[str, Meta(max_length=5000)] = ""
    samples: Annotated[int, Meta(ge=1, le=MOST_LANDINGS)] | None = None
    seed: Annotated[int, Meta(ge=0, le=2**63 - 1)] = 0
    maps: tuple[tuple[str, str], ...] = ()
    start: StudyStart = StudyStart()
    simulation: Simulation = Simulation()


@dataclasses.dataclass(frozen=True)
class Levels:
    """The values [SI] of one parameter: a single fixed value, a list, or a range with a count."""

    name: str
    values: tuple[float, ...]


@dataclasses.dataclass(frozen=True)
class Range:
    """A parameter drawn from a distribution on [low, high] [SI]."""

    name: str
    low: float
    high: float
    distribution: str
    mean: float  # of the normal distribution before it is cut to the range
    deviation: float


@dataclasses.dataclass(frozen=True)
class LandingStudy:
    """A study with all defaults filled in: everything on which its landings depend."""

    title: str
    question: str
    sampling: str
    samples: int  # of a Latin hypercube; 0 for a factorial
    seed: int
    maps: tuple[tuple[str, str], ...]
    policy: str | None  # the landings start from its entries into the goal box
    duration: float  # s
    timestep: float  # s
    parameters: tuple[Levels | Range, ...]  # those that the file names, in its order
    starts: tuple[tuple[float, ...], ...] = ()  # states (13,) of the entries, once they are flown
    vehicle: Vehicle = dataclasses.field(default_factory=load_vehicle)

    def fingerprint(self) -> str:
        """Return a hash of everything on which the results depend: study, vehicle, engine."""
        data = dataclasses.asdict(self)
        for name in ("title", "question", "maps"):
            del data[name]
        data["mujoco"] = mujoco.mj_versionString()
        data["numpy"] = np.__version__
        return hashlib.sha256(json.dumps(data, sort_keys=True).encode()).hexdigest()

    @property
    def varied(self) -> tuple[str, ...]:
        """Return the names of the parameters that vary."""
        return tuple(p.name for p in self.parameters if isinstance(p, Range) or len(p.values) > 1)

    @property
    def total(self) -> int:
        """Return the number of landings."""
        levels = math.prod(len(p.values) for p in self.parameters if isinstance(p, Levels))
        return self.samples or levels * max(1, len(self.starts))


def shipped() -> dict[str, Path]:
    """Return the shipped studies by name."""
    folder = Path(str(resources.files("inclined_landing.eval") / "landings"))
    return {path.stem: path for path in sorted(folder.glob("*.toml"))}


def read_study(name: str | Path, vehicle: Vehicle | None = None) -> LandingStudy:
    """Read a study file, or a shipped study by name, for a vehicle (default: the shipped one).

    Raises UserError, naming file and entry, for anything that is wrong.
    """
    path = shipped().get(str(name), Path(name))
    if not os.path.lexists(path):
        raise UserError(f"study {shown(path, 200)} does not exist (shipped ones: {', '.join(shipped())})")
    data = storage.read_toml(path, "study")
    try:
        return _resolved(schema.parse(data, StudyFile), vehicle or load_vehicle())
    except UserError as error:
        raise UserError(f"study {path}: {error}") from error


def _resolved(file: StudyFile, vehicle: Vehicle) -> LandingStudy:
    """Return the study of a file in SI units; raises UserError if its entries contradict each other."""
    hypercube, timestep = file.sampling == "latin-hypercube", file.simulation.timestep
    if hypercube != (file.samples is not None):
        raise UserError("a Latin hypercube needs samples; a factorial takes none")
    period = vehicle.command_control_period
    if timestep > period or abs(period / timestep - round(period / timestep)) > 1e-9:
        raise UserError(f"timestep must divide the control period of {period:g} s; {timestep:g} does not")
    if ("restitution" in file.parameters) != ("contact_time" in file.parameters):
        raise UserError("give both restitution and contact_time, or neither")
    known = known_parameters(vehicle)
    parameters = []
    for name, entry in file.parameters.items():
        if name not in known:
            raise UserError(f"unknown parameter {shown(repr(name), 40)}; {choices(known, name)}")
        if file.start.policy and known[name].at_touchdown:
            raise UserError(f"{name} cannot be set in a study that starts where a policy hands over")
        parameters.append(_parameter(known[name], entry, hypercube))
    study = LandingStudy(
        title=shown(file.title.strip(), 200),
        question=file.question.strip(),
        sampling=file.sampling,
        samples=file.samples or 0,
        seed=file.seed,
        maps=tuple(dict.fromkeys(file.maps)),
        policy=file.start.policy,
        duration=file.simulation.duration,
        timestep=timestep,
        parameters=tuple(parameters),
        vehicle=vehicle,
    )
    if not study.varied and not study.policy:
        raise UserError("no parameter varies; give at least one parameter a list or a range")
    if study.total > MOST_LANDINGS:
        raise UserError(f"the factorial has {study.total} landings, more than {MOST_LANDINGS}")
    for x, y in study.maps:
        if x == y or not {x, y} <= set(study.varied):
            raise UserError(f"the map of {shown(x, 40)} and {shown(y, 40)} needs two parameters that vary")
    return study


def _parameter(parameter: Parameter, entry: Varied, hypercube: bool) -> Levels | Range:
    """Return a parameter in SI units; raises UserError if its entry has no valid form."""
    name, unit, units = parameter.name, entry.unit, UNITS[parameter.kind]
    if unit not in units:
        raise UserError(f"parameter {name} needs a unit, {' or '.join(units)}, not {shown(repr(unit))}")
    named = {key for key, value in structs.asdict(entry).items() if value is not None} - {"unit"}
    needed, kinds = {"start", "stop", "count"}, "or from, to and count"
    if hypercube:
        normal = entry.distribution == "normal"
        needed = {"mean", "deviation"} if normal else {"start", "stop"}
        kinds = "from and to, or mean and deviation of a normal distribution"
    allowed = needed | {"start", "stop", "distribution"}
    if named not in ({"value"}, {"values"}) and not needed <= named <= allowed:
        raise UserError(f"parameter {name} needs one of value, values, {kinds}")
    numbers = entry.values if entry.value is None else (entry.value,)
    if numbers is not None:
        return Levels(name, tuple(_in_si(parameter, number, unit) for number in numbers))
    low = parameter.low if entry.start is None else _in_si(parameter, entry.start, unit)
    high = parameter.high if entry.stop is None else _in_si(parameter, entry.stop, unit)
    if low >= high:
        raise UserError(f"parameter {name}: the range is empty")
    distribution = entry.distribution or "uniform"
    mean, deviation = (units[unit] * (number or 0.0) for number in (entry.mean, entry.deviation))
    if distribution == "normal" and not low <= mean <= high:
        raise UserError(f"parameter {name}: the mean must be in the range")
    if entry.count is None:
        return Range(name, low, high, distribution, mean, deviation)
    return Levels(name, tuple(np.linspace(low, high, entry.count).tolist()))


def _in_si(parameter: Parameter, value: float, unit: str) -> float:
    """Return a value of the file in SI units; raises UserError beyond the parameter's bounds."""
    low, high, factor = parameter.low, parameter.high, UNITS[parameter.kind][unit]
    if not low - 1e-12 <= factor * value <= high + 1e-12:
        ends = f"from {low / factor:g} to {high / factor:g} {unit}".removesuffix(" 1")
        raise UserError(f"parameter {parameter.name} must be {ends}, not {value:g}")
    return min(max(factor * value, low), high)
