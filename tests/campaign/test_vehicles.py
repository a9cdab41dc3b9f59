"""Vehicles at and beyond the ends of their ranges, and tables that stand in a file in odd ways.

Entries with evil values and files of other kinds are in `test_toml.py`.
"""

import dataclasses
import random
import tomllib

import hypothesis.strategies as st
import pytest
from hypothesis import given

from inclined_landing.models.errors import UserError
from inclined_landing.models.parameters import check_vehicle, constants, load_vehicle
from tests.campaign.judge import EVIL, Case, changed, examples, judged
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


def edge(c, k: int, kind: str) -> Case:
    """One number of an entry at an end of its range, beyond it, or of another sign or size."""
    (low, high), value = c.range[k], numbers(c)[k]
    beyond = 1e-6 * (high - low)
    new = {
        "lowest": low,
        "highest": high,
        "below": low - beyond,
        "above": high + beyond,
        "negative": -value,
        "times 1000": 1000.0 * value,
        "thousandth": value / 1000.0,
    }[kind]
    row = [*numbers(c)[:k], new, *numbers(c)[k + 1 :]]
    return spoilt(f"{c.label} {k} {kind}", (c, row if isinstance(c.value, tuple) else new))


def corner(seed: int) -> Case:
    """Three entries at a time anywhere within their ranges, near to the shipped value or at an end."""
    rng, values = random.Random(seed), []
    for c in rng.sample(constants(), 3):
        row = [
            rng.choice([low, high, rng.uniform(low, high), x * 10 ** rng.uniform(-1, 1)])
            for x, (low, high) in zip(numbers(c), c.range)
        ]
        values.append((c, row if isinstance(c.value, tuple) else row[0]))
    return spoilt(f"corner {seed}", *values)


def with_head(section: str, head: str) -> Case:
    """A table that stands there last, twice, or in a list."""
    rest = {name: other for name, other in TABLES.items() if name != section}
    text = f"{spelt(rest)}\n{head.format(section)}{spelt(TABLES[section])}"
    return case("vehicle", f"table {head.format(section)!r}", lambda: text)


def renamed(c) -> Case:
    """An entry of another, very long name."""
    rest = changed(TABLES, (c.section, c.name), ...)
    tables = changed(rest, (c.section, f"{c.name}\n" * 100), TABLES[c.section][c.name])
    return case("vehicle", f"{c.label} renamed", lambda: spelt(tables))


KINDS = ("lowest", "highest", "below", "above", "negative", "times 1000", "thousandth")
EDGES = [(c, k, kind) for c in constants() for k in range(len(numbers(c))) for kind in KINDS]
HEADS = ("[{}]\n", "[{0}]\n[{0}]\n", "[[{}]]\n")
VEHICLES = st.one_of(
    st.sampled_from(EDGES).map(lambda e: edge(*e)),
    st.integers(0, 9999).map(corner),
    st.builds(with_head, st.sampled_from(list(TABLES)), st.sampled_from(HEADS)),
    st.sampled_from(constants()).map(renamed),
)


@examples(12)
@given(case=VEHICLES)
def test_vehicles_are_flown_or_refused(case):
    judged(case)


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
