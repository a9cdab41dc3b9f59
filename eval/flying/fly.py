"""`landing-eval fly`: a Crazyflie, or a simulated one, flies to the start and lands on the slope."""

from __future__ import annotations

import contextlib
import dataclasses
import logging
import math
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
import tyro
from msgspec import Meta

from inclined_landing.envs.shared.tables import say
from inclined_landing.eval.base.options import (
    Degrees,
    Flag,
    NewFolder,
    PolicyName,
    Starts,
    VehicleFile,
)
from inclined_landing.eval.flying.crazyflie import DeckName
from inclined_landing.models.errors import UserError, not_installed, shown

if TYPE_CHECKING:
    from inclined_landing.envs.policy import Policy
    from inclined_landing.eval.flying.interfaces import Clock, MotionCapture
    from inclined_landing.eval.flying.onboard import OnboardPosition
    from inclined_landing.eval.flying.pilot import Pilot, Plan, Report
    from inclined_landing.eval.flying.planned import PlannedFlight
    from inclined_landing.eval.flying.vehicle import Radio

CHECK_ATTEMPTS = 3  # times that the checks may take: a second without a glimpse of the markers can happen
ARM_WORD = "arm"  # typed before the motors may turn
VIRTUAL_PATIENCE = 20.0  # s of real time that a control step may take while the flight's time is simulated
Faults = Annotated[tuple[str, ...], tyro.conf.UseAppendAction, tyro.conf.arg(metavar="FAULT")]


