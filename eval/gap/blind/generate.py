"""Flights with a hidden cause, as documented CSV logs.

Ten flights for one cause, in memory, for development::

    from inclined_landing.eval.gap.blind.generate import flights, logs
    recordings, drawn = flights("wind", "medium", seed=3)     # drawn.parameters: the truth
    flight_logs = logs(recordings, voltage=drawn.voltage)     # FlightLog objects, as read from CSV
    recordings, drawn = flights(None, None, seed=3)           # nothing hidden

    flights(["wind", "thrust_scale"], "medium", seed=3)       # two causes
    flights("wind", "weak", seed=3, count=3, noise=3.0)       # three flights, three times the noise

Names and sizes are in `causes.py`. The same arguments give the same flights.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from inclined_landing.eval.gap.simulator import KINDS, Recording, World, fly, ordinary

from . import causes

SECONDS = 20.0
_LOWEST = 0.022  # m, the lowest height of the centre in a flight that does not land: the feet end at 0.018
_TRIES = 20

HEADER = (
    "t",
    "x",
    "y",
    "z",
    "roll",
    "pitch",
    "yaw",
    "cmd_thrust_pwm",
    "cmd_roll",
    "cmd_pitch",
    "cmd_yaw_rate",
)


def flights(
    cause: str | Sequence[str] | None,
    size: str | None,
    seed: int | Sequence[int],
    *,
    count: int = 10,
    noise: float = 1.0,
    seconds: float = SECONDS,
) -> tuple[list[Recording], causes.Drawn]:
    """Fly `count` ordinary flights with the named cause or causes (None: nothing hidden).

    Returns the recordings and the cause's numbers; with several causes the parameters are keyed
    `cause.parameter`.
    """
    rng = np.random.default_rng(seed)
    names = [] if cause is None else [cause] if isinstance(cause, str) else list(cause)
    drawn = [causes.draw(name, size, rng) for name in names]
    if len(drawn) == 1:
        both = drawn[0]
    else:
        both = causes.Drawn(
            world={k: v for one in drawn for k, v in one.world.items()},
            parameters={f"{n}.{k}": v for n, one in zip(names, drawn) for k, v in one.parameters.items()},
            voltage=any(one.voltage for one in drawn),
            spread={k: v for one in drawn for k, v in one.spread.items()},
        )
    return fly_all(both, rng, count=count, noise=noise, seconds=seconds), both


def fly_all(
    drawn: causes.Drawn,
    rng: np.random.Generator,
    *,
    count: int = 10,
    noise: float = 1.0,
    seconds: float = SECONDS,
) -> list[Recording]:
    """Fly `count` ordinary flights in the world of `drawn`, kinds in a random order.

    A flight that would touch the floor is flown again on another path.
    """
    kinds = [KINDS[k % len(KINDS)] for k in range(max(count, len(KINDS)))]
    kinds = [kinds[k] for k in rng.permutation(len(kinds))][:count]
    recordings = []
    for kind in kinds:
        fields = dict(drawn.world)
        for field, (low, high) in drawn.spread.items():
            fields[field] = rng.uniform(low, high)
        world = World(**fields)
        lowest = world.load_length + 0.3 if world.load_mass > 0 else 0.0
        for _ in range(_TRIES):
            recording = fly(ordinary(kind, rng, seconds, lowest), world, rng, noise=noise)
            if recording.truth[:, 2].min() > _LOWEST:
                break
        else:
            raise RuntimeError(f"no {kind} flight stayed above the floor")
        recordings.append(recording)
    return recordings


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
    """Write the documented CSV (SI units, angles of Rz Rx Ry) with micrometres and microradians."""
    from inclined_landing.eval import runs

    text = table(recording, voltage=voltage, contact=contact).to_csv(index=False, float_format="%.6f")
    runs.write_text(path, text)


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
