"""Options of tasks as records: the one source of each option's name, type, default, limits and help.

The record of a task is its class's `options_type`, a frozen dataclass derived from `TaskOptions`. The
constructor takes its fields as keyword arguments, a policy file carries them as `task_options`, and
`landing-train` has an option for every field with a help text. `Training`, the training defaults of a task,
is a record of the same kind.
"""

from __future__ import annotations

import dataclasses
import functools
import math
import types
import typing
from typing import Any

import numpy as np

from inclined_landing.models.errors import UserError, shown

LONGEST_HISTORY = 50  # steps
_MANY = (1, 10**9)


@dataclasses.dataclass(frozen=True)
class Option:
    """What is said of an option besides its name, type and default."""

    help: str = ""  # without one, `landing-train` has no such option
    limits: tuple[float, float] | None = None  # least and largest value, in the unit of the command line
    open: bool = False  # the limits themselves are excluded
    degrees: bool = False  # on the command line; an angle in rad everywhere else
    kind: Any = None  # type on the command line, where it is another one
    more: dict[str, Any] = dataclasses.field(default_factory=dict)  # further arguments of tyro.conf.arg
    recorded: bool = False  # policy files carry it even at its default
    trained_with: bool = False  # a policy is refused for a task with another value

    def allows(self, value: float) -> bool:
        """Is the value within the limits; those in degrees are of the command line alone."""
        if self.limits is None or self.degrees:
            return True
        low, high = self.limits
        return low < value < high if self.open else low <= value <= high


def option(default: Any, help: str = "", **others: Any) -> Any:
    """Return a field of a record from its default, its help text and other fields of `Option`."""
    return dataclasses.field(default=default, metadata={"option": Option(help, **others)})


@functools.cache
def types_of(record: type) -> dict[str, Any]:
    """Return the types of a record's fields by name."""
    return typing.get_type_hints(record)


@dataclasses.dataclass(frozen=True)
class Record:
    """A record of options."""

    def check(self) -> None:
        """Raise UserError for a value that is not of its type, or beyond its limits."""
        for field, known, kind in fields_of(type(self)):
            value, kinds = getattr(self, field.name), typing.get_args(known.kind or kind) or (kind,)
            if not any(_fits(value, one, known) for one in kinds):
                words = " or ".join(_words(one, known) for one in kinds if one is not types.NoneType)
                raise UserError(f"{field.name} must be {words}, not {shown(repr(value), 40)}")

    def recorded(self) -> dict[str, Any]:
        """Return what a policy file carries of them: what is not at its default, and some always."""
        values = {field.name: getattr(self, field.name) for field in dataclasses.fields(self)}
        return {
            field.name: values[field.name]
            for field, known, _ in fields_of(type(self))
            if known.recorded or values[field.name] != field.default
        }


def _fits(value: Any, kind: Any, known: Option) -> bool:
    if kind is bool or isinstance(value, (bool, np.bool_)):
        return kind is bool and isinstance(value, bool)
    if kind not in (int, float):
        return isinstance(value, kind)
    numbers = (int, np.integer) if kind is int else (int, float, np.integer, np.floating)
    return isinstance(value, numbers) and math.isfinite(value) and known.allows(value)


def _words(kind: Any, known: Option) -> str:
    if kind not in (int, float):
        return {bool: "True or False", str: "a text"}.get(kind, f"a {kind.__name__}")
    low, high = (f"{end:.15g}" for end in known.limits) if known.limits and not known.degrees else ("", "")
    if kind is int and (low, high) == ("2", "3"):
        return "2 or 3"
    ends = f" above {low} and below {high}" if known.open else f" from {low} to {high}"
    return f"a {'whole ' if kind is int else ''}number{ends if low else ''}"


