"""Vehicle files: refused in one sentence, or flown."""

import copy
import dataclasses
import inspect
import random
import tomllib
from importlib import resources

import numpy as np
import pytest

from campaign.judge import (
    EVIL,
    Case,
    Wrong,
    command,
    judge,
    mutations,
    parametrised,
    places,
    somewhere,
    toml,
    write,
)
from inclined_landing.envs.tasks.base import hover_states
from inclined_landing.eval import cli
from inclined_landing.models.errors import UserError
from inclined_landing.models.parameters import check_vehicle, constants, load_vehicle
from inclined_landing.models.plants import PLANTS, make_plant
from inclined_landing.train import cli as train

TEXT = (resources.files("inclined_landing.models") / "crazyflie.toml").read_text("utf-8")
TABLES = tomllib.loads(TEXT)
KEYS = ("value", "range", "unit", "source", "uncertainty")
DURATION = 0.1  # s


def flies(vehicle):
    """0.1 s from hover in both plants, finite."""
    for kind in PLANTS:
        plant = make_plant(kind, 1, vehicle)
        position = np.array([[1.0, 0.5, vehicle.platform_surface_height + 0.5]])
        plant.reset(np.arange(1), hover_states(position, vehicle))
        command = np.array([[min(vehicle.hover_pwm, vehicle.command_pwm_range[1]), 0.0, 0.0, 0.0]])
        for _ in range(round(DURATION / plant.control_period) or 1):
            plant.step(command)
        if not (np.isfinite(plant.state).all() and np.abs(plant.state).max() < 1e7):
            raise Wrong(f"{kind}: {plant.state}")


def case(name, content, **options):
    def make(folder):
        return write(folder / "vehicle.toml", content if isinstance(content, bytes) else spell(content))

    return Case(name, make, load_vehicle, flies, **options)


def spell(tables) -> str:
    return "\n".join(
        f"[{toml(section)}]\n" + "\n".join(f"{toml(name)} = {toml(entry)}" for name, entry in table.items())
        for section, table in tables.items()
    )


def changed(section, name, key, value):
    tables = copy.deepcopy(TABLES)
    tables[section][name][key] = value
    return tables


def evil_fields():
    """The value of every entry times every evil value; the other keys of entries drawn for each."""
    for c in constants():
        for evil, value in EVIL.items():
            yield case(f"{c.label} {evil}", changed(c.section, c.name, "value", value))
    rng = random.Random(2)
    for key in KEYS[1:]:
        for evil, value in EVIL.items():
            for c in rng.sample(constants(), 3):
                yield case(f"{c.label} {key} {evil}", changed(c.section, c.name, key, value))


def edges():
    """Every number of every entry at the ends of its range, beyond them, and with the other sign."""
    for c in constants():
        listed = isinstance(c.value, tuple)
        values = c.value if listed else (c.value,)
        for k, (value, (low, high)) in enumerate(zip(values, c.range)):
            beyond = 1e-6 * (high - low)
            for name, new in {
                "lowest": low,
                "highest": high,
                "below": low - beyond,
                "above": high + beyond,
                "negative": -value,
                "times 1000": 1000.0 * value,
                "thousandth": value / 1000.0,
            }.items():
                row = [*values[:k], new, *values[k + 1 :]]
                tables = changed(c.section, c.name, "value", row if listed else row[0])
                yield case(f"{c.label} {k} {name}", tables)


def corners(number=300, seed=1):
    """Three entries at a time anywhere within their ranges, near to the shipped value or at an end."""
    rng = random.Random(seed)
    for k in range(number):
        tables = copy.deepcopy(TABLES)
        for c in rng.sample(constants(), 3):
            listed = isinstance(c.value, tuple)
            row = [
                rng.choice([low, high, rng.uniform(low, high), x * 10 ** rng.uniform(-1, 1)])
                for x, (low, high) in zip(c.value if listed else (c.value,), c.range)
            ]
            tables[c.section][c.name]["value"] = row if listed else row[0]
        yield case(f"corner {k}", tables)


def structures():
    """Tables, entries and keys that are missing, doubled, renamed, moved or of another kind."""
    for c in constants():
        tables = copy.deepcopy(TABLES)
        del tables[c.section][c.name]
        yield case(f"{c.label} missing", tables)
        for key in KEYS:
            tables = copy.deepcopy(TABLES)
            del tables[c.section][c.name][key]
            yield case(f"{c.label} without {key}", tables)
        tables = copy.deepcopy(TABLES)
        tables[c.section][f"{c.name}\n" * 100] = tables[c.section].pop(c.name)
        yield case(f"{c.label} renamed", tables)
    rng = random.Random(3)
    for evil, value in EVIL.items():
        c = rng.choice(constants())
        tables = copy.deepcopy(TABLES)
        tables[c.section][c.name] = value
        yield case(f"{c.label} is {evil}", tables)
    for section in TABLES:
        tables = copy.deepcopy(TABLES)
        del tables[section]
        yield case(f"table {section} missing", tables)
        text = spell(TABLES).replace(f'["{section}"]', f"[{section}]\n[{section}]")
        yield case(f"table {section} twice", text.encode())
        text = spell(TABLES).replace(f'["{section}"]', f"[[{section}]]")
        yield case(f"table {section} in a list", text.encode())
    lines = TEXT.splitlines(keepends=True)
    for k, line in enumerate(lines):
        if "=" in line and not line.startswith("#"):
            yield case(f"line {k} twice", "".join([*lines[:k], line, *lines[k:]]).encode())


