"""`landing-eval fly`: a Crazyflie, or a simulated one, flies to the start and lands on the slope."""

from __future__ import annotations

import contextlib
import dataclasses
import logging
import math
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import tyro
from msgspec import Meta

from inclined_landing.eval.base.options import (
    Degrees,
    Flag,
    Flat,
    NewFolder,
    Only,
    Seed,
    Starts,
    VehicleFile,
    only_with,
    only_without,
)
from inclined_landing.models.base import storage
from inclined_landing.models.base.errors import UserError, shown
from inclined_landing.models.parameters import load_vehicle

if TYPE_CHECKING:
    from inclined_landing.eval.flying.connection import Connection
    from inclined_landing.eval.flying.flight_log import FlightLogWriter
    from inclined_landing.eval.flying.plan import FlightPlan
    from inclined_landing.eval.flying.report import FlightReport

FaultNames = Annotated[tuple[str, ...], tyro.conf.UseAppendAction, tyro.conf.arg(metavar="NAME[@WHEN]")]
_REAL = only_without("simulated")
_BY_CAMERAS = Only(lambda values: values["position"] == "mocap", "with --position onboard")
_SIMULATED, _PLANNED, _LANDING = only_with("simulated"), only_with("plan"), only_without("plan")


@dataclasses.dataclass(frozen=True)
class FlightOptions:
    """The flights of a command and their arena.

    Args:
        policy: policy for landing (motors are cut in the goal box) or touchdown (the policy itself comes to
            rest); default: the shipped landing policy.
        start: start of the landing in metres; repeatable, flown in turn (default: the paper's starts).
        inclination: inclination of the platform in degrees (default: that of the vehicle file).
        arena: vehicle file (TOML) with arena and platform (default: the shipped ones).
        plan: flight.csv of landing-eval plan, flown instead of a landing.
        no_platform: there is no platform in the arena; only with --plan.
    """

    policy: Annotated[str | None, tyro.conf.Positional, tyro.conf.arg(metavar="[POLICY]")] = None
    start: Annotated[Starts, _LANDING] = ()
    inclination: Degrees = None
    arena: VehicleFile = None
    plan: VehicleFile = None
    no_platform: Annotated[Flag, _PLANNED] = False

    def plans(self, stand: float = 0.0, heading: float = 0.0) -> list[FlightPlan]:
        """Return the planned flight, or a landing from each start, of a vehicle that stands so high [m].

        heading [rad]: that of the standing vehicle.

        Raises UserError for a policy for another task or slope, and for a planned flight that cannot be flown
        in the arena.
        """
        from inclined_landing.envs.policy import load_policy, trained_task
        from inclined_landing.envs.tasks import make_task
        from inclined_landing.envs.tasks.frozen import PAPER_STARTS
        from inclined_landing.eval.flying.plan import FlightPlan, read_planned
        from inclined_landing.eval.flying.surroundings import Surroundings
        from inclined_landing.eval.pictures.starts import parse_starts

        room = load_vehicle(self.arena)
        angle = room.platform_inclination if self.inclination is None else math.radians(self.inclination)
        slope = room.check_inclination(angle)

        hover = load_policy("setpoint", "setpoint", vehicle=room)
        if self.plan is not None:
            around = Surroundings(room, slope, not self.no_platform)
            reference = read_planned(self.plan, around)
            return [FlightPlan.along(reference, hover, around, stand=stand, heading=heading)]
        name = self.policy or "landing"
        task = trained_task(name)
        if task not in ("landing", "touchdown"):
            raise UserError(
                f"policy {shown(name)} is for the task {shown(task, 40)}, not for landing or touchdown"
            )
        landing = load_policy(name, task, vehicle=room, inclination=slope, azimuth=0.0)
        if landing.task.platform_moves:
            raise UserError(
                f"policy {shown(name)} is for moving platforms; fly needs one for a platform at rest"
            )
        landing = load_policy(name, landing.task)  # refuses another slope than the policy's
        plane = make_task("landing", room, inclination=slope)
        starts = parse_starts(self.start, plane) or list(PAPER_STARTS)
        return [
            FlightPlan.landing(landing, hover, (x, z), stand=stand, heading=heading) for x, z, *_ in starts
        ]


@dataclasses.dataclass(frozen=True)
class VehicleOptions:
    """The real vehicle and the source of its position.

    Args:
        uri: URI of the vehicle in cflib's form, such as radio://0/80/2M/E7E7E7E7E7 or udp://127.0.0.1:19850.
        mocap: motion capture as type (vicon, optitrack, qualisys, nokov, vrpn ...), host and rigid body.
        mocap_latency: latency of that system from exposure to arrival, in seconds.
        position: source of positions, motion capture or the vehicle's own Lighthouse deck.
        stand: height of the vehicle's stand in metres.
        heading: direction of the nose in degrees from x, if motion capture shows no attitude.
    """

    uri: Annotated[str | None, tyro.conf.arg(metavar="URI"), _REAL] = None
    mocap: Annotated[str | None, tyro.conf.arg(metavar="TYPE:HOST:BODY"), _REAL, _BY_CAMERAS] = None
    mocap_latency: Annotated[float, Meta(ge=0, le=0.1), tyro.conf.arg(metavar="S"), _REAL, _BY_CAMERAS] = 0.0
    position: Literal["mocap", "onboard"] = "mocap"
    stand: Annotated[float, Meta(ge=0.0, le=2.0), tyro.conf.arg(metavar="M"), _REAL] = 0.0
    heading: Annotated[float, Meta(ge=-360, le=360), tyro.conf.arg(metavar="DEG"), _REAL, _BY_CAMERAS] = 0.0

    def connection(self) -> Connection:
        """Return the connection to the vehicle. Raises UserError if none is stated."""
        if self.uri is None or (self.mocap is None and self.position == "mocap"):
            raise UserError(
                "give --uri and --mocap (or --position onboard) for a real vehicle, or --simulated for a "
                "simulated one"
            )
        from inclined_landing.eval.flying.connection import RealConnection
        from inclined_landing.eval.flying.vehicle import check_uri

        check_uri(self.uri)
        return RealConnection(self.uri, self.mocap, self.mocap_latency)


