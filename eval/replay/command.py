"""`landing-eval replay`: a page for the browser that shows flights."""

from __future__ import annotations

import dataclasses
import math
import shlex
import sys
import zipfile
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro
from msgspec import Meta

from inclined_landing.envs.ids import SHIPPED
from inclined_landing.eval.base.options import (
    Drawn,
    File,
    Flag,
    Flat,
    Flown,
    Only,
    Reading,
    Seed,
    Starts,
    only_with,
    only_without,
)
from inclined_landing.eval.gap.result import HORIZON
from inclined_landing.models.base import storage
from inclined_landing.models.base.errors import UserError, shown
from inclined_landing.models.parameters import load_vehicle
from inclined_landing.models.vehicle import Vehicle

if TYPE_CHECKING:
    from inclined_landing.envs.policy import Policy
    from inclined_landing.envs.tasks import Start

Sources = Annotated[
    tuple[str, ...], tyro.conf.Positional, tyro.conf.arg(metavar="POLICY|LOG [POLICY|LOG ...]")
]
_POLICY = Only(lambda values: any(map(_is_policy, values["sources"])), "without a policy")
_LOG = Only(lambda values: not all(map(_is_policy, values["sources"])), "without a log")


def command(
    sources: Sources,
    /,
    *,
    out: File,
    start: Annotated[Starts, _POLICY] = (),
    drawn: Annotated[Drawn, _POLICY, only_without("start")] = 0,
    seed: Annotated[Seed, only_with("drawn")] = 0,
    restart: Annotated[float, Meta(ge=0.05, le=3600), _LOG] = HORIZON,
    platform: Annotated[Flag, _LOG] = False,
    reading: Annotated[Flat[Reading], _LOG] = Reading(),
    flown: Flat[Flown] = Flown(),
) -> None:
    """Show flights of policies and logs in 3D, on one page for the browser.

    The page is self-contained and opens from a file. A policy flies from --start, or from its task's usual
    starts; its flight is shown at the engine's steps, with contact forces, until the vehicle is at rest. A
    log is shown together with a simulation of the same commands.

    Args:
        sources: policy files or names of shipped ones, and flight logs of any known kind.
        out: .html file.
        start: start of the policies in metres, X,Z or (setpoint) X,Y,Z; repeatable.
        drawn: number of flights of each policy from random starts instead, over random slopes if it observes
            the slope.
        seed: seed for the random starts.
        restart: seconds after which the simulation of a log restarts at the measured state.
        platform: the platform in the vehicle file was present in the flights (detected automatically in logs
            with contacts).
    """
    if not sources:
        raise UserError("name at least one policy or log")
    if out.suffix.lower() not in (".html", ".htm"):
        raise UserError(f"--out must be an .html file, not {shown(out.name)!r}")
    storage.check_file(out)
    from inclined_landing.envs.flights import record_flights
    from inclined_landing.envs.shared import runs
    from inclined_landing.envs.shared.tables import say
    from inclined_landing.eval.pictures.flights import choose_starts
    from inclined_landing.eval.pictures.starts import parse_starts, start_words, usual_starts
    from inclined_landing.eval.replay.page import write
    from inclined_landing.eval.replay.recording import Recording, from_flight
    from inclined_landing.models.plants import check_plant

    check_plant(flown.plant)
    vehicle, options = _vehicle(flown), reading.options()
    policies = [source for source in sources if _is_policy(source)]
    # Everything is read before anything flies.
    logs = {}
    if len(policies) < len(sources):
        from inclined_landing.eval.logs import read_log
        from inclined_landing.eval.replay.measured import from_log

        logs = {s: read_log(s, **options) for s in sources if s not in policies}
    ready: dict[str, tuple[Policy, Start]] = {}
    for source in policies:
        policy = flown.load(source)
        where = parse_starts(start, policy.task) or usual_starts(policy.task)
        ready[source] = policy, choose_starts(policy.task, where, drawn, seed)
    recordings, notes = list[Recording](), list[str]()
    names = [shown(_name(source), 60) for source in sources]
    for source, name in zip(sources, names):
        if source in ready:
            policy, starts = ready[source]
            for flight in record_flights(policy, flown.plant, starts):
                named = f"{name.removesuffix('.zip')} from {start_words(policy.task, flight.state[0])}"
                recordings.append(from_flight(flight, named, flown.plant))
            continue
        found, log_notes = from_log(
            logs[source], vehicle, platform=platform, horizon=restart, plant=flown.plant
        )
        recordings += found
        notes += log_notes
    text = write(
        recordings,
        title=", ".join(names[:2]) + (f" and {len(names) - 2} more" if len(names) > 2 else ""),
        notes=notes,
        run=shlex.join(["landing-eval", *sys.argv[1:]]),
        versions=runs.packages(),
    )
    with storage.made(out.parent):
        storage.write_text(out, text)
    for note in notes:
        print(note, file=sys.stderr)
    for recording in recordings:
        say(f"{recording.name}: {recording.outcome}")
    plural = "s" * (len(recordings) != 1)
    say(f"{out} shows {len(recordings)} flight{plural}; open it in a browser.")


def _is_policy(source: str) -> bool:
    if source in SHIPPED or Path(source).suffix == ".zip":
        return True
    path = Path(source)
    is_run = (path / "final.zip").is_file()
    return is_run or (path.is_file() and zipfile.is_zipfile(path))  # pipes and devices have no end


def _name(source: str) -> str:
    """Return the name of a policy or a log; a policy in a run folder has the name of the folder."""
    path = Path(source)
    of_a_run = path.name in ("final.zip", "best.zip") and path.parent.name
    return source if source in SHIPPED else path.parent.name if of_a_run else path.name


def _vehicle(flown: Flown) -> Vehicle:
    """Return the vehicle of a log's simulation."""
    vehicle = load_vehicle(flown.vehicle)
    if flown.inclination is None:
        return vehicle
    angle = math.radians(flown.inclination)
    vehicle.check_inclination(angle)
    return dataclasses.replace(vehicle, platform_inclination=angle)
