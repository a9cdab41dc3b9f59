"""The report on a training run, with tables, figures and a video; `landing-train` looks it up by name."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from inclined_landing.envs.ids import DESCENT, SHIPPED
from inclined_landing.envs.policy import Policy, load_policy
from inclined_landing.envs.shared import progress, runs
from inclined_landing.envs.shared.pool import in_fork
from inclined_landing.envs.shared.tables import say
from inclined_landing.envs.tasks import Task
from inclined_landing.eval.base.options import FITTED, Look
from inclined_landing.eval.pictures.flights import fly_from
from inclined_landing.eval.pictures.frames import film, renderer_for, strobe, write_picture, write_videos
from inclined_landing.eval.pictures.starts import usual_starts
from inclined_landing.eval.pictures.to_rest import to_rest
from inclined_landing.eval.study import groups, motor_cut, moving
from inclined_landing.eval.study.engine import Study, run
from inclined_landing.eval.study.options import NOMINAL
from inclined_landing.eval.study.scenarios import scenarios
from inclined_landing.eval.study.show import document, show
from inclined_landing.models.base import storage
from inclined_landing.models.base.errors import UserError

_LOOK = Look(camera=FITTED, width=960, height=540)  # of video and picture
_FPS = 25.0  # half as many as `landing-eval video` shows
_LANDING_SCALES = (1.0, 1.05, 0.95)  # of the thrust, in the table of a landing policy


def report(folder: Path, metrics: dict, vehicle: Path | None) -> None:
    """Write the table of `final.zip`, figures, a picture and a video of one flight into the run folder.

    vehicle: the run's vehicle file, if it has one.

    The flights of the table have no training aids; those of landings start from the frozen grid, which
    training never uses, in the hybrid plant. One number for each condition is added to metrics.json. All
    flights use the run's vehicle.
    """
    final = load_policy(folder / "final.zip", vehicle=vehicle)
    filmed = in_fork(_film, final, folder)  # a process renders, `filmed()` waits for it
    with ThreadPoolExecutor(1) as pool:  # while the engine flies for the table
        figures = pool.submit(_draw, folder, final)
        name, study = _study(final, metrics, vehicle)
        results = run([study])
        with progress.stages() as tick:
            tick("figures, picture and film")
            files = figures.result() + filmed()
    for path in files:
        print(path)
    storage.write_json(folder / f"{name}.json", document(name, results))
    main = study.views[0].measures[0]  # says how often the task is done
    metrics[runs.REPORTED] = {"final": results[0].all(main)}
    storage.write_json(folder / "metrics.json", metrics)  # last: it says that the report is whole
    show(results)
    say(f"The report of this run is in {folder}.")


def _draw(folder: Path, policy: Policy) -> list[Path]:
    """Write learning curves and figures of flights from the first usual starts, and return their files."""
    # Here, so that matplotlib is imported while the first flights are simulated.
    from inclined_landing.eval.base.style import save_figure
    from inclined_landing.eval.pictures import figure
    from inclined_landing.eval.pictures.learning import learning_curves

    task = policy.task
    files = [save_figure(learning_curves([folder]), folder / "learning_curves.png")]
    flights = fly_from(policy, usual_starts(task)[: figure.FIGURES], "mujoco", task.judged_steps)
    for name, flight in figure.names(flights).items():
        files += figure.draw(flight, folder, name, (".png",))  # a PDF embeds its fonts, which takes longer
    return files


def _film(policy: Policy, folder: Path) -> list[Path]:
    """Write video and picture of the flight from the first of the usual starts, and return their files."""
    files = [folder / f"{policy.task.name}.mp4", folder / "picture.png"]
    flight = to_rest(fly_from(policy, usual_starts(policy.task)[:1], "mujoco")[0])
    with renderer_for([flight], _LOOK) as renderer:
        write_videos({files[0]: 1}, film([flight], renderer, _FPS), fps=_FPS)
        write_picture(files[1], strobe(flight, renderer))
    return files


def _study(final: Policy, metrics: dict, vehicle: Path | None) -> tuple[str, Study]:
    """Return name and study of a trained policy; a touchdown is shown next to the policy it started from."""
    task = final.task
    if task.evaluated_by == "success":
        scales = _LANDING_SCALES if task.cut_at_success else (1.0,)
        return "success", groups.study({"final": final}, plant="hybrid", thrust_scales=scales)
    if task.evaluated_by == "touchdown":
        return "touchdown", motor_cut.study(final, _origin(task, metrics["config"]["start_from"], vehicle))
    if task.evaluated_by == "robustness --over moving":
        return "moving", moving.study(scenarios(), {final.name: moving.pilot_of(final)})
    raise UserError(f"task {task.name}: no report is known for evaluated_by = {task.evaluated_by!r}")


def _origin(task: Task, began: str, vehicle: Path | None) -> Policy:
    """Return the landing policy from which a training started, or the paper's if there was none."""
    is_available = began != DESCENT and (began in SHIPPED or Path(began).exists())
    origin = load_policy(began if is_available else NOMINAL, vehicle=vehicle)
    return load_policy(NOMINAL, vehicle=vehicle) if origin.task.name == task.name else origin
