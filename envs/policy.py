"""Policy files: Stable-Baselines3 zips with a stamp that says what they were trained for.

A policy file is what `PPO.save` writes plus one entry, `inclined_landing.json`: task, task
options, plant, seed, steps, command, versions. Reading it runs no code from the file: only the
actor's weights are taken. `Policy.predict` evaluates the network row by row in a compiled loop, so
that an action does not depend on how many others are computed with it.
"""

from __future__ import annotations

import dataclasses
import json
import shutil
import zipfile
from importlib import resources
from pathlib import Path

import numba
import numpy as np

from inclined_landing.envs.tasks import TASKS, Task, make_task, task_class
from inclined_landing.envs.tasks.base import resolve_pwm_centre
from inclined_landing.models import storage
from inclined_landing.models.errors import UserError
from inclined_landing.models.parameters import Vehicle, load_vehicle

STAMP = "inclined_landing.json"
SHIPPED = tuple(task.name for task in TASKS.values() if task.shipped)
_ACTIVATIONS = ("Tanh", "ReLU")  # index is the code in the compiled loop
_LIMIT = 10.0  # of `features.ScaledObservation`


@dataclasses.dataclass(frozen=True)
class Policy:
    """The deterministic actor of a policy file; `load_policy` makes one."""

    task: Task
    metadata: dict  # the stamp; empty for a plain SB3 file
    path: Path
    centre: np.ndarray  # (o,) subtracted from the observation
    scale: np.ndarray  # (o,) that the difference is divided by
    limit: float  # that the scaled observation is clipped to; inf without scaling
    weights: tuple[np.ndarray, ...]  # (inputs, outputs) of each layer
    biases: tuple[np.ndarray, ...]  # (outputs,)
    activation: str

    @property
    def name(self) -> str:
        """File name without its suffix."""
        return self.path.stem

    def predict(self, observation: np.ndarray) -> np.ndarray:
        """Actions (n, a) float32 in [-1, 1] for observations (n, o), or (a,) for (o,)."""
        observation = np.asarray(observation)
        rows = np.ascontiguousarray(np.atleast_2d(observation), np.float64)
        if rows.ndim != 2 or rows.shape[1] != len(self.centre):
            raise UserError(
                f"policy {self.name} takes observations of {len(self.centre)} numbers, "
                f"not an array of shape {observation.shape}"
            )
        action = _forward(
            rows, self.centre, self.scale, self.limit, self.weights, self.biases,
            _ACTIVATIONS.index(self.activation),
        )  # fmt: skip
        return action[0] if observation.ndim == 1 else action


@numba.njit(cache=True)
def _forward(rows, centre, scale, limit, weights, biases, activation):
    widest = len(centre)
    for bias in biases:
        widest = max(widest, len(bias))
    result = np.empty((len(rows), len(biases[len(biases) - 1])), np.float32)
    x, y = np.empty(widest), np.empty(widest)
    for r in range(len(rows)):
        for i in range(len(centre)):
            x[i] = min(limit, max(-limit, (rows[r, i] - centre[i]) / scale[i]))
        for k in range(len(weights)):
            w, b = weights[k], biases[k]
            y[: len(b)] = b
            for i in range(w.shape[0]):  # over inputs outside: vectorises in a fixed order
                for j in range(w.shape[1]):
                    y[j] += x[i] * w[i, j]
            if k < len(weights) - 1:
                for j in range(len(b)):
                    y[j] = np.tanh(y[j]) if activation == 0 else max(y[j], 0.0)
            x, y = y, x
        for j in range(result.shape[1]):
            result[r, j] = min(1.0, max(-1.0, x[j]))
    return result


def stamp(path: str | Path, metadata: dict) -> None:
    """Put `metadata` into the SB3 zip at `path`, replacing an earlier stamp; whole or not at all.

    metadata must name the task in "task" and its options in "task_options".
    """
    path = Path(path)
    missing = [key for key in ("task", "task_options") if key not in metadata]
    if missing:
        raise UserError(f"the stamp of {path} lacks {' and '.join(missing)}")
    with _open(path) as source, storage.atomic(path) as part:
        if STAMP not in source.namelist():
            shutil.copyfile(path, part)
        else:
            with zipfile.ZipFile(part, "w") as target:
                for entry in source.infolist():
                    if entry.filename != STAMP:
                        target.writestr(entry, source.read(entry))
        with zipfile.ZipFile(part, "a", zipfile.ZIP_DEFLATED) as target:
            target.writestr(STAMP, storage.to_json(metadata))


def locate(name: str | Path) -> Path:
    """Path of a policy: a shipped one by name (see SHIPPED), otherwise a file."""
    if str(name) in SHIPPED:
        path = Path(str(resources.files("inclined_landing.envs") / "shipped" / f"{name}.zip"))
        if not path.is_file():
            raise UserError(f"no {name} policy is shipped with this installation ({path} is missing)")
        return path
    path = Path(name)
    if path.is_dir():
        raise UserError(f"policy {path} is a folder; name the .zip file in it")
    if not path.is_file():
        raise UserError(f"policy {path} does not exist (shipped ones: {', '.join(SHIPPED)})")
    return path


