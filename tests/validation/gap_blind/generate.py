"""Flights and landings with a hidden cause, as recordings, logs or tables of the documented CSV.

    recordings, drawn = landings("friction", "strong", seed=3)  # sixteen touchdowns, four on the floor
    flight_logs = logs(recordings, contact=True)  # FlightLog objects, as read from CSV

Names and sizes are in `causes.py`; whole cases in `cases.py`. The same arguments give the same flights.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from inclined_landing.models.base import storage
from tests.validation.simulator import (
    KINDS,
    Reality,
    Recording,
    World,
    fly,
    landing,
    ordinary,
    reference,
)

from . import causes

SECONDS = 20.0
LANDINGS = 16
_LOWEST = 0.022  # m, the lowest height of the centre in a flight that does not land: the feet end at 0.018
_TRIES = 30
_BEFORE, _AFTER = 1.0, 0.7  # s of log before the first touch and after it
_REST_SPEED, _REST_RATE = 0.02, 0.2  # m/s, rad/s

HEADER = (
    *("t", "x", "y", "z", "roll", "pitch", "yaw"),
    *("cmd_thrust_pwm", "cmd_roll", "cmd_pitch", "cmd_yaw_rate"),
)


def landings(
    cause: str | Sequence[str] | None,
    size: str | None,
    seed: int | Sequence[int],
    *,
    count: int = LANDINGS,
) -> tuple[list[Recording], causes.Drawn]:
    """Land `count` times with the named cause or causes (None: nothing hidden): every fourth on the floor,
    the others on the inclined platform."""
    rng = np.random.default_rng(seed)
    drawn = _draw(cause, size, rng)
    return land_all(drawn, rng, count=count), drawn


def _draw(cause, size, rng) -> causes.Drawn:
    if isinstance(cause, str):
        return causes.draw(cause, size, rng)
    names = cause or ()
    return causes.combined(*(causes.draw(name, size, rng) for name in names), names=names)


def fly_all(
    drawn: causes.Drawn,
    rng: np.random.Generator,
    reality: Reality | None = None,
    *,
    count: int = 10,
    seconds: float = SECONDS,
) -> list[Recording]:
    """Fly `count` ordinary flights in the world of `drawn`, kinds in a random order.

    reality: whose vehicle, air and log (None: the reference).

    A flight that would touch the floor is flown again on another path.
    """
    recordings = []
    kinds: list[str] = []
    while len(recordings) < count:
        if not kinds:
            kinds = [KINDS[k] for k in rng.permutation(len(KINDS))]
        kind = kinds.pop()
        fields = drawn.world | {field: rng.uniform(*ends) for field, ends in drawn.spread.items()}
        world = World(**fields)
        lowest = world.load_length + 0.3 if world.load_mass > 0 else 0.0
        for _ in range(_TRIES):
            recording = fly(ordinary(kind, rng, seconds, lowest), world, rng, reality)
            if recording.truth[:, 2].min() > _LOWEST:
                break
        else:
            raise RuntimeError(f"no {kind} flight stayed above the floor")
        recordings.append(recording)
    return recordings


def land_all(
    drawn: causes.Drawn, rng: np.random.Generator, *, count: int = LANDINGS, fly: Callable = fly
) -> list[Recording]:
    """Land `count` times in the world of `drawn`; only landings that come to rest on the feet are kept.

    fly: of the simulator, or `bullet_reality.fly`.

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
    """Does the vehicle come to rest on the surface, on its feet, within the log?"""
    first = int(np.argmax(recording.contact))
    last = first + round(100 * _AFTER)
    if not recording.contact[first] or first < 100 * _BEFORE or last > len(recording.t):
        return False
    truth = recording.truth[:last]
    still = np.linalg.norm(truth[-1, 3:6]) < _REST_SPEED and np.linalg.norm(truth[-1, 9:12]) < _REST_RATE
    level = np.abs(truth[-1, 6:8] - [0.0, world.surface_tilt]).max() < 0.1
    upright = np.abs(truth[first:, 6:8] - [0.0, world.surface_tilt]).max() < 0.6
    return bool(still and level and upright and recording.contact[last - 1])


def table(recording: Recording, *, voltage: bool = False, contact: bool = False):
    """The documented columns of one flight as a DataFrame."""
    import pandas

    columns = np.column_stack([recording.t, recording.position, recording.attitude, recording.command])
    frame = pandas.DataFrame(columns, columns=list(HEADER))
    if voltage:
        frame["vbat"] = recording.voltage
    if contact:
        frame["contact"] = recording.contact.astype(int)
    return frame


def write_csv(recording: Recording, path: Path, *, voltage: bool = False, contact: bool = False) -> None:
    """Write the documented CSV: SI units, angles of Rz Rx Ry, micrometres and microradians."""

    text = table(recording, voltage=voltage, contact=contact).to_csv(index=False, float_format="%.6f")
    storage.write_text(path, text)


def logs(recordings: Sequence[Recording], *, voltage: bool = False, contact: bool = False):
    """The flights as FlightLog objects, as if written and read again."""
    from inclined_landing.eval.logs.log import FlightLog

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
