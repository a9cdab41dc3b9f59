"""Data that people write (tables of TOML, values of JSON) as typed structs, with errors of one sentence.

A file's layout is a `msgspec.Struct`: types, ranges (`Annotated[float, Meta(ge=0, le=1)]`), defaults. `parse`
converts, without a word on rules between entries: they are their reader's.
"""

from __future__ import annotations

import difflib
import re
from collections.abc import Mapping
from typing import Annotated, Any, TypeVar, get_args, get_origin

import msgspec
from msgspec import Meta, Struct, inspect, structs

from inclined_landing.models.errors import UserError, choices, shown

Real = Annotated[float, Meta(ge=-1e300, le=1e300)]  # any number that is finite
T = TypeVar("T")
_STEP = re.compile(r"\.([\w-]+)|\[(\d+|\.\.\.)\]")  # of a path such as $.start.x[0] or $.columns[...].unit


class Table(Struct, frozen=True, forbid_unknown_fields=True):
    """A table with the entries of its class and no others."""


def parse(data: Any, kind: type[T], where: str = "") -> T:
    """Return `data` as a `kind`: whole numbers become floats where asked for, no other type another one.

    Raises UserError, `where` before its sentence, for entries that are missing, unknown, of another type or
    out of range.
    """
    try:
        return msgspec.convert(data, kind)
    except msgspec.ValidationError as error:
        raise UserError(where + _sentence(str(error), data, kind)) from error


def _sentence(said: str, value: Any, kind: Any) -> str:
    """Return the sentence for the entry whose path ends msgspec's message ("... - at `$.deck.speed`")."""
    way: list[str] = []
    path = "" if _unknown(value, kind) else said.rpartition(" - at `$")[2]
    for key, place in _STEP.findall(path):
        name, value, kind = _step(value, kind, key, place)
        way[-1:] = [*way[-1:], name] if key or place == "..." else ["".join(way[-1:]) + name]
    if not isinstance(value, dict) or not (known := _entries(kind)):
        label = f"[{'.'.join(way[:-1])}] {way[-1]}" if way[1:] else "".join(way) or "the file"
        return f"{label} must be {expected(kind)}, not {shown(repr(value), 40)}"
    table = f"[{'.'.join(way)}]" if way else "the file"
    if unknown := _unknown(value, kind):
        near = difflib.get_close_matches(unknown[0], known, 1)
        hint = f"did you mean {near[0]}?" if near else choices(known, unknown[0])
        return f"unknown entry {shown(repr(unknown[0]), 40)} in {table}; {hint}"
    missing = next((name for name, entry in known.items() if entry.required and name not in value), "")
    return f"{table} lacks {missing}" if way else f"{missing} is missing"


def _entries(kind: Any) -> dict[str, structs.FieldInfo]:
    """Return the entries of a table by the names they have in files; none for what is no table."""
    tables = (member for member in _members(kind) if _is_table(member))
    return {entry.encode_name: entry for table in tables for entry in structs.fields(table)}


def _unknown(value: Any, kind: Any) -> list[str]:
    known = _entries(kind)
    return sorted(set(value) - set(known)) if known and isinstance(value, dict) else []


def _step(value: Any, kind: Any, key: str, place: str) -> tuple[str, Any, Any]:
    """Return name, value and type of the entry `key` of a table or at a `place`; "...": the wrong one."""
    for member in _members(kind):
        origin, inner = get_origin(member), get_args(member)
        if key and _is_table(member):
            return key, value[key], _entries(member)[key].type
        if place == "..." and origin in (dict, Mapping):
            key = next(key for key, entry in value.items() if not _fits(entry, inner[1]))
            return shown(key, 60), value[key], inner[1]
        if place and origin in (list, tuple):
            k = int(place)
            return f"[{k}]", value[k], inner[0 if origin is list or inner[-1] is ... else k]
    raise AssertionError(f"{kind} has no {key}{place}")


def _fits(value: Any, kind: Any) -> bool:
    try:
        msgspec.convert(value, kind)
    except msgspec.ValidationError:
        return False
    return True


def _members(kind: Any) -> tuple[Any, ...]:
    """Return the types of a union, or the only one, without their limits."""
    if get_origin(kind) is Annotated:
        return _members(get_args(kind)[0])
    if isinstance(inspect.type_info(kind), inspect.UnionType):
        return tuple(member for one in get_args(kind) for member in _members(one))
    return (kind,)


def _is_table(kind: Any) -> bool:
    return isinstance(kind, type) and issubclass(kind, Struct)


def expected(kind: Any) -> str:
    """Return what a value of a type must be, to go on after "must be": "a number from 0 to 2 or 'any'"."""
    return _words(inspect.type_info(kind))


def _words(kind: inspect.Type) -> str:
    if isinstance(kind, inspect.UnionType):  # TOML has no null
        return " or ".join(_words(one) for one in kind.types if not isinstance(one, inspect.NoneType))
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
    return "true or false" if isinstance(kind, inspect.BoolType) else "a table"


def _digits(limit: float) -> str:
    return str(limit) if isinstance(limit, int) else f"{limit:g}"


def _count(
    kind: inspect.StrType | inspect.ListType | inspect.VarTupleType | inspect.DictType, noun: str
) -> str:
    """Return " of 1 to 40 characters" where a length has limits."""
    least, most = kind.min_length, kind.max_length
    if most is None:
        return f" of at least {least} {noun}" if least else ""
    return f" of {least} to {most} {noun}" if least else f" of at most {most} {noun}"