def load_policy(
    path: str | Path,
    task: Task | str | None = None,
    *,
    vehicle: Vehicle | None = None,
    inclination: float | None = None,
) -> Policy:
    """Read a policy file, or a shipped policy by name.

    task: the task it must be for, by name or as an object (which then is the policy's task as it
        is); needed when the file has no stamp. By name, and by default, the task is built from the
        stamp.
    vehicle, inclination [rad]: of the task that is built, where they differ from the training's.
        The thrust at action 0 stays what it was in training.
    Raises UserError when the file is not such a policy or does not fit the task.
    """
    path = locate(path)
    with _open(path) as archive:
        metadata = _read_json(archive, STAMP, path) if STAMP in archive.namelist() else {}
        data = _read_json(archive, "data", path)
        tensors = _read_tensors(archive, path)
    wanted = task if task is None or isinstance(task, str) else task.name
    if wanted is not None and wanted not in TASKS:
        raise UserError(f"unknown task {wanted!r}; known are {' and '.join(TASKS)}")
    trained = metadata.get("task")
    if wanted and trained and wanted != trained:
        raise UserError(f"policy {path} was trained for the task {trained}, not for {wanted}")
    if not (wanted or trained):
        raise UserError(
            f"policy {path} does not say which task it was trained for; name the task ({' or '.join(TASKS)})"
        )
    if task is None or isinstance(task, str):
        task = _build_task(trained or wanted, metadata, vehicle, inclination, path)
    network = _actor(tensors, data, path)
    expected = len(task.observation_names), len(task.action_names)
    found = len(network["centre"]), len(network["biases"][-1])
    if found != expected:
        raise UserError(
            f"policy {path} takes {found[0]} observations and gives {found[1]} actions, but the "
            f"task {task.name} has {expected[0]} and {expected[1]}"
        )
    return Policy(task=task, metadata=metadata, path=path, **network)


def _build_task(name, metadata, vehicle, inclination, path) -> Task:
    options = metadata.get("task_options", {})
    if not isinstance(options, dict):
        raise UserError(f"policy {path}: task_options in its {STAMP} is not a table")
    options = dict(options)
    if inclination is not None:
        if not task_class(name).has_platform:
            raise UserError(f"policy {path} is for the task {name}, which has no inclined platform")
        options["inclination"] = inclination
    if vehicle is not None:
        options["pwm_centre"] = resolve_pwm_centre(options.get("pwm_centre", "paper"), load_vehicle())
    return make_task(name, vehicle, **options)


def _open(path: Path) -> zipfile.ZipFile:
    try:
        archive = zipfile.ZipFile(path)
    except FileNotFoundError as error:
        raise UserError(f"policy {path} does not exist") from error
    except OSError as error:
        raise UserError(f"policy {path} cannot be read: {error.strerror}") from error
    except zipfile.BadZipFile as error:
        raise UserError(f"policy {path} is not a zip file as Stable-Baselines3 saves them") from error
    missing = {"data", "policy.pth"} - set(archive.namelist())
    if missing:
        archive.close()
        raise UserError(
            f"policy {path} is not a Stable-Baselines3 policy: the zip lacks " + " and ".join(sorted(missing))
        )
    return archive


def _read_json(archive: zipfile.ZipFile, name: str, path: Path) -> dict:
    try:
        value = json.loads(archive.read(name))
    except (ValueError, zipfile.BadZipFile) as error:
        raise UserError(f"policy {path}: {name} in it is damaged") from error
    if not isinstance(value, dict):
        raise UserError(f"policy {path}: {name} in it is not a table")
    return value


def _read_tensors(archive: zipfile.ZipFile, path: Path) -> dict[str, np.ndarray]:
    """The network's tensors by name; only tensors are unpickled."""
    import pickle

    import torch

    try:
        with archive.open("policy.pth") as file:
            tensors = torch.load(file, map_location="cpu", weights_only=True)
        arrays = {name: tensor.double().numpy() for name, tensor in tensors.items()}
    except (
        *(RuntimeError, ValueError, EOFError, KeyError, AttributeError, OSError),
        *(pickle.UnpicklingError, zipfile.BadZipFile),
    ) as error:
        raise UserError(f"policy {path}: policy.pth in it is damaged") from error
    if not all(np.isfinite(array).all() for array in arrays.values()):
        raise UserError(f"policy {path} has weights that are NaN or infinite")
    return arrays


def _actor(tensors: dict[str, np.ndarray], data: dict, path: Path) -> dict:
    """The fields of `Policy` that make up the network."""
    prefix = "mlp_extractor.policy_net."
    hidden = sorted(
        {int(name.removeprefix(prefix).split(".")[0]) for name in tensors if name.startswith(prefix)}
    )
    layers = [f"{prefix}{k}" for k in hidden] + ["action_net"]
    extractor = {name.split(".", 1)[1] for name in tensors if name.startswith("features_extractor.")}
    complete = all(f"{layer}.{part}" in tensors for layer in layers for part in ("weight", "bias"))
    if not complete or "log_std" not in tensors or extractor - {"centre", "scale"}:
        raise UserError(f"policy {path} is not a PPO policy with a plain network and continuous actions")
    weights = tuple(np.ascontiguousarray(tensors[f"{layer}.weight"].T) for layer in layers)
    biases = tuple(tensors[f"{layer}.bias"] for layer in layers)
    inputs = weights[0].shape[0]
    options = data.get("policy_kwargs") or {}
    activation = str(options.get("activation_fn", "Tanh")).rstrip("'>").rpartition(".")[2]
    if activation not in _ACTIVATIONS or options.get("squash_output") in (True, "True"):
        raise UserError(
            f"policy {path} has a network this package cannot evaluate "
            f"(activation {activation}; known are {' and '.join(_ACTIVATIONS)})"
        )
    scaled = bool(extractor)
    return {
        "centre": tensors["features_extractor.centre"] if scaled else np.zeros(inputs),
        "scale": tensors["features_extractor.scale"] if scaled else np.ones(inputs),
        "limit": _LIMIT if scaled else np.inf,
        "weights": weights,
        "biases": biases,
        "activation": activation,
    }
