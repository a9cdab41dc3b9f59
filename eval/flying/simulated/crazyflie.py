"""cflib's own `Crazyflie` on a link into a `World`: the same calls and callbacks, in virtual time.

Nothing of cflib is imitated: packets are made and read by its own code. Three things differ from a radio.
Packets are delivered, and callbacks called, in the thread that waits on the clock. Requests of the setting-up
(tables of contents, parameters, log blocks, the supervisor's state) are answered at once. And link statistics
are not collected: they would measure real time.

    flight = fly_simulated(seed=7)
    cf, clock = flight.crazyflie, flight.clock
    cf.open_link(flight.uri)           # returns connected, with all parameters read
    cf.commander.send_setpoint(0, 0, 0, 0)
    clock.wait_until(clock.now() + 0.02)
"""

from __future__ import annotations

import dataclasses
import queue
import threading
import time as real_time
from collections.abc import Callable, Sequence

from inclined_landing.eval.flying.interfaces import MotionCapture
from inclined_landing.eval.flying.simulated.crtp import Packet, Port, port_of
from inclined_landing.eval.flying.simulated.faults import Fault
from inclined_landing.eval.flying.simulated.world import Setting, World
from inclined_landing.models.errors import optional

with optional():
    from cflib.crazyflie import Crazyflie, State
    from cflib.crtp.crtpdriver import CRTPDriver
    from cflib.crtp.crtpstack import CRTPPacket

URI = "simulated://0"
_PATIENCE = 5.0  # s of real time that cflib's threads may take in setting up the link


class _WorldLink(CRTPDriver):
    """The driver of cflib's link into the simulated world."""

    def __init__(self, world: World, owner: Crazyflie):
        super().__init__()
        self.needs_resending = False
        self.parameters_answered = 0
        self._world, self._owner = world, owner
        self._inbox: queue.SimpleQueue[Packet] = queue.SimpleQueue()

    def put(self, packet: Packet) -> None:
        """Receive a packet of the simulated vehicle."""
        self._inbox.put(packet)

    def send_packet(self, pk: CRTPPacket) -> None:
        """Send a packet of cflib, from any thread."""
        self._world.send((pk.header, bytes(pk.data)))

    def receive_packet(self, wait: float = 0) -> CRTPPacket | None:
        """Return the next packet; without one, stop cflib's loop of incoming packets."""
        try:
            head, data = self._inbox.get_nowait()
        except queue.Empty:
            self._owner.incoming.stop()
            return None
        self.parameters_answered += port_of(head)[0] == Port.PARAM
        return CRTPPacket(head, list(data))

    def close(self) -> None:
        """Disconnect from the world."""
        self._world.on_packet = lambda packet: None
        self._world.on_link_lost = lambda reason: None
        self._owner.incoming.stop()

    def get_name(self) -> str:
        """Return the driver's name."""
        return "simulated"


class SimulatedCrazyflie(Crazyflie):
    """cflib's Crazyflie whose link leads into `world`."""

    def __init__(self, world: World):
        super().__init__()
        self._world = world
        self._pilot: threading.Thread | None = None
        self._delivering = False
        self.link_statistics.start = lambda: None
        self.supervisor._cache_timeout = 0.0  # s of real time
        set_value = self.param.set_value

        def set_and_wait(name: str, value) -> None:
            """Set a parameter and wait until the vehicle has it: flights must not depend on threads."""
            before = self.link.parameters_answered if self.link else 0
            set_value(name, value)
            self._wait(lambda: self.link.parameters_answered > before)

        self.param.set_value = set_and_wait

    def open_link(self, link_uri: str = URI) -> None:
        """Connect; return once the vehicle is connected with all parameters read, or when that has failed."""
        self._pilot = threading.current_thread()
        self.connection_requested.call(link_uri)
        self.state, self.link_uri = State.INITIALIZED, link_uri
        link = self.link = _WorldLink(self._world, self)
        self._world.on_packet = link.put
        self._world.on_link_lost = self._link_error_cb
        self.packet_received.add_callback(self._check_for_initial_packet_cb)
        self._start_connection_setup()
        if not self._world.link_up:
            self._link_error_cb("Too many packets lost")
        self._wait(lambda: self.param.is_updated)

    def send_packet(self, pk, expected_reply=(), resend=False, timeout=0.2) -> None:
        """Send as cflib does, and deliver immediate answers before returning to the pilot."""
        super().send_packet(pk, expected_reply, resend, timeout)
        if threading.current_thread() is self._pilot:
            self.deliver()

    def deliver(self) -> None:
        """Call the callbacks of everything that has arrived, in this thread, by cflib's own loop."""
        if self.link is None or self._delivering:
            return
        self._delivering = True
        try:
            self.incoming._stop_event.clear()
            self.incoming.run()
        finally:
            self._delivering = False

    def _wait(self, done: Callable[[], bool]) -> None:
        """Wait for cflib's parameter thread in real time; the world's time stands still."""
        end = real_time.monotonic() + _PATIENCE
        while self.link is not None and not done():
            if real_time.monotonic() > end:
                raise TimeoutError("cflib's threads did not set up the simulated link in time")
            self.deliver()
            real_time.sleep(5e-5)


class SimulatedClock:
    """The world's clock; waiting advances it, with cflib's callbacks in this thread."""

    def __init__(self, world: World, crazyflie: SimulatedCrazyflie):
        self._world, self._crazyflie = world, crazyflie

    def now(self) -> float:
        """Return the present time [s]."""
        return self._world.time

    def wait_until(self, moment: float) -> None:
        """Advance the world to `moment` [s]."""
        self._crazyflie.deliver()
        for _ in self._world.events(moment):
            self._crazyflie.deliver()


@dataclasses.dataclass(frozen=True)
class SimulatedFlight:
    """A connected simulated vehicle, and the world with the ground truth."""

    world: World
    crazyflie: SimulatedCrazyflie
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
    crazyflie = SimulatedCrazyflie(world)
    return SimulatedFlight(world, crazyflie, SimulatedClock(world, crazyflie))
