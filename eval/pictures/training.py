"""Curves and figures of a training run."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from inclined_landing.envs.policy import Policy
from inclined_landing.envs.tasks import InclinedLanding
from inclined_landing.envs.tasks.landing import LandingConditions
from inclined_landing.eval.base.style import save_figure
from inclined_landing.eval.pictures import figure
from inclined_landing.eval.pictures.figures.curriculum import curriculum_figure
from inclined_landing.eval.pictures.flights import fly_from
from inclined_landing.eval.pictures.learning import learning_curves
from inclined_landing.eval.pictures.starts import usual_starts


def draw(folder: Path, policy: Policy, stages: Sequence[tuple[str, LandingConditions]]) -> list[Path]:
    """Write curves and figures, and return their files."""
    task = policy.task
    files = [save_figure(learning_curves([folder]), folder / "learning_curves.png")]
    if stages and isinstance(task, InclinedLanding):
        files.append(save_figure(curriculum_figure(stages, task=task), folder / "curriculum.png"))
    flights = fly_from(policy, usual_starts(task)[: figure.FIGURES], "mujoco", task.judged_steps)
    for name, flight in figure.names(flights).items():
        files += figure.draw(flight, folder, name, (".png",))  # a PDF embeds its fonts, which takes longer
    return files
