"""Find the effects that the model of your vehicle lacks, from flights in your own log columns.

    python examples/own_flights.py [FLIGHT.csv ...]

Replace MAPPING, WEIGHED and BENCH by your own and pass your logs. Without logs it writes the bundled ones as
such a laboratory would log them, to flights/ in the current folder. This takes half a minute.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pandas as pd

from inclined_landing.eval.gap import diagnose, measure_gap
from inclined_landing.eval.logs import read_log
from inclined_landing.models.parameters import load_vehicle

MAPPING = """
description = "our arena: x north, y east, z down, angles in degrees"
[columns]
t = { column = "time_ms", unit = "ms" }
x = "north"
y = { column = "east", sign = -1 }
z = { column = "down", sign = -1 }
roll = { column = "phi", unit = "deg" }
pitch = { column = "theta", unit = "deg", sign = -1 }
yaw = { column = "psi", unit = "deg", sign = -1 }
cmd_thrust_pwm = "pwm"
cmd_roll = { column = "phi_cmd", unit = "deg" }
cmd_pitch = { column = "theta_cmd", unit = "deg", sign = -1 }
cmd_yaw_rate = { column = "r_cmd", unit = "deg/s", sign = -1 }
"""
WEIGHED = 0.0330  # kg, with battery and markers
BENCH = {20000: 17.5, 30000: 26.1, 40000: 34.9, 50000: 43.6}  # PWM: gram-force of all four motors


def main() -> None:
    """Diagnose the flights with the vehicle as measured on the ground, and correct it."""
    paths = sys.argv[1:] or write_flights()
    Path("lab.toml").write_text(MAPPING, "utf-8")
    flights = [read_log(path, mapping="lab.toml") for path in paths]

    shipped = load_vehicle()
    pwm, force = np.array(list(BENCH)), 9.81e-3 * np.array(list(BENCH.values()))
    scale = (pwm @ force) / (pwm @ pwm) / shipped.thrust_per_pwm  # of a line through zero
    mine = shipped.changed(
        body_mass=WEIGHED,
        thrust_state_gain=scale * shipped.thrust_state_gain,  # the share of the thrust that lags
        thrust_direct_gain=scale * shipped.thrust_direct_gain,
    )
    diagnosis = diagnose(flights, mine)

    print(f"thrust {scale:.2f} times that of the shipped vehicle, by the bench; verdict: {diagnosis.verdict}")
    for effect in diagnosis.effects:
        sizes = ", ".join(f"{name} {value.value:.2f}" for name, value in effect.parameters.items())
        print(f"{effect.name}: {'sure' if effect.sure else 'possible'}, {effect.probability:.0%} ({sizes})")
    for name, vehicle in {"mine": mine, "corrected": diagnosis.apply(mine)}.items():
        print(
            f"position error one second ahead, {name}: {100 * measure_gap(vehicle, flights)['error']:.1f} cm"
        )


def write_flights() -> list[Path]:
    """Write the bundled flights in the laboratory's columns and units, in place of your own."""
    from inclined_landing.eval.gap import gap_example

    gap_example.command(Path("example"))
    Path("flights").mkdir()
    degrees = 180 / np.pi
    for path in sorted(Path("example/fit").glob("*.csv")):
        log = pd.read_csv(path)
        columns = {
            "time_ms": 1000 * log["t"],
            **{"north": log["x"], "east": -log["y"], "down": -log["z"]},
            **{"phi": degrees * log["roll"], "theta": -degrees * log["pitch"], "psi": -degrees * log["yaw"]},
            **{"pwm": log["cmd_thrust_pwm"], "phi_cmd": degrees * log["cmd_roll"]},
            **{"theta_cmd": -degrees * log["cmd_pitch"], "r_cmd": -degrees * log["cmd_yaw_rate"]},
        }
        pd.DataFrame(columns).to_csv(Path("flights") / path.name, index=False, float_format="%.6f")
    return sorted(Path("flights").glob("*.csv"))


if __name__ == "__main__":
    main()