def command(
    policy: Annotated[str | None, tyro.conf.Positional, tyro.conf.arg(metavar="POLICY")] = None,
    *,
    simulated: Flag = False,
    uri: Annotated[str | None, tyro.conf.arg(metavar="URI")] = None,
    mocap: Annotated[str | None, tyro.conf.arg(metavar="TYPE:HOST:BODY")] = None,
    position: Annotated[str, tyro.conf.arg(metavar="{mocap,onboard}")] = "mocap",
    at: Annotated[str | None, tyro.conf.arg(metavar="X,Y")] = None,
    mocap_latency: Annotated[Annotated[float, Meta(ge=0, le=0.1)] | None, tyro.conf.arg(metavar="S")] = None,
    setpoint: PolicyName = "setpoint",
    start: Starts = (),
    flights: Annotated[int, Meta(ge=1, le=1000)] = 1,
    inclination: Degrees = None,
    arena: VehicleFile = None,
    stand: Annotated[Annotated[float, Meta(ge=0.0, le=2.0)] | None, tyro.conf.arg(metavar="M")] = None,
    heading: Annotated[Annotated[float, Meta(ge=-360, le=360)] | None, tyro.conf.arg(metavar="DEG")] = None,
    plan: VehicleFile = None,
    no_platform: Flag = False,
    dry_run: Flag = False,
    yes: Flag = False,
    vehicle: Annotated[str | None, tyro.conf.arg(metavar="nominal|hidden|FILE")] = None,
    deck: DeckName = None,
    fault: Faults = (),
    seed: Annotated[Annotated[int, Meta(ge=0, le=2**32 - 1)] | None, tyro.conf.arg(metavar="SEED")] = None,
    out: NewFolder = None,
) -> int:
    """Fly a Crazyflie, or a simulated one: to the start and onto the slope, or as planned; logged as CSV.

    Ctrl-C switches the motors off. docs/flying.md says what is needed, and what ends a flight.

    Args:
        policy: for the task landing (motors are cut in the goal box) or touchdown (comes to rest by itself);
            the shipped landing policy by default.
        simulated: fly a simulated Crazyflie, in virtual time.
        uri: URI of the vehicle in cflib's form, like radio://0/80/2M/E7E7E7E7E7 or udp://127.0.0.1:19850.
        mocap: motion capture: type (vicon, optitrack, qualisys, nokov, vrpn ...), host, rigid body; or
            poses:HOST:PORT, datagrams that are sent there.
        position: where positions come from: motion capture, or the vehicle's own Lighthouse or Flow deck.
        at: where the vehicle stands, in metres, for a Flow deck; its heading is --heading.
        mocap_latency: latency of that system from exposure to arrival, in seconds; 0 by default.
        setpoint: policy that takes off and flies to the start.
        start: where the landing begins, in metres; repeat it for more, flown in turn. Default: the paper's.
        flights: number of flights.
        inclination: of the platform in the arena, in degrees, where it differs from the vehicle file's.
        arena: vehicle file (TOML) with arena and platform, where they are not the shipped ones.
        stand: height of what the vehicle stands on, in metres; 0 by default.
        heading: direction of its nose, in degrees from x, where motion capture shows no attitude, or for a
            Flow deck.
        plan: flight.csv of landing-eval plan, flown in the place of a landing.
        no_platform: no platform stands in the arena; for planned flights alone.
        dry_run: everything but motors; carry the vehicle by hand and read what would be commanded.
        yes: no confirmation; for simulated vehicles alone.
        vehicle: simulated vehicle: nominal, hidden (with gaps unknown to every policy), or a vehicle file.
        deck: of the simulated vehicle, that it positions itself by: lighthouse or flow.
        fault: fault of the simulated vehicle, NAME@EVENT+SECONDS, as in eval/flying/README.md.
        seed: seed of the simulated vehicle.
        out: new folder for the logs and fly.json; default runs/fly-DATE-TIME.
    """
    from inclined_landing.envs.shared.runs import check_new_run, new_run
    from inclined_landing.eval.flying.link import check_uri
    from inclined_landing.eval.flying.pilot import Plan
    from inclined_landing.eval.flying.planned import PlannedFlight
    from inclined_landing.models import storage

    _check_position(position, mocap, mocap_latency, at, deck, fault)
    if simulated:
        _reject_options(
            "of a real vehicle",
            uri=uri,
            mocap=mocap,
            mocap_latency=mocap_latency,
            stand=stand,
            heading=heading if position == "mocap" else None,
        )
    else:
        _reject_options(
            "of the simulated Crazyflie and needs --simulated",
            vehicle=vehicle,
            deck=deck,
            fault=fault or None,
            seed=seed,
        )
        if uri is None or (mocap is None and position == "mocap"):
            raise UserError(
                "name the vehicle and its motion capture, --uri and --mocap (or --position onboard), or fly "
                "--simulated"
            )
        check_uri(uri)
        if yes and not uri.startswith("udp://"):
            raise UserError("--yes is for simulated vehicles alone; before a real one flies, a word is typed")
    if plan is not None:
        _reject_options("of landings and not of --plan", policy=policy, start=start or None)
    elif no_platform:
        raise UserError("--no-platform is for planned flights alone; a landing needs the platform")
    landing, hover, starts = load_flight(policy, setpoint, start, inclination, arena, plan, not no_platform)
    if out is not None:
        check_new_run(out)
    own = None if position == "mocap" else _Onboard(at, heading, simulated)
    if uri is None:
        named = "nominal" if vehicle is None else vehicle
        session = _simulated(named, inclination, not no_platform, deck, fault, seed or 0, own)
    else:
        session = _real(uri, mocap, mocap_latency or 0.0, own)
    logging.getLogger("cflib").setLevel(
        logging.CRITICAL
    )  # it prints tracebacks of what is said in a sentence
    folder: Path | None = None  # not before a vehicle is there, and ready
    results: list[dict[str, Any]] = []
    for k in range(flights):
        flight = Plan(landing, hover, starts[k % len(starts)], stand or 0.0, math.radians(heading or 0.0))
        what = "as planned" if plan is not None else "landing"
        print(f"flight {k + 1} of {flights}, {what} from x {flight.start[0]:g}, z {flight.start[1]:g} m")
        with session.prepared(k, flight, dry_run, yes) as pilot:
            folder = folder or new_run(out, "fly")
            log = None if dry_run else folder / f"flight_{k + 1:02d}.csv"
            report = pilot.fly(log)
        results.append(summary(report, flight, log))
        storage.write_json(
            folder / "fly.json",
            {
                "command": "fly",
                "policy": None if isinstance(landing, PlannedFlight) else str(landing.path),
                "plan": None if plan is None else str(plan),
                "simulated": simulated,
                "position": position,
                "seed": seed,
                "flights": results,
            },
        )
        print(describe(report))
        if report.cause is not None and report.cause.name == "interrupted":
            return 130
        if report.error:
            print(report.error, file=sys.stderr)
            return 1
    succeeded = sum(result["landed"] or result["outcome"] == "plan flown" for result in results)
    if not dry_run:
        done = "landed" if plan is None else "flown as planned"
        say(f"{succeeded} of {flights} {done}; the logs are in {folder}.")
    return 0 if dry_run or succeeded == flights else 3


