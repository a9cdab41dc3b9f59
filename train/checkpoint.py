"""checkpoint.pt: everything needed to continue a run, written atomically by `torch.save`.

It is a dictionary of

    format      of these entries, a number
    state       JSON: progress, random generators, curriculum, histories
    best        bytes of the policy file of the best evaluation so far, None if there was none
    policy      tensors by name, as are the following
    optimizer   Adam's moments of each parameter, by its number
    averages    of the weights, empty without averaging
    plant       the vehicles
    episodes
    last        what the policy has seen and not yet answered, and the states of random generators

Reading executes nothing from the file. Entries are not compressed, so that reading takes no more memory than
the size of the file, and zip's checksums detect damaged bytes.
"""

from __future__ import annotations

import io
import json
import os
import zipfile
from collections import deque
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import torch
from msgspec import Meta, Struct

from inclined_landing.models.base import schema, storage
from inclined_landing.models.base.errors import UserError, shown
from inclined_landing.train.callbacks import TimeSpent
from inclined_landing.train.config import COPIED, ENDING
from inclined_landing.train.evaluation import PeriodicEvaluation
from inclined_landing.train.learner import Learner
from inclined_landing.train.record import FREE, RECORD, changed_entries, ranges_of

CHECKPOINT = "checkpoint.pt"
FORMAT = 3
_LARGEST = 2**30  # bytes
_BEFORE = {RECORD, *COPIED.values(), "tensorboard"}  # all that a run folder holds before its first checkpoint

Count = Annotated[int, Meta(ge=0, le=2**53)]
Row = dict[str, int | float]


class TrainingState(Struct, forbid_unknown_fields=True):
    """The content of the entry `state`."""

    steps: Count
    updates: Count
    start_rng: dict[str, Any]  # of the environment's generator
    numpy_rng: tuple[Annotated[int, Meta(ge=0, le=624)], Annotated[int, Meta(ge=0, le=1)], float]
    ended: list[tuple[float, Count]]  # reward and length of the latest episodes
    successes: list[bool]
    config: dict[str, Any]
    vehicle: dict[str, Any]
    ranges: dict[str, Any]
    curriculum: dict[str, int | float | str | list[bool | str] | None]
    history: list[Row]
    evaluations: list[Row]
    spent: dict[str, float]
    cpu: float


def save(learner: Learner, evaluation: PeriodicEvaluation, config: dict) -> None:
    """Write everything needed to continue a run to its folder; config: as in run.json."""
    model, best, buffer = learner.model, evaluation.best, io.BytesIO()
    _, key, position, has_gauss, gauss = np.random.get_state()  # noqa: NPY002 (SB3 shuffles with it)
    state = {
        "steps": learner.steps,
        "updates": int(model._n_updates),
        "start_rng": learner.batch.rng.bit_generator.state,
        "numpy_rng": [int(position), int(has_gauss), float(gauss)],
        "ended": [[e["r"], e["l"]] for e in model.ep_info_buffer],
        "successes": [bool(success) for success in model.ep_success_buffer],
        "config": config,
        "vehicle": changed_entries(learner.task.vehicle),
        "ranges": ranges_of(learner.config),
        "curriculum": learner.curriculum.state(),
        "history": learner.history,
        "evaluations": evaluation.rows,
        "spent": dict(learner.clock.spent),
        "cpu": learner.clock.cpu,
    }
    last = {
        "observations": model._last_obs,
        "episode_starts": model._last_episode_starts,
        "numpy_rng": key,
        "torch_rng": torch.get_rng_state(),
    }
    content = _tensors_of(learner) | {
        "format": FORMAT,
        "state": json.dumps(state),
        "best": best and torch.frombuffer(bytearray(best), dtype=torch.uint8),
        "optimizer": model.policy.optimizer.state_dict()["state"],
        "last": {name: torch.as_tensor(array) for name, array in last.items()},
    }
    torch.save(content, buffer)
    storage.write_bytes(learner.config.folder / CHECKPOINT, buffer.getvalue())


def of_run(folder: Path) -> dict | None:
    """Return the checkpoint of the run to resume; None if it was stopped before the first one."""
    if os.path.lexists(folder / CHECKPOINT):
        return read(folder / CHECKPOINT)
    if others := {p.name for p in folder.iterdir() if not storage.is_part(p)} - _BEFORE:
        raise UserError(
            f"nothing to resume: {folder} lacks its {CHECKPOINT}, though it holds {min(others)}; "
            "start a new run with another --out"
        )
    return None


