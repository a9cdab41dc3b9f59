"""`landing-eval crazyflie`: a simulated Crazyflie in real time, for cflib over UDP."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated

import tyro
from msgspec import Meta

from inclined_landing.envs.shared.tables import say
from inclined_landing.eval.base.options import Degrees, Flag, Seed
from inclined_landing.models.errors import UserError, shown
from inclined_landing.models.storage import check_file, made

FaultNames = Annotated[tuple[str, ...], tyro.conf.UseAppendAction, tyro.conf.arg(metavar="NAME[@WHEN]")]


def command(
    *,
    port: Annotated[int, Meta(ge=0, le=65535)] = 19850,
    poses: Annotated[str, tyro.conf.arg(metavar="HOST:PORT")] = "127.0.0.1:19870",
    vehicle: Annotated[str, tyro.conf.arg(metavar="nominal|hidden|FILE")] = "nominal",
    start: Annotated[str, tyro.conf.arg(metavar="X,Y")] = "1,0",
    inclination: Degrees = None,
    lighthouse: Flag = False,
    fault: FaultNames = (),
    seconds: Annotated[Annotated[float, Meta(gt=0.0, lt=1e6)] | None, tyro.conf.arg(metavar="S")] = None,
    seed: Seed = 0,
    out: Annotated[Path | None, tyro.conf.arg(metavar="FILE")] = None,
) -> int:
    """Run a simulated Crazyflie in real time, for cflib over UDP.

    It stands next to the platform, at udp://127.0.0.1:PORT, until Ctrl-C, and prints what happens. Faults
    (eval/flying/README.md) occur at a time, `link-lost@12`, or after an event, `mocap-frozen@air+2`.

    Args:
        port: UDP port to listen on; 0 picks a free one. cflib scans 19850 to 19859.
        poses: address to send the poses of its motion capture to.
        vehicle: nominal, hidden (with effects unknown to every policy), or a vehicle file.
        start: position on the floor in metres.
        inclination: inclination of the platform in degrees (default: that of the vehicle file).
        lighthouse: give the vehicle a Lighthouse deck that measures its position.
        fault: a fault and its time; repeatable.
        seconds: end after this time in seconds.
        seed: seed for noise, delays and dropouts.
        out: file for the ground truth, as documented CSV (.csv, .csv.gz).
    """
    from inclined_landing.eval.flying.positions import resolved
    from inclined_landing.eval.flying.simulated.body import named_vehicle
    from inclined_landing.eval.flying.simulated.faults import Fault
    from inclined_landing.eval.flying.simulated.server import SimulatorServer
    from inclined_landing.eval.flying.simulated.world import Setting, World

    address, faults = resolved(poses), [Fault.parse(text) for text in fault]
    angle = None if inclination is None else math.radians(inclination)
    setting = Setting(named_vehicle(vehicle), _parse_start(start), inclination=angle, lighthouse=lighthouse)
    if out is not None:
        if not out.name.endswith((".csv", ".csv.gz")):
            raise UserError(f"--out must be a .csv or .csv.gz file, not {shown(repr(out.name), 60)}")
        check_file(out)
    world = World(setting, seed, faults)
    process = SimulatorServer(world, port, address, lambda line: print(line, flush=True))
    print(f"a simulated Crazyflie at udp://127.0.0.1:{process.port}, its poses to {poses}", flush=True)
    try:
        process.run(float("inf") if seconds is None else seconds)
    except KeyboardInterrupt:
        pass
    finally:
        process.close()
        if out is not None:
            with made(out.parent):
                world.trace.write(out)
    x, y, z = world.body.state[:3]
    log = "" if out is None else f"; the ground truth is in {out}"
    say(f"The simulated Crazyflie was switched off at x {x:.2f}, y {y:.2f}, z {z:.2f} m{log}.")
    return 0


def _parse_start(text: str) -> tuple[float, float]:
    try:
        x, y = (float(number) for number in text.split(","))
    except ValueError:
        raise UserError(f"--start must be X,Y in metres, like 1,0, not {shown(repr(text), 60)}") from None
    return x, y