def load_flight(
    policy: str | None,
    setpoint: str,
    start: tuple[str, ...],
    inclination: float | None,
    arena: Path | None,
    plan: Path | None = None,
    platform: bool = True,
) -> tuple[Policy | PlannedFlight, Policy, list[tuple[float, float]]]:
    """Return what is flown, the set-point policy and the starts (x, z) [m].

    inclination [deg] of the platform in the arena, and whether it stands there. Raises UserError for a policy
    that is for another task or another slope, and for a planned flight that cannot be flown in the arena.
    """
    from inclined_landing.envs.policy import load_policy, trained_task
    from inclined_landing.envs.tasks import make_task
    from inclined_landing.envs.tasks.landing import PAPER_STARTS
    from inclined_landing.eval.flying.planned import read_planned
    from inclined_landing.models.parameters import load_vehicle

    room = load_vehicle(arena) if arena is not None else load_vehicle()

    def built(name: str, tasks: tuple[str, ...], **platform: float) -> Policy:
        task = trained_task(name)
        if task not in tasks:
            raise UserError(
                f"policy {shown(name)} is for the task {shown(task, 40)}; wanted is {' or '.join(tasks)}"
            )
        policy = load_policy(name, task, vehicle=room, **platform)
        if policy.task.platform_moves:
            raise UserError(f"policy {shown(name)} is for moving platforms; the pilot's stands still")
        return load_policy(name, policy.task)  # which refuses another slope than its own

    angle = room.platform_inclination if inclination is None else math.radians(inclination)
    slope = room.check_inclination(angle)
    hover = built(setpoint, ("setpoint",))
    if plan is not None:
        planned = read_planned(plan, room, slope, platform)
        x, _, z = planned.reference.position[0]
        return planned, hover, [(float(x), float(z))]
    landing = built(policy or "landing", ("landing", "touchdown"), inclination=slope, azimuth=0.0)
    plane = make_task("landing", room, inclination=slope)
    starts = [plane.parse_start(text) for text in start] or list(PAPER_STARTS)
    return landing, hover, [(point[0], point[1]) for point in starts]


@dataclasses.dataclass
class Connection:
    """How the flights of one command connect to the vehicle.

    guarded: around a flight with motors, what stops them should this process die.
    """

    simulated: bool
    connect: Callable[[int, Plan, bool], tuple[Any, Clock, MotionCapture]]
    dead_man_switch: Callable[[], contextlib.AbstractContextManager[Any]] = contextlib.nullcontext

    @contextlib.contextmanager
    def prepared(self, k: int, plan: Plan, dry: bool, yes: bool) -> Iterator[Pilot]:
        """Yield the pilot of flight k once its preflight checks have passed. Raises UserError where one
        fails.
        """
        from inclined_landing.eval.flying import safety
        from inclined_landing.eval.flying.pilot import Pilot

        radio, clock, mocap = self.connect(k, plan, dry)
        try:
            patience = VIRTUAL_PATIENCE if self.simulated else safety.HANG_LIMIT
            pilot = Pilot(radio, clock, mocap, plan, hang_limit=patience)
            for _ in range(CHECK_ATTEMPTS):
                checks = pilot.check()
                failed = [check for check in checks if not check.passed]
                if not failed:
                    break
            for check in checks:
                print(f"  {'ok ' if check.passed else 'NOT'} {check.name}: {check.found}")
            if failed:
                raise UserError(
                    "not ready to fly: " + "; ".join(f"{check.name}: {check.found}" for check in failed)
                )
            with contextlib.nullcontext() if dry else self.dead_man_switch():
                if not (dry or yes or self.simulated):
                    confirm()
                yield pilot
        finally:
            radio.close()


