"""The services behind the ports of CRTP, the radio protocol of the Crazyflie, as cflib asks for them.

Protocol version 12, as in bitcraze/crazyflie-firmware at 2a18fc2: `crtpservice.c`, `platformservice.c`,
`crtp_supervisor.c`, `log.c`, `param_logic.c`, `crtp_commander*.c`, and `crtp_localization_service.c` for its
emergency stops. There are no memories and no high-level commander; decks are their parameters. A packet is
(header, data): port and channel in one byte, and up to 30 bytes.
"""

from __future__ import annotations

import dataclasses
import enum
import errno
import struct
import zlib
from collections.abc import Callable, Iterator, Mapping

from inclined_landing.eval.flying.simulated.firmware import Firmware

Packet = tuple[int, bytes]


class Port(enum.IntEnum):
    """The ports that something answers on."""

    CONSOLE = 0
    PARAM = 2
    COMMANDER = 3
    MEM = 4
    LOG = 5
    LOCALIZATION = 6
    GENERIC = 7
    SUPERVISOR = 9
    PLATFORM = 13
    LINK = 15


PROTOCOL_VERSION = 12
LARGEST = 30  # bytes of data

_UINT16, _FLOAT, _BYTE = 2, 7, 8  # types, as tables of contents have them
_FETCHED = {1: "<B", 2: "<H", 3: "<L", 4: "<b", 5: "<h", 6: "<i", 7: "<f", 8: "<e"}
# Log variables. Angles in deg, pitch inverted; position in m, the filter's variance of the velocity in m2/s2;
# rates in deg/s, specific force in g, thrust of the set-point in force 0 to 60000, voltage in V.
LOGGED = (
    *(f"stateEstimate.{name}" for name in ("roll", "pitch", "yaw", "x", "y", "z")),
    *(f"kalman.{name}" for name in ("varPX", "varPY", "varPZ")),
    *(f"stabilizer.{name}" for name in ("roll", "pitch", "yaw", "thrust")),
    *(f"{sensor}.{axis}" for sensor in ("gyro", "acc") for axis in "xyz"),
    *("pm.vbat", "supervisor.info"),  # the last one: bits, see cflib's Supervisor
)
_MOST_BLOCKS, _MOST_VARIABLES, _LOG_BYTES = 16, 128, 26


def header(port: int, channel: int) -> int:
    """Return the first byte of a packet, with the two bits that are always set."""
    return port << 4 | 3 << 2 | channel


def port_of(head: int) -> tuple[int, int]:
    """Return port and channel of a header byte."""
    return head >> 4, head & 3


@dataclasses.dataclass
class _Block:
    """A block of log variables that are sent together."""

    variables: list[tuple[str, str]]  # name, struct format
    period: float = 0.0  # s; 0: stopped
    next: float = 0.0  # s


