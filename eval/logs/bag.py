"""ROS 1 and ROS 2 bags, through the rosbags library (no ROS needed).

A column is `topic:field.path`, as `/cf1/pose:pose.position.x`; an array's element is `values[0]`.
"""

from __future__ import annotations

import contextlib
import re
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
from rosbags.highlevel import AnyReader, AnyReaderError
from rosbags.typesys import Stores, get_typestore

from inclined_landing.eval.logs import mapping
from inclined_landing.eval.logs.record import Record
from inclined_landing.models.errors import UserError

SUFFIXES = (".bag", ".mcap", ".db3")
_PART = re.compile(r"(\w+)(?:\[(\d+)\])?")


def read(path: Path, patterns: Sequence[str]) -> Record:
    """The columns that fit `patterns` (`topic:field.path`, `*` in the topic).

    A message is dated by the stamp in its header; without one, by when the bag received it, which is
    noted. Raises UserError when the bag cannot be read, or a topic's messages lack the field.
    """
    columns, times, notes = {}, {}, []
    with _opened(path) as reader:
        wanted: dict[str, list[str]] = {}
        for pattern in dict.fromkeys(patterns):
            topic, _, field = pattern.partition(":")
            found = mapping.find(sorted(reader.topics), topic, str(path)) if field else None
            if found is not None:
                wanted.setdefault(found, []).append(field)
        for topic, fields in wanted.items():
            stamps, received, rows = [], [], []
            connections = [c for c in reader.connections if c.topic == topic]
            try:
                for connection, timestamp, raw in reader.messages(connections=connections):
                    message = reader.deserialize(raw, connection.msgtype)
                    stamps.append(_stamp(message))
                    received.append(1e-9 * timestamp)
                    rows.append([_value(message, field) for field in fields])
            except (AttributeError, IndexError, TypeError, ValueError) as error:
                raise UserError(
                    f"{path}: topic {topic} has no number {', '.join(fields)} ({error})"
                ) from error
            except (AnyReaderError, KeyError) as error:
                raise UserError(f"{path}: topic {topic} cannot be decoded ({error})") from error
            if not rows:
                continue
            stamped = all(stamps)
            if not stamped:
                notes.append(f"messages of {topic} have no stamp: dated by when they were recorded")
            clock = np.array(stamps if stamped else received)
            order = np.argsort(clock, kind="stable")
            for field, values in zip(fields, np.array(rows, float)[order].T):
                columns[f"{topic}:{field}"] = values
                times[f"{topic}:{field}"] = clock[order]
    return Record(str(path), columns, times=times, notes=tuple(notes))


@contextlib.contextmanager
def _opened(path: Path) -> Iterator[AnyReader]:
    folder = path.parent if path.suffix in (".mcap", ".db3") else path
    if path.suffix != ".bag" and not (folder / "metadata.yaml").is_file():
        raise UserError(f"{path}: a ROS 2 bag is a folder with metadata.yaml; none is there")
    try:
        reader = AnyReader([folder], default_typestore=get_typestore(Stores.LATEST))
        reader.open()
    except (AnyReaderError, OSError) as error:
        raise UserError(f"{path}: not a readable bag ({error})") from error
    try:
        yield reader
    finally:
        reader.close()


def _stamp(message) -> float | None:
    stamp = getattr(getattr(message, "header", None), "stamp", None)
    if stamp is None or not (stamp.sec or stamp.nanosec):
        return None
    return stamp.sec + 1e-9 * stamp.nanosec


def _value(message, field: str) -> float:
    for part in field.split("."):
        match = _PART.fullmatch(part)
        if match is None:
            raise AttributeError(f"{part!r} is not a field")
        message = getattr(message, match[1])
        if match[2] is not None:
            message = message[int(match[2])]
    return float(message)
