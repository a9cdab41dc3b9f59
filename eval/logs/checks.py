"""Plausibility checks of flights: findings as sentences, each with a decision."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any

import numpy as np

from inclined_landing.eval.logs import copies, motion, values
from inclined_landing.eval.logs.channels import FULL_COMMAND
from inclined_landing.eval.logs.log import Finding, FlightLog, as_logs, limit, refuse
from inclined_landing.models.base.errors import UserError

_ORDER = {"refuse": 0, "limit": 1, "info": 2}
HOVER_JUMP = 0.10  # difference of hover thrust between two groups of flights
HOVER_SPREAD = 0.06
NOMINAL_VOLTAGE = 4.0
LEAST_HOVER = 0.4  # of the full command: the Crazyflies of public flights hover at 0.5 to 0.9 of it


def check_log(log: FlightLog) -> tuple[Finding, ...]:
    """Return all findings about one flight, the worst first.

    Single columns are checked first; if they pass, signs, axes, units and clocks are checked by the motion.
    """
    (log,) = as_logs([log])
    findings = [*values.check(log), *copies.check(log)]
    if not any(finding.decision == "refuse" for finding in findings):
        good = without_bad_data(log, findings)
        moves = motion.motion(good)
        findings += motion.check(good, moves)
        share = hover_command(good, moves) / FULL_COMMAND
        if share < LEAST_HOVER:
            text = f"hovers at {100 * share:.0f} % of the full command; Crazyflies need 50 to 90 %"
            why = "is the unit right (for example newton instead of a fraction)?"
            findings.append(limit("cmd_thrust_pwm", f"{text}: {why}"))
    return tuple(sorted(findings, key=lambda finding: _ORDER[finding.decision]))


def enforce(log: FlightLog, where: str | None = None) -> FlightLog:
    """Return the flight without bad data and with its limits noted; raise UserError if it is refused."""
    findings = check_log(log)
    refused = [finding for finding in findings if finding.decision == "refuse"]
    if refused:
        raise UserError(f"{where or log.name}: {refused[0].text}")
    limits = [finding.text for finding in findings if finding.decision == "limit"]
    return without_bad_data(log, findings).noted(*limits)


def check_fleet(logs: Sequence[FlightLog]) -> tuple[Finding, ...]:
    """Return findings on whether the flights are of one vehicle, according to the hover commands.

    If every log has the battery voltage, command times voltage is compared if that agrees better.
    """
    if len(logs) < 2:
        return ()
    hover, unit = _hover_commands(logs)
    known = [(level, log.name) for level, log in zip(hover, logs) if np.isfinite(level)]
    if len(known) < 2:
        return ()
    known.sort()
    level = np.array([value for value, _ in known])
    steps = np.diff(level) / level[:-1]
    cut = int(np.argmax(steps)) + 1
    low, high = level[:cut], level[cut:]
    group_spread = max(np.ptp(low) / low[0], np.ptp(high) / high[0])
    names = [_list_names([name for _, name in group]) for group in (known[:cut], known[cut:])]
    groups = (
        f"{names[0]} hover{'s' if len(low) == 1 else ''} at {np.mean(low):.0f} {unit}, "
        f"{names[1]} at {np.mean(high):.0f} {unit}"
    )
    if steps[cut - 1] > HOVER_JUMP and steps[cut - 1] > 2 * group_spread:
        return (refuse("cmd_thrust_pwm", f"flights of different vehicles are mixed: {groups}"),)
    if level[-1] / level[0] - 1 > HOVER_SPREAD:
        spread = 100 * (level[-1] / level[0] - 1)
        text = (
            f"hover thrust differs by {spread:.0f} % between flights ({groups}): are they of one vehicle "
            "with one load?"
        )
        return (limit("cmd_thrust_pwm", text),)
    return ()


def _list_names(names: list[str]) -> str:
    more = f" and {len(names) - 3} more" if len(names) > 4 else ""
    return ", ".join(names[:3] if more else names) + more


def _hover_commands(logs: Sequence[FlightLog]) -> tuple[list[float], str]:
    """Return the hover command of each flight (NaN where it cannot be estimated), and its unit."""
    plain = [hover_command(log) for log in logs]
    if not np.isfinite(plain).all():
        return plain, "PWM"
    # Thrust follows the voltage across the motors, unless the command was compensated for it: the
    # product is taken where it makes the flights more alike.
    supplied = []
    for log in logs:
        if log.voltage is None:
            return plain, "PWM"
        command = log.command.copy()
        command[:, 0] *= log.voltage / NOMINAL_VOLTAGE
        supplied.append(hover_command(dataclasses.replace(log, command=command)))
    if np.nanstd(supplied) / np.nanmean(supplied) < np.nanstd(plain) / np.nanmean(plain):
        return supplied, f"PWM at {NOMINAL_VOLTAGE:g} V"
    return plain, "PWM"


def hover_command(log: FlightLog, moves: motion.LoggedMotion | None = None) -> float:
    """Return the command at a specific force of one g, from a linear fit over the rows in the air.

    moves: the log's `motion`, where it is known.
    The result is NaN if these last less than a second, or if thrust comes from wrong rotor speeds.
    """
    moves = motion.motion(log) if moves is None else moves
    if not moves.pwm or (log.thrust_is_measured and values.failed_speed_sensors(log)):
        return np.nan
    # Standing on the ground with the motors on looks like hovering at less thrust.
    air = motion.in_air(log, moves)
    pwm, force = np.concatenate(moves.pwm), np.concatenate(moves.force)
    if air.sum() < motion.RATE:
        return np.nan
    # pwm = slope (f - g) + level: the constant term is the command at f = g.
    _, level = np.polyfit(force[air] - motion.GRAVITY, pwm[air], 1)
    return float(level)


def without_bad_data(log: FlightLog, findings: Sequence[Finding]) -> FlightLog:
    """Return the flight without the rows and optional channels that findings exclude."""
    left_out: dict[str, Any] = {finding.without: None for finding in findings if finding.without}
    log = dataclasses.replace(log, **left_out)
    rows = sorted({row for finding in findings for row in finding.rows})
    return log.rows(np.delete(np.arange(len(log)), rows)) if rows else log
