"""The report on a training run, with tables, figures and a video; `landing-train` looks it up by name."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

from inclined_landing.envs.ids import SHIPPED
from inclined_landing.envs.policy import Policy, load_policy
from inclined_landing.envs.rendering import make_renderer
from inclined_landing.envs.shared.tables import say
from inclined_landing.envs.tasks import InclinedLanding, Task
from inclined_landing.envs.tasks.landing import LandingConditions
from inclined_landing.eval.base.starts import usual_starts
from inclined_landing.eval.base.style import save_figure
from inclined_landing.eval.pictures import figure, film
from inclined_landing.eval.pictures.figures.curriculum import curriculum_figure
from inclined_landing.eval.pictures.flights import fly_from
from inclined_landing.eval.pictures.frames import flight_view, strobe, write_picture, write_videos
from inclined_landing.eval.pictures.learning import learning_curves
from inclined_landing.eval.pictures.to_rest import to_rest
from inclined_landing.eval.study import groups, motor_cut, moving
from inclined_landing.eval.study.engine import Study, run
from inclined_landing.eval.study.options import NOMINAL
from inclined_landing.eval.study.scenarios import scenarios
from inclined_landing.eval.study.show import document, show
from inclined_landing.models.base import storage
from inclined_landing.models.parameters import load_vehicle

Stages = Sequence[tuple[str, LandingConditions]]  # titles and conditions
_LOOK: dict[str, Any] = {"width": 960, "height": 540}  # of video and picture
_LANDING_SCALES = (1.0, 1.05, 0.95)  # of the thrust, in the table of a landing policy
_FILM_FPS = 25.0  # half as many as `landing-eval video` shows


def report(folder: Path, metrics: dict, vehicle: Path | None, stages: Stages) -> None:
    """Write the table of `final.zip`, figures, a picture and a video of one flight into the run folder.

    vehicle: the run's vehicle file, if it has one. stages: the stages of its curriculum.

    The flights of the table have no training aids; those of landings start from the frozen grid, which
    training never uses, in the hybrid plant. One number for each condition is added to metrics.json. All
    flights use the run's vehicle.
    """

    def load(policy: str | Path) -> Policy:
        return load_policy(policy, vehicle=None if vehicle is None else load_vehicle(vehicle))

    final = load(folder / "final.zip")
    with ThreadPoolExecutor(1) as pool:  # of the table, whose time is the engine's
        pictures = pool.submit(_draw, folder, final, stages)
        results = run([_study(final, metrics, load)])
        for path in pictures.result():
            print(path)
    command = final.task.evaluated_by.split()[-1]
    storage.write_json(folder / f"{command}.json", document(command, results))
    metrics["success"] = {"final": results[0].all(results[0].study.views[0].measures[0])}
    storage.write_json(folder / "metrics.json", metrics)  # last: it says that the report is whole
    show(results)
    say(f"The report of this run is in {folder}.")


def _draw(folder: Path, policy: Policy, stages: Stages) -> list[Path]:
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
    view = flight_view([filmed], **_LOOK)
    with make_renderer(**_LOOK, camera=view, vehicle=task.vehicle) as renderer:
        frames, _, rate = film.film([filmed], _FILM_FPS, 1.0, renderer=renderer)
        files.append(folder / f"{task.name}.mp4")
        write_videos({files[-1]: 1}, frames, fps=rate)
        files.append(write_picture(folder / "picture.png", strobe(filmed, renderer=renderer)))
    return files


def _study(final: Policy, metrics: dict, load: Callable[[str | Path], Policy]) -> Study:
    """Return the study of a trained policy: a touchdown next to the policy that training started from."""
    task = final.task
    if task.evaluated_by == "success":
        scales = _LANDING_SCALES if task.cut_at_success else (1.0,)
        return groups.study({"final": final}, plant="hybrid", thrust_scales=scales)
    if task.evaluated_by == "touchdown":
        return motor_cut.study(final, _origin(task, metrics["config"]["start_from"], load))
    return moving.study(scenarios(), {final.name: moving.pilot_of(final)})


def _origin(task: Task, began: str, load: Callable[[str | Path], Policy]) -> Policy:
    """Return the landing policy from which a training started, or the paper's if there was none."""
    landed = began in SHIPPED or Path(began).exists()
    origin = load(began) if landed else None
    return load(NOMINAL) if origin is None or origin.task.name == task.name else origin
