"""Reader of study files (TOML); README.md in this folder is their manual."""

from __future__ import annotations

import dataclasses
import hashlib
import json
import math
import os
from importlib import resources
from pathlib import Path
from typing import Annotated

import mujoco
import numpy as np
from msgspec import Meta, field

from inclined_landing.eval.landings.parameters import Parameter, known_parameters
from inclined_landing.models.base import schema, storage
from inclined_landing.models.base.errors import UserError, choices, shown
from inclined_landing.models.base.schema import Real, Table
from inclined_landing.models.parameters import load_vehicle
from inclined_landing.models.vehicle import Vehicle

MOST_LANDINGS = 5_000_000


class Spread(Table, frozen=True):
    """A range of a parameter: levels of a factorial, or a distribution of a Latin hypercube."""

    start: Real = field(name="from")
    stop: Real = field(name="to")
    count: Annotated[int, Meta(ge=2, le=MOST_LANDINGS)] | None = None  # of levels
    mean: Real | None = None  # of a normal distribution that is cut to the range; otherwise it is uniform
    deviation: Annotated[float, Meta(gt=0, le=1e300)] | None = None


Numbers = Annotated[tuple[Real, ...], Meta(min_length=1)]


class StudyFile(Table, frozen=True):
    """The content of a study file; the parameters are in their units."""

    parameters: Annotated[dict[str, Real | Numbers | Spread], Meta(min_length=1)]
    title: Annotated[str, Meta(max_length=200)] = ""
    question: Annotated[str, Meta(max_length=5000)] = ""
    samples: Annotated[int, Meta(ge=1, le=MOST_LANDINGS)] | None = None  # of a Latin hypercube
    seed: Annotated[int, Meta(ge=0, le=2**63 - 1)] = 0
    maps: tuple[tuple[str, str], ...] = ()
    policy: str | None = None


@dataclasses.dataclass(frozen=True)
class Levels:
    """The values [SI] of one parameter; a single one is fixed."""

    name: str
    values: tuple[float, ...]


@dataclasses.dataclass(frozen=True)
class Range:
    """A parameter drawn from [low, high] [SI]: uniformly, or from a normal distribution cut to the range."""

    name: str
    low: float
    high: float
    mean: float | None
    deviation: float | None


@dataclasses.dataclass(frozen=True)
class Study:
    """A study with all defaults filled in: everything on which its landings depend."""

    title: str
    question: str
    samples: int  # of a Latin hypercube; 0 for a factorial
    seed: int
    maps: tuple[tuple[str, str], ...]
    policy: str | None  # whose goal-box entries the landings start from
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


def read_study(name: str | Path, vehicle: Vehicle | None = None) -> Study:
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


def _resolved(file: StudyFile, vehicle: Vehicle) -> Study:
    """Return the study of a file in SI units; raises UserError if its entries contradict each other."""
    if ("restitution" in file.parameters) != ("contact_time" in file.parameters):
        raise UserError("give both restitution and contact_time, or neither")
    known = known_parameters(vehicle)
    parameters = []
    for name, entry in file.parameters.items():
        if name not in known:
            raise UserError(f"unknown parameter {shown(repr(name), 40)}; {choices(known, name)}")
        if file.policy and known[name].at_touchdown:
            raise UserError(f"{name} cannot be set in a study that starts where a policy hands over")
        parameters.append(_parameter(known[name], entry, file.samples is not None))
    study = Study(
        title=shown(file.title.strip(), 200),
        question=file.question.strip(),
        samples=file.samples or 0,
        seed=file.seed,
        maps=tuple(dict.fromkeys(file.maps)),
        policy=file.policy,
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


def _parameter(parameter: Parameter, entry: float | Numbers | Spread, hypercube: bool) -> Levels | Range:
    """Return a parameter in SI units; raises UserError for values that it cannot have."""
    name = parameter.name
    if not isinstance(entry, Spread):
        numbers = entry if isinstance(entry, tuple) else (entry,)
        return Levels(name, tuple(parameter.in_si(number) for number in numbers))
    low, high = parameter.in_si(entry.start), parameter.in_si(entry.stop)
    if low >= high:
        raise UserError(f"parameter {name}: the range is empty")
    if entry.count is not None and not hypercube and entry.mean is entry.deviation is None:
        return Levels(name, tuple(np.linspace(low, high, entry.count).tolist()))
    if entry.count is not None or not hypercube or (entry.mean is None) != (entry.deviation is None):
        raise UserError(
            f"parameter {name} needs from, to and count; in a study with samples, from and to and optionally "
            "mean and deviation"
        )
    if entry.mean is None or entry.deviation is None:
        return Range(name, low, high, None, None)
    if not entry.start <= entry.mean <= entry.stop:
        raise UserError(f"parameter {name}: the mean must be in the range")
    return Range(name, low, high, parameter.factor * entry.mean, parameter.factor * entry.deviation)
