"""ROS 1 and ROS 2 bags, through the rosbags library (no ROS needed).

A column is `topic:field.path`, as `/cf1/pose:pose.position.x`; an array's element is `values[0]`.
"""

from __future__ import annotations

import contextlib
import itertools
import re
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np
from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_typestore

from inclined_landing.eval.logs import mapping
from inclined_landing.eval.logs.limits import LARGEST, LONGEST, MOST_ROWS
from inclined_landing.eval.logs.record import Record
from inclined_landing.models.base.errors import UserError, shown

LATEST = 1.0  # s that a message may be recorded after its stamp, where other topics have none
_PART = re.compile(r"(\w+)(?:\[(\d+)\])?")


def read(path: Path, patterns: Sequence[str]) -> Record:
    """Return the columns of a bag that match `patterns` (`topic:field.path`, `*` in the topic).

    The time of a message is the stamp in its header or, if there is none, the time at which the bag received
    it, which is noted. An element that an array lacks in some messages is NaN there. Unreadable columns are
    in `unreadable`, each with a reason. Raises UserError if the bag cannot be opened.
    """
    columns: dict[str, np.ndarray] = {}
    unreadable: dict[str, str] = {}
    clocks, notes = {}, list[str]()
    with _open_bag(path) as reader:
        fields_by_topic: dict[str, list[str]] = {}
        for pattern in dict.fromkeys(patterns):
            topic, _, field = pattern.partition(":")
            try:
                found = mapping.find(sorted(reader.topics), topic, str(path)) if field else None
            except UserError as error:  # of two vehicles, say
                unreadable[pattern] = str(error).removeprefix(f"{path}: ")
                continue
            if found is not None:
                fields_by_topic.setdefault(found, []).append(field)
        for topic, fields in fields_by_topic.items():
            try:
                stamps, received, values, wrong = _read_topic(reader, topic, fields)
            except UserError as error:
                unreadable |= {f"{topic}:{field}": str(error) for field in fields}
                continue
            if not len(received):
                continue
            clocks[topic] = stamps, received
            columns |= {f"{topic}:{field}": value for field, value in values.items()}
            unreadable |= {f"{topic}:{field}": why for field, why in wrong.items()}
    dated = _date(clocks, notes)
    times = {}
    for column in columns:
        clock = dated[column.partition(":")[0]]
        order = np.argsort(clock, kind="stable")
        columns[column], times[column] = columns[column][order], clock[order]
    return Record(str(path), columns, times=times, unreadable=unreadable, notes=tuple(notes))


def _read_topic(
    reader: AnyReader, topic: str, fields: Sequence[str]
) -> tuple[np.ndarray, np.ndarray, dict[str, np.ndarray], dict[str, str]]:
    """Return the stamps and times of receipt (m,) of a topic's messages [s], and each field's values (m,).

    A missing stamp is NaN. The last result contains reasons by field for those without numbers. Raises
    UserError, without the path, for messages that cannot be decoded.
    """
    stamps, received, wrong = [], [], {}
    values: dict[str, list[float]] = {field: [] for field in fields}
    for message, timestamp in _messages(reader, topic):
        stamps.append(_header_time(message))
        received.append(1e-9 * timestamp)
        for field in (field for field in values if field not in wrong):
            try:
                values[field].append(_field_value(message, field))
            except IndexError:  # fewer elements than in other messages: tracking was lost
                values[field].append(np.nan)
            except (AttributeError, TypeError, ValueError) as error:
                kind = str(getattr(message, "__msgtype__", "a nested type"))
                wrong[field] = (
                    f"field {field} of topic {topic} is not a number ({shown(kind)}: {_reason(error)})"
                )
    for field, column in values.items():
        if field not in wrong and received and "[" in field and np.isnan(column).all():
            wrong[field] = f"no message of topic {topic} has the element {field}"
    columns = {field: np.array(column, float) for field, column in values.items() if field not in wrong}
    return np.array(stamps), np.array(received), columns, wrong