def confirm() -> None:
    """Ask for the arming word. Raises UserError for anything else."""
    question = f"The motors will start. Goggles on, nobody inside the nets? Type {ARM_WORD} to fly: "
    print(question, end="", flush=True)
    typed = sys.stdin.readline().strip()
    if typed != ARM_WORD:
        raise UserError(f"not armed: {ARM_WORD} was not typed")


def summary(report: Report, plan: Plan, log: Path | None) -> dict[str, Any]:
    """Return a report as it is written to fly.json."""
    fields = dataclasses.asdict(report)
    for name in ("cause", "retreat"):
        fields[name] = fields[name] and fields[name]["name"]
    return {**fields, "landed": report.landed, "start_wanted": list(plan.start), "log": log and log.name}


def describe(report: Report) -> str:
    """Return the outcome of a flight in one line."""
    if report.outcome == "plan flown":
        return f"flown as planned, at most {100 * (report.astray or 0.0):.0f} cm off, and set down"
    if report.landed:
        assert report.goal is not None and report.landing_time is not None
        vx, vz = report.goal[3], report.goal[5]
        rest = {
            True: "rests on the slope",
            False: "does not rest on the slope",
            None: "was not seen afterwards",
        }
        touched = report.touched and report.outcome == "goal box"
        return (
            f"{report.outcome}{' after a touch of the platform,' if touched else ''} "
            f"{report.landing_time:.2f} s after hand-over at vx {vx:.2f}, vz {vz:.2f} m/s; "
            f"{rest[report.rests]}"
        )
    if report.cause is None:
        return report.outcome
    return f"ended early: {report.cause.name} ({report.cause.when})"


def _reject_options(why: str, **options: object) -> None:
    """Raise UserError for an option that does not apply here."""
    for name, value in options.items():
        if value is not None:
            raise UserError(f"--{name.replace('_', '-')} is {why}")


def _check_position(
    position: str,
    mocap: str | None,
    latency: float | None,
    at: str | None,
    deck: str | None,
    fault: tuple[str, ...],
) -> None:
    """Raise UserError for options that do not go with where positions come from."""
    from inclined_landing.eval.flying.simulated.deck import check_deck

    if position not in ("mocap", "onboard"):
        raise UserError(f"--position must be mocap or onboard, not {shown(repr(position), 40)}")
    if position == "mocap":
        _reject_options("of --position onboard", at=at, deck=deck)
        return
    _reject_options("of motion capture and not of --position onboard", mocap=mocap, mocap_latency=latency)
    if deck is not None:
        check_deck(deck)
    for text in fault:
        if text.startswith(("mocap-", "marker-", "attitude-turned")):
            raise UserError(
                f"the fault {shown(text, 40)} is of motion capture, which --position onboard has not"
            )


