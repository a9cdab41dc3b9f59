"""Connections of the flights of one command to their vehicle, simulated or real."""

from __future__ import annotations

import contextlib
import dataclasses
import sys
from collections.abc import Iterator

import numpy as np

from inclined_landing.eval.flying import positions, safety
from inclined_landing.eval.flying.interfaces import FlightClock, MotionCapture, RealClock
from inclined_landing.eval.flying.pilot import Pilot
from inclined_landing.eval.flying.plan import FlightPlan
from inclined_landing.eval.flying.simulated.faults import Fault
from inclined_landing.eval.flying.simulated.world import URI, Setting, World
from inclined_landing.eval.flying.vehicle import CflibLink, Radio
from inclined_landing.eval.flying.watchdog import DeadManSwitch
from inclined_landing.models.base.errors import UserError, not_installed

CHECK_ATTEMPTS = 3  # times that the checks may take: a second without a glimpse of the markers can happen
ARM_WORD = "arm"  # typed before the motors may turn
VIRTUAL_PATIENCE = 20.0  # s of real time that a control step may take while the flight's time is simulated
Connected = tuple[Radio, FlightClock, MotionCapture | None]  # None: the vehicle measures its position


@dataclasses.dataclass(frozen=True)
class SimulatedConnection:
    """Simulated Crazyflies in virtual time, a new one with its own seed for every flight."""

    setting: Setting
    faults: tuple[Fault, ...]
    seed: int
    hang_limit: float = VIRTUAL_PATIENCE  # s of real time that a control step may take
    confirms = False  # must somebody type a word before the motors turn

    def connect(self, k: int, plan: FlightPlan, dry: bool) -> Connected:
        """Return radio, clock and motion capture of a new vehicle."""
        seed = int(np.random.SeedSequence((self.seed, k)).generate_state(1)[0])
        world = World(self.setting, seed=seed, faults=self.faults)
        radio = Radio(world, world, plan.surroundings.vehicle.command_angle_limit, dry=dry)
        radio.connect(URI)
        return radio, world, None if self.setting.lighthouse else world.view

    def dead_man_switch(self) -> None:
        """Return None: the vehicle ends with this process."""


class RealConnection:
    """The vehicle at `uri`. mocap: TYPE:HOST:BODY with its latency [s]; None uses the vehicle's own deck."""

    hang_limit, confirms = safety.HANG_LIMIT, True

    def __init__(self, uri: str, mocap: str | None, latency: float):
        try:
            import cflib.crtp
        except ModuleNotFoundError as error:
            raise UserError(not_installed(error)) from error
        self.uri = uri
        self._clock = RealClock()
        self._capture = None if mocap is None else positions.open_capture(mocap, self._clock, latency)
        cflib.crtp.init_drivers()

    def connect(self, k: int, plan: FlightPlan, dry: bool) -> Connected:
        """Return radio, clock and motion capture; before every further flight the user puts it back."""
        from cflib.crazyflie import Crazyflie

        if k > 0:
            print("Put the vehicle back, switch it off and on, press Enter: ", end="", flush=True)
            if not sys.stdin.readline():
                raise UserError("standard input is closed, so no one can confirm the vehicle's position")
        limit = plan.surroundings.vehicle.command_angle_limit
        radio = Radio(CflibLink(Crazyflie()), self._clock, limit, dry=dry)
        radio.connect(self.uri)
        return radio, self._clock, self._capture

    def dead_man_switch(self) -> DeadManSwitch:
        """Return the context in which another process stops the motors if this one dies."""
        return DeadManSwitch(self.uri)


Connection = SimulatedConnection | RealConnection


@contextlib.contextmanager
def checked_pilot(connection: Connection, k: int, plan: FlightPlan, dry: bool) -> Iterator[Pilot]:
    """Yield the pilot of flight k once its preflight checks have passed and the user has armed it.

    Raises UserError if a check fails.
    """
    radio, clock, capture = connection.connect(k, plan, dry)
    try:
        mocap = capture or radio.onboard_position()
        switch = None if dry else connection.dead_man_switch()
        guarded = (lambda: True) if switch is None else switch.watches
        pilot = Pilot(radio, clock, mocap, plan, hang_limit=connection.hang_limit, guarded=guarded)
        for _ in range(CHECK_ATTEMPTS):
            checks = pilot.check()
            failed = [check for check in checks if not check.passed]
            if not failed:
                break
        for check in checks:
            print(f"  {'ok ' if check.passed else 'NOT'} {check.name}: {check.found}")
        if failed:
            reasons = "; ".join(f"{check.name}: {check.found}" for check in failed)
            raise UserError(f"not ready to fly: {reasons}")
        with switch or contextlib.nullcontext():
            if connection.confirms and not dry:
                question = "The motors will start. Goggles on, nets clear? Type {} to fly: "
                print(question.format(ARM_WORD), end="", flush=True)
                if sys.stdin.readline().strip() != ARM_WORD:
                    raise UserError(f"not armed: {ARM_WORD} was not typed")
            if not guarded():
                raise UserError("not ready to fly: the watchdog process that would stop the motors is gone")
            yield pilot
    finally:
        radio.close()
