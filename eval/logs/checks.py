"""Can this flight be believed? Findings in words, each with a decision."""

from __future__ import annotations

import dataclasses

from inclined_landing.eval.logs.log import FlightLog
from inclined_landing.models.errors import UserError


@dataclasses.dataclass(frozen=True)
class Finding:
    """One sentence about one channel, and what follows: refuse, limit (used all the same), info."""

    decision: str
    channel: str
    text: str


def check_log(log: FlightLog) -> tuple[Finding, ...]:
    """Everything there is to say about one flight, the worst first."""
    return ()


def enforce(log: FlightLog, where: str | None = None) -> FlightLog:
    """The flight with its limits noted; raises UserError when it is refused."""
    findings = check_log(log)
    refused = [finding for finding in findings if finding.decision == "refuse"]
    if refused:
        raise UserError(f"{where or log.name}: {refused[0].text}")
    return log.noted(*(finding.text for finding in findings if finding.decision == "limit"))
