"""`landing-eval figure`: figures of a policy's flights."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from inclined_landing.eval.base.options import Flat, Flown, Folder, PolicyFile, Starts
from inclined_landing.models.base import storage

if TYPE_CHECKING:
    from inclined_landing.envs.flights import Flight

FIGURES = 2  # of a policy, where no start is named


def command(policy: PolicyFile, /, *, out: Folder, start: Starts = (), flown: Flat[Flown] = Flown()) -> None:
    """Draw a stroboscopic trajectory with PWM and pitch over time, as PNG and PDF.

    Args:
        policy: policy file, or name of a shipped policy.
        out: folder for the files.
        start: start of a flight in metres, X,Z or (setpoint) X,Y,Z; repeatable (default: the first two of the
            task's usual starts; for landing the paper's, 1.5,1.8 and 0,2).
    """
    from inclined_landing.eval.pictures.flights import fly_from, say_outcomes
    from inclined_landing.eval.pictures.starts import parse_starts, usual_starts

    storage.check_folder(out)
    loaded = flown.load(policy)
    task = loaded.task
    points = parse_starts(start, task) or usual_starts(task)[:FIGURES]
    named = names(fly_from(loaded, points, flown.plant, task.judged_steps))
    for name, flight in named.items():
        draw(flight, out, name, (".png", ".pdf"))
    files = f"{name}.png and {name}.pdf" if len(named) == 1 else f"{', '.join(named)}, each as .png and .pdf"
    say_outcomes(named, f"{out} has {files}")


def names(flights: Sequence[Flight]) -> dict[str, Flight]:
    """Return flights by the names of their files."""
    if len(flights) == 1:
        return {"trajectory": flights[0]}
    return {f"trajectory_{k + 1}": flight for k, flight in enumerate(flights)}


def draw(flight: Flight, out: Path, name: str, suffixes: Sequence[str]) -> list[Path]:
    """Write the figure of one flight into the folder `out`, once for each suffix; return its files."""
    from inclined_landing.eval.base.style import save_figure
    from inclined_landing.eval.pictures.figures.trajectory import trajectory_figure

    drawn = trajectory_figure(flight)
    return [save_figure(drawn, out / f"{name}{suffix}") for suffix in suffixes]
