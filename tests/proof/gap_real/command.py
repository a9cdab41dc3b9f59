"""`gap-real`: the tables and figures of docs/real_flights.md from the four public data sets."""

from __future__ import annotations

import dataclasses
import functools
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Annotated, NamedTuple

import tyro
from matplotlib.figure import Figure
from rich.console import Console

from inclined_landing.envs.shared import runs
from inclined_landing.eval.base.options import Folder, VehicleFile
from inclined_landing.eval.base.style import save_figure, styled
from inclined_landing.eval.gap.flights.reading import read_flights
from inclined_landing.eval.logs import read_log
from inclined_landing.models import storage
from inclined_landing.models.errors import UserError
from inclined_landing.models.parameters import load_vehicle, write_vehicle
from inclined_landing.models.vehicle import Vehicle
from tests.proof.gap_real import alignment, attitude, figures, halves, pads, tables, thrust
from tests.proof.gap_real.halves import Fleet
from tests.proof.shared import check_known

MOTORS = Path(__file__).with_name("nanobench_motors.toml")
_DAY1, _UTIAS, _NANOBENCH = "utias_20250421_*.csv.gz", "utias_*.csv.gz", "nb_*.csv.gz"
# What single fits of the first day suggest (part `attitude`): start values of a fit without search.
GIVEN = {
    "thrust_scale": {"scale": 0.8},
    "mocap_tilt": {"roll": 0.045, "pitch": 0.02},
    "attitude_trim": {"roll": -0.015, "pitch": -0.02},
    "attitude_gain": {"scale": 0.8},
    "attitude_time_constant": {"scale": 0.4},
    "attitude_delay": {"delay": 0.05},
    "rotor_drag": {"lateral": 1.5, "axial": 1.5},
    "thrust_delay": {"delay": 0.04},
}


# The same for NanoBench: what sixty refits of a simulator of its own found to matter a second ahead.
NANOBENCH_GIVEN = {
    "thrust_scale": {"scale": 0.4},
    "thrust_bias": {"force": 0.1},
    "attitude_gain": {"scale": 0.7},
    "attitude_time_constant": {"scale": 0.3},
    "estimator_lean": {"lean": 0.01},
    "mocap_delay": {"delay": 0.04},
    "mocap_tilt": {"roll": -0.005, "pitch": 0.015},
    "rotor_drag": {"lateral": 1.5, "axial": 1.0},
    "body_drag": {"coefficient": 0.002},
    "battery_voltage": {"sensitivity": -0.05, "reference": 3.5},
    "thrust_fade": {"rate": 0.0005},
    "translational_lift": {"coefficient": 0.005},
}
NANOBENCH_MOTORS_GIVEN = NANOBENCH_GIVEN | {"thrust_scale": {"scale": 0.7}, "thrust_bias": {"force": -0.04}}


class Part(NamedTuple):
    """What a part of the study gives."""

    plain: object  # what real.json holds
    figure: Figure | None
    text: str  # tables in Markdown
    vehicle: Vehicle | None = None  # corrected by effects that were given


