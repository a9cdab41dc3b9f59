"""Sources of positions: motion capture systems and the Lighthouse deck.

Motion capture is read with the library `motioncapture` of IMRCLab: Vicon, OptiTrack, Qualisys, Nokov, VRPN.
Set up the axes of the system like the arena's: x along the slope's direction, z up, metres, and the rigid
body's origin in the vehicle's centre of mass, its axes along the vehicle's.

A vehicle with a Lighthouse deck measures its own position: the firmware's Kalman filter runs on board, and
its estimate arrives in a log block. It is used while the filter reports a small variance of the velocity.
"""

from __future__ import annotations

import atexit
import math
import subprocess
import sys
import threading
from typing import Any

import numpy as np

from inclined_landing.eval.flying.interfaces import FlightClock, MeasuredPose, MotionCapture
from inclined_landing.models.base.errors import UserError, not_installed, shown

CONNECTING = 10.0  # s that a connection to motion capture may take
_FIRST = 5.0  # s that its first frame may take
_PROBE = "import sys, motioncapture; motioncapture.connect(sys.argv[1], {'hostname': sys.argv[2]})"
LIGHTHOUSE = "deck.bcLighthouse4"  # parameter, 1 where the deck is there
POSITION = ("stateEstimate.x", "stateEstimate.y", "stateEstimate.z")
VARIANCE = ("kalman.varPX", "kalman.varPY", "kalman.varPZ")  # of the velocity, m2/s2 (`estimator_kalman.c`)
NOISE = 0.003  # m, standard deviation that the pilot gives such a position: it wanders by millimetres
UNSURE = 0.2  # m/s: a filter that knows its velocity no better has lost what its deck sees


def open_capture(name: str, clock: FlightClock, latency: float = 0.0) -> MotionCapture:
    """Return the motion capture of the body TYPE:HOST:BODY, such as vicon:192.168.1.10:cf1.

    latency [s]: of the system, from exposure to arrival. Raises UserError if the body is not seen.
    """
    kind, *rest = name.split(":")
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
            [sys.executable, "-P", "-c", _PROBE, kind, host],
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


class TrackedBody(MotionCapture):
    """One rigid body of a motion capture system.

    system: has `waitForNextFrame()` and `rigidBodies`, as in the library; latency [s]: of the system, from
    exposure to arrival. A thread waits for the frames; if that fails, no more poses arrive, which the pilot
    detects.
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


class OnboardPosition(MotionCapture):
    """The position that a Lighthouse deck measures, in the frame of the arena."""

    def __init__(self):
        self._pose: MeasuredPose | None = None
        self._believed = False

    def latest(self) -> MeasuredPose | None:
        return self._pose

    def add_position(self, time: float, position: np.ndarray) -> None:
        """Add a position (3,) [m] of the vehicle's estimate at `time` [s]."""
        if self._believed and np.isfinite(position).all():
            self._pose = MeasuredPose(time, position)

    def add_variance(self, variance: np.ndarray) -> None:
        """Add the variance (3,) [m2/s2] of the velocity in the vehicle's filter."""
        self._believed = bool(np.isfinite(variance).all() and math.sqrt(max(variance)) < UNSURE)
