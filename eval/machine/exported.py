"""What one action of an exported policy costs on this machine: C, NumPy, ONNX Runtime."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from inclined_landing.envs.policy import Policy
from inclined_landing.envs.shared.statistics import spread
from inclined_landing.envs.tasks import Task
from inclined_landing.eval.export import c_source, compiled, contract, numpy_file, vectors
from inclined_landing.eval.export.landing_policy import LandingPolicy
from inclined_landing.eval.export.network import Network
from inclined_landing.eval.export.vectors import Vectors
from inclined_landing.models.errors import UserError

_COMPARED = 1000  # inputs
_LOOP = 100  # actions of the C code between two looks at the clock: 0.1 ms


def latency(policy: Policy, repeats: int, seed: int) -> dict:
    """Return microseconds for one action of one input, per format; what is not installed is said in words.

    C is timed in loops of _LOOP actions, NumPy and ONNX Runtime (one thread) call by call.
    `largest_difference` is that of an action from the policy's, over a thousand inputs. `cost` is counted and
    estimated, see `export.cost`.
    """
    network = Network.from_policy(policy)
    terms = contract.describe(policy, network)
    rng = np.random.default_rng(seed)
    inputs = policy.centre + policy.scale * rng.normal(size=(_COMPARED, network.inputs))
    inputs, wanted = inputs.astype(np.float32), policy.predict(inputs.astype(np.float32))
    observations = inputs[:8, : len(policy.task.observation_names)]
    tested = vectors.sequence(policy, np.zeros((len(observations), 13)), observations)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        export = folder, policy.task, network, terms, tested
        numpy_file.write(*export)
        reader = LandingPolicy(folder / "policy.npz")
        return {
            "c": _c(export, inputs, wanted, repeats),
            "numpy": _measured(reader.infer, inputs, wanted, repeats),
            "onnx": _onnx(export, inputs, wanted, repeats),
            "cost": terms["cost"],
        }


def _c(export: tuple[Path, Task, Network, dict, Vectors], inputs, wanted, repeats: int) -> dict:
    folder, _, network, *_ = export
    try:
        c_source.write(*export)
        library = compiled.Library(folder, folder)
    except UserError as error:
        return {"skipped": str(error)}
    microseconds, actions, some = [], network.sizes[-1], inputs[:_LOOP].copy()
    for _ in range(max(20, repeats // 4)):
        began = time.perf_counter()
        library.infer(some, actions)
        microseconds.append(1e6 * (time.perf_counter() - began) / _LOOP)
    return spread(microseconds) | _apart(library.infer(inputs, actions), wanted)


def _onnx(export: tuple[Path, Task, Network, dict, Vectors], inputs, wanted, repeats: int) -> dict:
    try:
        import onnxruntime

        from inclined_landing.eval.export import onnx_file
    except ImportError as error:
        return {"skipped": f"{error.name} is not installed"}
    onnx_file.write(*export)
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    session = onnxruntime.InferenceSession(
        export[0] / "policy.onnx", options, providers=["CPUExecutionProvider"]
    )
    return _measured(lambda rows: session.run(None, {"input": rows})[0], inputs, wanted, repeats)


def _measured(act: Callable[[np.ndarray], np.ndarray], inputs, wanted, repeats: int) -> dict:
    """Microseconds of calls with one input each, after some to warm up; and the largest difference."""
    microseconds = []
    for k in range(repeats + 10):
        row = inputs[k % len(inputs)][None]
        began = time.perf_counter()
        act(row)
        microseconds.append(1e6 * (time.perf_counter() - began))
    return spread(microseconds[10:]) | _apart(act(inputs), wanted)


def _apart(actions: np.ndarray, wanted: np.ndarray) -> dict:
    return {"largest_difference": float(np.abs(actions - wanted).max())}