def command(
    data: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="DATA")],
    /,
    out: Folder,
    only: Annotated[tuple[str, ...], tyro.conf.arg(metavar="PART [PART ...]")] = (),
    heldout: Annotated[tuple[str, ...], tyro.conf.arg(metavar="LOG [LOG ...]")] = (),
    vehicle: VehicleFile = None,
) -> None:
    """Measured flights of others: what is named, how much of the gap closes (minutes).

    Args:
        data: folder of the tidy data sets utias_fmpc, nanobench, crazypad and arp_sysid.
        out: new folder for tables.md, real.json and figures.
        only: some of utias_day1, utias_all, utias_given, nanobench, nanobench_motors, nanobench_given,
            nanobench_motors_given, attitude, thrust, utias_streams, nanobench_streams, crazypad, arp_sysid.
        heldout: further flights, on which the one part of --only is judged, whose effects are given.
        vehicle: vehicle file (TOML), where the model differs from the shipped one.
    """
    if heldout and not (len(only) == 1 and only[0].endswith("_given")):
        raise UserError("--heldout goes with one part whose effects are given: --only nanobench_given, say")
    check_known("part", only, PARTS)
    chosen = {name: PARTS[name] for name in only or PARTS}
    if heldout:
        (name,) = only
        folder, study = PARTS[name]
        chosen = {name: (folder, functools.partial(study, heldout=heldout))}
    for folder, _ in chosen.values():
        if not (data / folder).is_dir():
            raise UserError(f"{data / folder} is missing; {data} should hold the four data sets")
    runs.check_new_run(out)
    nominal = load_vehicle(vehicle)
    console = Console(stderr=True)
    began = time.monotonic()
    parts: dict[str, Part] = {}
    for name, (folder, study) in chosen.items():
        console.print(f"{time.monotonic() - began:5.0f} s  {name}")
        with styled():
            parts[name] = study(data / folder, nominal)
    text = "\n".join(part.text for part in parts.values())
    results = {name: part.plain for name, part in parts.items()}
    results["run"] = {"data": str(data), "seconds": time.monotonic() - began, "versions": runs.versions()}
    with runs.staged_run(out) as folder:
        storage.write_json(folder / "real.json", results)
        storage.write_text(folder / "tables.md", text)
        for name, part in parts.items():
            if part.figure is not None:
                save_figure(part.figure, folder / f"{name}.png")
            if part.vehicle is not None:
                write_vehicle(folder / f"{name}.toml", part.vehicle)
    print(text)


def _fleet(name: str, pattern: str, mapping: str | None, folder: Path, nominal: Vehicle) -> Part:
    fleet = Fleet.of(name, flights(folder, pattern, mapping), nominal)
    plain = {
        "all": fleet.diagnosis.to_json(),
        "first_halves": fleet.first.to_json(),
        "second_halves": fleet.second.to_json(),
        "stability": _stability(fleet.stability),
    }
    return Part(plain, figures.fleet(fleet), tables.fleet(fleet))


def _given(
    name: str,
    pattern: str,
    mapping: str | None,
    values: Mapping,
    folder: Path,
    nominal: Vehicle,
    heldout: Sequence[str] = (),
) -> Part:
    logs = flights(folder, pattern, mapping)
    others = [read_log(file, mapping=mapping) for file in heldout]
    gap, vehicle = halves.judged(logs, nominal, values, others)
    rows = [] if heldout else halves.stability(logs, nominal, values)
    plain = {"gap": dataclasses.asdict(gap), "stability": _stability(rows)}
    text = tables.section(name, [tables.gap_row("left out", gap)], tables.stability(rows))
    return Part(plain, None, text, vehicle)


def _attitude(folder: Path, nominal: Vehicle) -> Part:
    logs = flights(folder, _UTIAS)
    found = [loop for log in logs for loop in attitude.loops(log, nominal)]
    tilts = [attitude.tilt(log, nominal) for log in logs]
    plain = {"loops": list(map(dataclasses.asdict, found)), "tilts": list(map(dataclasses.asdict, tilts))}
    rows = [
        {"flight": t.flight}
        | dict(zip(("roll on the floor", "pitch on the floor"), t.rest or (None, None)))
        | dict(
            zip(("roll by the flight", "pitch by the flight", "drag x 1/s", "drag y 1/s"), t.flown + t.drag)
        )
        for t in tilts
    ]
    return Part(plain, None, tables.section("attitude", found, rows))


def _streams(name: str, pattern: str, folder: Path, nominal: Vehicle) -> Part:
    logs = flights(folder, pattern)
    poses, late = [alignment.align_pose(log) for log in logs], alignment.align_commands(logs)
    plain: dict[str, object] = {
        log.name: {"pose": dataclasses.asdict(p), "commands": dataclasses.asdict(c)}
        for log, p, c in zip(logs, poses, late)
    }
    pairs = [
        {"flight": log.name}
        | {key: (e.value, e.half_width) for key, e in (("attitude late s", p.delay), ("commands late s", c))}
        | {"tracked point above m": (p.height.value, p.height.half_width)}
        for log, p, c in zip(logs, poses, late)
    ]
    text = tables.section(name, pairs)
    if name == "nanobench_streams":
        lean = attitude.lean(sorted(folder.glob(pattern)), logs, nominal)
        plain["lean"], text = dataclasses.asdict(lean), text + tables.lean(lean)
    return Part(plain, None, text)


