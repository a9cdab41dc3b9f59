"""`landing-eval gap-real`: the tables and figures of docs/real_flights.md from the four public data sets."""

from __future__ import annotations

import dataclasses
import time
from pathlib import Path
from typing import Annotated

import tyro
from rich.console import Console

from inclined_landing.eval.base import runs
from inclined_landing.eval.base.options import Folder, VehicleFile
from inclined_landing.eval.base.style import save_figure, styled
from inclined_landing.eval.gap.flights.reading import read_flights
from inclined_landing.eval.proof.gap_real import attitude, figures, halves, pads, tables, thrust
from inclined_landing.eval.proof.gap_real.halves import Study
from inclined_landing.models import storage
from inclined_landing.models.errors import UserError
from inclined_landing.models.parameters import load_vehicle

MOTORS = Path(__file__).with_name("nanobench_motors.toml")
# Flights of one day are one vehicle as it was: on the second day of utias_fmpc it hovers at 7 % less PWM and
# the motion capture holds another pitch for level.
FLEETS = {
    "utias_day1": ("utias_fmpc", "utias_20250421_*.csv.gz", None),
    "utias_all": ("utias_fmpc", "utias_*.csv.gz", None),
    "nanobench": ("nanobench", "nb_*.csv.gz", None),
    "nanobench_motors": ("nanobench", "nb_*.csv.gz", str(MOTORS)),
}
OTHER = {"attitude": "utias_fmpc", "utias_given": "utias_fmpc", "thrust": "nanobench"}
# What single fits of the first day suggest (part `attitude`): start values of a fit without search.
GIVEN = {
    "thrust_scale": {"scale": 0.8},
    "mocap_tilt": {"roll": 0.045, "pitch": 0.02},
    "attitude_trim": {"roll": -0.015, "pitch": -0.02},
    "attitude_gain": {"scale": 0.8},
    "attitude_time_constant": {"scale": 0.4},
    "attitude_delay": {"delay": 0.05},
    "rotor_drag": {"scale": 1.5},
    "thrust_delay": {"delay": 0.04},
}


def command(
    data: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="DATA")],
    /,
    out: Folder,
    only: Annotated[tuple[str, ...], tyro.conf.arg(metavar="PART [PART ...]")] = (),
    vehicle: VehicleFile = None,
) -> None:
    """Measured flights of others: what is named, how much of the gap closes (minutes).

    Args:
        data: folder of the tidy data sets utias_fmpc, nanobench, crazypad and arp_sysid.
        out: new folder for tables.md, real.json and figures.
        only: some of utias_day1, utias_all, utias_given, nanobench, nanobench_motors, attitude, thrust,
            crazypad, arp_sysid.
        vehicle: vehicle file (TOML), where the model differs from the shipped one.
    """
    parts = [*FLEETS, "utias_given", "attitude", "thrust", "crazypad", "arp_sysid"]
    for name in only:
        if name not in parts:
            raise UserError(f"unknown part {name!r}; known are {', '.join(parts)}")
    for name in only or parts:
        folder = FLEETS[name][0] if name in FLEETS else OTHER.get(name, name)
        if not (data / folder).is_dir():
            raise UserError(f"{data / folder} is missing; {data} should hold the four data sets")
    runs.check_new_run(out)
    nominal = load_vehicle(vehicle)
    console = Console(stderr=True)
    began = time.monotonic()
    results, pictures, text = {}, {}, []

    def source(fleet: str):
        folder, pattern, mapping = FLEETS[fleet]
        return data / folder, pattern, mapping

    for name in only or parts:
        console.print(f"{time.monotonic() - began:5.0f} s  {name}")
        if name in FLEETS:
            study = Study.of(name, flights(*source(name)), nominal)
            results[name] = _plain(study)
            with styled():
                pictures[name] = figures.study(study)
            text.append(tables.study(study))
        elif name == "utias_given":
            logs = flights(*source("utias_day1"))
            gap, rows = halves.judged(logs, nominal, GIVEN), halves.stability(logs, nominal, GIVEN)
            results[name] = {"gap": dataclasses.asdict(gap), "stability": _stability(rows)}
            text.append(tables.given(gap, rows))
        elif name == "attitude":
            logs = flights(data / "utias_fmpc", "utias_*.csv.gz")
            found = [loop for log in logs for loop in attitude.loops(log, nominal)]
            tilts = [attitude.tilt(log, nominal) for log in logs]
            results[name] = {
                "loops": [dataclasses.asdict(loop) for loop in found],
                "tilts": [dataclasses.asdict(t) for t in tilts],
            }
            text.append(tables.loops(found, tilts, nominal))
        elif name == "thrust":
            law = thrust.law(flights(data / "nanobench", "nb_*.csv.gz", str(MOTORS)), nominal)
            results[name] = dataclasses.asdict(law) | {"samples": len(law.samples), "near": _rows(law.near)}
            with styled():
                pictures[name] = figures.thrust(law)
            text.append(tables.law(law))
        elif name == "crazypad":
            table, slopes = pads.compare(data / name, nominal)
            results[name] = {"conditions": _rows(table), "per_volt": slopes}
            with styled():
                pictures[name] = figures.pads(table)
            text.append(tables.pads(table, slopes))
        else:
            lags = [thrust.motor_lag(path) for path in sorted((data / name).glob("arp_*.csv.gz"))]
            results[name] = [dataclasses.asdict(lag) for lag in lags]
            text.append(tables.lags(lags, nominal))
    results["run"] = {"data": str(data), "seconds": time.monotonic() - began, "versions": runs.versions()}
    with runs.staged_run(out) as folder:
        storage.write_json(folder / "real.json", results)
        storage.write_text(folder / "tables.md", "\n".join(text))
        for name, picture in pictures.items():
            save_figure(picture, folder / f"{name}.png")
    print("\n".join(text))


def flights(folder: Path, pattern: str, mapping: str | None = None):
    """Logs of a data set. Raises UserError when there are none."""
    files = [str(path) for path in sorted(folder.glob(pattern))]
    if not files:
        raise UserError(f"{folder} holds no {pattern}")
    return read_flights(files, mapping=mapping)[0]


def _plain(study: Study) -> dict:
    return {
        "all": study.diagnosis.to_json(),
        "first_halves": study.first.to_json(),
        "second_halves": study.second.to_json(),
        "stability": _stability(study.stability),
    }


def _stability(rows) -> list[dict]:
    return [dataclasses.asdict(row) | {"apart": row.apart, "change": row.change} for row in rows]


def _rows(table) -> list[dict]:
    return table.to_dict("records")
