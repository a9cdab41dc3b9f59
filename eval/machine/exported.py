"""What one action of an exported policy costs on this machine: C, NumPy, ONNX Runtime."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from inclined_landing.envs.policy import Policy
from inclined_landing.eval.base.statistics import spread
from inclined_landing.eval.export import c_source, compiled, contract, numpy_file, vectors
from inclined_landing.eval.export.landing_policy import LandingPolicy
from inclined_landing.eval.export.network import Network
from inclined_landing.models.errors import UserError

_LOOP = 100  # actions of the C code between two looks at the clock: 0.1 ms


def latency(policy: Policy, repeats: int, seed: int) -> dict:
    """Microseconds for one action of one input, per format; what is not installed is said in words.

_LOOP = 100  # actions of the C code between two looks at the clock
    NumPy and ONNX Runtime (one thread) call by call. `cost` is counted and estimated, see `export.cost`.
    """
    network = Network.of(policy)
    terms = contract.of(policy, network)
    rng = np.random.default_rng(seed)
    inputs = (policy.centre + policy.scale * rng.normal(size=(_LOOP, network.inputs))).astype(np.float32)
    observations = inputs[:8, : len(policy.task.observation_names)]
    tested = vectors.sequence(policy, np.zeros((len(observations), 13)), observations)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        numpy_file.write(folder, network, policy.task, tested)
        reader = LandingPolicy(folder / "policy.npz")
        return {
            "c": _c(folder, terms, network, tested, inputs, repeats),
            "numpy": spread(_each(reader.infer, inputs, repeats)),
            "onnx": _onnx(folder, network, inputs, repeats),
            "cost": terms["cost"],
        }


def _c(folder: Path, terms: dict, network: Network, tested, inputs: np.ndarray, repeats: int) -> dict:
    try:
        c_source.write(folder, terms, network, tested)
        library = compiled.Library(folder, folder)
    except UserError as error:
        return {"skipped": str(error)}
    microseconds = []
    for _ in range(max(20, repeats // 4)):
        began = time.perf_counter()
        library.infer(inputs, network.sizes[-1])
        microseconds.append(1e6 * (time.perf_counter() - began) / len(inputs))
    return spread(microseconds)


def _onnx(folder: Path, network: Network, inputs: np.ndarray, repeats: int) -> dict:
    try:
        import onnxruntime

        from inclined_landing.eval.export import onnx_file
    except ImportError as error:
        return {"skipped": f"{error.name} is not installed"}
    onnx_file.write(folder, network, {})
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    session = onnxruntime.InferenceSession(
        folder / "policy.onnx", options, providers=["CPUExecutionProvider"]
    )
    return spread(_each(lambda row: session.run(None, {"input": row[None]}), inputs, repeats))


def _each(act: Callable[[np.ndarray], object], inputs: np.ndarray, repeats: int) -> list[float]:
    """Microseconds of single calls, after some to warm up."""
    microseconds = []
    for k in range(repeats + 10):
        row = inputs[k % len(inputs)]
        began = time.perf_counter()
        act(row)
        microseconds.append(1e6 * (time.perf_counter() - began))
    return microseconds[10:]