def _thrust(folder: Path, nominal: Vehicle) -> Part:
    law = thrust.law(flights(folder, _NANOBENCH, str(MOTORS)), nominal)
    plain = dataclasses.asdict(law) | {"samples": len(law.samples), "near": law.near.to_dict("records")}
    return Part(plain, figures.thrust(law), tables.law(law))


def _pads(folder: Path, nominal: Vehicle) -> Part:
    table, slopes = pads.compare(folder, nominal)
    plain = {"conditions": table.to_dict("records"), "per_volt": slopes}
    rows = [
        {"vehicle": r["vehicle"], "change": r["condition"]}
        | {key: (r[key], r[f"{key}_half"]) for key in pads.QUANTITIES}
        | {"told": r["says"]}
        for r in plain["conditions"]
    ]
    per_volt = f"Request per volt: {slopes['total']:.1f} ± {slopes['total_half']:.1f} %/V."
    return Part(plain, figures.pads(table), tables.section("crazypad", rows, per_volt))


def _lags(folder: Path, nominal: Vehicle) -> Part:
    lags = [thrust.motor_lag(path) for path in sorted(folder.glob("arp_*.csv.gz"))]
    text = f"Motor lag; the vehicle file has {nominal.thrust_lag_rate:.1f} 1/s."
    return Part(list(map(dataclasses.asdict, lags)), None, tables.section("arp_sysid", text, lags))


# Part -> folder of its data set, and what is done with it. Flights of one day are one vehicle as it was: on
# the second day of utias_fmpc it hovers at 7 % less PWM and the motion capture holds another pitch for level.
PARTS: dict[str, tuple[str, Callable[..., Part]]] = {
    "utias_day1": ("utias_fmpc", functools.partial(_fleet, "utias_day1", _DAY1, None)),
    "utias_all": ("utias_fmpc", functools.partial(_fleet, "utias_all", _UTIAS, None)),
    "nanobench": ("nanobench", functools.partial(_fleet, "nanobench", _NANOBENCH, None)),
    "nanobench_motors": ("nanobench", functools.partial(_fleet, "nanobench_motors", _NANOBENCH, str(MOTORS))),
    "utias_given": ("utias_fmpc", functools.partial(_given, "utias_given", _DAY1, None, GIVEN)),
    "nanobench_given": (
        "nanobench",
        functools.partial(_given, "nanobench_given", _NANOBENCH, None, NANOBENCH_GIVEN),
    ),
    "nanobench_motors_given": (
        "nanobench",
        functools.partial(_given, "nanobench_motors_given", _NANOBENCH, str(MOTORS), NANOBENCH_MOTORS_GIVEN),
    ),
    "attitude": ("utias_fmpc", _attitude),
    "thrust": ("nanobench", _thrust),
    "utias_streams": ("utias_fmpc", functools.partial(_streams, "utias_streams", _UTIAS)),
    "nanobench_streams": ("nanobench", functools.partial(_streams, "nanobench_streams", _NANOBENCH)),
    "crazypad": ("crazypad", _pads),
    "arp_sysid": ("arp_sysid", _lags),
}


def flights(folder: Path, pattern: str, mapping: str | None = None):
    """Logs of a data set. Raises UserError when there are none."""
    files = [str(path) for path in sorted(folder.glob(pattern))]
    if not files:
        raise UserError(f"{folder} holds no {pattern}")
    return read_flights(files, mapping=mapping)[0]


def _stability(rows) -> list[dict]:
    return [dataclasses.asdict(row) | {"apart": row.apart, "change": row.change} for row in rows]