def resume(saved: dict, learner: Learner, evaluation: PeriodicEvaluation, recorded: dict) -> None:
    """Set a new learner and its evaluation to a checkpoint; raise UserError if it does not fit.

    recorded: the configuration in run.json.
    """
    config = learner.config
    path, most = config.folder / CHECKPOINT, config.most_steps()
    try:
        state = _restore(learner, saved)
        for name, value in recorded.items():
            if name not in (*FREE, *ENDING) and state.config.get(name, value) != value:
                raise UserError(f"belongs to another configuration: {name} differs from {RECORD}")
        if state.vehicle != changed_entries(learner.task.vehicle):
            raise UserError(f"belongs to a different vehicle than {COPIED['vehicle']}")
        if state.ranges != ranges_of(config):
            raise UserError(f"belongs to different ranges than {COPIED['randomise']}")
        learner.curriculum.restore(state.curriculum)
        learner.curriculum.log()
        best = None if saved["best"] is None else saved["best"].numpy().tobytes()
        # The last iteration is a whole one, which may end after the steps that were requested.
        if most <= state.steps - config.per_iteration:
            raise UserError(f"has {state.steps} steps, more than the {most} requested")
    except UserError as error:
        raise refused(path, f"cannot be continued: {error}") from error
    except (ArithmeticError, AttributeError, LookupError, RuntimeError, TypeError, ValueError) as error:
        raise refused(path, "cannot be continued: its numbers do not fit together") from error
    learner.history, learner.clock = state.history, TimeSpent(state.spent, state.cpu)
    evaluation.rows, evaluation.best = state.evaluations, best


def read(path: Path) -> dict:
    """Read a checkpoint; raises UserError for a damaged file or one of another kind."""
    content = storage.read_bytes(path, "checkpoint", _LARGEST)
    try:
        with zipfile.ZipFile(io.BytesIO(content)) as archive:
            if any(entry.compress_type for entry in archive.infolist()):
                raise ValueError("its entries are compressed")
            if damaged := archive.testzip():
                raise ValueError(f"{damaged} has other bytes than were written")
        saved = torch.load(io.BytesIO(content), weights_only=True)
    except Exception as error:  # whatever zipfile and torch raise for damaged bytes
        reason = str(error).partition("\n")[0] or type(error).__name__
        raise refused(path, f"is damaged or not a checkpoint of this version ({reason})") from error
    if not isinstance(saved, dict) or saved.get("format") != FORMAT:
        raise refused(path, "was written by another version of this package")
    return saved


def refused(path: Path, why: str) -> UserError:
    """Return the error for a checkpoint that cannot be continued."""
    return UserError(f"checkpoint {path} {shown(why, 120)}; begin a new run with another --out")


def _tensors_of(learner: Learner) -> dict[str, dict[str, torch.Tensor]]:
    """Return the tensors of a checkpoint that a new learner also has."""
    batch, averages = learner.batch, learner.averages
    return {
        "policy": learner.model.policy.state_dict(),
        "averages": {} if averages is None else averages.state_dict(),
        "plant": {name: torch.as_tensor(array) for name, array in batch.plant.save().items()},
        "episodes": {name: torch.as_tensor(array) for name, array in batch.episode_state().items()},
    }


def _restore(learner: Learner, saved: dict) -> TrainingState:
    """Set a new learner to a checkpoint, for `learn(..., reset_num_timesteps=False)`; return the state.

    Raises UserError for names, shapes or types that do not belong to this model and this environment.
    """
    state = schema.parse(json.loads(saved["state"]), TrainingState)
    model, batch, last = learner.model, learner.batch, saved["last"]
    batch.reset()  # which makes room for the waves of moving platforms
    for name, expected in _tensors_of(learner).items():
        _check(saved[name], expected, name)
    _check(last, {"torch_rng": torch.get_rng_state()}, "last")
    optimizer, step = model.policy.optimizer, torch.zeros(())
    for k, parameter in enumerate(optimizer.param_groups[0]["params"]):
        if moments := saved["optimizer"].get(k):  # the optimizer knows what has had a gradient
            like = {"step": step, "exp_avg": parameter, "exp_avg_sq": parameter}
            _check(moments, like, f"optimizer.{k}")
    model.policy.load_state_dict(saved["policy"])
    optimizer.load_state_dict(optimizer.state_dict() | {"state": saved["optimizer"]})
    if learner.averages is not None:
        learner.averages.load_state_dict(saved["averages"])
    batch.plant.restore({name: tensor.numpy() for name, tensor in saved["plant"].items()})
    batch.restore_episodes({name: tensor.numpy() for name, tensor in saved["episodes"].items()})
    model._last_obs = last["observations"].numpy()
    model._last_episode_starts = last["episode_starts"].numpy()
    model.num_timesteps, model._n_updates = state.steps, state.updates
    size = model._stats_window_size
    model.ep_info_buffer = deque(({"r": r, "l": l} for r, l in state.ended), maxlen=size)  # noqa: E741
    model.ep_success_buffer = deque(state.successes, maxlen=size)
    batch.rng.bit_generator.state = state.start_rng
    torch.set_rng_state(last["torch_rng"])
    np.random.set_state(("MT19937", last["numpy_rng"].numpy(), *state.numpy_rng))  # noqa: NPY002
    return state


def _check(found: dict[str, torch.Tensor], like: dict[str, torch.Tensor], of: str) -> None:
    """Raise UserError for a tensor of another shape or type than the one with its name in `like`."""
    for name, expected in like.items():
        array, wanted = found[name].numpy(), expected.detach().numpy()  # TypeError for one that is sparse
        if (array.shape, array.dtype) != (wanted.shape, wanted.dtype):
            raise UserError(f"{of}.{name} is {array.dtype} {array.shape}, not {wanted.dtype} {wanted.shape}")
