"""The contract of an export: the meaning of each input and output, and the origin of the policy.

`contract.json` is made from the task, the policy and its metadata; `contract.schema.json` is its schema.
"""

from __future__ import annotations

import dataclasses
import hashlib
import importlib.metadata
import math
from collections.abc import Mapping
from importlib import resources
from pathlib import Path

import numpy as np

from inclined_landing.envs.history import input_names
from inclined_landing.envs.policy import Policy, load_policy
from inclined_landing.envs.shared import runs
from inclined_landing.envs.spaces import action_space, observation_space
from inclined_landing.envs.tasks import Task
from inclined_landing.envs.tasks.base import COLUMNS
from inclined_landing.eval.export.vectors import TOLERANCE
from inclined_landing.models.attitude import COMMAND_NAMES, COMMAND_UNITS, STATE_UNITS
from inclined_landing.models.base import storage
from inclined_landing.models.base.errors import UserError, shown
from inclined_landing.models.parameters import check_vehicle, load_vehicle
from inclined_landing.models.vehicle import Vehicle

FORMAT = "inclined-landing policy"
VERSION = 1
_SMALLEST = float(np.finfo(np.float32).tiny)
FRAMES = {
    "arena": "right-handed, z up; origin on the floor under the middle of the platform, which rises along x",
    "attitude": "angles of R = Rz(yaw) Rx(roll) Ry(pitch) from the vehicle to the arena: positive pitch "
    "accelerates towards +x, positive roll towards -y",
    "body": "the vehicle's own axes: x ahead, z along the thrust",
}
# The frame of all observations in tasks that observe the slope.
_SURFACE = (
    "from the centre of the platform's surface, along level axes turned about the vertical by the azimuth "
    "that the slope faces. Roll and pitch are those of a vehicle of that heading with the same thrust axis, "
    "and so are roll and pitch commands: for a vehicle of another heading, rotate them by azimuth minus yaw. "
    "Slope roll and slope pitch are those of a vehicle that stands on the slope"
)
# Quantity and frame of what a task may observe; units are those of the state.
_QUANTITIES = {
    **{axis: (f"position {axis}", "arena") for axis in "xyz"},
    **{f"v{axis}": (f"velocity {axis}", "arena") for axis in "xyz"},
    **{angle: (f"{angle} angle", "attitude") for angle in ("roll", "pitch", "yaw")},
    **{f"w{axis}": (f"angular velocity {axis}", "body") for axis in "xyz"},
    "lag": ("state of the thrust lag", None),
    "feet": ("whether the feet touch the slab, 0 or 1", None),
}
_TRAINING = ("seed", "steps", "plant", "curriculum", "command", "ranges", "versions")  # of the metadata


def load(name: str, task: str | None = None, vehicle: Vehicle | Path | None = None) -> Policy:
    """Return the policy for the task and the vehicle of its training, or for another vehicle.

    Raises UserError when there is none.
    """
    policy = load_policy(name, task, vehicle=vehicle)
    if vehicle is not None or not policy.metadata.get("vehicle"):
        return policy
    return load_policy(name, task, vehicle=_trained_vehicle(policy))


def single(policy: Policy) -> Policy:
    """Return the policy in float32, which every export contains; raises UserError if that is impossible."""
    scale = policy.scale.astype(np.float32)
    if not (scale >= _SMALLEST).all() or not np.isfinite(scale).all():
        raise UserError(f"policy {policy.path} has an observation scale beyond the range of float32")
    return dataclasses.replace(
        policy,
        centre=policy.centre.astype(np.float32),
        scale=scale,
        weights=tuple(weight.astype(np.float32) for weight in policy.weights),
        biases=tuple(bias.astype(np.float32) for bias in policy.biases),
    )


def describe(policy: Policy) -> dict:
    """Return the contract of a policy. Raises UserError if its task has its own mapping of actions."""
    task, space = policy.task, action_space(policy.task)
    given = {COMMAND_NAMES[channel.column] for channel in task.channels}
    arrays = policy.centre, policy.scale, *policy.weights, *policy.biases
    _check_channels(policy)
    return {
        "format": FORMAT,
        "version": VERSION,
        "policy": {
            "name": policy.name,
            "sha256": hashlib.sha256(storage.read_bytes(policy.path, "policy", 2**30)).hexdigest(),
            "training": {key: policy.metadata[key] for key in _TRAINING if key in policy.metadata},
        },
        "task": _task(task),
        "control_period": task.vehicle.command_control_period,
        "rate": 1.0 / task.vehicle.command_control_period,
        "frames": FRAMES | ({"surface": _SURFACE} if task.observes_slope else {}),
        "observation": _observation(task),
        "input": _input(policy),
        "network": {
            "dtype": "float32",
            "layers": [len(bias) for bias in policy.biases],
            "activation": policy.activation,
            "squashed": policy.squashed,
            "bound": _finite(policy.bound),
        },
        "action": [
            {
                **dataclasses.asdict(channel),
                "index": k,
                "command": COMMAND_NAMES[channel.column],
                "unit": COMMAND_UNITS[channel.column],
                "range": [float(space.low[k]), float(space.high[k])],
            }
            for k, channel in enumerate(task.channels)
        ],
        "commands": [
            {"name": name, "unit": unit, "given": name in given}
            for name, unit in zip(COMMAND_NAMES, COMMAND_UNITS)
        ],
        "arena": {axis: list(getattr(task.vehicle, f"arena_{axis}")) for axis in "xyz"},
        "vehicle": _vehicle(policy),
        "numerics": {
            "tolerance": TOLERANCE,
            "not_finite": {
                "c": "an error code; nothing is written",
                "onnx": "every action of that row is NaN",
            },
        },
        "cost": {"constants": sum(a.size for a in arrays)},
        "versions": runs.packages(),
        "licence": {
            "spdx": importlib.metadata.metadata("inclined-landing")["License-Expression"],
            "of": "the exported code; a policy you trained is yours",
        },
    }