def _date(clocks: Mapping[str, tuple[np.ndarray, np.ndarray]], notes: list[str]) -> dict[str, np.ndarray]:
    """Return the times (m,) [s] of the messages by topic, from their stamps or times of receipt."""
    stamped = {
        topic: bool((stamps > 0.0).all() and np.ptp(stamps) <= LONGEST)
        for topic, (stamps, _) in clocks.items()
    }
    notes += [
        f"messages of {topic} have no time stamp; the time of recording is used"
        for topic in clocks
        if not stamped[topic]
    ]
    for topic, (stamps, received) in clocks.items():
        apart = float(np.median(np.abs(stamps - received)))
        if stamped[topic] and apart > LATEST and not all(stamped.values()):
            stamped[topic] = False
            notes.append(
                f"time stamps of {topic} differ from the times of recording by {apart:.3g} s; as other "
                "topics have no time stamps, the times of recording are used"
            )
    return {topic: clocks[topic][0 if stamped[topic] else 1] for topic in clocks}


def _messages(reader: AnyReader, topic: str) -> Iterator[tuple[object, int]]:
    """Yield the messages of a topic with their times of receipt [ns]."""
    connections = [c for c in reader.connections if c.topic == topic]
    stored = reader.messages(connections=connections)
    for count in itertools.count(1):
        try:
            connection, timestamp, raw = next(stored)
            message = reader.deserialize(raw, connection.msgtype)
        except StopIteration:
            return
        except Exception as error:  # rosbags raises any kind on damaged bytes
            kind = shown(connections[0].msgtype)
            raise UserError(
                f"topic {topic} ({kind}) cannot be decoded ({_reason(error)}); if the bag does not "
                "define this type, `ros2 bag convert` to mcap adds the definition"
            ) from error
        if count > MOST_ROWS:
            raise UserError(f"topic {topic} has more than {MOST_ROWS:.0e} messages; extract the flight")
        yield message, timestamp


@contextlib.contextmanager
def _open_bag(path: Path) -> Iterator[AnyReader]:
    """Open the bag. rosbags raises exceptions of any kind on damaged bytes, so all are caught."""
    folder = path.parent if path.suffix in (".mcap", ".db3") else path
    inside = list(folder.iterdir()) if folder.is_dir() else []
    if odd := [file.name for file in inside if not (file.is_file() or file.is_dir())]:  # a pipe has no end
        raise UserError(f"{path}: {shown(odd[0])} in it is not a regular file")
    files = [file for file in inside if file.is_file()]
    if path.suffix != ".bag" and folder / "metadata.yaml" not in files:
        stored = [path] if folder != path else [file for file in files if file.suffix in (".mcap", ".db3")]
        if len(stored) != 1:
            raise UserError(
                f"{path}: a ROS 2 bag is a folder with metadata.yaml, which `ros2 bag reindex "
                f"{shown(folder.name)}` writes, or one .mcap or .db3 file; {len(stored)} are there"
            )
        folder, files = stored[0], stored
    if sum(file.stat().st_size for file in files) > LARGEST:
        raise UserError(f"{path}: has more than {LARGEST:.3g} bytes; extract the flight")
    try:
        reader = AnyReader([folder], default_typestore=get_typestore(Stores.LATEST))
        reader.open()
    except Exception as error:
        tools = "`rosbag reindex` or `mcap recover` recovers the intact part of one that was cut short"
        raise UserError(f"{path}: not a readable bag ({_reason(error)}); {tools}") from error
    try:
        yield reader
    finally:
        reader.close()


def _reason(error: Exception) -> str:
    message = " ".join(str(error).split()).partition(": ")[0]  # what follows may be words of Python
    return shown(message or type(error).__name__, 120)


def _header_time(message) -> float:
    try:
        return float(message.header.stamp.sec + 1e-9 * message.header.stamp.nanosec)
    except (AttributeError, TypeError, ValueError):  # none, or of a type of its own
        return np.nan


def _field_value(message, field: str) -> float:
    for part in field.split("."):
        match = _PART.fullmatch(part)
        if match is None:
            raise AttributeError(f"{part!r} is not a field")
        message = getattr(message, match[1])
        if match[2] is not None:
            message = message[int(match[2])]
    return float(message)
