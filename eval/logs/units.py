"""Canonical columns of a flight log, and the units a file may give them in."""

from __future__ import annotations

import math

from inclined_landing.models.errors import UserError, shown

QUATERNION = ("qw", "qx", "qy", "qz")
COMMANDED_QUATERNION = ("cmd_qw", "cmd_qx", "cmd_qy", "cmd_qz")
REQUESTS = ("m1_cmd", "m2_cmd", "m3_cmd", "m4_cmd")
ROTOR_SPEEDS = ("m1_speed", "m2_speed", "m3_speed", "m4_speed")

# Canonical column -> quantity. The canonical unit is the one with factor 1 below.
COLUMNS = {
    "t": "time",
    **dict.fromkeys(("x", "y", "z"), "length"),
    **dict.fromkeys(("vx", "vy", "vz"), "speed"),
    **dict.fromkeys(("roll", "pitch", "yaw"), "angle"),
    **dict.fromkeys(QUATERNION, "number"),
    "cmd_thrust_pwm": "pwm",
    **dict.fromkeys(("cmd_roll", "cmd_pitch", "cmd_yaw"), "angle"),
    **dict.fromkeys(COMMANDED_QUATERNION, "number"),
    "cmd_yaw_rate": "angular rate",
    "vbat": "voltage",
    "contact": "flag",
    **dict.fromkeys(REQUESTS, "pwm"),
    **dict.fromkeys(ROTOR_SPEEDS, "rotor speed"),
}

_DEGREE = math.pi / 180
UNITS = {
    "time": {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9},
    "length": {"m": 1.0, "cm": 1e-2, "mm": 1e-3},
    "speed": {"m/s": 1.0, "cm/s": 1e-2, "mm/s": 1e-3},
    "angle": {"rad": 1.0, "deg": _DEGREE},
    "angular rate": {"rad/s": 1.0, "deg/s": _DEGREE},
    "rotor speed": {"rad/s": 1.0, "rpm": math.pi / 30},
    "number": {"1": 1.0, "-": 1.0, "": 1.0},
    "pwm": {"PWM": 1.0, "fraction": 65535.0, "%": 655.35, "percent": 655.35},
    "voltage": {"V": 1.0, "mV": 1e-3},
    "flag": {"1": 1.0, "-": 1.0, "": 1.0, "bool": 1.0},
}
_SPELLINGS = {"µs": "us", "μs": "us", "°": "deg", "degrees": "deg", "radians": "rad", "pwm": "PWM", "v": "V"}
_SPELLINGS |= {"°/s": "deg/s", "mv": "mV", "seconds": "s", "sec": "s"}


def factor(column: str, unit: str, where: str) -> float:
    """Return the conversion factor from `unit` to the canonical unit of `column`.

    Raises UserError (starting with `where`) when the unit does not measure the column's quantity.
    """
    known = UNITS[COLUMNS[column]]
    unit = unit.strip().strip("[]()")
    unit = _SPELLINGS.get(unit, unit)
    if unit not in known:
        choices = ", ".join(name for name in known if name)
        raise UserError(
            f"{where}: unit '{shown(unit, 40)}' of column {column} is not known; one of {choices}"
        )
    return known[unit]
