"""Policies: the actor in a policy file, with the task for which it was trained."""

from __future__ import annotations

import dataclasses
import functools
import os
from pathlib import Path
from typing import Any

import numpy as np

from inclined_landing.envs import policy_file, sb3_file
from inclined_landing.envs.batch import as_floats
from inclined_landing.envs.history import input_names
from inclined_landing.envs.ids import SHIPPED, SHIPPED_FOLDER
from inclined_landing.envs.network import Network, forward
from inclined_landing.envs.policy_file import ACTIVATIONS, DEEPEST, METADATA
from inclined_landing.envs.tasks import TASKS, Task, known, make_task, task_class
from inclined_landing.envs.tasks.base import OWN, resolve_pwm_centre, resolve_pwm_span
from inclined_landing.envs.vehicle_parameters import vehicle_parameters
from inclined_landing.models.base.errors import UserError, shown
from inclined_landing.models.parameters import as_vehicle, load_vehicle
from inclined_landing.models.vehicle import Vehicle

LARGEST_WEIGHT = 1e6  # beyond, sums of products could overflow
_WIDEST = 8192


@dataclasses.dataclass(frozen=True)
class Policy:
    """The deterministic actor of a policy file; `load_policy` makes one."""

    task: Task
    metadata: dict  # empty for a file of Stable-Baselines3 alone
    path: Path
    centre: np.ndarray  # (o,) subtracted from the observation
    scale: np.ndarray  # (o,) that the difference is divided by
    limit: float  # limit of the scaled observation; inf without scaling
    weights: tuple[np.ndarray, ...]  # (inputs, outputs) of each layer
    biases: tuple[np.ndarray, ...]  # (outputs,)
    activation: str
    squashed: bool = False  # whether the last layer ends with a tanh, as those of SAC and TD3 do
    bound: float = np.inf  # pre-activations of the last layer are clipped to +-bound before the tanh

    def __post_init__(self):
        """Raise UserError unless the arrays form one network with finite numbers."""
        sizes = [len(self.centre) if self.centre.ndim else 0]
        fits = self.centre.shape == self.scale.shape and self.centre.ndim == 1 and sizes[0] > 0
        for weight, bias in zip(self.weights, self.biases):
            fits &= weight.shape == (sizes[-1], bias.size) and bias.ndim == 1 and bias.size > 0
            sizes.append(bias.size)
        layers = len(self.weights)
        if not fits or not 0 < layers == len(self.biases):
            raise UserError(f"policy {self.path} has layers of incompatible sizes")
        if layers > DEEPEST or max(sizes) > _WIDEST:
            raise UserError(
                f"policy {self.path} has {layers} layers of up to {max(sizes)} numbers; at most {DEEPEST} "
                f"of {_WIDEST} are evaluated"
            )
        if not (np.isfinite(self.scale).all() and (self.scale > 0).all()):
            raise UserError(f"policy {self.path} has an observation scale that is not positive")
        for array in (self.centre, *self.weights, *self.biases):
            if not (np.abs(array) <= LARGEST_WEIGHT).all():  # NaN neither
                raise UserError(f"policy {self.path} has weights that are NaN or beyond {LARGEST_WEIGHT:g}")
        if self.activation not in ACTIVATIONS or not self.limit > 0:
            raise UserError(f"policy {self.path} has an unknown activation or no limit for observations")

    @property
    def name(self) -> str:
        """File name without its suffix."""
        return self.path.stem

    def predict(self, observation: np.ndarray) -> np.ndarray:
        """Return actions (n, a) float32 in [-1, 1] for inputs (n, i), or (a,) for (i,), history included."""
        observation = as_floats(observation, "the observation")
        rows = np.ascontiguousarray(np.atleast_2d(observation), np.float64)
        if rows.ndim != 2 or rows.shape[1] != len(self.centre):
            raise UserError(
                f"policy {self.name} takes observations of {len(self.centre)} numbers, "
                f"not an array of shape {observation.shape}"
            )
        action = forward(rows, self._network)
        return action[0] if observation.ndim == 1 else action

    @functools.cached_property
    def _network(self) -> Network:
        activation = ACTIVATIONS.index(self.activation)
        scaling = self.centre, self.scale, self.limit
        sizes = np.array([len(self.centre), *map(len, self.biases)])
        layers = np.concatenate([w.ravel() for w in self.weights]), np.concatenate(self.biases)
        return Network(*scaling, sizes, *layers, activation, self.squashed, self.bound)

    def with_fixed_vehicle(self) -> Policy:
        """Return the policy for only its task's vehicle: vehicle parameters become biases of the first layer.

        Returns the policy itself if it observes no parameters and its PWM at action 0 is a number.
        """
        task = self.task
        if not (task.observe_vehicle or task.per_vehicle_hover):
            return self
        # With first-layer weights [W_o; W_v]: b <- b + clip((v - centre_v) / scale_v, -limit, limit) W_v
        options = {k: v for k, v in task.options.items() if k != "observe_vehicle"}
        plain = make_task(task.name, task.vehicle, **options | {"pwm_centre": task.pwm_centre})
        kept = len(input_names(plain))
        observed = vehicle_parameters(task.vehicle) if task.observe_vehicle else np.zeros(0)
        scaled = np.clip((observed - self.centre[kept:]) / self.scale[kept:], -self.limit, self.limit)
        first, *others = self.weights
        return dataclasses.replace(
            self,
            task=plain,
            centre=self.centre[:kept],
            scale=self.scale[:kept],
            weights=(np.ascontiguousarray(first[:kept]), *others),
            biases=(self.biases[0] + scaled @ first[kept:], *self.biases[1:]),
        )


