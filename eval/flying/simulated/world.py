"""Everything except the pilot: vehicle, firmware, radio, cameras and faults, on one time axis.

The caller advances the time: in one go for flights in virtual time, by the real clock in `server.py`. All
random numbers come from one seed, so that a flight repeats bit for bit if the pilot does.
"""

from __future__ import annotations

import dataclasses
import functools
import heapq
import itertools
import math
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import numpy as np

from inclined_landing.eval.flying.interfaces import MeasuredPose
from inclined_landing.eval.flying.simulated.body import FLOOR, Body
from inclined_landing.eval.flying.simulated.crtp import Packet, Port, Services, port_of
from inclined_landing.eval.flying.simulated.faults import (
    BURST_LENGTH,
    BURST_LOSS,
    DEAD_MAN_DELAY,
    SWAP,
    Fault,
)
from inclined_landing.eval.flying.simulated.firmware import PERIOD, Firmware
from inclined_landing.eval.flying.simulated.sensors import Lighthouse, OnboardSensors
from inclined_landing.eval.flying.simulated.transport import (
    CameraQuality,
    LinkDirection,
    LinkQuality,
    SimulatedMotionCapture,
)
from inclined_landing.eval.logs import FlightLog, write_log
from inclined_landing.models.attitude import ROLL, VX, VZ, YAW, X, Z
from inclined_landing.models.errors import UserError
from inclined_landing.models.parameters import load_vehicle
from inclined_landing.models.vehicle import Vehicle

BOOT = 1.0  # s from switching on until somebody connects
# Packets whose answers the pilot waits for while it sets up: they take no time, and none is lost.
_ANSWERED_AT_ONCE = {
    *((Port.LINK, 0), (Port.LINK, 1), (Port.PLATFORM, 1), (Port.SUPERVISOR, 0), (Port.MEM, 0)),
    *((Port.PARAM, channel) for channel in range(4)),
    *((Port.LOG, 0), (Port.LOG, 1)),
}


@dataclasses.dataclass(frozen=True)
class Setting:
    """Vehicle, start, and quality of link and motion capture of a simulated flight."""

    vehicle: Vehicle = dataclasses.field(default_factory=load_vehicle)
    start: tuple[float, float] = (1.0, 0.0)  # x, y on the floor, m
    heading: float | None = None  # rad; None: drawn with a standard deviation of 2 deg
    inclination: float | None = None  # of the platform, rad; None: the vehicle file's
    platform: bool = True  # does it stand there
    lighthouse: bool = False  # does it position itself by a Lighthouse deck
    link: LinkQuality = dataclasses.field(default_factory=LinkQuality)
    cameras: CameraQuality = dataclasses.field(default_factory=CameraQuality)


@dataclasses.dataclass(frozen=True)
class Trace:
    """Ground truth at every engine step; T steps."""

    time: np.ndarray  # (T,) s
    state: np.ndarray  # (T, 13), columns of `models.attitude`
    touching: np.ndarray  # (T, 3) bool: slab, base, floor
    command: np.ndarray  # (T, 4) that vehicle and motors were given: PWM, rad, rad, rad/s
    voltage: np.ndarray  # (T,) V, of the supervisor's last period
    mode: np.ndarray  # (T,) firmware.State

    def write(self, path: Path) -> None:
        """Write the documented CSV at 125 Hz, atomically."""
        some = slice(None, None, 2)
        write_log(
            path,
            FlightLog(
                name=path.name,
                t=self.time[some] - self.time[0],
                position=self.state[some, X : Z + 1],
                attitude=np.unwrap(self.state[some, ROLL : YAW + 1], axis=0),
                command=self.command[some],
                velocity=self.state[some, VX : VZ + 1],
                voltage=self.voltage[some],
                contact=self.touching[some].any(axis=1),
            ),
        )


