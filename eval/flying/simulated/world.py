"""Everything except the pilot: vehicle, firmware, radio, cameras and faults, on one time axis.

The caller advances the time, and packets are delivered in its thread. Setting up (connecting, parameters,
logs) takes no time and loses no packets. All random numbers come from one seed, so that a flight repeats bit
for bit if the pilot does.

    world = World(seed=7)
    radio = Radio(world, world, angle_limit=0.5)
    radio.connect(URI)
    radio.arm()
    world.wait_until(world.now() + 0.02)
"""

from __future__ import annotations

import dataclasses
import functools
import heapq
import itertools
import math
from collections.abc import Callable, Sequence

import numpy as np

from inclined_landing.eval.flying.interfaces import Arrived, FlightClock
from inclined_landing.eval.flying.positions import LIGHTHOUSE
from inclined_landing.eval.flying.simulated.body import FLOOR, Body
from inclined_landing.eval.flying.simulated.faults import (
    BURST_LENGTH,
    BURST_LOSS,
    DEAD_MAN_DELAY,
    SWAP,
    Fault,
)
from inclined_landing.eval.flying.simulated.firmware import PERIOD, Firmware
from inclined_landing.eval.flying.simulated.sensors import LOGGED, Lighthouse, OnboardSensors
from inclined_landing.eval.flying.simulated.transport import (
    CameraQuality,
    LinkDirection,
    LinkQuality,
    SimulatedMotionCapture,
)
from inclined_landing.models.attitude import Z
from inclined_landing.models.base.errors import UserError
from inclined_landing.models.parameters import load_vehicle
from inclined_landing.models.vehicle import Vehicle

URI = "simulated://0"
BOOT = 1.0  # s from switching on until somebody connects


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
    mode: np.ndarray  # (T,) firmware.State


@dataclasses.dataclass
class LogBlock:
    """Variables that the vehicle sends together."""

    variables: tuple[str, ...]
    period: float  # s
    arrived: Arrived  # called with every packet that arrives
    next: float  # s


