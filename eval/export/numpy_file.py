"""The NumPy export: `policy.npz`, and the module that reads it."""

from __future__ import annotations

import math
from importlib import resources
from pathlib import Path

import numpy as np

from inclined_landing.envs.tasks import Task
from inclined_landing.eval.export.network import ExportNetwork
from inclined_landing.eval.export.vectors import Vectors
from inclined_landing.models import storage

READER = "landing_policy.py"


def write(folder: Path, task: Task, network: ExportNetwork, contract: dict, vectors: Vectors) -> None:
    """Write policy.npz and landing_policy.py into `folder`."""
    rows = [(c.column, c.centre, c.span, c.low, c.high, -math.inf if c.idle is None else c.idle)
            for c in task.channels]  # fmt: skip
    arrays = {
        "sizes": [task.history, len(task.observation_names), len(task.action_names)],
        "centre": network.centre,
        "scale": network.scale,
        "limit": np.float32(network.limit),
        "activation": network.activation,
        "squashed": network.squashed,
        "bound": np.float32(network.bound),
        "channels": np.array(rows, float),
        "layers": len(network.weights),
        "vector_observations": vectors.observations,
        "vector_actions": vectors.actions,
    }
    for k, (weight, bias) in enumerate(zip(network.weights, network.biases)):
        arrays |= {f"weight_{k}": weight, f"bias_{k}": bias}
    with storage.atomic(folder / "policy.npz") as part:
        np.savez(part, allow_pickle=False, **arrays)
    reader = resources.files("inclined_landing.eval.export").joinpath(READER)
    storage.write_bytes(folder / READER, reader.read_bytes())
