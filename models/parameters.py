"""Reader of `crazyflie.toml`, the only source of every physical constant.

`load_vehicle()` returns the values as a frozen :class:`Vehicle`; `constants()` returns range, unit, source
and uncertainty of each value. Vehicle files and vehicles made in Python are checked against the ranges of the
shipped file and for consistency (`plausible.py`).
"""

from __future__ import annotations

import dataclasses
import functools
import itertools
import json
from collections.abc import Mapping
from importlib import resources
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from msgspec import Meta

from inclined_landing.models import plausible
from inclined_landing.models.base import schema, storage
from inclined_landing.models.base.errors import UserError, first_of, shown
from inclined_landing.models.vehicle import Vehicle

_SHIPPED = "crazyflie.toml"
Size = Annotated[float, Meta(ge=0, le=1e300)]
_BASE, _BASED_ON = "crazyflie-2.1", "based_on"  # the latter begins a file that holds only what differs
_FOLDER = Path(str(resources.files("inclined_landing.models").joinpath("vehicles")))


class Entry(schema.Table, frozen=True):
    """One entry as written in a vehicle file."""

    value: schema.Real | tuple[schema.Real, ...]
    unit: str
    source: str
    uncertainty: str | Size | tuple[Size, ...]
    range: Any = None  # the shipped one, or none


@dataclasses.dataclass(frozen=True)
class Constant:
    """One entry of the vehicle file."""

    section: str
    name: str
    value: float | tuple[float, ...]
    range: tuple[tuple[float, float], ...]  # lowest and highest of each number
    unit: str
    source: str
    uncertainty: float | tuple[float, ...] | str

    @property
    def label(self) -> str:
        """Return the name for messages, as in the file."""
        return f"{self.section}.{self.name}"

    @property
    def field(self) -> str:
        """Return the name of the field of `Vehicle`."""
        return f"{self.section}_{self.name}"


def vehicle_names() -> list[str]:
    """Return the names of the shipped vehicles; `crazyflie-2.1` is that of `crazyflie.toml`."""
    return sorted([_BASE, *(path.stem for path in _FOLDER.glob("*.toml"))])


def locate_vehicle(name: str | Path) -> Path:
    """Return the path of a vehicle file: a shipped one by name, otherwise a file."""
    if str(name) not in vehicle_names():
        return storage.as_path(name, "vehicle file")
    return _FOLDER.parent / _SHIPPED if str(name) == _BASE else _FOLDER / f"{name}.toml"


def constants(path: str | Path | None = None) -> list[Constant]:
    """Return every entry of a vehicle file, or of a shipped one by name, in the order of `crazyflie.toml`.

    A file that begins with `based_on`, a shipped name, may lack entries, which are then that vehicle's.
    Ranges and units are the shipped ones; an entry may repeat its range. Raises UserError, naming file and
    entry, when the file is unreadable or an entry is missing, unknown or not what it should be.
    """
    if path is None:
        return list(_shipped().values())
    tables = storage.read_toml(locate_vehicle(path), "vehicle file")
    shipped, what = _shipped(), f"vehicle file {path}"
    based_on = tables.pop(_BASED_ON, None)
    if based_on is not None and based_on not in vehicle_names():
        names = ", ".join(vehicle_names())
        raise UserError(f"{what}: {_BASED_ON} must be one of {names}, not {shown(repr(based_on), 40)}")
    tables_read = schema.parse(tables, dict[str, dict[str, Entry]], f"{what}: ")
    found = {
        f"{section}.{name}": entry for section, table in tables_read.items() for name, entry in table.items()
    }
    known = {c.label for c in shipped.values()}
    if unknown := [label for label in found if label not in known]:
        raise UserError(f"{what} has unknown entries: {first_of(unknown)}")
    missing = [c.label for c in shipped.values() if c.label not in found]
    if missing and based_on is None:
        raise UserError(
            f"{what} lacks entries: {first_of(missing)}; a file that contains only "
            f'differences begins with {_BASED_ON} = "{_BASE}"'
        )
    return [
        _constant(found[like.label], like, f"{what}: ") if like.label in found else like
        for like in (constants(based_on) if based_on else shipped.values())
    ]


@functools.lru_cache(maxsize=1)
def _shipped() -> dict[str, Constant]:
    """Return the shipped entries by the names of `Vehicle`'s fields."""
    result = {}
    for section, table in storage.read_toml(locate_vehicle(_BASE), "vehicle file").items():
        for name, entry in table.items():
            value, spread, uncertainty = (_tuples(entry[k]) for k in ("value", "range", "uncertainty"))
            if not isinstance(spread[0], tuple):
                spread = (spread,) * (len(value) if isinstance(value, tuple) else 1)
            constant = Constant(section, name, value, spread, entry["unit"], entry["source"], uncertainty)
            result[constant.field] = constant
    return result


def _constant(entry: Entry, like: Constant, where: str) -> Constant:
    """Return one entry of another vehicle file, checked against the shipped one."""
    value, what = _checked(entry.value, like, where), f"{where}{like.label}"
    if entry.unit != like.unit:
        raise UserError(f"{what} must be in {like.unit!r}, not in {shown(repr(entry.unit), 40)}")
    if entry.range is not None and _tuples(entry.range) not in (like.range, like.range[0]):
        raise UserError(f"{what} must not have a range; the ranges are those of {_SHIPPED}")
    uncertainty = entry.uncertainty
    if isinstance(uncertainty, tuple) and np.shape(uncertainty) != np.shape(value):
        raise UserError(f"{what}: its uncertainty must be text, one number, or one for each of its values")
    return Constant(like.section, like.name, value, like.range, like.unit, entry.source, uncertainty)


