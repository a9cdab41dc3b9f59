"""Poses as UDP datagrams: what the simulated Crazyflie's process sends, and what any other source may.

One datagram is one pose, a JSON object:

    {"position": [x, y, z], "attitude": [w, x, y, z], "age": 0.008}

Metres; a unit quaternion, or null where only a point is seen; how many seconds before sending it was taken.
"""

from __future__ import annotations

import json
import math
import socket
import threading

import numpy as np

from inclined_landing.eval.flying.interfaces import Clock, Pose
from inclined_landing.models.errors import UserError, shown
from inclined_landing.models.storage import reason

LARGEST = 1024  # bytes of a datagram
OLDEST = 1.0  # s that a pose may be old when it is sent


def encode(pose: Pose, now: float) -> bytes:
    """Return the datagram of a pose that is sent at `now` [s]."""
    attitude = None if pose.attitude is None else [round(float(x), 6) for x in pose.attitude]
    position = [round(float(x), 6) for x in pose.position]
    return json.dumps({"position": position, "attitude": attitude, "age": round(now - pose.time, 6)}).encode()


def decode(datagram: bytes, now: float) -> Pose | None:
    """Return the pose of a datagram that arrives at `now` [s]; None for an invalid one."""
    try:
        entry = json.loads(datagram.decode())
        position = np.array(entry["position"], float)
        attitude = None if entry.get("attitude") is None else np.array(entry["attitude"], float)
        age = float(entry.get("age", 0.0))
    except (ValueError, TypeError, KeyError, AttributeError, RecursionError, OverflowError):
        return None
    if position.shape != (3,) or not np.isfinite(position).all() or not 0.0 <= age <= OLDEST:
        return None
    if attitude is not None:
        norm = np.linalg.norm(attitude)
        if attitude.shape != (4,) or not math.isfinite(norm) or abs(norm - 1.0) > 1e-2:
            return None
        attitude = attitude / norm
    return Pose(now - age, position, attitude)


def parse_address(text: str) -> tuple[str, int]:
    """Return host and port of HOST:PORT, or of a port alone on this machine. Raises UserError."""
    host, _, port = text.rpartition(":")
    if not (port.isascii() and port.isdigit() and len(port) <= 5 and 0 < int(port) < 65536):
        raise UserError(f"expected HOST:PORT with a port from 1 to 65535, not {shown(text, 60)}")
    return host or "127.0.0.1", int(port)


def resolved(text: str) -> tuple[str, int]:
    """Return the IP address and port of HOST:PORT. Raises UserError for an unknown host."""
    host, port = parse_address(text)
    try:
        return socket.gethostbyname(host), port
    except (OSError, UnicodeError) as error:
        raise UserError(f"{shown(host, 60)} is no host that is known here") from error


class PoseStream:
    """A `MotionCapture` that listens on a UDP port. address: HOST:PORT to listen on, or a port.

    Raises UserError where nobody may listen there.
    """

    def __init__(self, address: str, clock: Clock):
        self._clock = clock
        self._pose: Pose | None = None
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        try:
            self._socket.bind(resolved(address))
        except OSError as error:
            self._socket.close()
            raise UserError(f"cannot listen for poses on {shown(address, 60)}: {reason(error)}") from error
        self._closed = False
        self._thread = threading.Thread(target=self._listen, name="poses", daemon=True)
        self._thread.start()

    def latest(self) -> Pose | None:
        """Return the newest pose; None before the first one."""
        return self._pose

    def close(self) -> None:
        """Stop listening."""
        self._closed = True
        try:
            self._socket.shutdown(socket.SHUT_RDWR)
        except OSError:  # a UDP socket is not connected, but the call wakes the thread up
            pass
        self._thread.join(timeout=1.0)
        self._socket.close()

    def _listen(self) -> None:
        while True:
            try:
                datagram = self._socket.recv(LARGEST + 1)
            except OSError:
                return
            if self._closed:
                return
            pose = decode(datagram, self._clock.now()) if len(datagram) <= LARGEST else None
            if pose is not None and (self._pose is None or pose.time > self._pose.time):
                self._pose = pose
