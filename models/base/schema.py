"""Types and limits of input in files and on command lines, with errors of one sentence.

A limit is written once, in the type: `Annotated[float, Meta(ge=0, le=1)]`. A file's layout is a
`msgspec.Struct`, into which `parse` converts its data. The options of a command, a task or a plant are
declared by the annotations of a function or a dataclass, which `check` compares with the values. Rules
between several entries are in the reader of the file.
"""

from __future__ import annotations

import contextlib
import dataclasses
import difflib
import itertools
import math
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from types import UnionType
from typing import Annotated, Any, TypeVar, Union, get_args, get_origin, get_type_hints

import msgspec
import numpy as np
from msgspec import Meta, Struct, inspect, structs

from inclined_landing.models.base.errors import UserError, choices, shown

Real = Annotated[float, Meta(ge=-1e300, le=1e300)]  # any number that is finite
Many = Annotated[int, Meta(ge=1, le=10**9)]
Share = Annotated[float, Meta(ge=0, le=1)]
Pixels = Annotated[int, Meta(ge=16, le=4096)]  # a side of a picture
T = TypeVar("T")


class Table(Struct, frozen=True, forbid_unknown_fields=True):
    """Base class of tables that accept only the entries of the class."""


def parse(data: Any, kind: type[T], where: str = "", name: str = "") -> T:
    """Return `data` as a `kind`; whole numbers become floats if needed, and no other type is converted.

    name: name of the entry `data`, unless it is a whole file. Raises UserError, with `where` in front of the
    sentence, for entries that are missing, unknown, of another type or out of range.
    """
    try:
        return msgspec.convert(data, kind)
    except msgspec.ValidationError as error:
        raise UserError(where + _sentence(data, kind, [name] if name else [])) from error


def check(options: Any, kinds: Mapping[str, Any] | None = None, label: Callable[[str], str] = str) -> None:
    """Raise UserError unless each option has its type, is within its limits, and its numbers are finite.

    options: values by name, or a dataclass of them; nested groups of options are checked too. kinds: the
    types by name, if `options` does not define them. label: the word for an option in messages.
    """
    values = options if isinstance(options, Mapping) else vars(options)
    kinds = kinds_of(type(options)) if kinds is None else kinds
    for name, value in values.items():
        if dataclasses.is_dataclass(value) and not isinstance(value, type):
            check(value, None, label)
        elif name in kinds:
            plain = _plain(value)
            if not _fits(plain, kinds[name]):
                raise UserError(_sentence(plain, kinds[name], [label(name)]))
            for number in _floats(plain):
                if not math.isfinite(number):
                    raise UserError(f"{label(name)} must be {expected(kinds[name])}, not {number}")


def kinds_of(options: Any) -> dict[str, Any]:
    """Return the types, with their limits, from the annotations of a class or a function."""
    return get_type_hints(options, include_extras=True)


def _plain(value: Any) -> Any:
    """Return an option with numbers of NumPy as Python's and sequences as lists."""
    if isinstance(value, np.generic):
        return value.item()
    return [_plain(one) for one in value] if isinstance(value, list | tuple) else value


def _floats(value: Any) -> Iterator[float]:
    if isinstance(value, list):
        for one in value:
            yield from _floats(one)
    elif isinstance(value, float):
        yield value


def _sentence(value: Any, kind: Any, way: list[str]) -> str:
    """Return the message for the innermost entry that does not fit; way: the keys that lead to `value`."""
    for key, entry, wanted in _entries(value, kind):
        if not _fits(entry, wanted):
            inner = [*way, key] if isinstance(key, str) else [*way[:-1], f"{''.join(way[-1:])}[{key}]"]
            return _sentence(entry, wanted, inner)
    names = [shown(key, 60) for key in way]
    known = _fields(kind)
    if not known or not isinstance(value, dict):
        label = f"[{'.'.join(names[:-1])}] {names[-1]}" if names[1:] else "".join(names) or "the file"
        return f"{label} must be {expected(kind)}, not {shown(repr(value), 40)}"
    table = f"[{'.'.join(names)}]" if names else "the file"
    if unknown := sorted(set(value) - set(known)):
        near = difflib.get_close_matches(unknown[0], known, 1)
        hint = f"did you mean {near[0]}?" if near else choices(known, unknown[0])
        return f"unknown entry {shown(repr(unknown[0]), 40)} in {table}; {hint}"
    missing = next(name for name, field in known.items() if field.required and name not in value)
    return f"{table} lacks {missing}" if names else f"{missing} is missing"


