"""After a training run: what the final policy does, as tables, figures and a video."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from inclined_landing.envs.policy import Policy, load_policy
from inclined_landing.eval.base.options import Flown
from inclined_landing.eval.pictures import figure, picture, video
from inclined_landing.eval.pictures.figures import curriculum_figure, learning_curves, save_figure
from inclined_landing.eval.policies import success, success_table, touchdown
from inclined_landing.eval.policies.judges import judge_of
from inclined_landing.models import storage
from inclined_landing.models.parameters import load_vehicle
from inclined_landing.train.curriculum import make_curriculum
from inclined_landing.train.run import VEHICLE


def report(folder: Path, metrics: dict) -> None:
    """Write the table of `final.zip`, figures and a video into the run folder.

    The table is flown in the plain MuJoCo plant, for landings from the frozen grid, which training never
    saw; its one number of each condition is added to metrics.json. Everything flies the run's vehicle.
    """
    config = metrics["config"]
    vehicle = folder / VEHICLE if config.get("vehicle") is not None else None

    def load(policy: str | Path) -> Policy:
        return load_policy(policy, vehicle=None if vehicle is None else load_vehicle(vehicle))

    final = folder / "final.zip"
    task = load(final).task
    show = _TABLES.get(task.table, _success)(folder, metrics, load)
    save_figure(learning_curves([folder]), folder / "learning_curves.png")
    stages = make_curriculum(config["curriculum"], task.name, config["gamma"]).stages()
    if stages:
        save_figure(curriculum_figure(stages, task=task), folder / "curriculum.png")
    flown = Flown(vehicle=vehicle)
    figure.command(str(final), folder, flown=flown)
    starts = [",".join(f"{number:g}" for number in start) for start in task.film_starts]
    video.command(str(final), folder / f"{task.name}.mp4", tuple(starts), gif=True, flown=flown)
    picture.command(str(final), folder / "picture.png", flown=flown)
    storage.write_json(folder / "metrics.json", metrics)  # last: it says that the report is whole
    show()
    print(f"everything about this run is in {folder}")


def _success(folder: Path, metrics: dict, load: Callable[[str | Path], Policy]) -> Callable[[], None]:
    """success.json of `final.zip`; what is returned prints it."""
    final = load(folder / "final.zip")
    judge = judge_of(final.task)
    table = success.evaluate(final, thrust_scales=judge.report_scales)
    storage.write_json(folder / "success.json", table)
    metrics["success"] = {"final": [judge.headline(c) for c in table["conditions"]]}
    if (folder / "best.zip").exists():
        best = success.evaluate(load(folder / "best.zip"))
        metrics["success"]["best"] = [judge.headline(c) for c in best["conditions"]]
    return lambda: success_table.show(table)


def _touchdown(folder: Path, metrics: dict, load: Callable[[str | Path], Policy]) -> Callable[[], None]:
    """touchdown.json of `final.zip` against the policy that training went on from."""
    final, origin = load(folder / "final.zip"), load(metrics["config"]["start_from"])
    if origin.task.name == final.task.name:  # the comparison is with a motor cut, whatever came in between
        origin = load(final.task.training.start_from)
    table = touchdown.evaluate(final, origin)
    storage.write_json(folder / "touchdown.json", table)
    metrics["success"] = {"final": touchdown.overall(table, "touchdown")}
    return lambda: touchdown.show(table)


_TABLES = {"touchdown": _touchdown}  # by the `table` of a task, where it is not one of success
