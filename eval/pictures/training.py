"""Curves, figures, a video and a picture of a training run."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from inclined_landing.envs.policy import Policy
from inclined_landing.envs.tasks import InclinedLanding
from inclined_landing.envs.tasks.landing import LandingConditions
from inclined_landing.eval.base.options import FITTED, Look
from inclined_landing.eval.base.style import save_figure
from inclined_landing.eval.pictures import figure, film
from inclined_landing.eval.pictures.figures.curriculum import curriculum_figure
from inclined_landing.eval.pictures.flights import fly_from
from inclined_landing.eval.pictures.frames import renderer_for, strobe, write_picture, write_videos
from inclined_landing.eval.pictures.learning import learning_curves
from inclined_landing.eval.pictures.starts import usual_starts
from inclined_landing.eval.pictures.to_rest import to_rest

_LOOK = Look(camera=FITTED, width=960, height=540)  # of video and picture
_FPS = 25.0  # half as many as `landing-eval video` shows


def draw(folder: Path, policy: Policy, stages: Sequence[tuple[str, LandingConditions]]) -> list[Path]:
    """Write curves, figures, a video and a picture, and return their files."""
    task = policy.task
    files = [save_figure(learning_curves([folder]), folder / "learning_curves.png")]
    if stages and isinstance(task, InclinedLanding):
        files.append(save_figure(curriculum_figure(stages, task=task), folder / "curriculum.png"))
    points = usual_starts(task)
    flights = fly_from(policy, points[: figure.FIGURES], "mujoco", task.judged_steps)
    for name, flight in figure.names(flights).items():
        files += figure.draw(flight, folder, name, (".png",))  # a PDF embeds its fonts, which takes longer
    filmed = to_rest(fly_from(policy, points[:1], "mujoco")[0])
    with renderer_for([filmed], _LOOK) as renderer:
        frames, _, rate = film.film([filmed], renderer, _FPS, 1.0)
        files.append(folder / f"{task.name}.mp4")
        write_videos({files[-1]: 1}, frames, fps=rate)
        files.append(write_picture(folder / "picture.png", strobe(filmed, renderer)))
    return files