def _entries(value: Any, kind: Any) -> Iterator[tuple[str | int, Any, Any]]:
    """Yield key, value and type of everything in a table or list."""
    if isinstance(value, dict):
        yield from ((name, value[name], field.type) for name, field in _fields(kind).items() if name in value)
    for member in _members(kind):
        origin, inner = get_origin(member), get_args(member)
        if isinstance(value, dict) and origin in (dict, Mapping):
            yield from ((key, entry, inner[1]) for key, entry in value.items())
        if isinstance(value, list) and origin in (list, tuple):
            kinds = inner if origin is tuple and inner[-1] is not ... else itertools.repeat(inner[0])
            yield from ((k, entry, wanted) for k, (entry, wanted) in enumerate(zip(value, kinds)))


def _fits(value: Any, kind: Any) -> bool:
    """Return whether a value has a type, or one of a union, and is within its limits; text may be a path."""
    for one in _alternatives(kind):
        with contextlib.suppress(msgspec.ValidationError):
            msgspec.convert(Path(value) if one is Path and isinstance(value, str) else value, one)
            return True
    return False


def _fields(kind: Any) -> dict[str, structs.FieldInfo]:
    """Return the entries of a table by their names in files; none for other types."""
    tables = (one for one in _members(kind) if isinstance(one, type) and issubclass(one, Struct))
    return {field.encode_name: field for table in tables for field in structs.fields(table)}


def _alternatives(kind: Any) -> tuple[Any, ...]:
    """Return the types of a union, or the only one, with their limits."""
    inner = get_args(kind)[0] if get_origin(kind) is Annotated else kind
    if get_origin(inner) in (Union, UnionType):
        return tuple(member for one in get_args(inner) for member in _alternatives(one))
    return (kind,)


def _members(kind: Any) -> tuple[Any, ...]:
    """Return the types of a union, or the only one, without their limits."""
    return tuple(get_args(one)[0] if get_origin(one) is Annotated else one for one in _alternatives(kind))


def expected(kind: Any) -> str:
    """Return the text after "must be" for a value of a type, for instance "a number from 0 to 2 or 'any'"."""
    some = (one for one in _alternatives(kind) if one not in (None, type(None)))  # TOML has no null
    return " or ".join(_words(inspect.type_info(one)) for one in some)


def _words(kind: inspect.Type) -> str:
    if isinstance(kind, inspect.UnionType):
        return " or ".join(map(_words, kind.types))
    if isinstance(kind, inspect.IntType | inspect.FloatType):
        noun = "a whole number" if isinstance(kind, inspect.IntType) else "a number"
        limits = {"of at least": kind.ge, "above": kind.gt, "of at most": kind.le, "below": kind.lt}
        said = {word: _digits(x) for word, x in limits.items() if x is not None and abs(x) < 1e300}
        if said.keys() == {"of at least", "of at most"}:
            return f"{noun} from {said['of at least']} to {said['of at most']}"
        return " ".join([noun, " and ".join(f"{word} {digits}" for word, digits in said.items())]).strip()
    if isinstance(kind, inspect.StrType):
        return "text" + _count(kind, "characters")
    if isinstance(kind, inspect.LiteralType):
        return " or ".join(map(repr, kind.values))
    if isinstance(kind, inspect.TupleType):
        return f"a list of {len(kind.item_types)}, each {_words(kind.item_types[0])}"
    if isinstance(kind, inspect.ListType | inspect.VarTupleType):
        return f"a list{_count(kind, 'entries')}, each {_words(kind.item_type)}"
    if isinstance(kind, inspect.DictType):
        return "a table" + _count(kind, "entries")
    if isinstance(kind, inspect.CustomType):
        return f"a {kind.cls.__name__.lower()}"
    return "true or false" if isinstance(kind, inspect.BoolType) else "a table"


def _digits(limit: float) -> str:
    return str(limit) if isinstance(limit, int) else f"{limit:g}"


def _count(kind: Any, noun: str) -> str:
    """Return " of 1 to 40 characters" where a length has limits."""
    least, most = kind.min_length, kind.max_length
    if most is None:
        return f" of at least {least} {noun}" if least else ""
    return f" of {least} to {most} {noun}" if least else f" of at most {most} {noun}"
