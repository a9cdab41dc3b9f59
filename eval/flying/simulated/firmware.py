"""The rules of the Crazyflie 2.1 firmware for flying and for refusing to fly.

Behaviour, names and numbers follow bitcraze/crazyflie-firmware at 2a18fc2 (August 2026): `supervisor.c`,
`supervisor_state_machine.c`, `platform_defaults.h`, `commander.c`, `crtp_commander_rpyt.c`,
`crtp_commander_generic.c`. For users, these rules matter:

- thrust stays 0 until a set-point of thrust 0 was received (`thrustLocked`);
- without a new set-point the vehicle levels out after 0.5 s and keeps its thrust, and stops its motors after
  2 s: it is then locked until a restart;
- an emergency stop stops the motors and locks; so does its watchdog, once used, 1 s after the last notice;
- a vehicle that is tilted for 1 s, or upside down for 0.1 s, stops its motors ("crashed");
- it arms itself, as the 2.1 with brushed motors does, and disarms 3 s after a landing.
"""

from __future__ import annotations

import dataclasses
import enum
import math
from collections.abc import Iterator

# commander, crtp_commander_rpyt.c
LEAST_THRUST, MOST_THRUST = 1000, 60000
# supervisor.c, s
WATCHDOG_LEVELS = 0.5
WATCHDOG_STOPS = 2.0
EMERGENCY_WATCHDOG = 1.0
FLYING_HYSTERESIS = 2.0
PERIOD = 0.04  # of the supervisor, 25 Hz
# platform_defaults.h: s, and g along the body's z
TILTED, TILTED_TIME = 0.5, 1.0
UPSIDE_DOWN, UPSIDE_DOWN_TIME = -0.2, 0.1
FREE_FALL = 0.1
PREFLIGHT_TIMEOUT, LANDING_TIMEOUT = 30.0, 3.0
STEEPEST = 80.0  # deg; what a set-point beyond, or one that is no number, amounts to


class State(enum.IntEnum):
    """States of the supervisor, in the firmware's order."""

    NOT_INITIALIZED = 0
    CHECKS_NOT_PASSED = 1
    CHECKS_PASSED = 2
    ARMING = 3
    READY_TO_FLY = 4
    FLYING = 5
    LANDED = 6
    RESET = 7
    LEVEL_OUT = 8
    FREE_FALL = 9
    LOCKED = 10
    CRASHED = 11


# The supervisor lets set-points through.
_CAN_FLY = {State.READY_TO_FLY, State.FLYING, State.LEVEL_OUT, State.LANDED}
_ARMED = _CAN_FLY | {State.ARMING}


@dataclasses.dataclass(frozen=True)
class FirmwareSetpoint:
    """The commander's set-point, in the firmware's units and signs."""

    thrust: float = 0.0  # 0 to 60000
    roll: float = 0.0  # deg
    pitch: float = 0.0  # deg, legacy: positive leans back
    yaw_rate: float = 0.0  # deg/s, positive turns left
    time: float = -math.inf  # s, when it was received