class World:
    """A simulated Crazyflie with its surroundings, from the moment it is switched on.

    on_packet is called with every packet that arrives at the pilot's side, on_link_lost with a reason where
    the link is given up, on_message with every line of what happens, on_pose with every pose that arrives.
    Raises UserError for a setting that cannot be.
    """

    def __init__(self, setting: Setting, seed: int, faults: Sequence[Fault] = ()):
        seeds = np.random.SeedSequence(seed).spawn(7)
        generators = (np.random.default_rng(s) for s in seeds)
        up, down, seen, specific_force, self.random, start, positions = generators
        if not setting.lighthouse and any(fault.name == "deck-blind" for fault in faults):
            raise UserError("the fault deck-blind needs --lighthouse or --position onboard")
        heading = math.radians(2.0) * start.normal() if setting.heading is None else setting.heading
        self.setting = setting
        self.body = Body(
            setting.vehicle,
            start=setting.start,
            heading=heading,
            inclination=setting.inclination,
            platform=setting.platform,
            seed=int(start.integers(2**31)),
        )
        self.up, self.down = LinkDirection(setting.link, up), LinkDirection(setting.link, down)
        self.view = SimulatedMotionCapture(setting.cameras, seen)
        self._switch_on()
        self.deck = Lighthouse(self.body, positions) if setting.lighthouse else None
        self.sensors = OnboardSensors(self.body, lambda: self.firmware, specific_force, self.deck)
        self.time = 0.0
        self.on_packet: Callable[[Packet], None] = lambda packet: None
        self.on_link_lost: Callable[[str], None] = lambda reason: None
        self.on_message: Callable[[str], None] = lambda line: None
        self.on_pose: Callable[[MeasuredPose], None] = lambda pose: None
        self.thrust = 0.0  # that the motors are given
        self._queue: list[tuple[float, int, Callable[[], None]]] = []
        self._count = itertools.count()
        self._frame = float(start.random()) / setting.cameras.rate
        self._last_battery_reading, self._voltage = -math.inf, self.body.voltage
        self._waiting = list(faults)
        self.begun_faults: list[tuple[float, str]] = []  # faults so far: when, which
        self._flown = False
        self._rows: list[tuple] = []
        self.advance(BOOT)
        self._trigger("start")

    def _switch_on(self) -> None:
        self.firmware = Firmware(self._print)
        self.firmware.parameters["deck.bcLighthouse4"] = int(self.setting.lighthouse)
        self.services = Services(self.firmware, lambda time: self.sensors.values(time))

    def _print(self, line: str) -> None:
        self.on_message(f"console: {line}")
        for packet in self.services.console(line):
            self._send_down(self.body.time, packet)

    @property
    def trace(self) -> Trace:
        """The ground truth so far."""
        return Trace(*map(np.array, zip(*self._rows)))

    # --- what the pilot's side does --------------------------------------------------------------

    def send(self, packet: Packet) -> None:
        """Send a packet of the pilot, now."""
        if port_of(packet[0]) in _ANSWERED_AT_ONCE:
            if self.link_up:
                for answer in self.services.answer(self.time, packet):
                    self.on_packet(answer)
            return
        arrival = self.up.arrival(self.time)
        if arrival is not None:
            self.schedule(arrival, lambda: self._receive(packet))

    @property
    def link_up(self) -> bool:
        """Whether packets get through both ways."""
        return not (self.up.down or self.down.down)

    def advance(self, until: float) -> None:
        """Advance to `until` [s], with everything that is due meanwhile in its order."""
        for _ in self.events(until):
            pass

    def events(self, until: float) -> Iterator[float]:
        """Advance as `advance` does, but yield the time [s] after each event."""
        while True:
            queued = self._queue[0][0] if self._queue else math.inf
            due = min(queued, self._frame, self.services.next_log)
            if due > until:
                break
            self._run(due)
            self.time = max(self.time, due)
            if queued == due:
                heapq.heappop(self._queue)[2]()
            elif self._frame == due:
                self._capture(due)
            else:
                for packet in self.services.logged(due):
                    self._send_down(due, packet)
            yield due
        self._run(until)
        self.time = max(self.time, until)

    # --- what happens ----------------------------------------------------------------------------

    def schedule(self, time: float, action: Callable[[], None]) -> None:
        """Schedule an action at a time [s]."""
        heapq.heappush(self._queue, (time, next(self._count), action))

    # --- what faults do --------------------------------------------------------------------------

    def begin(self, fault: Fault) -> None:
        """Begin a fault now, whatever event it was to wait for."""
        self.on_message(f"fault: {fault.name}")
        self.begun_faults.append((self.time, fault.name))
        match fault.name:
            case "link-lost":
                self._lose_link()
            case "pilot-killed":
                self.up.down = self.down.down = True
                self.schedule(self.time + DEAD_MAN_DELAY, lambda: self.firmware.stop_now())
            case "uplink-lost":
                self.up.down = True
            case "downlink-lost":
                self.down.down = True
            case "packet-storm":
                self._lose_packets(BURST_LOSS)
                self.schedule(self.time + BURST_LENGTH, lambda: self._lose_packets(0.0))
            case "mocap-lost":
                self.view.blind = True
            case "mocap-frozen":
                self.view.frozen = True
            case "mocap-stuck":
                self.view.stuck = True
            case "marker-swap":
                direction = self.random.normal(size=3)
                self.view.shift = SWAP * direction / math.sqrt(direction @ direction)
            case "attitude-turned":
                self.view.turned = True
            case "deck-blind" if self.deck is not None:
                self.deck.blind = True
            case "attitude-wrong":
                self.sensors.sign = -1.0
            case "low-battery":
                self.sensors.failing = True
            case "reboot":
                self._switch_on()
                self._lose_link()

    def _lose_packets(self, share: float) -> None:
        self.up.storm = self.down.storm = share

    def _lose_link(self) -> None:
        """Let no packet through any more; report it as cflib's radio driver does without acknowledgements."""
        self.up.down = self.down.down = True
        end = self.time + self.up.link.attempts * self.up.link.again
        self.schedule(end, lambda: self.on_link_lost("Too many packets lost"))

    # --- what happens by itself ------------------------------------------------------------------

    def _receive(self, packet: Packet) -> None:
        for answer in self.services.answer(self.time, packet):
            self._send_down(self.time, answer)

    def _send_down(self, time: float, packet: Packet) -> None:
        arrival = self.down.arrival(time)
        if arrival is not None:
            self.schedule(arrival, lambda: self.on_packet(packet))

    def _capture(self, time: float) -> None:
        self._frame += 1.0 / self.setting.cameras.rate
        frame = self.view.expose(time, *self.body.pose_at(time))
        if frame is not None:
            arrival, pose = frame
            self.schedule(arrival, lambda: self._arrive(pose))

    def _arrive(self, pose: MeasuredPose) -> None:
        self.view.arrive(pose)
        self.on_pose(pose)

    def _run(self, until: float) -> None:
        while self.body.time < until - 1e-9:
            self._step()

    def _step(self) -> None:
        body = self.body
        if body.time - self._last_battery_reading >= PERIOD - 1e-9:
            self._last_battery_reading = body.time
            self._voltage = body.voltage
            self.sensors.look()
        specific_force = body.specific_force
        setpoint = self.firmware.step(
            body.time, specific_force[2], math.sqrt(specific_force @ specific_force)
        )
        body.step(setpoint)
        self.thrust = setpoint.thrust
        mode = int(self.firmware.state)
        self._rows.append((body.time, body.state, body.touching, body.command.copy(), self._voltage, mode))
        self._watch()

    def _watch(self) -> None:
        """Trigger the faults whose events have occurred."""
        body = self.body
        lifted = not body.touching[FLOOR] and body.state[Z] > body.plant.foot_height + 0.01
        if lifted and not self._flown:
            self._flown = True
            self._trigger("air")

    def _trigger(self, event: str) -> None:
        for fault in [f for f in self._waiting if f.event == event]:
            self._waiting.remove(fault)
            self.schedule(self.body.time + fault.after, functools.partial(self.begin, fault))