@dataclasses.dataclass(frozen=True)
class SimulationOptions:
    """A simulated Crazyflie instead of a real one.

    Args:
        simulated: fly a simulated Crazyflie, in virtual time.
        vehicle: simulated vehicle: nominal, hidden (with effects unknown to every policy), or a vehicle file.
        fault: fault of the simulated vehicle, NAME@EVENT+SECONDS, as in eval/flying/README.md.
        seed: seed of the simulated vehicle.
    """

    simulated: Flag = False
    vehicle: Annotated[str, tyro.conf.arg(metavar="nominal|hidden|FILE"), _SIMULATED] = "nominal"
    fault: Annotated[FaultNames, _SIMULATED] = ()
    seed: Annotated[Seed, _SIMULATED] = 0

    def connection(self, flight: FlightOptions, lighthouse: bool) -> Connection:
        """Return the connection to simulated vehicles, each next to the platform of its flight."""
        from inclined_landing.eval.flying.connection import SimulatedConnection
        from inclined_landing.eval.flying.simulated.body import named_vehicle
        from inclined_landing.eval.flying.simulated.faults import Fault
        from inclined_landing.eval.flying.simulated.world import Setting

        for text in self.fault:
            if lighthouse and text.startswith(("mocap-", "marker-", "attitude-turned")):
                raise UserError(
                    f"the fault {shown(text, 40)} concerns motion capture, which --position onboard does not "
                    "use"
                )
        angle = None if flight.inclination is None else math.radians(flight.inclination)
        setting = Setting(
            named_vehicle(self.vehicle),
            inclination=angle,
            platform=not flight.no_platform,
            lighthouse=lighthouse,
        )
        faults = tuple(Fault.parse(text) for text in self.fault)
        return SimulatedConnection(setting, faults, self.seed)


def command(
    flight: Flat[FlightOptions] = FlightOptions(),
    real: Flat[VehicleOptions] = VehicleOptions(),
    simulation: Flat[SimulationOptions] = SimulationOptions(),
    *,
    flights: Annotated[int, Meta(ge=1, le=1000)] = 1,
    dry_run: Flag = False,
    out: NewFolder = None,
) -> int:
    """Fly a real or simulated Crazyflie onto the slope, or along a plan; logs as CSV.

    Ctrl-C switches the motors off. See docs/guides/fly.md for preparation, and for what ends a flight.

    Args:
        flights: number of flights.
        dry_run: leave the motors off; carry the vehicle by hand and read the commands that would be sent.
        out: new folder for the logs and fly.json (default: runs/fly-DATE-TIME).
    """
    from inclined_landing.envs.shared import runs
    from inclined_landing.envs.shared.tables import say
    from inclined_landing.eval.flying.connection import checked_pilot
    from inclined_landing.eval.flying.flight_log import FlightLogWriter
    from inclined_landing.eval.flying.report import describe, describe_all, summary

    if flight.plan is not None and flight.policy is not None:
        raise UserError("--plan is flown instead of a landing; name no policy with --plan")
    plans = flight.plans(real.stand, math.radians(real.heading))
    onboard = real.position == "onboard"
    connection = simulation.connection(flight, onboard) if simulation.simulated else real.connection()
    policy = plans[0].final.policy  # None of a planned flight
    logging.getLogger("cflib").setLevel(logging.CRITICAL)  # its messages are reported in a sentence
    description = {
        "command": "fly",
        "policy": policy and str(policy.path),
        "plan": None if flight.plan is None else str(flight.plan),
        "simulated": simulation.simulated,
        "position": real.position,
        "seed": simulation.seed if simulation.simulated else None,
    }
    folder = out or runs.dated("fly")
    results: list[dict[str, Any]] = []
    reports: list[FlightReport] = []
    with runs.owned(folder):
        for k in range(flights):
            plan = plans[k % len(plans)]
            x, _, z = plan.start_point
            print(f"flight {k + 1} of {flights}, {plan.final.phase.value} from x {x:z.4g}, z {z:.4g} m")
            log = None if dry_run else FlightLogWriter(folder / f"flight_{k + 1:02d}.csv")
            with log or contextlib.nullcontext(), checked_pilot(connection, k, plan, dry_run) as pilot:
                report = pilot.fly(log)
                print(describe(report))
                reports.append(report)
                results.append(summary(report, plan, log.path if log and log.begun else None))
                _write(log, folder / "fly.json", {**description, "flights": results})
            if report.cause is not None and report.cause.name == "interrupted":
                return 130
            if report.error:
                print(report.error, file=sys.stderr)
                return 1
    if dry_run:
        return 0
    said = describe_all(reports, policy.task.name if policy else "plan")
    say(f"{said[0].upper()}{said[1:]}; the logs are in {folder}.")
    return 0 if all(report.succeeded for report in reports) else 3


def _write(log: FlightLogWriter | None, path: Path, description: dict[str, Any]) -> None:
    """Finish the log and write the description. Raises UserError, with the names of the files that fail."""
    failed: list[str] = []
    writes = [] if log is None else [log.finish]
    for write in (*writes, lambda: storage.write_json(path, description)):
        try:
            write()
        except UserError as error:
            failed.append(str(error))
    if failed:
        raise UserError("; ".join(failed))
