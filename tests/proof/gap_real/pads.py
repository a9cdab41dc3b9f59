"""Known hardware changes seen in hover, by what the motors were asked for: pitch was not logged.

In hover the requests (before battery compensation, proportional to force in that firmware) say without any
attitude: their sum the weight over the thrust per request, their balance where the centre of mass sits or
which rotor is weak. Their diagonal balance (the turning moment) should tell a weak rotor from a weight.
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pandas as pd
from scipy import stats

from inclined_landing.eval.logs.csv_file import read_columns
from inclined_landing.models.errors import UserError
from inclined_landing.models.vehicle import Vehicle

NORMAL = "normal_flight"
NAME = re.compile(r"pad_(E\d)_(.+)_log(\d+)")
# Hover and slow cruise at the height flown.
HEIGHT, CLIMB, ACCELERATION = (0.35, 0.75), 0.05, 1.0
_COLUMNS = ("t", "z", "vz", "az", "vbat", "m1_cmd", "m2_cmd", "m3_cmd", "m4_cmd")
QUANTITIES = {"total": "%", "M3": "%", "offset_x": "mm", "offset_y": "mm", "diagonal": "%"}


def hover(path: Path, vehicle: Vehicle) -> dict:
    """Means over the hover of one log; offsets by the balance of moments with `vehicle.rotor_arm`."""
    name = NAME.match(path.name)
    if name is None:
        raise UserError(f"{path} is not called pad_VEHICLE_CONDITION_logNUMBER")
    table = read_columns(path, _COLUMNS)
    still = table.z.between(*HEIGHT) & (table.vz.abs() < CLIMB) & (table.az.abs() < ACCELERATION)
    m = table.loc[still, [f"m{i}_cmd" for i in (1, 2, 3, 4)]].mean().to_numpy()
    share = m / m.sum()
    arm = 1000.0 * vehicle.rotor_arm
    return {
        "vehicle": name[1],
        "condition": name[2],
        "log": int(name[3]),
        "seconds": float(still.sum() * np.median(np.diff(table.t))),
        "voltage": float(table.vbat[still].mean()),
        # Logarithms times 100: differences are percent.
        "total": 100.0 * np.log(m.sum()),
        "M3": 100.0 * np.log(m[2]),
        "offset_x": arm * float(share @ [1, -1, -1, 1]),
        "offset_y": arm * float(share @ [-1, -1, 1, 1]),
        "diagonal": 100.0 * float(share @ [1, -1, 1, -1]),
    }


def compare(folder: Path, vehicle: Vehicle) -> tuple[pd.DataFrame, dict[str, float]]:
    """Every condition against the normal flights of the same vehicle, the voltage taken out.

    Returns a table (vehicle, condition, and value and half-width of the interval of every quantity, 95 % for
    all conditions of one quantity together: Bonferroni)
    and the slope of each quantity per volt. Two logs of a condition differ in voltage: that gives the
    slope, and what it leaves gives the intervals.
    """
    logs = pd.DataFrame([hover(p, vehicle) for p in sorted(folder.glob("pad_*.csv.gz"))])
    if logs.empty:
        raise UserError(f"{folder} holds no pad_*.csv.gz")
    case = logs.vehicle + " " + logs.condition
    cases = list(dict.fromkeys(case))
    x = np.hstack([(case.to_numpy()[:, None] == np.array(cases)).astype(float), logs[["voltage"]] - 3.5])
    freedom = len(logs) - x.shape[1]
    lacking = [v for v in logs.vehicle.unique() if f"{v} {NORMAL}" not in cases]
    if freedom < 1 or lacking or not np.isfinite(logs[["voltage", *QUANTITIES]].to_numpy(float)).all():
        raise UserError(f"{folder} needs hover of each vehicle's {NORMAL}, and conditions flown twice")
    inverse = np.linalg.inv(x.T @ x)
    quantile = stats.t.ppf(1.0 - 0.025 / (len(cases) - logs.vehicle.nunique()), freedom)
    rows = {c: dict(zip(("vehicle", "condition"), c.split(" "))) for c in cases}
    slopes = {}
    for quantity in QUANTITIES:
        y = logs[quantity].to_numpy()
        fit = inverse @ x.T @ y
        variance = ((y - x @ fit) ** 2).sum() / freedom
        slopes[quantity] = float(fit[-1])
        slopes[f"{quantity}_half"] = float(quantile * np.sqrt(variance * inverse[-1, -1]))
        for c in cases:
            contrast = np.zeros(x.shape[1])
            contrast[cases.index(c)] += 1.0
            contrast[cases.index(f"{c.split(' ')[0]} {NORMAL}")] -= 1.0
            rows[c][quantity] = float(contrast @ fit)
            rows[c][f"{quantity}_half"] = float(quantile * np.sqrt(variance * contrast @ inverse @ contrast))
    table = pd.DataFrame([r for r in rows.values() if r["condition"] != NORMAL])
    table["says"] = [verdict(r) for _, r in table.iterrows()]
    return table, slopes


def verdict(row) -> str:
    """What can be told about one condition."""
    seen = [
        what
        for what, quantity in (("more force", "total"), ("M3 works harder", "M3"))
        if row[quantity] > row[f"{quantity}_half"]
    ]
    return ", ".join(seen) or "nothing"
