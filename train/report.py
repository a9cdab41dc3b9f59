"""After a training run: what the final policy does, as tables, figures and a video."""

from __future__ import annotations

from pathlib import Path

from rich.console import Console

from inclined_landing.envs.policy import load_policy
from inclined_landing.envs.tasks.landing import Conditions
from inclined_landing.eval.pictures import commands as pictures
from inclined_landing.eval.pictures.figures import curriculum_figure, learning_curves, save_figure
from inclined_landing.eval.policies import success, success_table, touchdown
from inclined_landing.models import storage
from inclined_landing.train.curriculum import AdaptiveCurriculum, PaperCurriculum

THRUST_SCALES = (1.0, 1.05, 0.95)
_FILM_STARTS = ("1.5,1.8", "0,2", "-1.5,1.6")


def report(folder: Path, metrics: dict) -> None:
    """Write success.json, figures and the landing video of `final.zip` into the run folder.

    The success table is flown in the plain MuJoCo plant from the frozen grid, which training never
    saw; the one number of each condition is added to metrics.json.
    """
    if metrics["config"]["task"] == "touchdown":
        return _touchdown(folder, metrics)
    landing = metrics["config"]["task"] == "landing"
    final = folder / "final.zip"
    table = success.evaluate(load_policy(final), thrust_scales=THRUST_SCALES if landing else (1.0,))
    storage.write_json(folder / "success.json", table)
    metrics["success"] = {"final": _headline(table, landing)}
    if (folder / "best.zip").exists():
        best = success.evaluate(load_policy(folder / "best.zip"))
        metrics["success"]["best"] = _headline(best, landing)
    storage.write_json(folder / "metrics.json", metrics)
    save_figure(learning_curves([folder]), folder / "learning_curves.png")
    if landing:
        save_figure(curriculum_figure(stages(metrics["config"]["curriculum"])), folder / "curriculum.png")
    pictures.figure(str(final), folder)
    starts = _FILM_STARTS if landing else ()
    pictures.video(str(final), folder / f"{metrics['config']['task']}.mp4", starts, gif=True)
    pictures.picture(str(final), folder / "picture.png")
    success_table.show(table)
    Console().print(f"everything about this run is in {folder}")


def _touchdown(folder: Path, metrics: dict) -> None:
    """touchdown.json, learning curves, video and picture of `final.zip`."""
    final = folder / "final.zip"
    table = touchdown.evaluate(load_policy(final), load_policy(metrics["config"]["start_from"]))
    storage.write_json(folder / "touchdown.json", table)
    metrics["success"] = {"final": touchdown.overall(table, "touchdown")}
    storage.write_json(folder / "metrics.json", metrics)
    save_figure(learning_curves([folder]), folder / "learning_curves.png")
    pictures.video(str(final), folder / "touchdown.mp4", _FILM_STARTS, gif=True)
    pictures.picture(str(final), folder / "picture.png")
    touchdown.show(table)
    Console().print(f"everything about this run is in {folder}")


def stages(name: str) -> list[tuple[str, Conditions]]:
    """Titles and conditions of four moments of a curriculum, for the figure."""
    if name == "adaptive":
        curriculum, moments = AdaptiveCurriculum(), []
        for level in (0.0, 0.25, 0.6, 1.0):
            curriculum.level = level
            moments.append((f"level {level:g}", curriculum.conditions()))
        return moments
    if name == "paper":
        curriculum, moments = PaperCurriculum(), []
        for episodes, tilting, steps in ((0, 0, 0), (5000, 0, 390_000), (9000, 3000, 700_000)):
            curriculum.episodes, curriculum.tilting_episodes, curriculum.steps = episodes, tilting, steps
            moments.append((f"{steps // 1000} k steps", curriculum.conditions()))
        curriculum.episodes, curriculum.tilting_episodes, curriculum.steps = 19_000, 6000, 3_000_000
        return [*moments, ("3 M steps", curriculum.conditions())]
    return [("the task", Conditions())]


def _headline(table: dict, landing: bool) -> list[dict]:
    if not landing:
        return [{"mean_error": c["error"], "within": c["within"]} for c in table["conditions"]]
    return [
        {
            "thrust_scale": c["thrust_scale"],
            "strict": c["grid"]["strict"],
            "success": c["grid"]["success"],
            "entry": c["entry"],
        }
        for c in table["conditions"]
    ]