def _task(task: Task) -> dict:
    goal, half = task.goal, task.goal_half_widths
    named = lambda values: None if values is None else dict(zip(task.observation_names, map(float, values)))  # noqa: E731
    return {
        "name": task.name,
        "options": task.options,
        "inclination": task.inclination if task.has_platform and not task.observes_slope else None,
        "max_steps": task.max_steps,
        "goal": named(goal),
        "goal_half_widths": named(half),
        "motors_cut_at_goal": task.cut_at_success,
    }


def _observation(task: Task) -> list[dict]:
    space = observation_space(task)
    rows = []
    for k, name in enumerate(task.observation_names):
        quantity, frame = _QUANTITIES.get(name, (name, None))
        unit = STATE_UNITS[COLUMNS[name]] if name in COLUMNS else "1" if name in _QUANTITIES else None
        arena = getattr(task.vehicle, f"arena_{name}", None) if name in ("x", "y", "z") else None
        if task.observes_slope and name != "feet":
            frame, arena = "surface", None
            unit = "rad" if name.startswith("slope") else unit
        rows.append(
            {
                "index": k,
                "name": name,
                "quantity": quantity,
                "unit": unit,
                "frame": frame,
                "range": [_finite(float(space.low[k])), _finite(float(space.high[k]))],
                "inside_arena": None if arena is None else list(arena),
            }
        )
    return rows


def _input(policy: Policy) -> dict:
    task = policy.task
    step = [*task.observation_names, *(f"{name} command" for name in task.action_names)]
    return {
        "size": len(policy.centre),
        "names": list(input_names(task)),
        "formula": "clip((input - centre) / scale, -limit, limit)",
        "centre": policy.centre.tolist(),
        "scale": policy.scale.tolist(),
        "limit": _finite(policy.limit),
        "history": {
            "steps": task.history,
            "step": step if task.history else [],
            "order": "after the current observation, most recent step first",
            "before_start": {"observation": "the first one", "action": 0.0},
        },
    }


def _check_channels(policy: Policy) -> None:
    """Raise UserError unless the task's commands follow its channels."""
    task = policy.task
    actions = np.random.default_rng(0).uniform(-1.0, 1.0, (64, len(task.action_names)))
    if not np.allclose(Task.commands(task, actions), task.commands(actions), rtol=0.0, atol=1e-9):
        raise UserError(
            f"policy {policy.path}: the task {task.name} maps actions to commands in its own way, "
            "which cannot be exported"
        )


def _vehicle(policy: Policy) -> dict:
    file = resources.files("inclined_landing.models").joinpath("crazyflie.toml")
    constants, shipped = storage.to_json(dataclasses.asdict(policy.task.vehicle)), load_vehicle()
    return {
        "file": file.name,
        "sha256": hashlib.sha256(file.read_bytes()).hexdigest(),
        "differences": {k: v for k, v in vars(policy.task.vehicle).items() if v != getattr(shipped, k)},
        "constants_sha256": hashlib.sha256(constants.encode()).hexdigest(),
    }


def _trained_vehicle(policy: Policy) -> Vehicle:
    """Return the shipped vehicle with the differences in the metadata; raise UserError for invalid ones."""
    entry, shipped = policy.metadata["vehicle"], load_vehicle()
    what = f"policy {policy.path}: the vehicle in its metadata"
    if not isinstance(entry, Mapping):
        raise UserError(f"{what} is not a table")
    if unknown := [name for name in entry if name not in vars(shipped)]:
        raise UserError(f"{what} has the unknown entry {shown(unknown[0], 60)}")
    fields = {name: tuple(value) if isinstance(value, list) else value for name, value in entry.items()}
    vehicle = shipped.changed(**fields)
    try:
        check_vehicle(vehicle)
    except UserError as error:
        raise UserError(f"{what}: {error}") from error
    return vehicle


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None