class Services:
    """The CRTP services of one `Firmware`: answers to packets, and log blocks.

    values: the present values of LOGGED by name, at a time [s]; read when a block is due.
    """

    def __init__(self, firmware: Firmware, values: Callable[[float], Mapping[str, float]]):
        self.firmware = firmware
        self._values = values
        self._blocks: dict[int, _Block] = {}

    def answer(self, time: float, packet: Packet) -> list[Packet]:
        """Return the answers to a packet that arrives at `time` [s]; none for a malformed one."""
        head, data = packet
        port, channel = port_of(head)
        if len(data) > LARGEST:
            return []
        try:
            replies = list(self._replies(time, port, channel, bytes(data)))
        except (struct.error, IndexError):  # too short
            return []
        return [(header(port, c), bytes(d)) for c, d in replies]

    @property
    def next_log(self) -> float:
        """Time at which the next log block is due [s]; infinity while none is."""
        return min((b.next for b in self._blocks.values() if b.period), default=float("inf"))

    def logged(self, time: float) -> list[Packet]:
        """Return the log blocks that are due at `time` [s]."""
        packets = []
        for name, block in sorted(self._blocks.items()):
            if block.period and block.next <= time + 1e-9:
                values = self._values(block.next)
                stamp = int(block.next * 1000.0).to_bytes(4, "little")[:3]
                data = b"".join(_packed(form, values[v]) for v, form in block.variables)
                packets.append((header(Port.LOG, 2), bytes([name]) + stamp + data))
                block.next += block.period
        return packets

    @staticmethod
    def console(line: str) -> list[Packet]:
        """Return the packets of a line that the firmware prints."""
        text = (line + "\n").encode()
        return [(header(Port.CONSOLE, 0), text[k : k + LARGEST]) for k in range(0, len(text), LARGEST)]

    def _replies(self, time: float, port: int, channel: int, data: bytes) -> Iterator[tuple[int, bytes]]:
        """Act on a packet; yield channel and data of the answers."""
        fly, command = self.firmware, data[0] if data else None
        match port, channel, command:
            case Port.LINK, 0, _:
                yield 0, data
            case Port.LINK, 1, _:
                yield 1, b"Bitcraze Crazyflie".ljust(LARGEST, b"\0")
            case Port.PLATFORM, 1, 0:
                yield 1, struct.pack("<BI", 0, PROTOCOL_VERSION)
            case Port.PLATFORM, 1, 1:
                yield 1, b"\x01simulated"
            case Port.PLATFORM, 1, 2:
                yield 1, b"\x02CF21"
            case Port.SUPERVISOR, 0, 0x0C:
                yield 0, struct.pack("<BH", 0x8C, fly.info)
            case Port.SUPERVISOR, 1, 1:
                yield 1, bytes([0x81, fly.request_arming(bool(data[1])), fly.armed])
            case ((Port.SUPERVISOR | Port.LOCALIZATION), 1, 3):
                fly.stop_now()
            case ((Port.SUPERVISOR | Port.LOCALIZATION), 1, 4):
                fly.notice(time)
            case Port.COMMANDER, 0, _:
                fly.receive_rpyt(time, *struct.unpack("<fffH", data))
            case Port.GENERIC, 0, 0:
                fly.receive_stop(time)
            case Port.MEM, 0, 1:
                yield 0, bytes([1, 0])
            case Port.PARAM, 0, _:
                yield from _contents(data, [(name, _BYTE) for name in fly.parameters], b"")
            case Port.PARAM, (1 | 2), _:
                yield channel, self._parameter(channel, data)
            case Port.LOG, 0, _:
                kinds = [(name, _UINT16 if name == "supervisor.info" else _FLOAT) for name in LOGGED]
                yield from _contents(data, kinds, bytes([_MOST_BLOCKS, _MOST_VARIABLES]))
            case Port.LOG, 1, int():
                block = data[1] if len(data) > 1 else 0
                yield 1, bytes([command, block, self._set_up(time, command, block, data[2:])])

    def _parameter(self, channel: int, data: bytes) -> bytes:
        """Return the answer to reading (channel 1) or writing (2) a parameter."""
        number, values = struct.unpack("<H", data[:2])[0], self.firmware.parameters
        if number >= len(values):
            return data[:2] + bytes([errno.ENOENT])
        name = list(values)[number]
        if channel == 2:
            values[name] = data[2]
            return data
        return data[:2] + bytes([0, values[name]])

    def _set_up(self, time: float, command: int, name: int, data: bytes) -> int:
        """Return the result of a log block command: 0 or an error number."""
        if command == 5:
            self._blocks.clear()
            return 0
        if command in (6, 7):
            return self._add(name, data, new=command == 6)
        block = self._blocks.get(name)
        if block is None:
            return errno.ENOENT
        if command == 2:
            del self._blocks[name]
        elif command == 3:
            block.period = data[0] / 100.0
            block.next = time + block.period
        elif command == 4:
            block.period = 0.0
        else:
            return errno.ENOEXEC
        return 0

    def _add(self, name: int, data: bytes, new: bool) -> int:
        if new and name in self._blocks:
            return errno.EEXIST
        if new and len(self._blocks) == _MOST_BLOCKS:
            return errno.ENOMEM
        if not new and name not in self._blocks:
            return errno.ENOENT
        added = []
        for kind, number in struct.iter_unpack("<BH", data[: len(data) // 3 * 3]):
            if number >= len(LOGGED) or kind & 15 not in _FETCHED:
                return errno.ENOENT
            added.append((LOGGED[number], _FETCHED[kind & 15]))
        variables = (self._blocks[name].variables if not new else []) + added
        if sum(struct.calcsize(form) for _, form in variables) > _LOG_BYTES:
            return errno.E2BIG
        if sum(len(b.variables) for b in self._blocks.values()) + len(added) > _MOST_VARIABLES:
            return errno.ENOMEM
        self._blocks[name] = _Block(variables)
        return 0


def _contents(data: bytes, items: list[tuple[str, int]], more: bytes) -> Iterator[tuple[int, bytes]]:
    """Yield the size and hash of a table of contents, or one of its items."""
    if data[0] == 3:
        checksum = zlib.crc32(repr(items).encode())
        yield 0, struct.pack("<BHI", 3, len(items), checksum) + more
    elif data[0] == 2:
        number = struct.unpack("<H", data[1:3])[0]
        if number >= len(items):
            yield 0, b"\x02"
            return
        name, kind = items[number]
        yield 0, struct.pack("<BHB", 2, number, kind) + name.replace(".", "\0").encode() + b"\0"


def _packed(form: str, value: float) -> bytes:
    """Return one logged value as bytes; integers are clipped to their range."""
    if form in ("<f", "<e"):
        return struct.pack(form, value)
    size, signed = 8 * struct.calcsize(form), form[1].islower()
    low, high = (-(2 ** (size - 1)), 2 ** (size - 1) - 1) if signed else (0, 2**size - 1)
    return struct.pack(form, min(high, max(low, round(value))))
