"""Canonical columns of a flight log, and the units in which a file may store them."""

from __future__ import annotations

import math
import re

from inclined_landing.models.base.errors import UserError, shown

QUATERNION = ("qw", "qx", "qy", "qz")
COMMANDED_QUATERNION = ("cmd_qw", "cmd_qx", "cmd_qy", "cmd_qz")
REQUESTS = ("m1_cmd", "m2_cmd", "m3_cmd", "m4_cmd")
ROTOR_SPEEDS = ("m1_speed", "m2_speed", "m3_speed", "m4_speed")

# Canonical column -> quantity. The canonical unit is the one with factor 1 below.
COLUMNS = {
    "t": "time",
    **dict.fromkeys(("x", "y", "z"), "length"),
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
    "length": {"m": 1.0, "cm": 1e-2, "mm": 1e-3, "ft": 0.3048, "in": 0.0254},
    "angle": {"rad": 1.0, "deg": _DEGREE},
    "angular rate": {"rad/s": 1.0, "deg/s": _DEGREE},
    "rotor speed": {"rad/s": 1.0, "rpm": math.pi / 30},
    "number": {"1": 1.0, "-": 1.0, "": 1.0},
    "pwm": {"PWM": 1.0, "fraction": 65535.0, "%": 655.35, "percent": 655.35},
    "voltage": {"V": 1.0, "mV": 1e-3},
    "flag": {"1": 1.0, "-": 1.0, "": 1.0, "bool": 1.0},
}
_SPELLINGS = {
    **{"µs": "us", "μs": "us", "°": "deg", "°/s": "deg/s", "pwm": "PWM", "v": "V", "mv": "mV"},
    **dict.fromkeys(("degree", "degrees"), "deg"),
    **dict.fromkeys(("radian", "radians"), "rad"),
    **dict.fromkeys(("metre", "metres", "meter", "meters"), "m"),
    **dict.fromkeys(("foot", "feet"), "ft"),
    **dict.fromkeys(("volt", "volts"), "V"),
    **dict.fromkeys(("sec", "secs", "second", "seconds"), "s"),
    **dict.fromkeys(("msec", "millis", "milliseconds"), "ms"),
    **dict.fromkeys(("usec", "micros", "microseconds"), "us"),
    **dict.fromkeys(("nsec", "nanos", "nanoseconds"), "ns"),
}
OF_A_FORCE = (
    "newton, gram or m/s2 need a mapping file: inherit = 'documented' and, under [columns], "
    "cmd_thrust_pwm = { column = 'NAME', full = 0.6 }, the value at full command"
)
_IN_BRACKETS = re.compile(r"(.+?)\s*[\[(]([^\[\]()]*)[\])]")  # x [mm], roll (deg)
_AT_THE_END = re.compile(r"(.+?)[ _](deg|degrees|rad|[mc]?m|m?v|s|secs?|[mun]s|[mun]sec)", re.IGNORECASE)
_TIMES = re.compile(r"(\d+(?:\.\d*)?(?:[eE][+-]?\d+)?)\s*([^\d\s].*)")  # 0.01 s


def split(name: str) -> tuple[str, str | None]:
    """Return the name of a column in lower case without the unit at its end, and that unit or None."""
    match = _IN_BRACKETS.fullmatch(name.strip()) or _AT_THE_END.fullmatch(name.strip())
    return (match[1].lower(), match[2]) if match else (name.strip().lower(), None)


def known(column: str, unit: str) -> bool:
    """Return whether `unit` measures the quantity of a column."""
    return _spelled(column, unit) in UNITS[COLUMNS[column]]


def factor(column: str, unit: str, where: str) -> float:
    """Return the conversion factor from `unit`, such as ms or 0.01 s, to the canonical unit of `column`.

    Raises UserError (starting with `where`) if the unit does not measure the column's quantity.
    """
    times = _TIMES.fullmatch(unit.strip().strip("[]()"))
    number, single = (float(times[1]), times[2]) if times else (1.0, unit)
    if known(column, single) and 0.0 < number < 1e9:
        return number * UNITS[COLUMNS[column]][_spelled(column, single)]
    named = shown(unit.strip().strip("[]()"), 40)
    choices = ", ".join(name for name in UNITS[COLUMNS[column]] if name)
    sentence = f"{where}: unit '{named}' of column {column} is unknown; choose from {choices}"
    if COLUMNS[column] == "pwm":
        sentence += f"; {OF_A_FORCE}"
    raise UserError(sentence)


def _spelled(column: str, unit: str) -> str:
    unit = unit.strip().strip("[]()")
    if unit in UNITS[COLUMNS[column]]:
        return unit
    return _SPELLINGS.get(unit, _SPELLINGS.get(unit.lower(), unit.lower()))
