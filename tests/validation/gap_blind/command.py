"""`gap-blind`: draw a set, seal its labels, identify and diagnose every case as a user would,
open the labels, count."""

from __future__ import annotations

import hashlib
import importlib.util
import time
from pathlib import Path
from typing import Annotated

import tyro
from msgspec import Meta

from inclined_landing.envs.shared import runs
from inclined_landing.eval.base.options import Folder, Seed
from inclined_landing.models.base import storage
from inclined_landing.models.base.errors import UserError

from ..shared import answered, check_known
from .cases import ROTORPY, SETS, Case, of_set
from .score import score_case
from .tables import markdown, results_of

_NEEDED = {
    "rotorpy": ("rotorpy", "torch", "torchdiffeq", "roma"),
}
_SET, _LABELS = "set.json", "sealed/labels.json"


def command(
    out: Folder,
    set: Annotated[str, tyro.conf.arg(metavar="{dev,fresh,rotorpy}")] = "dev",
    seed: Seed = 0,
    cases: Annotated[int, Meta(ge=1, le=10**6)] | None = None,
    processes: Annotated[int, Meta(ge=1, le=256)] = 2,
) -> None:
    """Hidden causes in flights of independent simulators: what gap names (minutes).

    Args:
        out: folder for results.json and table.md; an interrupted run goes on in it.
        set: development (thresholds are chosen on it) or fresh (scored once), whose vehicles share no
            structure; or flights of RotorPy (needs rotorpy).
        seed: of the set.
        cases: at most so many, every stratum keeping its share (default: all).
        processes: cases diagnosed at a time.
    """
    check_known("set", [set], (*SETS, ROTORPY))
    if missing := [name for name in _NEEDED.get(set, ()) if importlib.util.find_spec(name) is None]:
        raise UserError(f"--set {set} needs {missing[0]}; pip install 'inclined-landing[baselines]'")
    drawn = {case.name: case for case in of_set(set, seed, cases)}
    labels = {name: case.label() for name, case in drawn.items()}
    with runs.owned(out, _SET):
        storage.remove_parts(out)
        description = _open_set(out, {"set": set, "seed": seed, "cases drawn": len(drawn)}, labels)
        calls = {name: (case,) for name, case in drawn.items()}
        reports = answered(out / "reports", _case, calls, processes)
    rows = [{"case": name} | score_case(labels[name], reports[name]) for name in sorted(drawn)]
    results = description | results_of(rows)
    storage.write_json(out / "results.json", results)
    storage.write_text(out / "table.md", markdown(results))
    print(markdown(results))
    print(f"{len(drawn)} cases were judged; the table is {out / 'table.md'}.")


def _open_set(out: Path, description: dict, labels: dict) -> dict:
    """Seal the labels and return the set's record, after a check that the folder holds this very set."""
    sealed = storage.to_json(labels) + "\n"
    description = description | {"labels sha256": hashlib.sha256(sealed.encode("utf-8")).hexdigest()}
    if (out / _SET).exists():
        found = storage.read_json(out / _SET, "record")
        if not isinstance(found, dict) or {key: found.get(key) for key in description} != description:
            raise UserError(f"{out / _SET} is damaged or that of another blind set; choose another folder")
    else:
        found = description | {"versions": runs.versions()}
        storage.write_json(out / _SET, found)
    with storage.made((out / _LABELS).parent):
        storage.write_text(out / _LABELS, sealed)
    return found


def _case(case: Case) -> dict:
    """Fly one case, identify its vehicle as a user would, and return the report of the diagnosis."""
    from inclined_landing.eval.gap import diagnose
    from inclined_landing.eval.gap.answer.identification import identify
    from inclined_landing.eval.gap.model.reference import VehiclePosterior
    from inclined_landing.models.parameters import load_vehicle

    flown, began = case.fly(), time.perf_counter()
    if flown.identify:
        found = identify(flown.identify, load_vehicle())
        vehicle, reference = case.vehicle(found.vehicle), found.reference
    else:
        vehicle = case.vehicle(load_vehicle())
        reference = VehiclePosterior.of_file(None, vehicle)
    spent, began = time.perf_counter() - began, time.perf_counter()
    known = {"reference": reference, "heldout": flown.heldout, "plants": ("analytic", "mujoco")}
    try:
        report = diagnose(flown.gap, vehicle, **known, curves=False).to_json()
    except UserError as error:
        report = {"verdict": "failed", "effects": [], "notes": [str(error)]}
    return report | {"identify seconds": spent, "wall seconds": time.perf_counter() - began}
