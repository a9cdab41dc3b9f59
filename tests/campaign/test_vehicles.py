"""Vehicles at and beyond the ends of their ranges, and tables that stand in a file in odd ways.

Entries with evil values and files of other kinds are in `test_toml.py`.
"""

import dataclasses
import random
import tomllib

import pytest

from inclined_landing.models.errors import UserError
from inclined_landing.models.parameters import check_vehicle, constants, load_vehicle
from tests.campaign.judge import EVIL, Case, changed, judge, parametrised
from tests.campaign.test_toml import VEHICLE, case, spelt

TABLES = tomllib.loads(VEHICLE)


def spoilt(name: str, *values: tuple) -> Case:
    """A file in which constants have other values, (constant, value) each."""

    def make() -> str:
        tables = TABLES
        for c, value in values:
            tables = changed(tables, (c.section, c.name, "value"), value)
        return spelt(tables)

    return case("vehicle", name, make)


def numbers(c) -> tuple:
    """The numbers of an entry."""
    return c.value if isinstance(c.value, tuple) else (c.value,)


def edges():
    """Every number of every entry at the ends of its range, beyond them, and with the other sign."""
    for c in constants():
        for k, (value, (low, high)) in enumerate(zip(numbers(c), c.range)):
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
                row = [*numbers(c)[:k], new, *numbers(c)[k + 1 :]]
                yield spoilt(f"{c.label} {k} {name}", (c, row if isinstance(c.value, tuple) else new))


def corners():
    """Three entries at a time anywhere within their ranges, near to the shipped value or at an end."""
    for k in range(300):
        rng, values = random.Random(k), []
        for c in rng.sample(constants(), 3):
            row = [
                rng.choice([low, high, rng.uniform(low, high), x * 10 ** rng.uniform(-1, 1)])
                for x, (low, high) in zip(numbers(c), c.range)
            ]
            values.append((c, row if isinstance(c.value, tuple) else row[0]))
        yield spoilt(f"corner {k}", *values)


def tables():
    """Tables that stand there twice, or in a list, and entries of another name."""
    for section, table in TABLES.items():
        rest = {name: other for name, other in TABLES.items() if name != section}
        for name, head in {"": "[{}]\n", "twice": "[{0}]\n[{0}]\n", "in a list": "[[{}]]\n"}.items():
            text = f"{spelt(rest)}\n{head.format(section)}{spelt(table)}"
            yield case("vehicle", f"table {section} {name}", lambda text=text: text)
    for c in constants():

        def renamed(c=c) -> str:
            rest = changed(TABLES, (c.section, c.name), ...)
            return spelt(changed(rest, (c.section, f"{c.name}\n" * 100), TABLES[c.section][c.name]))

        yield case("vehicle", f"{c.label} renamed", renamed)


@parametrised(edges, corners, tables, each=4)
def test_vehicles_are_flown_or_refused(case, tmp_path):
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