def _checked(value: Any, like: Constant, where: str = "") -> float | tuple[float, ...]:
    """Return the value of an entry as numbers within their range; where: the beginning of a message."""
    several = isinstance(like.value, tuple)
    kind = tuple[(schema.Real,) * len(like.range)] if several else schema.Real  # type: ignore[misc]
    try:
        schema.check({like.label: value}, {like.label: kind})
    except UserError as error:
        raise UserError(f"{where}{error}") from error
    numbers = tuple(map(float, value if several else (value,)))
    units = like.unit.split(", ")
    for k, (number, (low, high)) in enumerate(zip(numbers, like.range)):
        if not low <= number <= high:
            unit = units[k % len(units)]
            unit = "" if unit == "1" else f" {unit}"
            raise UserError(
                f"{where}{like.label} is {number:g}{unit}; it must be from {low:g} to {high:g}{unit}"
            )
    return numbers if several else numbers[0]


def load_vehicle(path: str | Path | None = None) -> Vehicle:
    """Read a vehicle file, or a shipped vehicle by name (default: the Crazyflie 2.1).

    Raises UserError, naming file and entry, when an entry is missing, unknown, of another type or outside
    its range, or when entries contradict each other.
    """
    if path is None:
        return _crazyflie()
    values: dict[str, Any] = {c.field: c.value for c in constants(path)}
    vehicle = Vehicle(**values)
    for sentence in itertools.chain(plausible.contradictions(vehicle), plausible.misplaced(vehicle)):
        raise UserError(f"vehicle file {path}: {sentence}")
    return vehicle


@functools.lru_cache(maxsize=1)
def _crazyflie() -> Vehicle:
    values: dict[str, Any] = {field: c.value for field, c in _shipped().items()}
    return Vehicle(**values)


def as_vehicle(vehicle: Vehicle | str | Path | None) -> Vehicle:
    """Return a vehicle: the one given, or as `load_vehicle` reads it; raise UserError for anything else."""
    if vehicle is None or isinstance(vehicle, (str, Path)):
        return load_vehicle(vehicle)
    if not isinstance(vehicle, Vehicle):
        raise UserError(f"vehicle must be a Vehicle or the path of a file, not {shown(repr(vehicle), 40)}")
    return vehicle


def check_vehicle(vehicle: Vehicle) -> None:
    """Raise UserError, naming the entry, if a value is outside its range or contradicts another.

    Platforms may be outside the limits of the tasks (`plausible.misplaced`), because fits of their tilt try
    such values.
    """
    if not isinstance(vehicle, Vehicle):
        raise UserError(f"expected a Vehicle, not {shown(repr(vehicle), 40)}")
    for field, constant in _shipped().items():
        value = getattr(vehicle, field)
        numbers = value if isinstance(value, tuple) else (value,)
        # Nearly all are floats within their ranges, and the check of the others takes ten times as long.
        within = (type(x) is float and low <= x <= high for x, (low, high) in zip(numbers, constant.range))
        alike = type(value) is type(constant.value) and len(numbers) == len(constant.range)
        if not (alike and all(within)):
            _checked(value, constant)
    for sentence in plausible.contradictions(vehicle):
        raise UserError(sentence)


def write_vehicle(
    path: str | Path,
    vehicle: Vehicle,
    sources: Mapping[str, str] | None = None,
    uncertainties: Mapping[str, float | tuple[float, ...] | str] | None = None,
    *,
    base: str | Path | None = None,
    heading: str = "",
    brief: bool = False,
) -> None:
    """Write `vehicle` atomically as a file that `load_vehicle` reads back exactly.

    The file has no ranges, because these do not belong to the vehicle. sources, uncertainties: by field
    (`body_mass`), for fields that differ from the vehicle file `base` (default: the shipped one); other
    entries keep theirs. heading: a comment at the top. brief: write `based_on` with the name `base`, a
    shipped vehicle, and only the entries that differ. Raises UserError when the file cannot be written.
    """
    sources, uncertainties = sources or {}, uncertainties or {}
    lines = [f"# {line}".rstrip() for line in heading.splitlines()]
    if brief:
        lines += ["", f"{_BASED_ON} = {_toml(str(base or _BASE))}"]
    section = None
    for c in constants(base):
        if brief and getattr(vehicle, c.field) == c.value:
            continue
        if c.section != section:
            section = c.section
            lines += ["", f"[{section}]"]
        value, source, uncertainty = getattr(vehicle, c.field), c.source, c.uncertainty
        if value != c.value:
            source = sources.get(c.field, f"changed from {_toml(c.value)}")
            uncertainty = uncertainties.get(c.field, "not known")
        lines.append(
            f"{c.name} = {{ value = {_toml(value)}, unit = {_toml(c.unit)}, source = {_toml(source)}, "
            f"uncertainty = {_toml(uncertainty)} }}"
        )
    storage.write_text(path, "\n".join(lines).lstrip("\n") + "\n")


def _toml(value: Any) -> str:
    if isinstance(value, str):
        return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
    if isinstance(value, (tuple, list)):
        return "[" + ", ".join(repr(float(x)) for x in value) + "]"
    return repr(float(value))


def _tuples(value: Any) -> Any:
    return tuple(map(_tuples, value)) if isinstance(value, list) else value