class Firmware:
    """Commander and supervisor. Times are seconds since the vehicle was switched on."""

    def __init__(self):
        self.state = State.NOT_INITIALIZED
        self.setpoint = FirmwareSetpoint()
        self.thrust = 0.0  # the present thrust of the motors
        self.armed = self.crashed = self.emergency = self.tumbled = False
        self._commanded = False  # has the commander had a set-point: its priority is no longer "disable"
        self._locked = True
        self._last_supervision = -math.inf
        self._tilted_since: float | None = None
        self._last_notice: float | None = None  # last notice of the emergency watchdog
        self._last_thrust = self._ready = self._landed = -math.inf

    # --- what a client sends ---------------------------------------------------------------------

    def receive_rpyt(self, time: float, roll: float, pitch: float, yaw_rate: float, thrust: int) -> None:
        """Receive a legacy set-point: degrees, degrees per second (positive turns right), 0 to 65535."""
        if not self._commanded:
            self._locked = True
        if thrust == 0:
            self._locked = False
        limited = 0.0 if self._locked or thrust < LEAST_THRUST else float(min(thrust, MOST_THRUST))
        self.setpoint, self._commanded = FirmwareSetpoint(limited, roll, pitch, -yaw_rate, time), True

    def receive_stop(self, time: float) -> None:
        """Receive the generic "stop" set-point."""
        self.setpoint, self._commanded = FirmwareSetpoint(time=time), True

    def request_arming(self) -> None:
        """Arm, unless the checks have not passed."""
        self.armed = self.armed or self.state is State.CHECKS_PASSED

    def stop_now(self) -> None:
        """Do an emergency stop; only a restart ends it."""
        self.emergency = True

    def notice(self, time: float) -> None:
        """Feed the emergency watchdog, which runs from the first notice on."""
        self._last_notice = time

    # --- what runs on board ----------------------------------------------------------------------

    @property
    def info(self) -> int:
        """Status bits of the supervisor, as the log variable `supervisor.info` has them."""
        bits = (
            *(self.state is State.CHECKS_PASSED, self.armed, True, self.state in _CAN_FLY),
            *(self.state in (State.FLYING, State.LEVEL_OUT), self.tumbled),
            *(self.state is State.LOCKED, self.crashed),
        )
        return sum(bit << k for k, bit in enumerate(bits))

    def step(self, time: float, up: float, norm: float) -> FirmwareSetpoint:
        """Return the set-point of motors and attitude loops from `time` on.

        up: acceleration along the body's z, as measured by an accelerometer [g]; norm: its norm [g].
        """
        setpoint = self.setpoint if self.state in _CAN_FLY else FirmwareSetpoint()
        if setpoint.thrust > 0.0:
            self._last_thrust = time
        if time - self._last_supervision >= PERIOD - 1e-9:
            self._last_supervision = time
            self._supervise(time, time - setpoint.time, up, norm)
        if self.state is State.LEVEL_OUT:
            setpoint = FirmwareSetpoint(setpoint.thrust, time=setpoint.time)
        elif self.state not in _ARMED:
            setpoint = FirmwareSetpoint()
        self.thrust = setpoint.thrust
        if setpoint.thrust == 0.0:
            return FirmwareSetpoint(time=setpoint.time)
        roll, pitch = (_bounded(angle, STEEPEST) for angle in (setpoint.roll, setpoint.pitch))
        return FirmwareSetpoint(
            setpoint.thrust, roll, pitch, _bounded(setpoint.yaw_rate, 720.0), setpoint.time
        )

    def _transitions(self, time: float, age: float) -> Iterator[tuple[State, bool]]:
        """Yield the transitions from the present state in their order, and whether their conditions hold.

        age [s]: of the set-point. In each period the first transition whose condition holds is made.
        """
        late, too_late = age > WATCHDOG_LEVELS, age > WATCHDOG_STOPS
        silent = self._last_notice is not None and time >= self._last_notice + EMERGENCY_WATCHDOG
        emergency = self.emergency or silent
        flying, tumbled = time - self._last_thrust < FLYING_HYSTERESIS, self.tumbled
        match self.state:
            case State.NOT_INITIALIZED | State.RESET:
                yield State.CHECKS_NOT_PASSED, True
            case State.CHECKS_NOT_PASSED:
                yield State.FREE_FALL, emergency
                yield State.CHECKS_PASSED, not tumbled
            case State.CHECKS_PASSED:
                yield State.FREE_FALL, emergency
                yield State.CHECKS_NOT_PASSED, tumbled
                yield State.ARMING, self.armed
            case State.ARMING:
                yield State.FREE_FALL, emergency
                yield State.CHECKS_NOT_PASSED, tumbled or not self.armed
                yield State.READY_TO_FLY, True  # brushed motors tell no speed that could be awaited
            case State.READY_TO_FLY:
                yield State.FREE_FALL, emergency
                timeout = time - self._ready > PREFLIGHT_TIMEOUT
                yield State.CHECKS_NOT_PASSED, tumbled or timeout or not self.armed
                yield State.FLYING, flying
            case State.FLYING:
                yield State.FREE_FALL, too_late or emergency
                yield State.CRASHED, tumbled
                yield State.RESET, not self.armed
                yield State.LEVEL_OUT, late
                yield State.LANDED, not flying
            case State.LANDED:
                yield State.RESET, time - self._landed > LANDING_TIMEOUT or not self.armed
                yield State.FLYING, flying
            case State.LEVEL_OUT:
                yield State.FREE_FALL, too_late or tumbled or emergency
                yield State.FLYING, not (late or too_late)
            case State.FREE_FALL:
                yield State.LOCKED, True
            case State.CRASHED:
                yield State.LOCKED, emergency

    def _is_tumbled(self, time: float, up: float, norm: float) -> bool:
        if norm < FREE_FALL:
            self._tilted_since = None
        if up >= TILTED:
            self._tilted_since = None
            return False
        if self._tilted_since is None:
            self._tilted_since = time
        lasted = time - self._tilted_since
        return lasted > TILTED_TIME or (up < UPSIDE_DOWN and lasted > UPSIDE_DOWN_TIME)

    def _supervise(self, time: float, age: float, up: float, norm: float) -> None:
        self.tumbled = self._is_tumbled(time, up, norm)
        new = next((to for to, holds in self._transitions(time, age) if holds), self.state)
        if new is self.state:
            return
        self.state = new
        if new is State.READY_TO_FLY:
            self._ready = time
        elif new is State.LANDED:
            self._landed = time
        elif new is State.CRASHED:
            self.crashed = True
        if new not in _ARMED:
            self.armed = False
        if new is State.CHECKS_PASSED:
            self.armed = True  # the 2.1 arms itself


def _bounded(value: float, size: float) -> float:
    """Return `value` clipped to [-size, size]; `size` itself for NaN."""
    return size if math.isnan(value) else min(size, max(-size, value))
