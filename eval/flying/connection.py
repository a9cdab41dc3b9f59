"""How the flights of one command connect to their vehicle: a simulated one, or one that is there."""

from __future__ import annotations

import contextlib
import dataclasses
import sys
from collections.abc import Iterator
from typing import Any

import numpy as np

from inclined_landing.eval.flying import positions, safety
from inclined_landing.eval.flying.interfaces import FlightClock, MotionCapture, RealClock
from inclined_landing.eval.flying.pilot import Pilot
from inclined_landing.eval.flying.plan import FlightPlan, PlannedFlight
from inclined_landing.eval.flying.simulated.faults import Fault
from inclined_landing.eval.flying.simulated.world import Setting
from inclined_landing.eval.flying.vehicle import Radio
from inclined_landing.eval.flying.watchdog import DeadManSwitch
from inclined_landing.models.errors import UserError, not_installed

CHECK_ATTEMPTS = 3  # times that the checks may take: a second without a glimpse of the markers can happen
ARM_WORD = "arm"  # typed before the motors may turn
VIRTUAL_PATIENCE = 20.0  # s of real time that a control step may take while the flight's time is simulated
Connected = tuple[Radio, FlightClock, MotionCapture]


@dataclasses.dataclass(frozen=True)
class OnboardPositioning:
    """The vehicle's own position in the place of motion capture."""

    at: tuple[float, float] | None  # x, y where it stands, m; None: unknown
    stated: bool  # by somebody: where it stands, or its heading

    def start(self, radio: Radio, plan: FlightPlan) -> MotionCapture:
        """Return what the connected vehicle says. Raises UserError where it cannot, or not on this flight."""
        deck = positions.find_deck(radio.crazyflie.param.get_value)
        if deck != positions.FLOW and self.stated:
            raise UserError(
                "a Lighthouse knows where the vehicle stands: --at and --heading are of a Flow deck"
            )
        free = isinstance(plan.landing, PlannedFlight) and not plan.landing.present
        if deck == positions.FLOW and not free:
            raise UserError(
                "a Flow deck measures the height above what is below it and takes the platform for the "
                "floor: it can fly --plan with --no-platform, and no landing"
            )
        if deck == positions.FLOW and self.at is None:
            raise UserError("a Flow deck does not know where the vehicle stands: say it, --at X,Y in metres")
        floor = plan.stand + plan.surroundings.standing_height
        position = positions.OnboardPosition(deck, self.at or (0.0, 0.0), plan.heading, floor)
        radio.log_position(position)
        return position


@dataclasses.dataclass(frozen=True)
class SimulatedConnection:
    """Simulated Crazyflies in virtual time, a new one with its own seed for every flight."""

    setting: Setting
    faults: tuple[Fault, ...]
    seed: int
    onboard: OnboardPositioning | None = None
    hang_limit: float = VIRTUAL_PATIENCE  # s of real time that a control step may take
    confirms: bool = False  # must somebody type a word before the motors turn

    def connect(self, k: int, plan: FlightPlan, dry: bool) -> Connected:
        """Return radio, clock and positions of a new vehicle."""
        from inclined_landing.eval.flying.simulated.crazyflie import fly_simulated

        seed = int(np.random.SeedSequence((self.seed, k)).generate_state(1)[0])
        flight = fly_simulated(self.setting, seed=seed, faults=self.faults)
        radio = Radio(flight.crazyflie, flight.clock, plan.vehicle.command_angle_limit, dry=dry)
        radio.connect(flight.uri)
        return radio, flight.clock, _positions(self.onboard, radio, plan, flight.motion_capture)

    def dead_man_switch(self) -> contextlib.AbstractContextManager[Any]:
        """Return a context that does nothing."""
        return contextlib.nullcontext()


class RealConnection:
    """The vehicle at `uri`. mocap: TYPE:HOST:BODY with its latency [s], or None with `onboard`."""

    hang_limit = safety.HANG_LIMIT

    def __init__(
        self, uri: str, mocap: str | None, latency: float, onboard: OnboardPositioning | None, confirms: bool
    ):
        try:
            import cflib.crtp
        except ModuleNotFoundError as error:
            raise UserError(not_installed(error)) from error
        self.uri, self.onboard, self.confirms = uri, onboard, confirms
        self._clock = RealClock()
        self._capture = None if mocap is None else positions.open_capture(mocap, self._clock, latency)
        cflib.crtp.init_drivers()

    def connect(self, k: int, plan: FlightPlan, dry: bool) -> Connected:
        """Return radio, clock and positions of the vehicle, which is put back for every further flight."""
        from cflib.crazyflie import Crazyflie

        if k > 0:
            print("Put the vehicle back, switch it off and on, press Enter: ", end="", flush=True)
            if not sys.stdin.readline():
                raise UserError("nobody is there to put the vehicle back")
        radio = Radio(Crazyflie(), self._clock, plan.vehicle.command_angle_limit, dry=dry)
        radio.connect(self.uri)
        return radio, self._clock, _positions(self.onboard, radio, plan, self._capture)

    def dead_man_switch(self) -> contextlib.AbstractContextManager[Any]:
        """Return the context in which another process stops the motors should this one die."""
        return DeadManSwitch(self.uri)


Connection = SimulatedConnection | RealConnection


def _positions(
    onboard: OnboardPositioning | None, radio: Radio, plan: FlightPlan, capture: MotionCapture | None
) -> MotionCapture:
    """Return where positions come from; closes the link of a vehicle that cannot say its own."""
    if onboard is None:
        assert capture is not None
        return capture
    try:
        return onboard.start(radio, plan)
    except UserError:
        radio.close()
        raise


@contextlib.contextmanager
def checked_pilot(connection: Connection, k: int, plan: FlightPlan, dry: bool) -> Iterator[Pilot]:
    """Yield the pilot of flight k once its preflight checks have passed, and somebody has armed it.

    Raises UserError where a check fails.
    """
    radio, clock, mocap = connection.connect(k, plan, dry)
    try:
        pilot = Pilot(radio, clock, mocap, plan, hang_limit=connection.hang_limit)
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
        with contextlib.nullcontext() if dry else connection.dead_man_switch():
            if connection.confirms and not dry:
                _confirm()
            yield pilot
    finally:
        radio.close()


def _confirm() -> None:
    """Ask for the arming word. Raises UserError for anything else."""
    question = f"The motors will start. Goggles on, nobody inside the nets? Type {ARM_WORD} to fly: "
    print(question, end="", flush=True)
    if sys.stdin.readline().strip() != ARM_WORD:
        raise UserError(f"not armed: {ARM_WORD} was not typed")