@dataclasses.dataclass(frozen=True)
class _Onboard:
    """The vehicle's own position in the place of motion capture; at, heading as the options say."""

    at: str | None
    heading: float | None  # deg
    simulated: bool

    def of(self, radio: Radio, plan: Plan) -> OnboardPosition:
        """Return what the connected vehicle says. Raises UserError where it cannot, or not on this flight."""
        from inclined_landing.eval.flying.crazyflie import parse_start
        from inclined_landing.eval.flying.onboard import FLOW, OnboardPosition
        from inclined_landing.eval.flying.planned import PlannedFlight
        from inclined_landing.eval.flying.simulated.world import Setting

        deck = radio.find_deck()
        if deck != FLOW and (self.at is not None or self.heading is not None):
            raise UserError(
                "a Lighthouse knows where the vehicle stands: --at and --heading are of a Flow deck"
            )
        if deck == FLOW and not (isinstance(plan.landing, PlannedFlight) and not plan.landing.present):
            raise UserError(
                "a Flow deck measures the height above what is below it and takes the platform for the "
                "floor: it can fly --plan with --no-platform, and no landing"
            )
        if deck == FLOW and self.at is None and not self.simulated:
            raise UserError("a Flow deck does not know where the vehicle stands: say it, --at X,Y in metres")
        at = Setting.start if self.at is None else parse_start(self.at, "--at")
        found = OnboardPosition(deck, at, plan.heading, plan.stand + plan.surroundings.standing_height)
        radio.log_position(found)
        return found


def _simulated(
    vehicle: str,
    inclination: float | None,
    platform: bool,
    deck: str | None,
    fault: tuple[str, ...],
    seed: int,
    own: _Onboard | None,
) -> Connection:
    """Return a connection to simulated Crazyflies, a new one with its own seed for every flight."""
    from inclined_landing.eval.flying.simulated.crazyflie import fly_simulated
    from inclined_landing.eval.flying.simulated.faults import Fault
    from inclined_landing.eval.flying.simulated.vehicles import named_vehicle
    from inclined_landing.eval.flying.simulated.world import Setting
    from inclined_landing.eval.flying.vehicle import Radio

    faults = [Fault.parse(text) for text in fault]
    angle = None if inclination is None else math.radians(inclination)
    setting = Setting(named_vehicle(vehicle), inclination=angle, platform=platform, deck=deck)

    def connect(k: int, plan: Plan, dry: bool) -> tuple[Radio, Any, Any]:
        flight_seed = int(np.random.SeedSequence((seed, k)).generate_state(1)[0])
        flight = fly_simulated(setting, seed=flight_seed, faults=faults)
        radio = Radio(flight.crazyflie, flight.clock, plan.vehicle.command_angle_limit, dry=dry)
        radio.connect(flight.uri)
        return radio, flight.clock, _positions(radio, plan, flight.motion_capture, own)

    return Connection(True, connect)


def _positions(
    radio: Radio, plan: Plan, capture: MotionCapture | None, own: _Onboard | None
) -> MotionCapture:
    """Return where positions come from; closes the link of a vehicle that cannot say its own."""
    if own is None:
        assert capture is not None
        return capture
    try:
        return own.of(radio, plan)
    except UserError:
        radio.close()
        raise


def _real(uri: str, mocap: str | None, latency: float, own: _Onboard | None) -> Connection:
    """Return a connection to the vehicle at `uri`."""
    try:
        import cflib.crtp
        from cflib.crazyflie import Crazyflie
    except ModuleNotFoundError as error:
        raise UserError(not_installed(error)) from error
    from inclined_landing.eval.flying.dead_man import DeadManSwitch
    from inclined_landing.eval.flying.interfaces import RealClock
    from inclined_landing.eval.flying.link import find_radio
    from inclined_landing.eval.flying.motion_capture import open_capture
    from inclined_landing.eval.flying.vehicle import Radio

    find_radio(uri)
    clock = RealClock()
    capture = None if mocap is None else open_capture(mocap, clock, latency)
    cflib.crtp.init_drivers()

    def connect(k: int, plan: Plan, dry: bool) -> tuple[Radio, Any, Any]:
        if k > 0:
            print("Put the vehicle back, switch it off and on, press Enter: ", end="", flush=True)
            if not sys.stdin.readline():
                raise UserError("nobody is there to put the vehicle back")
        radio = Radio(Crazyflie(), clock, plan.vehicle.command_angle_limit, dry=dry)
        radio.connect(uri)
        return radio, clock, _positions(radio, plan, capture, own)

    return Connection(False, connect, lambda: DeadManSwitch(uri))
