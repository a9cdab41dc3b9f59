"""`landing-train` in a process that is made to be killed, and when two policies are the same.

Evaluations and films are short there.
"""

import collections
import io
import os
import signal
import sys
import zipfile

import numpy as np
import torch

from inclined_landing.train import cli, evaluation, warm_start


def train(arguments: list[str], log: str, dies_at: int | None = None) -> None:
    """Run `landing-train ARGUMENTS` and exit with its code.

    dies_at: the file, in the order of writing, before whose renaming the process kills itself.
    """
    handle = os.open(log, os.O_WRONLY | os.O_CREAT | os.O_APPEND)
    os.dup2(handle, 1)
    os.dup2(handle, 2)
    sys.stdout = sys.stderr = os.fdopen(handle, "w", buffering=1)
    evaluation.EVALUATION_STARTS = 2
    warm_start._ROUNDS, warm_start._STEPS, warm_start.CRITIC_FIRST = 2, 20, 1000
    if dies_at is not None:
        _die_before_renaming(dies_at)
    sys.exit(cli.main(arguments))


def _die_before_renaming(number: int) -> None:
    replace, left = os.replace, [number]

    def counted(source, target):
        left[0] -= ".part" in os.path.basename(source)
        if left[0] < 0:
            os.kill(os.getpid(), signal.SIGKILL)
        replace(source, target)

    os.replace = counted


def weights(path) -> dict[str, np.ndarray]:
    """Network and optimizer of a policy file, everything that training goes on from."""
    with zipfile.ZipFile(path) as archive:
        policy = torch.load(io.BytesIO(archive.read("policy.pth")), weights_only=True)
        optimizer = torch.load(io.BytesIO(archive.read("policy.optimizer.pth")), weights_only=True)
    result = {name: tensor.numpy() for name, tensor in policy.items()}
    for k, moments in optimizer["state"].items():
        result |= {f"optimizer {k} {name}": tensor.numpy() for name, tensor in moments.items()}
    return result


def assert_same_policy(a, b):
    assert not differences(weights(a), weights(b))


# What a resumed run may differ in: clocks and what draws or logs, what was asked for, the vehicles of the
# last evaluation, and the best policy's file, which has the time in it.
PASSING = {
    *("clock", "_began", "start_time", "t", "training_seconds", "cpu_seconds", "curve", "_logger"),
    *("config", "record", "folder", "resumed", "begun_at", "teacher", "evaluation", "best"),
    *("_seeds", "_num_timesteps_at_start", "lr_schedule"),
}


def differences(a, b, where="", seen=None) -> list[str]:
    """Paths of everything in which two objects differ: their numbers, texts and arrays, to any depth."""
    seen = set() if seen is None else seen
    if id(a) in seen or (callable(a) and not isinstance(a, torch.nn.Module)):
        return []
    if type(a) is not type(b):
        return [f"{where}: {type(a)} {type(b)}"]
    if isinstance(a, (torch.Tensor, np.ndarray)):
        a, b = (x.detach().numpy() if isinstance(x, torch.Tensor) else x for x in (a, b))
        if a.dtype != object:
            same = a.shape == b.shape and a.tobytes() == b.tobytes()
            return [] if same else [where]
        a, b = a.tolist(), b.tolist()
    if a is None or isinstance(a, (bool, int, float, str, bytes, np.generic)):
        return [] if a == b or (a != a and b != b) else [f"{where}: {str(a)[:60]} {str(b)[:60]}"]
    seen.add(id(a))
    if isinstance(a, np.random.Generator):
        a, b = a.bit_generator.state, b.bit_generator.state
    elif isinstance(a, (torch.nn.Module, torch.optim.Optimizer)):
        a, b = a.state_dict(), b.state_dict()
    elif hasattr(a, "save") and hasattr(
        a, "hover_share"
    ):  # vehicles in a plant, whose engine is not Python's
        a, b = a.save(), b.save()
    elif not isinstance(a, (dict, list, tuple, collections.deque, set)):
        a, b = getattr(a, "__dict__", {}), getattr(b, "__dict__", {})
    if isinstance(a, dict):
        found = [f"{where}.{name} is only in one" for name in a.keys() ^ b.keys() if name not in PASSING]
        pairs = [(name, a[name], b[name]) for name in a.keys() & b.keys() if name not in PASSING]
    elif isinstance(a, set):
        return [] if a == b else [where]
    else:
        found = [] if len(a) == len(b) else [f"{where}: {len(a)} {len(b)}"]
        pairs = [(k, *pair) for k, pair in enumerate(zip(a, b))]
    for name, *pair in pairs:
        found += differences(*pair, f"{where}.{name}", seen)
    return found
