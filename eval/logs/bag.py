"""ROS 1 and ROS 2 bags, through the rosbags library (no ROS needed).

A column is `topic:field.path`, as `/cf1/pose:pose.position.x`; an array's element is `values[0]`.
"""

from __future__ import annotations

import contextlib
import itertools
import re
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_typestore

from inclined_landing.eval.logs import mapping
from inclined_landing.eval.logs.limits import LARGEST, MOST_ROWS
from inclined_landing.eval.logs.record import Record
from inclined_landing.models.errors import UserError, shown

_PART = re.compile(r"(\w+)(?:\[(\d+)\])?")


def read(path: Path, patterns: Sequence[str]) -> Record:
    """Return the columns of a bag that match `patterns` (`topic:field.path`, `*` in the topic).

    A message is dated by the stamp in its header; without one, by when the bag received it, which is
    noted. Raises UserError when the bag cannot be read, or a topic's messages lack the field.
    """
    columns, times, notes = {}, {}, []
    with _open_bag(path) as reader:
        fields_by_topic: dict[str, list[str]] = {}
        for pattern in dict.fromkeys(patterns):
            topic, _, field = pattern.partition(":")
            found = mapping.find(sorted(reader.topics), topic, str(path)) if field else None
            if found is not None:
                fields_by_topic.setdefault(found, []).append(field)
        for topic, fields in fields_by_topic.items():
            stamps, received, rows = [], [], []
            for message, timestamp in _messages(path, reader, topic):
                try:
                    rows.append([_field_value(message, field) for field in fields])
                except (AttributeError, IndexError, TypeError, ValueError) as error:
                    raise UserError(
                        f"{path}: topic {topic} has no number {', '.join(fields)} ({_reason(error)})"
                    ) from error
                stamps.append(_header_time(message))
                received.append(1e-9 * timestamp)
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


def _messages(path: Path, reader: AnyReader, topic: str) -> Iterator[tuple[object, int]]:
    """Yield the messages of a topic and when the bag received them [ns]."""
    connections = [c for c in reader.connections if c.topic == topic]
    stored = reader.messages(connections=connections)
    for count in itertools.count(1):
        try:
            connection, timestamp, raw = next(stored)
            message = reader.deserialize(raw, connection.msgtype)
        except StopIteration:
            return
        except Exception as error:
            raise UserError(f"{path}: topic {topic} cannot be decoded ({_reason(error)})") from error
        if count > MOST_ROWS:
            raise UserError(
                f"{path}: topic {topic} has more than {MOST_ROWS:.0e} messages; cut the flight out"
            )
        yield message, timestamp


@contextlib.contextmanager
def _open_bag(path: Path) -> Iterator[AnyReader]:
    """Open the bag. rosbags raises exceptions of any kind on damaged bytes, so all are caught."""
    folder = path.parent if path.suffix in (".mcap", ".db3") else path
    files = [file for file in folder.iterdir() if file.is_file()] if folder.is_dir() else []
    if path.suffix != ".bag" and folder / "metadata.yaml" not in files:
        raise UserError(f"{path}: a ROS 2 bag is a folder with metadata.yaml; none is there")
    if sum(file.stat().st_size for file in files) > LARGEST:
        raise UserError(f"{path}: has more than {LARGEST:.3g} bytes; cut the flight out")
    try:
        reader = AnyReader([folder], default_typestore=get_typestore(Stores.LATEST))
        reader.open()
    except Exception as error:
        raise UserError(f"{path}: not a readable bag ({_reason(error)})") from error
    try:
        yield reader
    finally:
        reader.close()


def _reason(error: Exception) -> str:
    message = " ".join(str(error).split()).partition(": ")[0]  # what follows may be words of Python
    return shown(message or type(error).__name__, 120)


def _header_time(message) -> float | None:
    stamp = getattr(getattr(message, "header", None), "stamp", None)
    if stamp is None or not (stamp.sec or stamp.nanosec):
        return None
    return stamp.sec + 1e-9 * stamp.nanosec


def _field_value(message, field: str) -> float:
    for part in field.split("."):
        match = _PART.fullmatch(part)
        if match is None:
            raise AttributeError(f"{part!r} is not a field")
        message = getattr(message, match[1])
        if match[2] is not None:
            message = message[int(match[2])]
    return float(message)
