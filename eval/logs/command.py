"""`landing-eval logs`: the contents of a log, and the findings of the checks."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from inclined_landing.eval.base.options import Flag, Flat, LogSource
from inclined_landing.eval.logs.log import Finding, FlightLog, limit, refuse
from inclined_landing.models.base.errors import UserError, first_of, shown


def command(source: Flat[LogSource], *, json: Flag = False) -> None:
    """Report what flight logs contain and whether they are plausible.

    The exit code is 2 if a log is refused.

    Args:
        json: print only JSON on standard output.
    """
    from inclined_landing.envs.shared.tables import say
    from inclined_landing.eval.logs.checks import check_fleet, without_bad_data
    from inclined_landing.models.base import storage

    options = source.options()
    reports = [_check_file(file, options) for file in source.files]
    usable = [(log, found) for log, found in reports if log is not None and not _refused(found)]
    fleet = check_fleet([without_bad_data(log, found) for log, found in usable])
    flights = [_flight_json(file, *report) for file, report in zip(source.files, reports)]
    together = [_finding_json(finding) for finding in fleet]
    if json:
        print(storage.to_json({"flights": flights, "together": together}))
    else:
        for file, flight in zip(source.files, flights):
            say(*_describe(file, flight))
        if together:
            say("together", *map(_finding_line, together))
        say(_answer([findings for _, findings in reports], fleet))
    refused = [
        findings[0].text if log is None else f"{shown(file, 250)}: {findings[0].text}"
        for file, (log, findings) in zip(source.files, reports)
        if _refused(findings)
    ]
    if refused:
        raise UserError(f"{len(refused)} of {len(reports)} logs refused: {first_of(refused)}")
    if fleet and fleet[0].decision == "refuse":
        raise UserError(fleet[0].text)


def _refused(findings: Sequence[Finding]) -> bool:
    """Return whether the first finding, which is the worst, refuses the flight."""
    return bool(findings) and findings[0].decision == "refuse"


def _answer(found: Sequence[Sequence[Finding]], fleet: Sequence[Finding]) -> str:
    """Return a sentence on how many logs can be used, from the findings on each and on all together."""
    decisions = [{finding.decision for finding in findings} for findings in found]
    usable = [seen for seen in decisions if "refuse" not in seen]
    limited = sum("limit" in seen for seen in usable)
    count = f"{len(usable)} of {len(found)} log{'s' * (len(found) != 1)} can be used"
    together = ", but not together" if any(finding.decision == "refuse" for finding in fleet) else ""
    return f"{count}{f', {limited} with limits' if limited else ''}{together}."


def _check_file(file: str, options: Mapping[str, Any]) -> tuple[FlightLog | None, tuple[Finding, ...]]:
    from inclined_landing.eval.logs.checks import check_log
    from inclined_landing.eval.logs.read import read_log

    try:
        log = read_log(file, **options, check=False)
    except UserError as error:
        return None, (refuse("", str(error)),)
    notes = [limit("", note) for note in log.notes]
    findings = [*notes, *check_log(log)]
    return log, tuple(sorted(findings, key=lambda finding: finding.decision != "refuse"))


def _describe(file: str, flight: Mapping) -> Iterator[str]:
    """Yield the lines about a flight."""
    yield shown(file, 250)
    if "rows" in flight:
        rows = f"{flight['rows']} rows, {flight['seconds']:.1f} s, {flight['rate']:.0f} rows per second"
        yield from (f"  {rows}", f"  logged: {', '.join(flight['logged'])}")
    yield from map(_finding_line, flight["findings"])


def _finding_line(finding: Mapping[str, str]) -> str:
    label = {"refuse": "refused", "limit": "limit", "info": "note"}[finding["decision"]]
    return f"  {label}: {finding['text']}"


def _flight_json(file: str, log: FlightLog | None, findings: Sequence[Finding]) -> dict[str, Any]:
    read = {}
    if log is not None:
        logged = [name for name in log.columns() if name not in ("t", *log.missing)]
        read = {"rows": len(log), "seconds": log.duration, "rate": log.rate, "logged": logged}
    return {"file": str(Path(file)), **read, "findings": [_finding_json(finding) for finding in findings]}


def _finding_json(finding: Finding) -> dict[str, str]:
    return {"decision": finding.decision, "column": finding.channel, "text": finding.text}
