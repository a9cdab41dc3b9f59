"""Evidence that is given several times: copies and cut-outs of one flight, recognised by the measured poses.

Two flights never agree in a measured pose to the last digit while they move: what does is the same row.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

import numpy as np
import pandas

from inclined_landing.eval.gap.result import SetAside
from inclined_landing.eval.logs import FlightLog
from inclined_landing.eval.logs.repeats import percent
from inclined_landing.eval.logs.values import SHORTEST
from inclined_landing.models.base.errors import UserError

DIGIT = 1e-4  # m or rad, to which poses are compared: a file may have been written anew with fewer digits
SAMPLED = 16  # of so many rows, one is kept to recognise a flight by
SAME = 0.5  # share of its poses that a flight has in common with itself, cut out and written anew


DIFFERENT = "fitting and evaluation need different flights"


def poses(log: FlightLog) -> np.ndarray:
    """Return a number (m,) for the pose of every row, the same for the same pose."""
    turned = np.arctan2(np.sin(log.attitude), np.cos(log.attitude))
    cells = np.round(np.nan_to_num(np.hstack([log.position, turned])) / DIGIT).astype(np.int64)
    return pandas.util.hash_pandas_object(pandas.DataFrame(cells), index=False).to_numpy() >> np.uint64(11)


def fingerprint(log: FlightLog) -> tuple[int, ...]:
    """Return some of the numbers of a flight's poses, by which it and parts of it are recognised."""
    found = np.unique(poses(log))
    return tuple(map(int, found[found % SAMPLED == 0]))


def check_unused(logs: Iterable[FlightLog], used: Mapping[str, Sequence[int]], where: str) -> None:
    """Raise UserError for a flight among `logs` of which `used` has the fingerprint, by name."""
    for log in logs:
        own = np.array(fingerprint(log), np.int64)
        for name, known in used.items():
            if np.isin(own, known).sum() > max(SAME * min(len(own), len(known)), 1):
                raise UserError(f"{log.name} holds the same flight as {name} {where}; {DIFFERENT}")


def distinct(
    flights: Sequence[FlightLog], heldout: Sequence[FlightLog]
) -> tuple[list[FlightLog], list[FlightLog], tuple[SetAside, ...], tuple[str, ...]]:
    """Return flights without what an earlier one contains, held-out ones too; those left out, and notes.

    Raises UserError for a held-out flight that is fitted.
    """
    aside, notes = list[SetAside](), list[str]()
    seen: list[tuple[str, np.ndarray, bool]] = []
    kept: tuple[list[FlightLog], list[FlightLog]] = [], []
    for log, held_out in [*((log, False) for log in flights), *((log, True) for log in heldout)]:
        every = poses(log)
        rest: FlightLog | None = log
        for name, known, is_held_out in seen:
            again = np.isin(every, known)
            common = len(np.unique(every[again]))
            if common <= min(SAME * len(np.unique(every)), SHORTEST * log.rate):
                continue
            new = _lasting(log.t, ~again)
            if held_out and not is_held_out and not new.any():
                raise UserError(f"{log.name} holds the same flight as {name}; {DIFFERENT}")
            if not new.any():
                aside.append(SetAside(log.name, f"it is the same flight as {name}."))
                rest = None
                break
            notes.append(
                f"{log.name}: {percent((~new).mean())} of its rows are those of {name}: they count once"
            )
            rest, every = log.rows(new), every[new]
            log = rest
        if rest is not None:
            seen.append((rest.name, every, held_out))
            kept[held_out].append(rest)
    return *kept, tuple(aside), tuple(notes)


def _lasting(t: np.ndarray, rows: np.ndarray) -> np.ndarray:
    """Return the stretches of `rows` (m,) bool that last long enough to be used."""
    result = np.zeros(len(rows), bool)
    for a, b in np.flatnonzero(np.diff(np.r_[False, rows, False])).reshape(-1, 2):
        result[a:b] = t[b - 1] - t[a] >= SHORTEST
    return result
