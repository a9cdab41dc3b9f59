"""Every file that people write in TOML, with one entry wrong, as another text and in other places.

An entry of `READERS` is all that a new kind of file needs.
"""

import dataclasses
import functools
import itertools
import tempfile
import tomllib
from collections.abc import Callable
from importlib import resources
from pathlib import Path

import hypothesis.strategies as st
import numpy as np
import pytest
from hypothesis import given

from inclined_landing.envs.randomise import read_ranges
from inclined_landing.envs.tasks.base import hover_states
from inclined_landing.eval.landings import design
from inclined_landing.eval.landings.study import Levels, Study, known_parameters, read_study
from inclined_landing.eval.logs import read_log
from inclined_landing.eval.moving.scenario import Scenario, read_scenario, shipped
from inclined_landing.models.parameters import load_vehicle
from inclined_landing.models.plants import PLANTS, make_plant
from inclined_landing.models.vehicle import Vehicle
from tests.campaign.flights import a_flight, fly, text
from tests.campaign.judge import (
    Case,
    Wrong,
    contents,
    examples,
    judged,
    places,
    spoilt,
    toml,
    write,
)

DURATION = 0.1  # s, of a flight of a vehicle


@dataclasses.dataclass(frozen=True)
class Reader:
    """A kind of file: a good one, what reads it, and what then must hold."""

    good: str
    take: Callable[[Path], object]
    works: Callable[[object], None] = lambda result: None
    named: str | None = None  # what sentences name; None: the file
    where: Callable[[tuple], bool] = lambda keys: True  # which entries are spoilt
    more: dict[str, Callable[[], str]] = dataclasses.field(default_factory=dict)  # other contents, by name


def flies(vehicle: Vehicle) -> None:
    """0.1 s from hover in all plants, finite."""
    for kind in PLANTS:
        plant = make_plant(kind, 1, vehicle)
        position = np.array([[1.0, 0.5, vehicle.platform_surface_height + 0.5]])
        plant.reset(np.arange(1), hover_states(position, vehicle))
        command = np.array([[min(vehicle.hover_pwm, vehicle.command_pwm_range[1]), 0.0, 0.0, 0.0]])
        for _ in range(round(DURATION / plant.control_period) or 1):
            plant.step(command)
        if not (np.isfinite(plant.state).all() and np.abs(plant.state).max() < 1e7):
            raise Wrong(f"{kind}: {plant.state}")


def can_be_simulated(study: Study) -> None:
    """Drawn, every parameter lies within its bounds."""
    assert 1 <= design.total(study) <= 5_000_000
    if design.total(study) > 100_000:
        return
    known = known_parameters()
    drawn, start = design.design(study)
    assert len(start) == design.total(study)
    for p in study.parameters:
        values = drawn[p.name]
        assert np.isfinite(values).all() and known[p.name].low <= values.min()
        assert values.max() <= known[p.name].high
        assert isinstance(p, Levels) or np.ptp(values) > 0 or design.total(study) == 1


def can_be_landed_on(scenario: Scenario) -> None:
    """Its platforms stay finite, and there is time to rest for as long as is asked."""
    drawn = scenario.draw(load_vehicle(), 2)
    assert all(np.isfinite(array).all() for array in (drawn.start, drawn.azimuth, *drawn.motion.at(1.0)))
    assert scenario.success.hold < scenario.success.within


def is_value_or_of_mass(keys: tuple) -> bool:
    """All entries of a vehicle have the same fields, and one reader: unit, source ... of one do for all."""
    return len(keys) < 3 or keys[1] == "mass" or keys[2:] == ("value",)


def ranges_drawn(path: Path) -> list[Vehicle]:
    return read_ranges(path).draw(load_vehicle(), 0, 3)


@functools.cache
def _log_folder() -> tempfile.TemporaryDirectory:
    holder = tempfile.TemporaryDirectory()
    write(Path(holder.name, "log.csv"), text(a_flight()))
    return holder


def mapped(path: Path):
    return read_log(Path(_log_folder().name, "log.csv"), mapping=path)


