"""Flights and landings with a hidden cause, as recordings, logs or CSV files.

Names and sizes are in `causes.py`; whole cases in `cases.py`. The same arguments give the same flights.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from inclined_landing.eval.logs.log import FlightLog
from inclined_landing.eval.logs.read import log_table
from inclined_landing.models.base import storage
from tests.validation.simulator import KINDS, Reality, Recording, World, fly, landing, ordinary, reference

from .causes import Drawn

SECONDS = 20.0
LANDINGS = 16
_LOWEST = 0.022  # m, the lowest height of the centre in a flight that does not land: the feet end at 0.018
_TRIES = 30
_BEFORE, _AFTER = 1.0, 0.7  # s of log before the first touch and after it
_REST_SPEED, _REST_RATE = 0.02, 0.2  # m/s, rad/s


def fly_all(
    drawn: Drawn,
    rng: np.random.Generator,
    reality: Reality | None = None,
    *,
    count: int = 10,
    seconds: float = SECONDS,
) -> list[Recording]:
    """Fly `count` ordinary flights in the world of `drawn`, kinds in a random order.

    A flight that would touch the floor is flown again on another path.

    Args:
        reality: whose vehicle, air and log (None: the reference).
    """
    recordings = []
    kinds: list[str] = []
    while len(recordings) < count:
        if not kinds:
            kinds = [KINDS[k] for k in rng.permutation(len(KINDS))]
        kind = kinds.pop()
        world = drawn.world_of(rng)
        lowest = world.load_length + 0.3 if world.load_mass > 0 else 0.0
        for _ in range(_TRIES):
            recording = fly(ordinary(kind, rng, seconds, lowest), world, rng, reality)
            if recording.truth[:, 2].min() > _LOWEST:
                break
        else:
            raise RuntimeError(f"no {kind} flight stayed above the floor")
        recordings.append(recording)
    return recordings


def land_all(drawn: Drawn, rng: np.random.Generator, *, count: int = LANDINGS) -> list[Recording]:
    """Land `count` times in the world of `drawn`; only landings that come to rest on the feet are kept.

    The pilot goes by the nominal platform. Every fourth landing is on the floor, 2 m beside it, where
    height and tilt of the platform do not matter.
    """
    c = reference().constants
    recordings = []
    while len(recordings) < count:
        floor = len(recordings) % 4 == 3
        surface, tilt = (0.0, 0.0) if floor else (c.platform_height, c.platform_tilt)
        fields = {"contact": 1.0, "surface_height": surface, "surface_tilt": tilt}
        for field, value in drawn.world.items():
            if field not in fields:
                fields[field] = value
            elif not floor:
                fields[field] += value
        world = World(**fields)
        for _ in range(_TRIES):
            recording = fly(landing(rng, surface, tilt, c.foot_height), world, rng)
            if _landed(recording, world):
                break
        else:
            raise RuntimeError("no landing came to rest")
        if floor:
            recording.position[:, 0] += 2.0
            recording.truth[:, 0] += 2.0
        first = int(np.argmax(recording.contact)) / 100
        recordings.append(recording.between(first - _BEFORE, first + _AFTER))
    return recordings


def _landed(recording: Recording, world: World) -> bool:
    """Return whether the vehicle comes to rest on the surface, on its feet, within the log."""
    first = int(np.argmax(recording.contact))
    last = first + round(100 * _AFTER)
    if not recording.contact[first] or first < 100 * _BEFORE or last > len(recording.t):
        return False
    truth = recording.truth[:last]
    still = np.linalg.norm(truth[-1, 3:6]) < _REST_SPEED and np.linalg.norm(truth[-1, 9:12]) < _REST_RATE
    level = np.abs(truth[-1, 6:8] - [0.0, world.surface_tilt]).max() < 0.1
    upright = np.abs(truth[first:, 6:8] - [0.0, world.surface_tilt]).max() < 0.6
    return bool(still and level and upright and recording.contact[last - 1])


def logs(recordings: Sequence[Recording], *, voltage: bool = False, contact: bool = False) -> list[FlightLog]:
    """Return the flights as if written and read again."""
    return [
        FlightLog(
            name=f"flight_{k:02d}",
            t=one.t,
            position=one.position,
            attitude=one.attitude,
            command=one.command,
            voltage=one.voltage if voltage else None,
            contact=one.contact if contact else None,
        )
        for k, one in enumerate(recordings)
    ]


def write_csv(log: FlightLog, path: Path) -> None:
    """Write the documented CSV: SI units, micrometres and microradians."""
    storage.write_text(path, log_table(log).to_csv(index=False, float_format="%.6f"))
