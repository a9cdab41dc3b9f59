"""Typed structs of data that people write: what fits comes back, all else is one sentence that names it."""

import copy
import dataclasses
import math
import re
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from msgspec import Meta, field

from inclined_landing.models.base.errors import UserError
from inclined_landing.models.base.schema import Real, Table, check, parse

Share = Annotated[float, Meta(ge=0, le=1)]


class Part(Table, frozen=True):
    size: Share
    sides: tuple[Share, Share] = (0.0, 1.0)
    start: Real | None = field(name="from", default=None)


class File(Table, frozen=True):
    seed: Annotated[int, Meta(ge=0, lt=9)]
    part: Part
    title: Annotated[str, Meta(min_length=1, max_length=5)] = "none"
    kind: Literal["up", "down"] | Share = "up"
    parts: dict[str, Part] = field(default_factory=dict)
    rows: Annotated[tuple[tuple[str | Part, ...], ...], Meta(max_length=2)] = ()


GOOD = {
    "seed": 3,
    "part": {"size": 1, "sides": [0, 0.5], "from": -2},
    "title": "x",
    "kind": "down",
    "parts": {"left one": {"size": 0.5}, "b": {"size": 0.25}},
    "rows": [["a"], ["b", {"size": 0.125}]],
}


def test_whole_numbers_become_floats_and_nothing_else_changes():
    file = parse(GOOD, File)
    assert file.part == Part(1.0, (0.0, 0.5), -2.0) and type(file.part.size) is type(file.part.start) is float
    assert file.parts == {"left one": Part(0.5), "b": Part(0.25)} and file.rows == (
        ("a",),
        ("b", Part(0.125)),
    )
    assert parse({"seed": 0, "part": {"size": 0}}, File) == File(0, Part(0.0))


@given(st.integers(-(10**300), 10**300))
def test_a_whole_number_becomes_the_float_next_to_it(number):
    assert parse(number, Real) == float(number)


@pytest.mark.parametrize(("keys", "value", "sentence"), [
    (("seed",), 9, "seed must be a whole number of at least 0 and below 9, not 9"),
    (("seed",), True, "seed must be a whole number of at least 0 and below 9, not True"),
    (("seed",), 1.0, "seed must be a whole number of at least 0 and below 9, not 1.0"),
    (("seed",), ..., "seed is missing"),
    (("part", "size"), math.nan, "[part] size must be a number from 0 to 1, not nan"),
    (("part", "size"), "1", "[part] size must be a number from 0 to 1, not '1'"),
    (("part", "size"), 10**400, f"[part] size must be a number from 0 to 1, not 1{25 * '0'} ... {10 * '0'}"),
    (("part", "size"), ..., "[part] lacks size"),
    (("part", "from"), math.inf, "[part] from must be a number, not inf"),
    (("part", "sides"), [1], "[part] sides must be a list of 2, each a number from 0 to 1, not [1]"),
    (("part", "sides", 1), -1, "[part] sides[1] must be a number from 0 to 1, not -1"),
    (("part", "side"), 1, "unknown entry 'side' in [part]; did you mean sides?"),
    (("part", "colour"), 1, "unknown entry 'colour' in [part]; choose from size, sides, from"),
    (("part",), 3, "part must be a table, not 3"),
    (("title",), "", "title must be text of 1 to 5 characters, not ''"),
    (("kind",), "left", "kind must be 'down' or 'up' or a number from 0 to 1, not 'left'"),
    (("parts", "left one", "size"), 2, "[parts.left one] size must be a number from 0 to 1, not 2"),
    (("rows",), [[]] * 3,
     "rows must be a list of at most 2 entries, each a list, each text or a table, not "),
    (("rows", 1, 1, "size"), 2, "[rows[1][1]] size must be a number from 0 to 1, not 2"),
    (("x - at `$.part",), 1, "unknown entry 'x - at `$.part' in the file; choose from seed, part"),
])  # fmt: skip
def test_what_does_not_fit_is_named(keys, value, sentence):
    data = table = copy.deepcopy(GOOD)
    for key in keys[:-1]:
        table = table[key]
    table[keys[-1]] = value
    if value is ...:
        del table[keys[-1]]
    with pytest.raises(UserError) as refused:
        parse(data, File, "file f: ")
    assert str(refused.value).startswith(f"file f: {sentence}")


@dataclasses.dataclass
class Group:
    near: Annotated[Share | None, "a note"] = None
    out: Path | None = None


@dataclasses.dataclass
class Options:
    seed: Annotated[int, Meta(ge=0, lt=9)] = 0
    rates: Annotated[tuple[Share, ...], Meta(max_length=2)] = ()
    centre: float | Literal["hover"] | None = None
    group: Group = dataclasses.field(default_factory=Group)


@pytest.mark.parametrize("options", [
    Options(),
    Options(np.int64(3), (np.float32(0.5), 1), "hover", Group(0.25, "a file")),
    Options(centre=3),
])  # fmt: skip
def test_options_that_fit_their_types_are_let_pass(options):
    check(options)


@pytest.mark.parametrize(("options", "sentence"), [
    (Options(seed=True), "seed must be a whole number of at least 0 and below 9, not True"),
    (Options(rates=(0.5, 2.0)), "rates[1] must be a number from 0 to 1, not 2.0"),
    (Options(centre=math.inf), "centre must be a number or 'hover', not inf"),
    (Options(group=Group(near=2.0)), "near must be a number from 0 to 1, not 2.0"),
    (Options(group=Group(out=3)), "out must be a path, not 3"),
])  # fmt: skip
def test_options_that_do_not_fit_are_one_sentence(options, sentence):
    with pytest.raises(UserError, match=re.escape(sentence)):
        check(options)