VEHICLE = (resources.files("inclined_landing.models") / "crazyflie.toml").read_text("utf-8")
RANGES = """
nominal = 0.1
probability = 0.5
vehicles = ["crazyflie-2.0", "crazyflie-2.1"]
[effects]
wind = { x = [-1, 1], y = [0, 0], probability = 1.0 }
mass = { scale = [0.8, 1.1] }
[body]
mass = [0.027, 0.032]
inertia = [[1.5e-5, 1.8e-5], [1.5e-5, 1.8e-5], [2.6e-5, 3.2e-5]]
"""
STUDY = """
title = "small"
question = "none"
sampling = "latin-hypercube"
samples = 12
seed = 5
maps = [["inclination", "mass"]]

[simulation]
duration = 0.4
timestep = 0.004

[parameters]
inclination = { from = 10, to = 40, unit = "deg" }
friction = { values = [0.5, 1.0], unit = "1" }
mass = { mean = 33, deviation = 3, from = 28, to = 42, unit = "g", distribution = "normal" }
thrust = { from = 0.1, to = 1, unit = "1", distribution = "log-uniform" }
"""
FACTORIAL = """
sampling = "factorial"

[start]
policy = "landing"

[parameters]
friction = { from = 0.2, to = 1.0, count = 3, unit = "1" }
mass = { value = 33, unit = "g" }
"""
MAPPING = """
description = "a lab"
detect = ["cmd_thrust_pwm"]
euler = "ZXY"
notes = ["a note"]
[columns]
t = { column = "t", unit = "s", late = 0.0 }
x = { column = "x", unit = "m", sign = 1, add = 0.0, late = 0.0 }
y = ["absent", { column = "y" }]
z = { mean = ["z", "z"] }
roll = { sum = ["roll", "roll"] }
pitch = "pitch"
cmd_thrust_pwm = "cmd_thrust_pwm"
"""


def spelt(tables: dict) -> str:
    """Tables as TOML."""
    return "\n".join(f"{toml(key)} = {toml(value)}" for key, value in tables.items())


def units_and_bounds() -> dict[str, Callable[[], str]]:
    """Every parameter of a study in every unit, between bounds that are none."""
    bounds = ((-1e300, 1e300), (0, 5e-324), (1, 1), (2, 1), (1e-300, 1))
    found = {}
    for name, unit, (low, high) in itertools.product(
        known_parameters(), ("1", "m", "deg", "s", "kg", "parsec"), bounds
    ):
        entry = {"from": low, "to": high, "unit": unit}
        content = {"sampling": "latin-hypercube", "samples": 3, "parameters": {name: entry}}
        found[f"{name} {unit} {low} {high}"] = functools.partial(spelt, content)
    return found


def instead(good: str, old: str, *new: str) -> dict[str, Callable[[], str]]:
    """A good file with other words in place of some."""
    return {f"{word[:30]}": functools.partial(good.replace, old, word) for word in new}


COUNTS = (1, 10**6, 10**7, 10**12, 10**30)
MANY = f"values = {[30 + k / 1e4 for k in range(40_000)]}"
PAIR = '["inclination", "mass"]'
COLUMNS = "[columns]\n" + "".join(f'{c} = "{c}"\n' for c in ("t", "y", "z", "roll", "cmd_thrust_pwm"))
INHERITED = {  # what no other file of TOML has: inheritance, and patterns of names
    "itself": 'inherit = "mapping.toml"\n',
    "none": 'inherit = "/none/such.toml"\n' + COLUMNS,
    "a folder": 'inherit = "/"\n' + COLUMNS,
    "a device": 'inherit = "/dev/zero"\n' + COLUMNS,
    "shipped": 'inherit = "documented"\n',
    "refuses": f'refuse = "{"x" * 100}"\n' + COLUMNS,
    "twice": COLUMNS + 't = "t"',
    "stars": COLUMNS + f'x = "{"*" * 5000}"',
    "brackets": COLUMNS + f'x = "*{"[" * 5000}"',
    "long": COLUMNS + f'x = "{"x" * 100_000}"',
}
READERS = {
    "vehicle": Reader(VEHICLE, load_vehicle, flies, where=is_value_or_of_mass),
    "ranges": Reader(RANGES, ranges_drawn),
    "study": Reader(
        STUDY,
        read_study,
        can_be_simulated,
        more=units_and_bounds()
        | instead(STUDY, "samples = 12", *(f"samples = {count}" for count in COUNTS))
        | instead(STUDY, PAIR, f"{PAIR}," * 5000),
    ),
    "factorial": Reader(
        FACTORIAL,
        read_study,
        can_be_simulated,
        more=instead(FACTORIAL, "count = 3", *(f"count = {count}" for count in COUNTS))
        | instead(FACTORIAL, "value = 33", MANY),
    ),
    "scenario": Reader(shipped()["ship_5_bow"].read_text("utf-8"), read_scenario, can_be_landed_on),
    "mapping": Reader(  # the log is what lacks a column that is mapped
        MAPPING, mapped, fly, named="", more={name: lambda c=c: c for name, c in INHERITED.items()}
    ),
}


