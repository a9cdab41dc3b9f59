"""The radio link to the Crazyflie: URI, cflib, connecting, logging, set-points, stopping."""

from __future__ import annotations

import collections
import contextlib
import dataclasses
import re
import socket
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from inclined_landing.eval.flying import frames, positions
from inclined_landing.eval.flying.estimate import Attitude, ClockOffset
from inclined_landing.eval.flying.interfaces import Arrived, FlightClock
from inclined_landing.models.base.errors import UserError, shown

if TYPE_CHECKING:
    from inclined_landing.eval.flying.simulated.world import World

CONNECTING = 30.0  # s that a connection may take: tables of contents come over the radio
ATTITUDE_PERIOD = 10  # ms: 100 Hz. cflib asks in steps of 10 ms; the paper's 80 Hz lie between two of them
STATUS_PERIOD = 100  # ms
VARIANCE_PERIOD = 50  # ms
REPEATS = 5  # of a command that is sent once, one after the other: any of them may get lost
_LOCKED = 1 << 5 | 1 << 6 | 1 << 7  # tumbled, locked, crashed in supervisor.info, see cflib's Supervisor
UDEV = "https://www.bitcraze.io/documentation/repository/crazyflie-lib-python/master/installation/usb_permissions/"
# Crazyradio by number or serial number, channel 0 to 125, rate, address.
_RADIO = re.compile(
    r"radio://([0-9]{1,3}|[0-9A-Fa-f]{10,32})/(?P<channel>[0-9]{1,3})"
    r"(/(250K|1M|2M)(/[0-9A-Fa-f]{10})?)?(\?rate_limit=[1-9][0-9]{0,5})?",
    re.ASCII,
)
_REMEDIES = {  # by scheme, where a vehicle does not answer
    "radio": "is the vehicle on, do channel, rate and address match, is the Crazyradio plugged in and "
    f"free? On Linux udev rules give access to it: {UDEV}",
    "udp": "is a simulator of the firmware running there?",
}


def check_uri(uri: str) -> None:
    """Raise UserError for a URI that cflib does not understand or would misread.

    cflib uses 2M for an unknown rate, and pads a short address with zeros.
    """
    if udp := re.fullmatch(r"udp://([^/?#@:\s]+:[0-9]{1,5})", uri):
        _resolve(udp[1])
        return
    radio = _RADIO.fullmatch(uri)
    if not (radio and int(radio["channel"]) <= 125):
        raise UserError(
            "--uri must look like radio://0/80/2M/E7E7E7E7E7 (Crazyradio, channel up to 125, rate 250K, 1M "
            "or 2M, address of ten hexadecimal digits) or udp://127.0.0.1:19850, not "
            f"{shown(repr(uri), 60)}"
        )


def _resolve(text: str) -> None:
    """Raise UserError unless the text is HOST:PORT with a known host."""
    host, _, port = text.rpartition(":")
    if not 0 < int(port) < 65536:
        raise UserError(f"expected HOST:PORT with a port from 1 to 65535, not {shown(text, 60)}")
    try:
        socket.gethostbyname(host)
    except (OSError, UnicodeError) as error:
        raise UserError(f"{shown(host, 60)} is an unknown host") from error


@dataclasses.dataclass(frozen=True)
class Status:
    """Battery voltage and supervisor state of the vehicle."""

    time: float  # s, of arrival
    voltage: float  # V
    locked: bool  # by its supervisor; False where the firmware does not tell


class CflibLink:
    """The radio link to one vehicle by cflib's `Crazyflie`. Its callbacks run in cflib's own thread."""

    def __init__(self, crazyflie: Any):
        self.crazyflie, self.connected = crazyflie, False
        self.lost: str | None = None  # why, once it is
        self._logs: list[Any] = []
        for caller, react in (
            (crazyflie.connected, self._is_connected),
            (crazyflie.connection_failed, self._is_lost),
            (crazyflie.connection_lost, self._is_lost),
            (crazyflie.disconnected, self._is_gone),
        ):
            caller.add_callback(react)

    def open(self, uri: str) -> None:
        """Begin to connect to a vehicle."""
        self.crazyflie.open_link(uri)

    def parameter(self, name: str) -> float:
        """Return a parameter of the firmware. Raises KeyError for firmware without it."""
        return float(self.crazyflie.param.get_value(name))

    def log(self, name: str, period: int, variables: Sequence[str], arrived: Arrived) -> None:
        """Log variables every `period` [ms]. Raises KeyError for firmware without one of them."""
        from cflib.crazyflie.log import LogConfig

        config = LogConfig(name, period)
        for variable in variables:
            config.add_variable(variable, None)
        self.crazyflie.log.add_config(config)
        config.data_received_cb.add_callback(lambda stamp, values, _: arrived(stamp, values))
        config.start()
        self._logs.append(config)

    def arm(self) -> None:
        """Request arming."""
        self.crazyflie.supervisor.send_arming_request(True)

    def setpoint(self, roll: float, pitch: float, yaw_rate: float, thrust: int) -> None:
        """Send a set-point in the signs of cflib's `send_setpoint` [deg, deg, deg/s, 0 to 65535]."""
        self.crazyflie.commander.send_setpoint(roll, pitch, yaw_rate, thrust)

    def notice(self) -> None:
        """Feed the firmware's emergency watchdog, which runs from the first notice on."""
        self.crazyflie.supervisor.send_emergency_stop_watchdog()

    def stop(self) -> None:
        """Send the set-point that stops the motors."""
        self.crazyflie.commander.send_stop_setpoint()

    def emergency_stop(self) -> None:
        """Stop the motors and lock the vehicle."""
        self.crazyflie.supervisor.send_emergency_stop()

    def close(self) -> None:
        """End the logs and the connection; ignores errors."""
        for log in self._logs:
            with contextlib.suppress(Exception):
                log.stop()
        with contextlib.suppress(Exception):
            self.crazyflie.close_link()

    def _is_connected(self, uri: str) -> None:
        self.connected = True

    def _is_lost(self, uri: str, why: str = "") -> None:
        self.lost = why or "connection lost"

    def _is_gone(self, uri: str) -> None:
        if self.connected and self.lost is None:
            self.lost = "disconnected"