def locate(name: str | Path) -> Path:
    """Return the path of a policy: a shipped one by name (see SHIPPED), a file, or the final one of a run."""
    if not isinstance(name, (str, os.PathLike)):
        raise UserError(f"a policy must be a path or the name of a shipped one, not {shown(repr(name), 40)}")
    if str(name) in SHIPPED:
        path = SHIPPED_FOLDER / f"{name}.zip"
        if not path.is_file():
            raise UserError(f"the shipped policy {name} is missing from this installation ({path})")
        return path
    path = Path(name)
    if os.path.isdir(path):
        path = path / "final.zip"
        if not path.exists():
            raise UserError(f"policy {name} is a folder without final.zip; name the .zip file in it")
    if not os.path.exists(path):
        raise UserError(f"policy {path} does not exist (shipped ones: {', '.join(SHIPPED)})")
    return path


def load_policy(
    path: str | Path,
    task: Task | str | None = None,
    *,
    vehicle: Vehicle | str | Path | None = None,
    inclination: float | None = None,
    azimuth: float | None = None,
) -> Policy:
    """Read a policy file, the final policy of a run folder, or a shipped policy by name.

    The PWM of an action is the same as in training or, with `pwm_centre="own"`, relative to the hover of each
    vehicle.

    Args:
        path: policy file, run folder, or name of a shipped policy.
        task: the task of the policy, by name or as an object, such as that of an environment (which then is
            the policy's task); needed if the file has none. By name, and by default, the task is built from
            the metadata.
        vehicle: vehicle of the task that is built, if it differs from the training's.
        inclination: inclination [rad] of its slope, if it differs from the training's.
        azimuth: azimuth [rad] of its slope, if it differs from the training's.

    Raises:
        UserError: if the file is not a policy or does not fit the task: a task object must have the PWM
            settings, slope options, dimensions and angle limits of the metadata, and its inclination or the
            given one.
    """
    if not (task is None or isinstance(task, (str, Task))):
        raise UserError(f"task must be a Task or the name of one, not {shown(repr(task), 40)}")
    vehicle = None if vehicle is None else as_vehicle(vehicle)
    path = locate(path)
    metadata, network = read_policy(path)
    wanted, trained = task.name if isinstance(task, Task) else task, metadata.get("task")
    if isinstance(task, str):
        task_class(task)  # is there one of this name
    if wanted and trained and wanted != trained:
        raise UserError(f"policy {path} was trained for the task {trained}, not for {wanted}")
    if not (wanted or trained):
        raise UserError(f"policy {path} does not state its task; name it ({' or '.join(TASKS)})")
    if not isinstance(task, Task):
        if not (wanted or known(trained)):
            raise _unknown_task(metadata, path)
        slope = {"inclination": inclination, "azimuth": azimuth}
        task = _build_task(trained or wanted, metadata, vehicle, slope, path)
    elif metadata:
        _check_training_options(task, metadata, inclination, path)
    policy = Policy(task=task, metadata=metadata, path=path, **network)
    expected = len(input_names(task)), len(task.action_names)
    found = len(policy.centre), len(policy.biases[-1])
    if found != expected:
        raise UserError(
            f"policy {path} takes {found[0]} observations and returns {found[1]} actions, but the "
            f"task {task.name} has {expected[0]} and {expected[1]}"
        )
    return policy