def texts():
    """Files of other kinds, and the bytes of a good one damaged."""
    good = TEXT.encode()
    for name, content in {
        "empty": b"",
        "white": b"\n" * 1000,
        "only tables": b"".join(f"[{s}]\n".encode() for s in TABLES),
        "byte order mark": TEXT.encode("utf-8-sig"),
        "UTF-16": TEXT.encode("utf-16"),
        "Latin 1": good.replace(b"Each", b"\xe9ach"),
        "NUL bytes": good + b"\0" * 100,
        "CR LF": good.replace(b"\n", b"\r\n"),
        "nested lists": good + b"x = " + b"[" * 100_000,
        "nested over lines": good + b"x = " + b"[\n" * 100_000,
        "nested tables": good + b"x = " + b"{a=" * 10_000,
        "long key": good + b"[" + b"a." * 10_000 + b"a]\n",
        "dotted key": good + b"a." * 200_000 + b"a = 1\n",
        "many dotted keys": good + b"".join(b"a%d." % k + b"a." * 300 + b"a = 1\n" for k in range(1000)),
        "many entries": good + b"".join(b"x%d = 1\n" % k for k in range(50_000)),
        "many tables": good + b"".join(b"[x%d]\n" % k for k in range(50_000)),
        "a million digits": good.replace(b"0.03303", b"9" * 900_000),
        "long number": good.replace(b"0.03303", b"0.0" + b"3" * 900_000),
        "XML": b"<mujoco/>",
        "JSON": b'{"body": {"mass": 1}}',
        "too long": good + b"#" * 2_000_000,
    }.items():
        yield case(name, content, seconds=10.0)
    for name, content in mutations(good, 210):
        yield case(f"mutation {name}", content)


def commands():
    """Every command that takes a policy or flights, and a vehicle: wrong ones, of every kind."""
    wrong = [
        *(case for case in evil_fields() if case.name in ("body.mass nan", "arena.x text")),
        *(case for case in edges() if case.name in ("body.mass 0 negative", "platform.width 0 times 1000")),
        *(case for case in texts() if case.name in ("empty", "nested over lines", "UTF-16")),
        *(case for case in places("vehicle.toml", load_vehicle) if case.name in ("a pipe", "a folder")),
    ]
    assert len(wrong) == 9
    starts = {"train": (train.main, ["landing"])}
    for name in cli.COMMANDS:
        asked = str(inspect.signature(cli.find(name)).parameters)
        if "Flown" in asked or "FlightSource" in asked:
            starts[name] = (cli.main, [name, "landing" if "Flown" in asked else "flight.csv"])
    assert len(starts) > 5
    for name, (main, words) in starts.items():
        for bad in wrong:

            def take(path, main=main, words=words):
                return command(main, [*words, *somewhere(words[0], path.parent), "--vehicle", str(path)])

            yield dataclasses.replace(bad, name=f"{name} with {bad.name}", take=take, works=refused)


def refused(_):
    raise Wrong("a wrong vehicle was flown")


@parametrised(evil_fields(), sample=25)
def test_evil_values(case, tmp_path):
    judge(case, tmp_path)


@parametrised(edges(), sample=15)
def test_edges_of_the_ranges(case, tmp_path):
    judge(case, tmp_path)


@parametrised(corners(), sample=10)
def test_corners_of_the_ranges(case, tmp_path):
    judge(case, tmp_path)


@parametrised(structures(), sample=20)
def test_structures(case, tmp_path):
    judge(case, tmp_path)


@parametrised(texts(), sample=20)
def test_texts(case, tmp_path):
    judge(case, tmp_path)


@parametrised(commands(), sample=12)
def test_commands(case, tmp_path):
    judge(case, tmp_path)


@parametrised(places("vehicle.toml", load_vehicle), sample=20)
def test_places(case, tmp_path):
    judge(case, tmp_path)


@pytest.mark.parametrize("evil", EVIL)
def test_vehicles_made_in_python(evil):
    """Every field of a Vehicle; a value is taken only where it is a number within its range."""
    for constant in constants():
        vehicle = dataclasses.replace(load_vehicle(), **{constant.field: EVIL[evil]})
        try:
            check_vehicle(vehicle)
        except UserError as error:
            assert str(error).isprintable() and len(str(error)) <= 300
        else:
            values = EVIL[evil] if isinstance(EVIL[evil], list) else [EVIL[evil]]
            assert all(low <= x <= high for x, (low, high) in zip(values, constant.range))