def case(kind: str, name: str, make: Callable[[], str | bytes]) -> Case:
    """A file of a kind."""
    reader = READERS[kind]

    def made(folder: Path) -> Path:
        return write(folder / f"{kind}.toml", make())

    return Case(f"{kind} {name}", made, reader.take, reader.works, named=reader.named)


def odd(good: bytes) -> dict[str, Callable[[], bytes]]:
    """Good files in other encodings, deep, long and large ones."""
    lines = good.splitlines(keepends=True)
    begun = good + b"[x]\n"
    return {
        "byte order mark": lambda: good.decode().encode("utf-8-sig"),
        "UTF-16": lambda: good.decode().encode("utf-16"),
        "Latin 1": lambda: b"# \xe9\n" + good,
        "NUL bytes": lambda: good + bytes(100),
        "CR LF": lambda: good.replace(b"\n", b"\r\n"),
        "twice": lambda: good + good,
        "a line twice": lambda: good + lines[-1],
        "nested lists": lambda: b"x = " + b"[" * 100_000,
        "nested over lines": lambda: b"x = " + b"[\n" * 100_000,
        "nested in tables": lambda: b"x = " + b"{a=" * 10_000,
        "long key": lambda: good + b"[" + b"a." * 10_000 + b"a]\n",
        "dotted key": lambda: begun + b"a." * 200_000 + b"a = 1\n",
        "many dotted keys": lambda: (
            begun + b"".join(b"a%d." % k + b"a." * 300 + b"a = 1\n" for k in range(1000))
        ),
        "many entries": lambda: begun + b"".join(b"x%d = 1\n" % k for k in range(50_000)),
        "many tables": lambda: good + b"".join(b"[x%d]\n" % k for k in range(50_000)),
        "a million digits": lambda: b"x = " + b"9" * 900_000 + b"\n" + good,
        "long number": lambda: b"x = 0.0" + b"3" * 900_000 + b"\n" + good,
        "too long": lambda: good + b"#" * 30_000_000,
    }


@functools.cache
def files(kind: str) -> st.SearchStrategy[Case]:
    """Draw a good file with one entry wrong, one with other contents, or what is no file."""
    reader = READERS[kind]
    tables, good = tomllib.loads(reader.good), reader.good.encode()
    entries = spoilt(tables, reader.where).map(lambda s: (s[0], lambda: spelt(s[1](tables))))
    texts = [entries, contents(good, odd(good))]
    texts += [st.sampled_from(list(reader.more.items()))] if reader.more else []
    return st.one_of(texts).map(lambda s: case(kind, *s)) | places(f"{kind}.toml", reader.take)


@pytest.mark.parametrize("kind", READERS)
@examples(8)
@given(data=st.data())
def test_files_are_used_or_refused(kind, data):
    judged(data.draw(files(kind)))


@pytest.mark.parametrize("kind", READERS)
def test_good_files_are_used(kind):
    good = READERS[kind].good
    assert judged(case(kind, "good", lambda: spelt(tomllib.loads(good)))) == "works"


def test_mappings_that_inherit_from_each_other_are_refused():
    def loop(folder: Path) -> Path:
        for k in range(30):
            write(folder / f"m{k}.toml", f'inherit = "{folder}/m{(k + 1) % 30}.toml"\n')
        return folder / "m0.toml"

    assert judged(Case("loop", loop, mapped, named="")) != "works"