class World(FlightClock):
    """A simulated Crazyflie on the floor with its surroundings, from the moment it is switched on.

    It is the clock of its flight: waiting advances it. It is also its radio link, with the methods of
    `vehicle.CflibLink`. Raises UserError for an impossible setting.
    """

    def __init__(self, setting: Setting | None = None, *, seed: int, faults: Sequence[Fault] = ()):
        setting = setting or Setting()
        seeds = np.random.SeedSequence(seed).spawn(7)
        generators = (np.random.default_rng(s) for s in seeds)
        up, down, seen, specific_force, self.random, start, positions = generators
        if not setting.lighthouse and any(fault.name == "deck-blind" for fault in faults):
            raise UserError("the fault deck-blind needs --position onboard")
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
        self.logs: list[LogBlock] = []
        self.firmware = Firmware()
        self.deck = Lighthouse(self.body, positions) if setting.lighthouse else None
        self.sensors = OnboardSensors(self.body, lambda: self.firmware, specific_force, self.deck)
        self.connected = False
        self.lost: str | None = None
        self.time = 0.0
        self.thrust = 0.0  # the thrust commanded to the motors
        self._queue: list[tuple[float, int, Callable[[], object]]] = []
        self._count = itertools.count()
        self._frame = float(start.random()) / setting.cameras.rate
        self._last_battery_reading = -math.inf
        self._waiting = list(faults)
        self.begun_faults: list[tuple[float, str]] = []  # faults so far: when, which
        self._flown = False
        self._rows: list[tuple] = []
        self.wait_until(BOOT)
        self._trigger("start")

    @property
    def trace(self) -> Trace:
        """The ground truth so far."""
        return Trace(*map(np.array, zip(*self._rows)))

    # --- the link: what the pilot's side does ----------------------------------------------------

    def open(self, uri: str) -> None:
        if self.up.down or self.down.down:
            self.give_up()
        else:
            self.connected = True

    def parameter(self, name: str) -> float:
        return {LIGHTHOUSE: float(self.setting.lighthouse)}[name]

    def log(self, name: str, period: int, variables: Sequence[str], arrived: Arrived) -> None:
        for variable in variables:
            if variable not in LOGGED:
                raise KeyError(variable)
        seconds = 1e-3 * period
        self.logs.append(LogBlock(tuple(variables), seconds, arrived, self.time + seconds))

    def arm(self) -> None:
        self._send(lambda time: self.firmware.request_arming())

    def setpoint(self, roll: float, pitch: float, yaw_rate: float, thrust: int) -> None:
        # Packed as the floats roll, -pitch, yaw rate (`Commander.send_setpoint`).
        r, p, y = np.array([roll, -pitch, yaw_rate], np.float32).tolist()
        self._send(lambda time: self.firmware.receive_rpyt(time, r, p, y, thrust))

    def notice(self) -> None:
        self._send(lambda time: self.firmware.notice(time))

    def stop(self) -> None:
        self._send(lambda time: self.firmware.receive_stop(time))

    def emergency_stop(self) -> None:
        self._send(lambda time: self.firmware.stop_now())

    def close(self) -> None:
        self.logs.clear()

    def give_up(self) -> None:
        """Report the link as lost, in the words of cflib's radio driver."""
        self.lost = "Too many packets lost"

    def _send(self, received: Callable[[float], object]) -> None:
        """Send a packet of the pilot, now; `received` is called with the time [s] at which it arrives."""
        arrival = self.up.arrival(self.time)
        if arrival is not None:
            self.schedule(arrival, lambda: received(self.time))

    # --- the clock -------------------------------------------------------------------------------

    def now(self) -> float:
        return self.time

    def wait_until(self, moment: float) -> None:
        """Advance to `moment` [s], executing everything that is due meanwhile in order."""
        while True:
            queued = self._queue[0][0] if self._queue else math.inf
            due = min(queued, self._frame, *(block.next for block in self.logs))
            if due > moment:
                break
            self._run(due)
            self.time = max(self.time, due)
            if queued == due:
                heapq.heappop(self._queue)[2]()
            elif self._frame == due:
                self._capture(due)
            else:
                for block in self.logs:
                    if block.next <= due + 1e-9:
                        self._send_log(block, due)
        self._run(moment)
        self.time = max(self.time, moment)

    # --- what happens ----------------------------------------------------------------------------

    def schedule(self, time: float, action: Callable[[], object]) -> None:
        """Schedule an action at a time [s]."""
        heapq.heappush(self._queue, (time, next(self._count), action))

    # --- what faults do --------------------------------------------------------------------------

    def begin(self, fault: Fault) -> None:
        """Begin a fault now, regardless of its event."""
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
                self.firmware = Firmware()
                self.logs.clear()
                self._lose_link()

    def _lose_packets(self, share: float) -> None:
        self.up.storm = self.down.storm = share

    def _lose_link(self) -> None:
        """Block all packets; report it as cflib's radio driver does without acknowledgements."""
        self.up.down = self.down.down = True
        end = self.time + self.up.link.attempts * self.up.link.again
        self.schedule(end, self.give_up)

    # --- what happens by itself ------------------------------------------------------------------

    def _send_log(self, block: LogBlock, time: float) -> None:
        """Send the values of a block as floats, with the vehicle's time in milliseconds."""
        now, stamp = self.sensors.values(block.next), int(1000.0 * block.next)
        values = {name: float(np.float32(now[name])) for name in block.variables}
        block.next += block.period
        arrival = self.down.arrival(time)
        if arrival is not None:
            self.schedule(arrival, functools.partial(block.arrived, stamp, values))

    def _capture(self, time: float) -> None:
        self._frame += 1.0 / self.setting.cameras.rate
        frame = self.view.expose(time, *self.body.pose_at(time))
        if frame is not None:
            arrival, pose = frame
            self.schedule(arrival, functools.partial(self.view.arrive, pose))

    def _run(self, until: float) -> None:
        while self.body.time < until - 1e-9:
            self._step()

    def _step(self) -> None:
        body = self.body
        if body.time - self._last_battery_reading >= PERIOD - 1e-9:
            self._last_battery_reading = body.time
            self.sensors.look()
        specific_force = body.specific_force
        setpoint = self.firmware.step(
            body.time, specific_force[2], math.sqrt(specific_force @ specific_force)
        )
        body.step(setpoint)
        self.thrust = setpoint.thrust
        mode = int(self.firmware.state)
        self._rows.append((body.time, body.state, body.touching, body.command.copy(), mode))
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
