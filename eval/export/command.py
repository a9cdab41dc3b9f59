"""`landing-eval export`: a policy for another machine, with its contract and test vectors."""

from __future__ import annotations

import importlib
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from inclined_landing.eval.base.options import PolicyFile, RunFolder, TaskName, VehicleFile
from inclined_landing.models.base.errors import UserError, shown

if TYPE_CHECKING:
    from inclined_landing.envs.policy import Policy

# Modules with a function `write(folder, policy, contract, vectors)`, the policy in float32, imported when
# they are needed.
FORMATS = {"onnx": "inclined_landing.eval.export.onnx_file", "c": "inclined_landing.eval.export.c_source"}
FormatName = Annotated[str, tyro.conf.arg(metavar="{onnx,c}")]


def command(
    policy: PolicyFile,
    /,
    format: FormatName,
    out: RunFolder,
    task: TaskName = None,
    vehicle: VehicleFile = None,
) -> None:
    """Export a policy as ONNX or as C for a microcontroller, with contract and test vectors.

    Args:
        policy: policy file, or name of a shipped policy.
        format: onnx for ONNX runtimes, c for a microcontroller.
        out: new folder for the export.
        task: task of the policy. Only needed for a plain Stable-Baselines3 file and for a custom task, which
            is written module:Class or file.py:Class and imported.
        vehicle: vehicle file (TOML) or name of a shipped vehicle (default: that of the training). Vehicle
            parameters that a policy observes become constants of the network.
    """
    from inclined_landing.envs.shared.tables import say
    from inclined_landing.envs.tasks import import_task, is_path
    from inclined_landing.eval.export import c_source, contract

    loaded = contract.load(
        policy, import_task(task).name if task is not None and is_path(task) else task, vehicle
    )
    terms = write(loaded, format, out)
    if format == "c" and 4 * terms["cost"]["constants"] > c_source.SMALL:
        say(f"its constants take {4 * terms['cost']['constants']} bytes of flash in addition to the firmware")
    say(
        f"The policy {loaded.name} is exported as {format}; {out / 'contract.json'} describes its inputs and "
        "outputs."
    )


def write(policy: Policy, format: str, out: str | Path) -> dict:
    """Write the export of a policy into the new folder `out`, atomically; return its contract.

    format: one of FORMATS. Raises UserError for any other format, for a policy that the format cannot
    represent, and if the folder exists and is not empty or cannot be written; ImportError for a format whose
    package is not installed.
    """
    if format not in FORMATS:
        raise UserError(f"unknown format {shown(repr(format), 40)}; choose from {', '.join(FORMATS)}")
    module = importlib.import_module(FORMATS[format])
    from inclined_landing.envs.shared.runs import staged_run
    from inclined_landing.eval.export import contract, vectors
    from inclined_landing.models.base import storage

    policy = policy.with_fixed_vehicle()
    written, terms = contract.single(policy), contract.describe(policy)
    tested = vectors.record(policy)
    with staged_run(out) as folder:
        module.write(folder, written, terms, tested)
        storage.write_json(folder / "vectors.json", tested.table())
        storage.write_json(folder / "contract.json", terms)
    return terms
