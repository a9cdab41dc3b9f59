"""A flight of the simulated Crazyflie in virtual time: its link, its clock and its motion capture.

Packets are delivered in the thread that waits on the clock. Setting up (connecting, parameters, logs) takes
no time and loses no packets. The link's signs are those of cflib's calls.

    flight = fly_simulated(seed=7)
    radio = Radio(flight.link, flight.clock, angle_limit=0.5)
    radio.connect(flight.uri)
    radio.arm()
    flight.clock.wait_until(flight.clock.now() + 0.02)
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from inclined_landing.eval.flying.interfaces import Arrived, MotionCapture
from inclined_landing.eval.flying.simulated.faults import Fault
from inclined_landing.eval.flying.simulated.world import Setting, World

URI = "simulated://0"


class SimulatedLink:
    """The `Link` to the vehicle of a world."""

    def __init__(self, world: World):
        self.connected = False
        self.lost: str | None = None
        self._world = world

    def open(self, uri: str = URI) -> None:
        """Connect immediately; if there is no link, report that it is lost."""
        self._world.on_link_lost = self._is_lost
        if self._world.link_up:
            self.connected = True
        else:
            self._is_lost("Too many packets lost")

    def parameter(self, name: str) -> float:
        """Return a parameter of the vehicle. Raises KeyError for one that it has not."""
        return self._world.parameters[name]

    def log(self, name: str, period: int, variables: Sequence[str], arrived: Arrived) -> None:
        """Log variables every `period` [ms]. Raises KeyError for a variable that the vehicle has not."""
        self._world.log(variables, 1e-3 * period, arrived)

    def arm(self) -> None:
        """Request arming."""
        self._world.send(lambda time: self._world.firmware.request_arming(True))

    def setpoint(self, roll: float, pitch: float, yaw_rate: float, thrust: int) -> None:
        """Send a set-point [deg, deg, deg/s, 0 to 65535]."""
        # Packed as the floats roll, -pitch, yaw rate (`Commander.send_setpoint`).
        r, p, y = np.array([roll, -pitch, yaw_rate], np.float32).tolist()
        self._world.send(lambda time: self._world.firmware.receive_rpyt(time, r, p, y, thrust))

    def notice(self) -> None:
        """Feed the firmware's emergency watchdog."""
        self._world.send(lambda time: self._world.firmware.notice(time))

    def stop(self) -> None:
        """Send the set-point that stops the motors."""
        self._world.send(lambda time: self._world.firmware.receive_stop(time))

    def emergency_stop(self) -> None:
        """Stop the motors and lock the vehicle."""
        self._world.send(lambda time: self._world.firmware.stop_now())

    def close(self) -> None:
        """End the logs and the connection."""
        self._world.logs.clear()
        self._world.on_link_lost = lambda reason: None

    def _is_lost(self, reason: str) -> None:
        self.lost = reason


class SimulatedClock:
    """The world's clock; waiting advances it."""

    def __init__(self, world: World):
        self._world = world

    def now(self) -> float:
        """Return the present time [s]."""
        return self._world.time

    def wait_until(self, moment: float) -> None:
        """Advance the world to `moment` [s]."""
        self._world.advance(moment)


@dataclasses.dataclass(frozen=True)
class SimulatedFlight:
    """A simulated vehicle with its link and clock, and the world with the ground truth."""

    world: World
    link: SimulatedLink
    clock: SimulatedClock
    uri: str = URI

    @property
    def motion_capture(self) -> MotionCapture:
        """The simulated motion capture."""
        return self.world.view


def fly_simulated(
    setting: Setting | None = None, *, seed: int, faults: Sequence[Fault] = ()
) -> SimulatedFlight:
    """Return a Crazyflie on the floor, just switched on. Raises UserError for an impossible setting."""
    world = World(setting or Setting(), seed, faults)
    return SimulatedFlight(world, SimulatedLink(world), SimulatedClock(world))
