"""`landing-train` in a process that is made to be killed, and when two policies are the same.

Evaluations and films are short there.
"""

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
    """Bit for bit."""
    one, other = ({name: array.tobytes() for name, array in weights(path).items()} for path in (a, b))
    assert one.keys() == other.keys()
    assert not [name for name in one if one[name] != other[name]]
