"""Where positions come from: motion capture systems, poses as UDP datagrams, a Lighthouse deck.

Motion capture is reached by the library `motioncapture` of IMRCLab: Vicon, OptiTrack, Qualisys, Nokov, VRPN.
Set up the axes of the system like the arena's: x along the slope's direction, z up, metres, and the rigid
body's origin in the vehicle's centre of mass, its axes along the vehicle's.

Datagrams are what the simulated Crazyflie's process sends, and what any other source may. One is one pose, a
JSON object:

    {"position": [x, y, z], "attitude": [w, x, y, z], "age": 0.008}

Metres; a unit quaternion, or null where only a point is seen; how many seconds before sending it was taken.

A vehicle with a Lighthouse deck measures its own position: the firmware's Kalman filter runs on board, and
its estimate arrives in a log block. It is used while the filter reports a small variance of the velocity.
"""

from __future__ import annotations

import atexit
import json
import math
import socket
import subprocess
import sys
import threading
from typing import Any

import numpy as np

from inclined_landing.eval.flying.interfaces import FlightClock, MeasuredPose, MotionCapture
from inclined_landing.models.errors import UserError, not_installed, shown
from inclined_landing.models.storage import reason

CONNECTING = 10.0  # s that a connection to motion capture may take
_FIRST = 5.0  # s that its first frame may take
_PROBE = "import sys, motioncapture; motioncapture.connect(sys.argv[1], {'hostname': sys.argv[2]})"
LARGEST = 1024  # bytes of a datagram
OLDEST = 1.0  # s that a pose may be old when it is sent
LIGHTHOUSE = "deck.bcLighthouse4"  # parameter, 1 where the deck is there
POSITION = ("stateEstimate.x", "stateEstimate.y", "stateEstimate.z")
VARIANCE = ("kalman.varPX", "kalman.varPY", "kalman.varPZ")  # of the velocity, m2/s2 (`estimator_kalman.c`)
NOISE = 0.003  # m, standard deviation that the pilot gives such a position: it wanders by millimetres
UNSURE = 0.2  # m/s: a filter that knows its velocity no better has lost what its deck sees


def open_capture(name: str, clock: FlightClock, latency: float = 0.0) -> MotionCapture:
    """Return the body TYPE:HOST:BODY, such as vicon:192.168.1.10:cf1, or the poses sent to poses:HOST:PORT.

    latency [s]: of the system, from exposure to arrival. Raises UserError where nothing is seen.
    """
    kind, *rest = name.split(":")
    if kind == "poses":
        return PoseStream(":".join(rest), clock)
    if len(rest) != 2 or not all((kind, *rest)):
        raise UserError(
            f"--mocap must be TYPE:HOST:BODY, like vicon:192.168.1.10:cf1, not {shown(repr(name), 60)}"
        )
    host, body = rest
    try:
        import motioncapture
    except ModuleNotFoundError as error:
        raise UserError(not_installed(error)) from error
    try:
        # In another process first, which can be killed where the host does not answer.
        subprocess.run(
            [sys.executable, "-c", _PROBE, kind, host],
            capture_output=True,
            text=True,
            timeout=CONNECTING,
            check=True,
        )
        system = motioncapture.connect(kind, {"hostname": host})
    except Exception as error:  # the library raises whatever its SDKs do
        said: object = error
        if isinstance(error, subprocess.TimeoutExpired):
            said = f"no answer in {CONNECTING:g} s"
        elif isinstance(error, subprocess.CalledProcessError):
            said = (error.stderr.strip() or f"it exited with code {error.returncode}").splitlines()[-1]
        raise UserError(f"no motion capture at {shown(name, 80)}: {shown(said, 200)}") from error
    tracked = TrackedBody(system, body, clock, latency)
    tracked.await_first()
    return tracked


