"""Binary logs of the Crazyflie's micro-SD card deck.

Little-endian. Header: byte 0xBC, uint16 version (1 or 2), uint16 number of event types; per event type
uint16 id, name, uint16 number of variables, and each variable's name with its type in parentheses, as
`stateEstimate.x(f)`. Names end with a zero byte; types are those of Python's struct: b B h H i I f e.
Then events, in order of time: uint16 id, the time (version 1: uint32 in ms, version 2: uint64 in µs) and
the values. The last four bytes are the CRC-32 of everything before.

Source: Bitcraze, crazyflie-firmware, src/deck/drivers/src/usddeck.c and tools/usdlog/cfusdlog.py.
"""

from __future__ import annotations

import struct
import zlib
from pathlib import Path

import numpy as np

from inclined_landing.eval.logs.clock import LATEST_ROW
from inclined_landing.eval.logs.record import Record
from inclined_landing.models.base.errors import UserError

MAGIC = 0xBC
_TIME = {1: ("<u4", 1e-3), 2: ("<u8", 1e-6)}  # version -> type, seconds
_TYPES = {"b": "i1", "B": "u1", "h": "<i2", "H": "<u2", "i": "<i4", "I": "<u4", "f": "<f4", "e": "<f2"}
_FIXED_FREQUENCY = "fixedFrequency"
_LONGEST_PAUSE = 60.0  # s that a recording in which the checksum is wrong may pause


def is_sd_card_log(path: Path) -> bool:
    """Return whether the file begins like a micro-SD log."""
    with path.open("rb") as file:
        return file.read(1) == bytes([MAGIC])


def read(path: Path) -> Record:
    """Return the log's columns by variable name, each with the time of its events.

    A variable in several events is `event:name` for all but the event logged at a fixed frequency. After a
    wrong checksum or at a truncated end (battery empty, card removed) the rest is lost, which is noted; so
    are zero bytes at the end of a preallocated file.

    Raises UserError for anything else.
    """
    data = path.read_bytes()
    notes = []
    version, events, start = _header(path, data)
    sizes = {key: dtype.itemsize for key, (_, dtype) in events.items()}
    rows, rest = _offsets(data, start, len(data) - 4, sizes)
    if zlib.crc32(data[:-4]) != struct.unpack("<I", data[-4:])[0]:
        written = len(data.rstrip(b"\0"))
        if len(data) - written < max(sizes.values(), default=0):
            written = len(data)  # zeros may be the values of the last event
        rows, rest = _offsets(data, start, len(data), sizes, written)
        after = len(data) - rest
        if zlib.crc32(data[:after]) == int.from_bytes(data[after : after + 4], "little"):
            rest = 0  # whole, only longer
        else:
            notes.append("the checksum is wrong: the recording was cut short or the file is damaged")
            rows, rest = _offsets(data, start, written, sizes)
            rows = _of_one_recording(data, rows, version, notes)
        if written < len(data):
            notes.append(f"the file ends in {len(data) - written} zero bytes and is read up to there")
    if rest:
        notes.append(f"the last {rest} bytes are not a whole event and were left out")
    columns, times = {}, {}
    # Fixed frequency first: its variables keep their plain names.
    for key, (event, dtype) in sorted(events.items(), key=lambda item: item[1][0] != _FIXED_FREQUENCY):
        if not rows.get(key):
            continue
        offsets = np.asarray(rows[key])
        packed = np.frombuffer(data, np.uint8)[offsets[:, None] + np.arange(dtype.itemsize)]
        table = np.ascontiguousarray(packed).view(dtype)[:, 0]
        for name in dtype.names[2:]:
            column = name if name not in columns else f"{event}:{name}"
            columns[column] = table[name].astype(float)
            times[column] = table["time"] * _TIME[version][1]
    if not columns:
        raise UserError(f"{path}: this micro-SD log contains no events")
    return Record(str(path), columns, times=times, notes=tuple(notes))


def _of_one_recording(
    data: bytes, rows: dict[int, list[int]], version: int, notes: list[str]
) -> dict[int, list[int]]:
    """Return the events before the clock jumps, as at the remains of an earlier, longer recording."""
    offsets = np.sort(np.concatenate([[], *rows.values()]).astype(int))
    kind, seconds = np.dtype(_TIME[version][0]), _TIME[version][1]
    packed = np.frombuffer(data, np.uint8)[offsets[:, None] + 2 + np.arange(kind.itemsize)]
    t = np.ascontiguousarray(packed).view(kind)[:, 0] * seconds
    jumps = np.flatnonzero((np.diff(t) < -LATEST_ROW) | (np.diff(t) > _LONGEST_PAUSE))
    if not len(jumps):
        return rows
    last = jumps[0]
    notes.append(
        f"the clock jumps from {t[last]:.6g} to {t[last + 1]:.6g} s: what follows is damaged or another "
        "recording, and was left out"
    )
    return {key: [k for k in found if k <= offsets[last]] for key, found in rows.items()}


def _header(path: Path, data: bytes) -> tuple[int, dict[int, tuple[str, np.dtype]], int]:
    """Return the version, (name, row type) of every event by its id, and the offset of the first event."""
    try:
        magic, version, number = struct.unpack_from("<BHH", data)
        if magic != MAGIC or version not in _TIME:
            raise UserError(
                f"{path}: not a micro-SD log of version 1 or 2 (byte {magic:#x}, version {version})"
            )
        position, events = 5, {}
        for _ in range(number):
            (key,) = struct.unpack_from("<H", data, position)
            event, position = _name(data, position + 2)
            (variables,) = struct.unpack_from("<H", data, position)
            position += 2
            fields = [("id", "<u2"), ("time", _TIME[version][0])]
            for _ in range(variables):
                name, position = _name(data, position)
                fields.append(_field(path, name))
            events[key] = (event, np.dtype(fields))
    except (struct.error, ValueError) as error:
        if isinstance(error, UserError):
            raise
        raise UserError(f"{path}: the header of the micro-SD log is damaged ({error})") from error
    return version, events, position


def _field(path: Path, name: str) -> tuple[str, str]:
    """Return name and type of a variable whose name ends with its type in parentheses."""
    name, kind = name[:-3], name[-3:]
    if kind[:1] + kind[2:] != "()" or kind[1] not in _TYPES:
        raise UserError(f"{path}: variable {name + kind} has an unknown type")
    return name, _TYPES[kind[1]]


def _name(data: bytes, position: int) -> tuple[str, int]:
    end = data.index(b"\0", position)
    return data[position:end].decode("ascii"), end + 1


def _offsets(
    data: bytes, position: int, end: int, sizes: dict[int, int], written: int | None = None
) -> tuple[dict[int, list[int]], int]:
    """Return the offsets of each event's rows, and the number of trailing bytes without a complete event.

    From `written` on there are zeros, which no event begins with.
    """
    rows: dict[int, list[int]] = {}
    while position + 2 <= end and position < (end if written is None else written):
        key = data[position] | data[position + 1] << 8
        size = sizes.get(key)
        if size is None or position + size > end:
            break
        rows.setdefault(key, []).append(position)
        position += size
    return rows, end - position
