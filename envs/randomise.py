"""Randomised vehicles: a file of ranges, and the pool of vehicles that is drawn from it.

A file of ranges is TOML. Every range is [lowest, highest]; equal ends fix the number:

    nominal = 0.1               # share of episodes with the unchanged vehicle file (default: 0)
    probability = 0.5           # probability that a vehicle has an effect (default: 1)

    [effects.thrust_scale]      # an effect of the library by name, with its parameters; others are neutral
    scale = [0.8, 1.1]
    probability = 1             # probability of this effect

    [effects.wind]
    x = [-1, 1]
    y = [-1, 1]

    [body]                      # tables and entries of the vehicle file, in its units
    mass = [0.027, 0.032]
    inertia = [[1.5e-5, 1.8e-5], [1.5e-5, 1.8e-5], [2.6e-5, 3.2e-5]]

Entries are set first and effects applied on top, in their order. Every number of a pool is distributed over
its range independently of the others, either uniformly or, for policies trained in the plane, more densely
towards its ends. Entries that all vehicles of a plant share cannot have a range: commands, arena, and the
platform except for its surface_height (the effects platform_height and platform_tilt move it).

Mass, inertia, arms, thrust and loops of real vehicles are correlated, and independent ranges would include
impossible vehicles. Instead, a file may therefore list vehicles, as files or shipped names, between which
vehicles are drawn:

    vehicles = ["crazyflie-2.0", "crazyflie-2.1", "hummingbird"]

Drawn vehicles are distributed uniformly over the whole list and half an interval beyond each end, where the
end itself is used, so that all listed vehicles have the same share. Between two neighbours all numbers of the
tables body, thrust, motor, rotor, drag and attitude are interpolated by the same share, geometrically if both
ends have the same sign, so that power laws, ratios and thrust to weight are interpolated too. Entries and
effects are set on top.

`landing-train --randomise FILE` reads such a file. Two files are shipped: `robust` contains the whole library
of effects, slightly beyond their plausible sizes; `vehicles` contains quadrotors from 28 g to 0.5 kg.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from importlib import resources
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from msgspec import Meta, Struct

from inclined_landing.models.base import schema, storage
from inclined_landing.models.base.errors import UserError, choices, shown
from inclined_landing.models.base.schema import Share
from inclined_landing.models.effects import LIBRARY
from inclined_landing.models.parameters import Constant, check_vehicle, constants, load_vehicle
from inclined_landing.models.vehicle import Vehicle

Range = tuple[float, float]

POOL = 256  # vehicles that a run draws
_FOLDER = Path(str(resources.files("inclined_landing.envs") / "shipped"))
_COMMON = ("command", "arena", "rotor", "platform")  # tables that all vehicles of a plant share
_OF_THE_VEHICLE = ("body_", "thrust_", "motor_", "rotor_", "drag_", "attitude_")  # fields, by their beginning
_EXCEPT = "platform.surface_height"
_STREAM = 7_000_003  # of random numbers, beside those that starts come from


class _General(Struct, frozen=True):
    """Entries of a file outside its tables."""

    nominal: Share = 0.0
    probability: Share = 1.0
    vehicles: Annotated[tuple[str, ...], Meta(min_length=2)] = ()


@dataclasses.dataclass(frozen=True)
class Ranges:
    """The content of a file of ranges."""

    given: dict[str, Any]  # the content of the file
    nominal: float  # share of the episodes
    fields: dict[str, tuple[Range, ...]]  # field of Vehicle -> of each of its numbers
    effects: dict[str, dict[str, Range]]  # effect -> parameter -> range
    probability: dict[str, float]  # of each of these effects
    what: str  # in sentences
    vehicles: tuple[Vehicle, ...] = ()  # between which drawn ones lie, neighbours beside each other

    def draw(
        self,
        vehicle: Vehicle,
        seed: int,
        count: int = POOL,
        *,
        to_the_ends: bool = False,
        alone: float = 0.0,
    ) -> list[Vehicle]:
        """Draw `count` vehicles from a seed; raises UserError if one of them is impossible.

        to_the_ends: numbers have the arcsine distribution over their range, with 41 % of them in its outer
        tenths, instead of the uniform one with 20 %. The most difficult vehicles are near the ends, and
        policies do not extrapolate to them.

        alone: share of the vehicles that have one effect, each equally often, besides those that all have
        (of probability 1).
        """
        rng = np.random.default_rng([_STREAM, seed])

        def spread(low: float, high: float) -> np.ndarray:
            return low + (high - low) * (rng.permutation(count) + rng.random(count)) / count

        def values_in(low: float, high: float) -> np.ndarray:
            u = spread(0.0, 1.0)
            return low + (high - low) * (0.5 - 0.5 * np.cos(np.pi * u) if to_the_ends else u)

        entries = {f: np.stack([values_in(*r) for r in ranges], axis=1) for f, ranges in self.fields.items()}
        present = {name: spread(0.0, 1.0) < chance for name, chance in self.probability.items()}
        optional = [present[name] for name, chance in self.probability.items() if 0.0 < chance < 1.0]
        ones = np.arange(round(alone * count))
        for k, has in enumerate(optional):
            has[ones] = ones % len(optional) == k
        sizes = {
            name: {parameter: values_in(*r) for parameter, r in ranges.items()}
            for name, ranges in self.effects.items()
        }
        last = len(self.vehicles) - 1.0
        places = np.clip(spread(-0.5, last + 0.5), 0.0, last) if self.vehicles else None
        drawn = []
        for k in range(count):
            base = vehicle if places is None else between(self.vehicles, float(places[k]), vehicle)
            member = _with_entries(base, {f: rows[k].tolist() for f, rows in entries.items()})
            for name, columns in sizes.items():
                if present[name][k]:
                    values = {parameter: float(column[k]) for parameter, column in columns.items()}
                    member = LIBRARY[name].apply(member, values)
            drawn.append(member)
        self._check(drawn)
        return drawn

    def each_alone(self, vehicle: Vehicle) -> list[Vehicle]:
        """Return vehicles with one deviation each; raises UserError if one of them is impossible.

        An effect has its plausible size; if its ranges do not include that, one vehicle has their lower and
        one their upper ends. Entries, which may depend on each other, are at their lower ends in one vehicle
        and at their upper ends in another. The file's vehicles follow.
        """
        alone = []
        for name, ranges in self.effects.items():
            size = LIBRARY[name].plausible
            within = all(low <= size[parameter] <= high for parameter, (low, high) in ranges.items())
            ends = [{parameter: r[end] for parameter, r in ranges.items()} for end in (0, 1)]
            sizes = [{p: size[p] for p in ranges}] if within else ends
            alone += [LIBRARY[name].apply(vehicle, values) for values in sizes]
        for end in (0, 1) if self.fields else ():
            numbers = {name: [r[end] for r in entries] for name, entries in self.fields.items()}
            alone.append(_with_entries(vehicle, numbers))
        alone += [between(self.vehicles, float(k), vehicle) for k in range(len(self.vehicles))]
        self._check(alone)
        return alone

    def _check(self, vehicles: Sequence[Vehicle]) -> None:
        for vehicle in vehicles:
            try:
                check_vehicle(vehicle)
            except UserError as error:
                raise UserError(f"{self.what} contains impossible vehicles: {error}") from error


def _with_entries(vehicle: Vehicle, numbers: dict[str, list[float]]) -> Vehicle:
    """Return a vehicle with new numbers in some fields; a field with one number takes a list of one."""
    tuples = {name: isinstance(getattr(vehicle, name), tuple) for name in numbers}
    return vehicle.changed(**{name: tuple(x) if tuples[name] else x[0] for name, x in numbers.items()})


def between(vehicles: Sequence[Vehicle], place: float, like: Vehicle) -> Vehicle:
    """Return the vehicle at a position in the list of `vehicles`, 0 for the first; arena etc. are those of
    `like`.

    Each number is interpolated by the same share: geometrically if it has the same sign in both neighbours,
    else linearly.
    """
    k = min(int(place), len(vehicles) - 2)
    share, (one, other) = place - k, vehicles[k : k + 2]
    fields = {}
    for field, value in vars(one).items():
        if field.startswith(_OF_THE_VEHICLE):
            a, b = np.asarray(value, float), np.asarray(getattr(other, field), float)
            same_sign = a * b > 0.0
            one_size, other_size = (np.where(same_sign, np.abs(x), 1.0) for x in (a, b))
            size = one_size ** (1.0 - share) * other_size**share
            mixed = np.where(same_sign, np.sign(a) * size, (1.0 - share) * a + share * b)
            mixed = np.where(a == b, a, mixed)  # whole numbers stay whole
            fields[field] = tuple(mixed.tolist()) if isinstance(value, tuple) else float(mixed)
    return like.changed(**fields)


def shipped() -> list[str]:
    """Return the names of the shipped files."""
    return sorted(path.stem for path in _FOLDER.glob("*.toml"))


def locate(name: str | Path) -> Path:
    """Return the path of a file of ranges: a shipped one by name, otherwise a file."""
    return _FOLDER / f"{name}.toml" if str(name) in shipped() else Path(name)


def read_ranges(name: str | Path) -> Ranges:
    """Read the ranges in a file, or in a shipped one by name.

    Raises UserError for a malformed file, or for entries that cannot vary between vehicles.
    """
    what = f"randomise file {name}"
    data = storage.read_toml(locate(name), "randomise file")
    general = {key: value for key, value in data.items() if key in _General.__struct_fields__}
    file = schema.parse(general, _General, f"{what}: ")
    try:
        vehicles = tuple(load_vehicle(vehicle) for vehicle in file.vehicles)
    except UserError as error:
        raise UserError(f"{what}: {error}") from error
    entries = {constant.label: constant for constant in constants()}
    fields, effects, probability = {}, {}, {}
    for table, lines in data.items():
        if table in general:
            continue
        if not isinstance(lines, dict):
            raise UserError(f"{what}: {shown(table, 40)} is outside any table")
        for key, value in lines.items():
            label = f"{table}.{key}"
            if table == "effects" and isinstance(value, dict):
                ranges = dict(value)
                chance = ranges.pop("probability", file.probability)
                probability[key] = schema.parse(chance, Share, f"{what}: ", f"{label}.probability")
                effects[key] = _of_effect(key, ranges, what)
                continue
            if label not in entries:
                other = "an effect with parameters, like [effects.thrust_scale], or " * (table == "effects")
                raise UserError(f"{what}: {shown(label, 60)} is not {other}an entry of the vehicle file")
            if table in _COMMON and label != _EXCEPT:
                raise UserError(f"{what}: {label} cannot vary between vehicles")
            fields[entries[label].field] = _of_entry(entries[label], value, what)
    if not (fields or effects or vehicles):
        raise UserError(f"{what} contains no range, such as scale = [0.8, 1.1] in [effects.thrust_scale]")
    return Ranges(data, file.nominal, fields, effects, probability, what, vehicles)


def _of_effect(name: str, ranges: dict, what: str) -> dict[str, Range]:
    if name not in LIBRARY:
        raise UserError(f"{what}: unknown effect {shown(name, 40)}; {choices(LIBRARY, name)}")
    known = {p.name: p for p in LIBRARY[name].parameters}
    for key in ranges:
        if key not in known:
            raise UserError(
                f"{what}: effect {name} has no parameter {shown(key, 40)}; choose from {', '.join(known)}"
            )
    if not ranges:
        raise UserError(f"{what}: effect {name} has no range; its parameters are {', '.join(known)}")
    return {
        key: _range(value, known[key].bounds, f"effects.{name}.{key}", what) for key, value in ranges.items()
    }


def _of_entry(entry: Constant, value: Any, what: str) -> tuple[Range, ...]:
    if not isinstance(entry.value, tuple):
        return (_range(value, entry.range[0], entry.label, what),)
    ranges = schema.parse(value, list[Any], f"{what}: ", entry.label)
    if len(ranges) != len(entry.range):
        raise UserError(f"{what}: {entry.label} must be {len(entry.range)} ranges, not {len(ranges)}")
    return tuple(_range(x, limits, entry.label, what) for x, limits in zip(ranges, entry.range))


def _range(value: object, limits: Range, label: str, what: str) -> Range:
    """Return a range within limits; raises UserError for any other value."""
    number = Annotated[float, Meta(ge=limits[0], le=limits[1])]
    low, high = schema.parse(value, tuple[number, number], f"{what}: ", label)  # type: ignore[valid-type]
    if low > high:
        raise UserError(f"{what}: {label} has its lower end {low:g} above its upper end {high:g}")
    return low, high
