"""A good flight log, which several modules spoil or give to commands."""

import numpy as np

from inclined_landing.eval.logs import FlightLog, motion
from inclined_landing.eval.logs.log import COMMANDS, MEASURED

ROWS = 400
COLUMNS = ("t", *MEASURED, *COMMANDS, "vx", "vy", "vz", "vbat", "contact")


def a_flight() -> dict[str, np.ndarray]:
    """Columns of a flight in a circle that the checks let pass."""
    t = np.arange(ROWS) / 100
    x, y, z = 0.3 * np.cos(2 * t), 0.3 * np.sin(2 * t), 1 + 0.1 * np.sin(3 * t)
    pitch, roll = -1.2 * np.cos(2 * t) / 9.81, 1.2 * np.sin(2 * t) / 9.81
    pwm = 38000 * (1 - 0.9 * np.sin(3 * t) / 9.81)
    values = [t, x, y, z, roll, pitch, 0 * t, pwm, roll, pitch, 0 * t]
    values += [np.gradient(p, t) for p in (x, y, z)] + [4.1 - 0.01 * t, 0 * t]
    return dict(zip(COLUMNS, values))


def text(columns: dict) -> str:
    """Columns as CSV; cells that are text stand as they are."""
    rows = zip(
        *([cell if isinstance(cell, str) else repr(float(cell)) for cell in c] for c in columns.values())
    )
    return "\n".join([",".join(columns), *map(",".join, rows)]) + "\n"


def fly(log: FlightLog) -> None:
    """What is read is a flight: finite where it was logged, with an even grid of bounded size."""
    assert np.isfinite(log.position).all() and len(log) < 10_000
    for part in motion.motion(log):
        assert np.isfinite(part.force).all() and len(part.force) < 100_000
