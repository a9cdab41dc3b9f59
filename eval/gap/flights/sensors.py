"""Flights whose thrust is that of measured rotor speeds of which one is wrong."""

from __future__ import annotations

import math
from collections.abc import Sequence

from inclined_landing.eval.gap.result import InconsistentFlights
from inclined_landing.eval.logs import FlightLog
from inclined_landing.eval.logs.values import failed_speed_sensors
from inclined_landing.models.errors import UserError, first_of


def without_failed_sensors(
    flights: Sequence[FlightLog],
) -> tuple[list[FlightLog], tuple[InconsistentFlights, ...]]:
    """Return the flights whose thrust can be believed, and the others, one by one.

    Raises UserError where the thrust of all is that of rotor speeds of which one is wrong.
    """
    why = [" ".join(failed_speed_sensors(log).values()) if log.thrust_is_measured else "" for log in flights]
    good = [log for log, text in zip(flights, why) if not text]
    failed = [(log.name, text) for log, text in zip(flights, why) if text]
    if failed and not good:
        raise UserError(first_of([f"{name}: {text}" for name, text in failed]))
    names = tuple(log.name for log in good)
    return good, tuple(
        InconsistentFlights((name,), names, (), math.nan, math.nan, text) for name, text in failed
    )