def read_policy(path: str | Path) -> tuple[dict, dict[str, Any]]:
    """Return the metadata of a policy file, or of a shipped policy, and its network as fields of `Policy`.

    The metadata are empty for a plain file of Stable-Baselines3.
    """
    path = locate(path)
    with policy_file.open_file(path) as archive:
        metadata, network = policy_file.read(archive, path)
        return metadata, network or sb3_file.read_network(archive, path)


def trained_task(path: str | Path) -> str | None:
    """Return the task that a policy file, or a shipped policy, was trained for; None for a file without."""
    return read_metadata(path).get("task")


def trained_options(path: str | Path) -> dict[str, Any]:
    """Return the task options that a policy file, or a shipped policy, was trained with."""
    return read_metadata(path).get("task_options", {})


def read_metadata(path: str | Path) -> dict:
    """Return the metadata of a policy file or a shipped policy; empty for a plain Stable-Baselines3 file."""
    path = locate(path)
    with policy_file.open_file(path) as archive:
        return policy_file.read(archive, path)[0]


def action_map(options: dict) -> tuple[float | str, float]:
    """Return the PWM at action 0 and the PWM span from the options of a training.

    Names such as "hover" are resolved with the shipped vehicle; "own" is returned unchanged.
    """
    shipped, centre = load_vehicle(), options.get("pwm_centre", "hover")
    if centre != OWN:
        centre = resolve_pwm_centre(centre, shipped)
    return centre, resolve_pwm_span(options.get("pwm_span"), shipped)


def _check_training_options(task: Task, metadata: dict, inclination, path) -> None:
    """Raise UserError if a task differs from training in quantities that the policy does not observe.

    The message lists all differences as arguments to type.
    """
    options = metadata.get("task_options", {})
    trained: dict[str, Any] = {}
    here: dict[str, Any] = {}
    for field in dataclasses.fields(task.options_type):
        if field.metadata.get("trained_with"):
            trained[field.name] = options.get(field.name, field.default)
            here[field.name] = task.options.get(field.name, field.default)
    centre, trained["pwm_span"] = action_map(options)
    trained["pwm_centre"], here["pwm_span"] = centre, task.pwm_span
    here["pwm_centre"] = OWN if task.per_vehicle_hover else task.pwm_centre
    drawn = task.options.get("steepest") is not None
    if inclination is None and not drawn and options.get("inclination") is not None:
        trained["inclination"], here["inclination"] = options["inclination"], task.options.get("inclination")
    wrong = [name for name in trained if not _same(trained[name], here[name])]
    if wrong:
        wanted, found = (", ".join(f"{name}={_typed(of[name])}" for name in wrong) for of in (trained, here))
        raise UserError(
            f"policy {path} was trained with {wanted}, and the {task.name} task here has {found}; use "
            "these options, or make_for(POLICY)"
            + (", or give inclination as well if that is intended" if "inclination" in wrong else "")
        )


def _same(one: Any, other: Any) -> bool:
    if isinstance(one, (int, float)) and isinstance(other, (int, float)):
        return abs(one - other) <= 1e-6 * max(1.0, abs(one))
    return one is other or one == other


def _typed(value: Any) -> str:
    """Return a value as Python source text."""
    return shown(f"{value:.15g}" if isinstance(value, float) else repr(value), 40)


def _build_task(name, metadata, vehicle, slope, path) -> Task:
    options = dict(metadata.get("task_options", {}))
    angles = {key: angle for key, angle in slope.items() if angle is not None}
    if angles and not task_class(name).has_platform:
        raise UserError(f"policy {path} is for the task {name}, which has no inclined platform")
    options |= angles
    try:
        if vehicle is not None:
            options["pwm_centre"], options["pwm_span"] = action_map(options)
        return make_task(name, vehicle, **options)
    except UserError as error:
        raise UserError(f"policy {path}: {error}") from error


def _unknown_task(metadata: dict, path: Path) -> UserError:
    """Return the error for an unknown task, perhaps a custom one; a file never causes an import."""
    name, source = metadata.get("task"), metadata.get("task_from")
    if source is not None:
        return UserError(
            f"policy {path} was trained for {shown(name, 40)}, a task of {shown(source, 60)}; if you trust "
            f"that code, name it: --task {shown(source, 60)}"
        )
    return UserError(
        f"policy {path}: its {METADATA} names an unknown task, {shown(name, 40)}; "
        f"the known tasks are {' and '.join(TASKS)}"
    )