def fields_of(*records: type) -> list[tuple[dataclasses.Field, Option, Any]]:
    """Return the fields of records, each name once, what is said of each, and its type."""
    found: dict[str, tuple[dataclasses.Field, Option, Any]] = {}
    for record in records:
        for field in dataclasses.fields(record):
            kind = types_of(record)[field.name]
            found.setdefault(field.name, (field, field.metadata.get("option") or Option(), kind))
    return list(found.values())


@dataclasses.dataclass(frozen=True)
class TaskOptions(Record):
    """Options that every task has."""

    angle_limit: float | None = option(
        None,
        "Of roll and pitch commands in degrees, where it differs from the vehicle file's.",
        limits=(1, 80),
        degrees=True,
        more={"metavar": "DEG"},
        trained_with=True,
    )
    pwm_centre: float | str = option(
        "hover",
        "PWM at action 0: a number, hover (of the vehicle with its effects), own (of each vehicle that is "
        "drawn, or flown later) or paper (42 000). A policy to go on from is rewritten where it has another.",
        more={
            "metavar": "NUMBER|hover|own|paper",
            "help_behavior_hint": "(default: hover; landing on drawn vehicles the middle of all commands, "
            "35000; with --from the policy's)",
        },
        recorded=True,
    )
    pwm_span: float | None = option(
        None,
        "PWM from action 0 to action 1: wider, for a vehicle whose motors have lost thrust.",
        limits=(1, 65_535),
        more={
            "metavar": "NUMBER",
            "help_behavior_hint": "(default: the vehicle file's, 16500; landing on drawn vehicles up to the "
            "ends of all commands, 25000; with --from the policy's)",
        },
        recorded=True,
    )
    history: int = option(
        0,
        "Past steps, observation and action each, that the policy is given besides the observation (default: "
        "as many as the policy in --from; else landing on drawn vehicles 3, others 0).",
        limits=(0, LONGEST_HISTORY),
    )
    observe_vehicle: bool = option(
        False,
        "Tell the policy six numbers of each vehicle: thrust to weight, lags, gain, drag, reach. One that "
        "goes on from a policy that is told them is too.",
    )


@dataclasses.dataclass(frozen=True)
class Training(Record):
    """What `landing-train` takes where its option of the same name is not given."""

    steps: int | None = option(1_000_000, "Environment steps, fixed beforehand", limits=_MANY)
    success: float | None = option(
        None, "Share of successes, in two evaluations in a row, that ends the run", limits=(0, 1)
    )
    min_steps: int = option(300_000, "Environment steps that such a run has at least", limits=(0, 10**9))
    max_steps: int = option(3_000_000, "Environment steps that such a run has at most", limits=_MANY)
    start_from: str | None = option(
        None,
        "The policy to go on from, a file or a shipped one; {start}",
        more={"name": "from", "metavar": "POLICY"},
    )
    integrator: str = option("implicitfast", "Of the engine in training, 4 ms steps; evaluation uses RK4")
    keep_out: float = option(
        0.04, "Sensor-only zone around the platform that is an obstacle in training, m", limits=(0, 1)
    )
    curriculum: str = option("none", "What eases the task at first; {curricula}")
    environments: int = option(64, "Vehicles stepped together", limits=(1, 16_384))
    rollout: int = option(
        128, "Steps of each vehicle in an iteration; ppo updates after it", limits=(1, 65_536)
    )
    batch_size: int = option(
        512, "Samples in a minibatch, of ppo at most a whole rollout; sac and td3 256", limits=(2, 10**9)
    )
    epochs: int = option(5, "Passes of ppo over each rollout", limits=(1, 1000))
    learning_rate: float = option(
        1e-3,
        "Initial, the curriculum says when it falls; sac and td3 0.001",
        limits=(0, 1),
        open=True,
    )
    gamma: float = option(
        0.99,
        "Discount; paper: from 0.97 to 0.99 over 800 000 steps, as in the curriculum paper anyway",
        kind=float | str,
        more={"metavar": "NUMBER|paper"},
    )
    log_std_init: float = option(-0.4, "Logarithm of the initial exploration noise of ppo", limits=(-10, 2))
