"""Motion capture systems, by the library `motioncapture` of IMRCLab: Vicon, OptiTrack, Qualisys, Nokov, VRPN
...

Every system needs its axes set up as the arena's: x along the slope's way, z up, metres, and the rigid body's
origin in the vehicle's centre of mass, its axes along the vehicle's.
"""

from __future__ import annotations

import atexit
import subprocess
import sys
import threading
from typing import Any

import numpy as np

from inclined_landing.eval.flying.interfaces import Clock, MotionCapture, Pose
from inclined_landing.eval.flying.pose_stream import PoseStream
from inclined_landing.models.errors import UserError, not_installed, shown

FORM = "TYPE:HOST:BODY"
CONNECTING = 10.0  # s that a connection may take
_FIRST = 5.0  # s that the first frame may take
_PROBE = "import sys, motioncapture; motioncapture.connect(sys.argv[1], {'hostname': sys.argv[2]})"


class Tracked:
    """One rigid body of a motion capture system.

    system: with `waitForNextFrame()` and `rigidBodies`, as the library's are; latency [s]: of the system,
    from exposure to arrival. A thread waits for the frames; where that fails, poses end, and the pilot
    notices.
    """

    def __init__(self, system: Any, body: str, clock: Clock, latency: float = 0.0):
        self._system, self._body = system, body
        self._clock, self._latency = clock, latency
        self._pose: Pose | None = None
        self._seen: tuple[str, ...] = ()
        self._first, self._ended = threading.Event(), threading.Event()
        self._thread = threading.Thread(target=self._follow, name="motion capture", daemon=True)
        self._thread.start()
        atexit.register(self.close)  # a thread in the library's code would abort the interpreter's end

    def latest(self) -> Pose | None:
        """Return the newest pose; None before the first one."""
        return self._pose

    def await_first(self) -> None:
        """Wait until the body has been seen. Raises UserError, naming the visible bodies, when it is not."""
        if not self._first.wait(_FIRST):
            others = ", ".join(shown(name, 30) for name in self._seen[:8]) or "nothing"
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
                self._seen = tuple(bodies)
                continue
            q = body.rotation
            position = np.array(body.position, float).reshape(-1)
            if position.shape == (3,) and np.isfinite(position).all():
                self._pose = Pose(arrival - self._latency, position, np.array([q.w, q.x, q.y, q.z], float))
                self._first.set()


def open_capture(name: str, clock: Clock, latency: float = 0.0) -> MotionCapture:
    """Return the body TYPE:HOST:BODY, such as vicon:192.168.1.10:cf1, or the poses sent to poses:HOST:PORT.

    Raises UserError where it is not seen.
    """
    parts = name.split(":")
    if parts[0] == "poses":
        return PoseStream(name.partition(":")[2], clock)
    if len(parts) != 3 or not all(parts):
        raise UserError(f"--mocap must be {FORM}, like vicon:192.168.1.10:cf1, not {shown(repr(name), 60)}")
    kind, host, body = parts
    try:
        import motioncapture
    except ModuleNotFoundError as error:
        raise UserError(not_installed(error)) from error
    _probe(name, kind, host)
    try:
        system = motioncapture.connect(kind, {"hostname": host})
    except Exception as error:  # the library raises whatever its SDKs do
        raise UserError(f"no motion capture at {shown(name, 80)}: {shown(error, 200)}") from error
    tracked = Tracked(system, body, clock, latency)
    tracked.await_first()
    return tracked


def _probe(name: str, kind: str, host: str) -> None:
    """Raise UserError for a host without answer, by connecting in another process that can be killed."""
    try:
        probe = subprocess.run(
            [sys.executable, "-c", _PROBE, kind, host], capture_output=True, text=True, timeout=CONNECTING
        )
    except subprocess.TimeoutExpired:
        raise UserError(f"no motion capture at {shown(name, 80)}: no answer in {CONNECTING:g} s") from None
    if probe.returncode != 0:
        message = (probe.stderr.strip() or f"it ended with {probe.returncode}").splitlines()[-1]
        raise UserError(f"no motion capture at {shown(name, 80)}: {shown(message, 200)}")