class TrackedBody:
    """One rigid body of a motion capture system.

    system: with `waitForNextFrame()` and `rigidBodies`, as the library's are; latency [s]: of the system,
    from exposure to arrival. A thread waits for the frames; where that fails, poses end, and the pilot
    notices.
    """

    def __init__(self, system: Any, body: str, clock: FlightClock, latency: float = 0.0):
        self._system, self._body = system, body
        self._clock, self._latency = clock, latency
        self._pose: MeasuredPose | None = None
        self._others: tuple[str, ...] = ()
        self._first, self._ended = threading.Event(), threading.Event()
        self._thread = threading.Thread(target=self._follow, name="motion capture", daemon=True)
        self._thread.start()
        atexit.register(self.close)  # a thread in the library's code would abort the interpreter's end

    def latest(self) -> MeasuredPose | None:
        """Return the newest pose; None before the first one."""
        return self._pose

    def await_first(self) -> None:
        """Wait until the body has been seen. Raises UserError, naming the visible bodies, when it is not."""
        if not self._first.wait(_FIRST):
            others = ", ".join(shown(name, 30) for name in self._others[:8]) or "nothing"
            raise UserError(
                f"motion capture does not show {shown(self._body, 40)} within {_FIRST:g} s; it shows {others}"
            )

    def close(self) -> None:
        """Stop receiving frames."""
        self._ended.set()
        self._thread.join(1.0)

    def _follow(self) -> None:
        while not self._ended.is_set():
            self._system.waitForNextFrame()
            arrival = self._clock.now()
            bodies = self._system.rigidBodies
            body = bodies.get(self._body)
            if body is None:
                self._others = tuple(bodies)
                continue
            q = body.rotation
            position = np.array(body.position, float).reshape(-1)
            if position.shape == (3,) and np.isfinite(position).all():
                attitude = np.array([q.w, q.x, q.y, q.z], float)
                self._pose = MeasuredPose(arrival - self._latency, position, attitude)
                self._first.set()


def encode(pose: MeasuredPose, now: float) -> bytes:
    """Return the datagram of a pose that is sent at `now` [s]."""
    attitude = None if pose.attitude is None else [round(float(x), 6) for x in pose.attitude]
    position = [round(float(x), 6) for x in pose.position]
    return json.dumps({"position": position, "attitude": attitude, "age": round(now - pose.time, 6)}).encode()


def decode(datagram: bytes, now: float) -> MeasuredPose | None:
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
    return MeasuredPose(now - age, position, attitude)


def resolved(text: str) -> tuple[str, int]:
    """Return the IP address and port of HOST:PORT, or of a port alone on this machine. Raises UserError."""
    host, _, port = text.rpartition(":")
    if not (port.isascii() and port.isdigit() and len(port) <= 5 and 0 < int(port) < 65536):
        raise UserError(f"expected HOST:PORT with a port from 1 to 65535, not {shown(text, 60)}")
    try:
        return socket.gethostbyname(host or "127.0.0.1"), int(port)
    except (OSError, UnicodeError) as error:
        raise UserError(f"{shown(host, 60)} is an unknown host") from error


class PoseStream:
    """A `MotionCapture` that listens on a UDP port. address: HOST:PORT to listen on, or a port.

    Raises UserError where that address cannot be bound.
    """

    def __init__(self, address: str, clock: FlightClock):
        self._clock = clock
        self._pose: MeasuredPose | None = None
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        try:
            self._socket.bind(resolved(address))
        except OSError as error:
            self._socket.close()
            raise UserError(f"cannot listen for poses on {shown(address, 60)}: {reason(error)}") from error
        self._closed = False
        self._thread = threading.Thread(target=self._listen, name="poses", daemon=True)
        self._thread.start()

    def latest(self) -> MeasuredPose | None:
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


class OnboardPosition:
    """A `MotionCapture` from the position that a Lighthouse deck measures, in the frame of the arena."""

    def __init__(self):
        self._pose: MeasuredPose | None = None
        self._believed = False

    def latest(self) -> MeasuredPose | None:
        """Return the newest pose; None before the first one."""
        return self._pose

    def add_position(self, time: float, position: np.ndarray) -> None:
        """Add a position (3,) [m] of the vehicle's estimate that it had at `time` [s]."""
        if self._believed and np.isfinite(position).all():
            self._pose = MeasuredPose(time, position)

    def add_variance(self, variance: np.ndarray) -> None:
        """Add what the vehicle's filter says of its velocity, (3,) [m2/s2]."""
        self._believed = bool(np.isfinite(variance).all() and math.sqrt(max(variance)) < UNSURE)