class Radio:
    """The radio link for the pilot. Received data wait in `received`.

    dry: nothing that moves a motor is sent.
    """

    def __init__(self, link: CflibLink | World, clock: FlightClock, angle_limit: float, *, dry: bool = False):
        self.link, self.clock, self.dry = link, clock, dry
        self.angle_limit = angle_limit  # rad
        self._received: collections.deque[Attitude | Status] = collections.deque(maxlen=10_000)
        self._dates = ClockOffset()

    @property
    def lost(self) -> str | None:
        """The reason why the link is lost; None while it is not."""
        return self.link.lost

    def connect(self, uri: str) -> None:
        """Open the link and start the logs. Raises UserError if that fails."""
        end = self.clock.now() + CONNECTING
        self.link.open(uri)
        while not self.link.connected:
            if self.lost is not None or self.clock.now() > end:
                reason = (self.lost or f"no answer for {CONNECTING:g} s").strip().partition("\n")[0]
                self.close()
                reason = reason.removeprefix("Couldn't load link driver: ")
                remedy = _REMEDIES.get(uri.partition("://")[0])
                hint = f"; {remedy}" if remedy else ""
                raise UserError(f"no connection to {shown(uri)}: {shown(reason, 200)}{hint}")
            self.clock.wait_until(self.clock.now() + 0.02)
        specific_force = ("stateEstimate.roll", "stateEstimate.pitch", "stateEstimate.yaw", "acc.z")
        self.link.log("attitude", ATTITUDE_PERIOD, specific_force, self._attitude)
        try:
            self.link.log("status", STATUS_PERIOD, ("pm.vbat", "supervisor.info"), self._status)
        except KeyError:  # older firmware
            self.link.log("status", STATUS_PERIOD, ("pm.vbat",), self._status)

    def onboard_position(self) -> positions.OnboardPosition:
        """Return the position that the vehicle logs. Raises UserError without a Lighthouse deck."""
        try:
            found = bool(self.link.parameter(positions.LIGHTHOUSE))
        except KeyError:  # older firmware
            found = False
        if not found:
            raise UserError(
                "the vehicle has no deck that measures its position: no Lighthouse deck was found "
                f"({positions.LIGHTHOUSE})"
            )
        to = positions.OnboardPosition()

        def position(stamp: int, data: Mapping[str, float]) -> None:
            time = self._dates.date(stamp, self.clock.now())
            to.add_position(time, np.array([data[name] for name in positions.POSITION]))

        def variance(stamp: int, data: Mapping[str, float]) -> None:
            to.add_variance(np.array([data[name] for name in positions.VARIANCE]))

        self.link.log("variance", VARIANCE_PERIOD, positions.VARIANCE, variance)
        self.link.log("position", ATTITUDE_PERIOD, positions.POSITION, position)
        return to

    def received(self) -> list[Attitude | Status]:
        """Return the data received since the last call, in order."""
        fresh = []
        with contextlib.suppress(IndexError):
            while True:
                fresh.append(self._received.popleft())
        return fresh

    def arm(self) -> None:
        """Request arming (the Crazyflie 2.1 arms itself), and unlock the thrust by set-points of zero
        thrust, one of which must arrive: without it the vehicle does not start.
        """
        if not self.dry:
            self.link.arm()
            for _ in range(REPEATS):
                self.link.setpoint(0.0, 0.0, 0.0, 0)

    def send(self, command: np.ndarray) -> None:
        """Send a set-point: PWM, roll, pitch [rad], yaw rate [rad/s] in the vehicle's heading.

        The first one starts the firmware's emergency watchdog: without notice the motors stop after 1 s (not
        2 s after the last set-point), and the vehicle has to be switched off and on before it flies again.
        """
        setpoint = frames.radio_setpoint(command, self.angle_limit)
        if self.dry:
            return
        self.link.setpoint(*setpoint)
        self.link.notice()

    def stop(self) -> None:
        """Switch the motors off; they can be started again."""
        if not self.dry:
            self.link.stop()

    def emergency_stop(self) -> None:
        """Switch the motors off even if something fails: the vehicle stays locked until it is power-cycled.
        Each command is tried independently.
        """
        if self.dry:
            return
        for _ in range(REPEATS):
            for command in (self.link.stop, self.link.emergency_stop):
                with contextlib.suppress(Exception):
                    command()

    def close(self) -> None:
        """End the logs and the connection; ignores errors."""
        self.link.close()

    def _attitude(self, stamp: int, data: Mapping[str, float]) -> None:
        angles = (data[f"stateEstimate.{name}"] for name in ("roll", "pitch", "yaw"))
        time = self._dates.date(stamp, self.clock.now())
        self._received.append(Attitude(time, frames.logged_rotation(*angles), float(data["acc.z"])))

    def _status(self, stamp: int, data: Mapping[str, float]) -> None:
        locked = bool(int(data.get("supervisor.info", 0)) & _LOCKED)
        self._received.append(Status(self.clock.now(), float(data["pm.vbat"]), locked))
