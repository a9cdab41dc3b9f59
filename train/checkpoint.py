"""checkpoint.pt: everything needed to continue a run, in one atomically written zip of plain data.

state.json   numbers and text: progress, random generators, curriculum, histories
NAME.npy     arrays: network, optimizer, vehicles, episodes, random states
best.zip     the policy of the best evaluation so far, if there was one

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
from typing import Annotated, Any, NamedTuple

import numpy as np
import torch
from msgspec import Meta, Struct
from stable_baselines3 import PPO

from inclined_landing.envs.sb3 import BatchVecEnv
from inclined_landing.models.base import schema, storage
from inclined_landing.models.base.errors import UserError, shown
from inclined_landing.train.callbacks import TimeSpent
from inclined_landing.train.config import COPIED, ENDING
from inclined_landing.train.evaluation import PeriodicEvaluation
from inclined_landing.train.learner import Learner
from inclined_landing.train.record import FREE, RECORD, changed_entries, ranges_of

CHECKPOINT = "checkpoint.pt"
FORMAT = 2
AVERAGE = "average."  # before the names of averaged weights
_LARGEST = 2**30  # bytes
_MOMENTS = ("step", "exp_avg", "exp_avg_sq")  # Adam's, of each parameter
_BEFORE = {RECORD, *COPIED.values(), "tensorboard"}  # all that a run folder holds before its first checkpoint

Count = Annotated[int, Meta(ge=0, le=2**53)]
Row = dict[str, int | float]


class TrainingState(Struct, forbid_unknown_fields=True):
    """The content of state.json, without its format."""

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


class Checkpoint(NamedTuple):
    """The content of a checkpoint."""

    state: dict  # JSON types, NaN allowed
    arrays: dict[str, np.ndarray]
    best: bytes | None


def save(learner: Learner, evaluation: PeriodicEvaluation, config: dict) -> None:
    """Write everything needed to continue a run to its folder; config: as in run.json."""
    numbers, arrays = training_state(learner.model, learner.env)
    arrays |= {f"{AVERAGE}{name}": tensor.numpy() for name, tensor in learner.averages.items()}
    state = numbers | {
        "config": config,
        "vehicle": changed_entries(learner.task.vehicle),
        "ranges": ranges_of(learner.config),
        "curriculum": learner.curriculum.state(),
        "history": learner.history,
        "evaluations": evaluation.rows,
        "spent": dict(learner.clock.spent),
        "cpu": learner.clock.cpu,
    }
    write(learner.config.folder / CHECKPOINT, Checkpoint(state, arrays, evaluation.best))


def of_run(folder: Path) -> Checkpoint | None:
    """Return the checkpoint of the run to resume; None if it was stopped before the first one."""
    if os.path.lexists(folder / CHECKPOINT):
        return read(folder / CHECKPOINT)
    if others := {p.name for p in folder.iterdir() if not storage.is_part(p)} - _BEFORE:
        raise UserError(
            f"nothing to resume: {folder} lacks its {CHECKPOINT}, though it holds {min(others)}; "
            "start a new run with another --out"
        )
    return None


def resume(saved: Checkpoint, learner: Learner, evaluation: PeriodicEvaluation, recorded: dict) -> None:
    """Set a new learner and its evaluation to a checkpoint; raise UserError if it does not fit.

    recorded: the configuration in run.json.
    """
    config = learner.config
    path, most = config.folder / CHECKPOINT, config.most_steps()
    try:
        state = restore(learner.model, learner.env, saved)
        for name, value in recorded.items():
            if name not in (*FREE, *ENDING) and state.config.get(name, value) != value:
                raise UserError(f"belongs to another configuration: {name} differs from {RECORD}")
        if state.vehicle != changed_entries(learner.task.vehicle):
            raise UserError(f"belongs to a different vehicle than {COPIED['vehicle']}")
        if state.ranges != ranges_of(config):
            raise UserError(f"belongs to different ranges than {COPIED['randomise']}")
        learner.curriculum.restore(state.curriculum)
        learner.curriculum.log()
        learner.averages = averages(learner.model, saved)
        # The last iteration is a whole one, which may end after the steps that were requested.
        if most <= state.steps - config.per_iteration:
            raise UserError(f"has {state.steps} steps, more than the {most} requested")
    except UserError as error:
        raise refused(path, f"cannot be continued: {error}") from error
    except (ArithmeticError, AttributeError, LookupError, RuntimeError, TypeError, ValueError) as error:
        raise refused(path, "cannot be continued: its numbers do not fit together") from error
    learner.history, learner.clock = state.history, TimeSpent(state.spent, state.cpu)
    evaluation.rows, evaluation.best = state.evaluations, saved.best


def write(path: Path, saved: Checkpoint) -> None:
    """Write a checkpoint atomically."""
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w") as archive:
        archive.writestr("state.json", json.dumps({"format": FORMAT} | saved.state))
        for name, array in saved.arrays.items():
            with archive.open(f"{name}.npy", "w") as file:
                np.lib.format.write_array(file, array, allow_pickle=False)
        if saved.best is not None:
            archive.writestr("best.zip", saved.best)
    storage.write_bytes(path, buffer.getvalue())


def read(path: Path) -> Checkpoint:
    """Read a checkpoint; raises UserError for a damaged file or one of another kind."""
    content = storage.read_bytes(path, "checkpoint", _LARGEST)
    try:
        with zipfile.ZipFile(io.BytesIO(content)) as archive:
            if any(entry.compress_type for entry in archive.infolist()):
                raise ValueError("its entries are compressed")
            entries = {name: archive.read(name) for name in archive.namelist()}
        state = json.loads(entries.pop("state.json"))
        best = entries.pop("best.zip", None)
        arrays = {
            name.removesuffix(".npy"): np.lib.format.read_array(io.BytesIO(data), allow_pickle=False)
            for name, data in entries.items()
        }
    except Exception as error:  # whatever zipfile, json and numpy raise for damaged bytes
        reason = str(error).partition("\n")[0] or type(error).__name__
        raise refused(path, f"is damaged or not a checkpoint ({reason})") from error
    if not isinstance(state, dict) or state.pop("format", None) != FORMAT:
        raise refused(path, "was written by another version of this package")
    return Checkpoint(state, arrays, best)


def refused(path: Path, why: str) -> UserError:
    """Return the error for a checkpoint that cannot be continued."""
    return UserError(f"checkpoint {path} {shown(why, 120)}; begin a new run with another --out")


def training_state(model: PPO, env: BatchVecEnv) -> tuple[dict, dict[str, np.ndarray]]:
    """Return the numbers (JSON types) and arrays from which the training can be continued exactly."""
    _, key, position, has_gauss, gauss = np.random.get_state()  # noqa: NPY002 (SB3 shuffles with it)
    numbers = {
        "steps": int(model.num_timesteps),
        "updates": int(model._n_updates),
        "start_rng": env.env.rng.bit_generator.state,
        "numpy_rng": [int(position), int(has_gauss), float(gauss)],
        "ended": [[e["r"], e["l"]] for e in model.ep_info_buffer],
        "successes": [bool(success) for success in model.ep_success_buffer],
    }
    arrays = _arrays(model, env) | {
        "numpy_rng": key,
        "last_obs": model._last_obs,
        "last_episode_starts": model._last_episode_starts,
    }
    for k, moments in model.policy.optimizer.state_dict()["state"].items():
        arrays |= {f"optimizer.{k}.{name}": moment.numpy() for name, moment in moments.items()}
    return numbers, arrays


def _arrays(model: PPO, env: BatchVecEnv) -> dict[str, np.ndarray]:
    """Return the arrays that a new model also has."""
    batch = env.env
    parts = {"policy": {name: tensor.numpy() for name, tensor in model.policy.state_dict().items()}}
    parts |= {"plant": batch.plant.save(), "episodes": batch.episode_state()}
    arrays = {f"{part}.{name}": array for part in parts for name, array in parts[part].items()}
    return arrays | {"torch_rng": torch.get_rng_state().numpy()}


def restore(model: PPO, env: BatchVecEnv, saved: Checkpoint) -> TrainingState:
    """Set a new model to the state of a checkpoint, for `learn(..., reset_num_timesteps=False)`; return the
    state.

    Raises UserError for names, shapes or types that do not belong to this model and this environment.
    """
    state, arrays, batch = schema.parse(saved.state, TrainingState), saved.arrays, env.env
    batch.reset()  # which makes room for the waves of moving platforms
    moments = _checked_moments(model, env, arrays)

    def part(name: str) -> dict[str, np.ndarray]:
        return {k.removeprefix(f"{name}."): a for k, a in arrays.items() if k.startswith(f"{name}.")}

    model.policy.load_state_dict({name: torch.as_tensor(a) for name, a in part("policy").items()})
    optimizer = model.policy.optimizer
    optimizer.load_state_dict(optimizer.state_dict() | {"state": moments})
    batch.plant.restore(part("plant"))
    batch.restore_episodes(part("episodes"))
    model._last_obs = arrays["last_obs"]
    model._last_episode_starts = arrays["last_episode_starts"]
    model.num_timesteps, model._n_updates = state.steps, state.updates
    size = model._stats_window_size
    model.ep_info_buffer = deque(({"r": r, "l": l} for r, l in state.ended), maxlen=size)  # noqa: E741
    model.ep_success_buffer = deque(state.successes, maxlen=size)
    batch.rng.bit_generator.state = state.start_rng
    torch.set_rng_state(torch.as_tensor(arrays["torch_rng"]))
    np.random.set_state(("MT19937", arrays["numpy_rng"], *state.numpy_rng))  # noqa: NPY002
    return state


def averages(model: PPO, saved: Checkpoint) -> dict[str, torch.Tensor]:
    """Return the averaged weights of a checkpoint by name; raises UserError if they do not fit the model."""
    found = {}
    for key, array in saved.arrays.items():
        if key.startswith(AVERAGE):
            name = key.removeprefix(AVERAGE)
            like = model.policy.get_parameter(name).detach().numpy()
            if (array.shape, array.dtype) != (like.shape, like.dtype):
                raise UserError(f"{key} is {array.dtype} {array.shape}, not {like.dtype} {like.shape}")
            found[name] = torch.as_tensor(array)
    return found


def _checked_moments(model: PPO, env: BatchVecEnv, arrays: dict) -> dict[int, dict[str, torch.Tensor]]:
    """Return the optimizer's moments by parameter; raises UserError for an array of another shape or type."""
    like = _arrays(model, env)
    moments: dict[int, dict[str, torch.Tensor]] = {}
    for k, parameter in enumerate(model.policy.optimizer.param_groups[0]["params"]):
        if f"optimizer.{k}.step" in arrays:  # the optimizer knows what has had a gradient
            moments[k] = {name: torch.as_tensor(arrays[f"optimizer.{k}.{name}"]) for name in _MOMENTS}
            weights = parameter.detach().numpy()
            like |= {f"optimizer.{k}.{name}": weights for name in _MOMENTS[1:]}
    for name, array in like.items():
        found = arrays[name]
        if (found.shape, found.dtype) != (array.shape, array.dtype):
            raise UserError(f"{name} is {found.dtype} {found.shape}, not {array.dtype} {array.shape}")
    return moments
