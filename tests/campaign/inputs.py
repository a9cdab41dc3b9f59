"""Good inputs, which the campaign damages and commands are run on."""

import json
from pathlib import Path

import numpy as np

from inclined_landing.eval.logs.log import COMMANDS, MEASURED

ROWS = 400
STUDY = """
title = "small"
question = "none"
sampling = "latin-hypercube"
samples = 12
seed = 5
maps = [["inclination", "mass"]]

[simulation]
duration = 0.4
timestep = 0.004

[parameters]
inclination = { from = 10, to = 40, unit = "deg" }
friction = { values = [0.5, 1.0], unit = "1" }
mass = { mean = 33, deviation = 3, from = 28, to = 42, unit = "g", distribution = "normal" }
thrust = { from = 0.1, to = 1, unit = "1" }
"""
RANGES = """
nominal = 0.1
probability = 0.5
vehicles = ["crazyflie-2.0", "crazyflie-2.1"]
[effects]
wind = { x = [-1, 1], y = [0, 0], probability = 1.0 }
mass = { scale = [0.8, 1.1] }
[body]
mass = [0.027, 0.032]
inertia = [[1.5e-5, 1.8e-5], [1.5e-5, 1.8e-5], [2.6e-5, 3.2e-5]]
"""
MAPPING = """
description = "a lab"
detect = ["cmd_thrust_pwm"]
euler = "ZXY"
notes = ["a note"]
[columns]
t = { column = "t", unit = "s", late = 0.0 }
x = { column = "x", unit = "m", sign = 1, add = 0.0, late = 0.0 }
y = ["absent", { column = "y" }]
z = { mean = ["z", "z"] }
roll = { mean = ["roll", "roll"] }
pitch = "pitch"
cmd_thrust_pwm = "cmd_thrust_pwm"
"""
REPORT = {"version": 1, "sets": [{"effects": ["body_drag"], "probability": 1.0, "values": {"body_drag": {}}}]}


def flight() -> str:
    """Return a log (CSV) of a flight in a circle that the checks let pass."""
    t = np.arange(ROWS) / 100
    x, y, z = 0.3 * np.cos(2 * t), 0.3 * np.sin(2 * t), 1 + 0.1 * np.sin(3 * t)
    pitch, roll = -1.2 * np.cos(2 * t) / 9.81, 1.2 * np.sin(2 * t) / 9.81
    pwm = 38000 * (1 - 0.9 * np.sin(3 * t) / 9.81)
    sent = 1.2 * np.sin(2 * (t + 0.05)) / 9.81, -1.2 * np.cos(2 * (t + 0.05)) / 9.81  # 50 ms ahead
    values = [t, x, y, z, roll, pitch, 0 * t, pwm, *sent, 0 * t]
    values += [np.gradient(p, t) for p in (x, y, z)] + [4.1 - 0.01 * t, 0 * t]
    head = ("t", *MEASURED, *COMMANDS, "vx", "vy", "vz", "vbat", "contact")
    return (
        "\n".join([",".join(head), *(",".join(map(repr, row)) for row in np.stack(values).T.tolist())]) + "\n"
    )


def place(folder: Path) -> Path:
    """Write what command lines of the tests name as {place}, and return the folder."""
    folder.mkdir(exist_ok=True)
    (folder / "log.csv").write_text(flight())
    (folder / "study.toml").write_text(STUDY)
    (folder / "report").mkdir()
    (folder / "report/report.json").write_text(json.dumps(REPORT))
    (folder / "loop").symlink_to("loop")
    (folder / "link").symlink_to(folder / "nowhere" / "at" / "all")
    return folder
