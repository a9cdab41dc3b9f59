"""`gap-blind`: draw a set, seal its labels, identify and diagnose every case as a user would,
open the labels, count."""

from __future__ import annotations

import hashlib
import importlib.util
import time
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro
from msgspec import Meta
from rich.console import Console

from inclined_landing.envs.shared import runs
from inclined_landing.eval.base import style
from inclined_landing.eval.base.options import Folder, Seed
from inclined_landing.models import storage
from inclined_landing.models.errors import UserError
from inclined_landing.models.vehicle import Vehicle

from ..shared import check_known, in_processes
from . import score, summary
from .cases import CURVE, ROTORPY, SETS, STRATA, Case, Flown, of_set
from .page import markdown, reliability

if TYPE_CHECKING:
    from inclined_landing.eval.gap.model.reference import VehiclePosterior

METHODS = ("workflow", "tuning", "sparse")
_SET, _LABELS, _RESULTS = "set.json", "sealed/labels.json", "results.json"


def command(
    out: Folder,
    set: Annotated[str, tyro.conf.arg(metavar="{dev,fresh,rotorpy,curve}")] = "dev",
    seed: Seed = 0,
    cases: Annotated[int, Meta(ge=len(STRATA), le=10**6)] | None = None,
    method: Annotated[tuple[str, ...], tyro.conf.arg(metavar="{workflow,tuning,sparse} [...]")] = (
        "workflow",
    ),
    processes: Annotated[int, Meta(ge=1, le=256)] = 2,
) -> None:
    """Hidden causes in flights of independent simulators: what gap names (minutes).

    Args:
        out: folder for results.json, table.md and reliability.png; an interrupted run goes on in it.
        set: development (thresholds are chosen on it) or fresh (scored once), whose vehicles share no
            structure; flights of a simulator by others (needs rotorpy); or the same causes in 3, 10 and 30
            flights and in three levels of noise, in vehicles of all families.
        seed: of the set.
        cases: at most so many, every stratum keeping its share (default: all).
        method: one or more of: the gap workflow, parameter tuning only, sparse regression (needs pysindy).
        processes: cases diagnosed at a time.
    """
    methods = method
    check_known("set", [set], (*SETS, ROTORPY, CURVE))
    check_known("method", methods, METHODS)
    if "sparse" in methods and importlib.util.find_spec("pysindy") is None:
        raise UserError("--method sparse needs pysindy; pip install 'inclined-landing[baselines]'")
    needed = ("rotorpy", "torch", "torchdiffeq", "roma") if set == ROTORPY else ()
    if missing := [name for name in needed if importlib.util.find_spec(name) is None]:
        raise UserError(f"--set rotorpy needs {missing[0]}; pip install 'inclined-landing[baselines]'")
    drawn = of_set(set, seed, cases)
    labels = {case.name: case.label() for case in drawn}
    out = runs.new_run(out, "gap-blind", resumable=_SET)
    with runs.locked(out):
        storage.remove_parts(out)
        _open_set(out, {"set": set, "seed": seed, "cases": len(drawn)}, labels)
        _diagnose_all(drawn, labels, methods, out, processes)
        results = _score(out, labels, methods)
    storage.write_json(out / _RESULTS, results)
    storage.write_text(out / "table.md", markdown(results))
    figure = reliability(results)
    if figure is not None:
        style.save_figure(figure, out / "reliability.png")
    Console().print(markdown(results), markup=False, highlight=False, soft_wrap=True)
    print(f"{len(drawn)} cases were judged; the table is {out / 'table.md'}.")


def _open_set(out: Path, description: dict, labels: dict) -> None:
    """Seal the labels and describe the set, or check that the folder holds this very set."""
    sealed = storage.to_json(labels) + "\n"
    description = description | {"labels sha256": hashlib.sha256(sealed.encode("utf-8")).hexdigest()}
    if (out / _SET).exists():
        found = storage.read_json(out / _SET, "record")
        if not isinstance(found, dict) or {key: found.get(key) for key in description} != description:
            raise UserError(f"{out / _SET} is damaged or that of another blind set; choose another folder")
    else:
        storage.write_json(out / _SET, description | {"versions": runs.versions()})
    for name in (_LABELS, _RESULTS, *(f"reports/{method}/case.json" for method in METHODS)):
        storage.check_file(out / name)
    style.make_folder((out / _LABELS).parent)
    storage.write_text(out / _LABELS, sealed)


def _diagnose_all(drawn, labels: dict, methods, out: Path, processes: int) -> None:
    for method in methods:
        style.make_folder(out / "reports" / method)
    todo = []
    for case in drawn:
        missing = [m for m in methods if not _scored(out, m, case.name, labels[case.name])]
        if missing:
            todo.append((case, missing, out))
    for _ in in_processes(_case, todo, processes, len(drawn) - len(todo)):
        pass


def _report(out: Path, method: str, name: str) -> Path:
    return out / "reports" / method / f"{name}.json"


def _scored(out: Path, method: str, name: str, label: dict) -> dict | None:
    """The row of one case in the results; None where its report is not there, or damaged."""
    try:
        report = storage.read_json(_report(out, method, name), "report")
        row = {"case": name} | score.score_case(label, report)
        summary.by_family([row])
    except (ValueError, KeyError, TypeError, AttributeError, ArithmeticError):
        return None
    return row


def _case(case: Case, methods: Sequence[str], out: Path) -> None:
    """Fly one case, identify its vehicle as a user would, and write the report of every method."""
    flown, began = case.fly(), time.perf_counter()
    vehicle, reference = _identified(case, flown)
    spent = time.perf_counter() - began
    for method in methods:
        began = time.perf_counter()
        try:
            report = diagnosed(method, flown, vehicle, reference)
        except UserError as error:
            report = {"verdict": "failed", "effects": [], "notes": [str(error)]}
        report |= {"identify seconds": spent, "wall seconds": time.perf_counter() - began}
        storage.write_json(_report(out, method, case.name), report)


def _identified(case: Case, flown: Flown) -> tuple[Vehicle, VehiclePosterior]:
    """The vehicle that the gap is measured for, and what is known of it."""
    from inclined_landing.eval.gap.answer.identify import identify
    from inclined_landing.eval.gap.model.reference import VehiclePosterior
    from inclined_landing.models.parameters import load_vehicle

    if not flown.identify:
        vehicle = case.vehicle(load_vehicle())
        return vehicle, VehiclePosterior.of_file(None, vehicle)
    found = identify(flown.identify, load_vehicle())
    return case.vehicle(found.vehicle), found.reference


def diagnosed(method: str, flown: Flown, vehicle: Vehicle, reference: VehiclePosterior) -> dict:
    """The report of one method on the logs of one case."""
    if method == "workflow":
        from inclined_landing.eval.gap import diagnose

        plants = ("analytic", "mujoco")
        known = {"reference": reference, "heldout": flown.heldout}
        return diagnose(flown.gap, vehicle, **known, plants=plants, curves=False).to_json()
    from . import baselines

    return baselines.report(method, flown.gap, flown.heldout, vehicle)


def _score(out: Path, labels: dict, methods: Sequence[str]) -> dict:
    """Open the labels and judge every report."""
    results = storage.read_json(out / _SET, "record") | {"methods": {}}
    for method in methods:
        rows = [_scored(out, method, name, label) for name, label in sorted(labels.items())]
        results["methods"][method] = {
            "table": summary.table(rows),
            "families": summary.by_family(rows),
            "calibration": summary.calibration(rows),
            "cases": rows,
        }
    return results
