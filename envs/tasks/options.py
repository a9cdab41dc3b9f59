"""Options of tasks as records: the only source of each option's name, type, default and limits.

The record of a task is its class's `options_type`, a frozen dataclass derived from `TaskOptions`. The
constructor takes its fields as keyword arguments, and a policy file carries them as `task_options`.
`Training`, the training defaults of a task, is a record of the same kind.
"""

from __future__ import annotations

import dataclasses
from typing import Annotated, Any

from msgspec import Meta

from inclined_landing.models.base import schema
from inclined_landing.models.base.schema import Many, Share
from inclined_landing.models.scene import Zone

LONGEST_HISTORY = 50  # steps


def option(default: Any, *, recorded: bool = False, trained_with: bool = False) -> Any:
    """Return a field of a record with metadata beyond its type and default.

    recorded: policy files store it even at its default. trained_with: a task with another value refuses the
    policy.
    """
    metadata = {"recorded": recorded, "trained_with": trained_with}
    return dataclasses.field(default=default, metadata=metadata)


@dataclasses.dataclass(frozen=True)
class Record:
    """A record of options."""

    def check(self) -> None:
        """Raise UserError for a value that has the wrong type or exceeds its limits."""
        schema.check(self)

    def recorded(self) -> dict[str, Any]:
        """Return the options that a policy file stores: those that differ from the default, and some more."""
        fields = {field.name: field for field in dataclasses.fields(self)}
        values = {name: getattr(self, name) for name in fields}
        return {
            name: values[name]
            for name, field in fields.items()
            if field.metadata.get("recorded") or values[name] != field.default
        }


@dataclasses.dataclass(frozen=True)
class TaskOptions(Record):
    """Options that every task has."""

    angle_limit: float | None = option(None, trained_with=True)
    """Limit of roll and pitch commands [rad] (default: the vehicle file's)."""
    pwm_centre: float | str = option("hover", recorded=True)
    """PWM at action 0: a number, hover (that of the vehicle with its effects), own (that of each drawn or
    flown vehicle) or paper (42 000)."""
    pwm_span: Annotated[float, Meta(ge=1, le=65_535)] | None = option(None, recorded=True)
    """PWM from action 0 to action 1 (default: the vehicle file's)."""
    history: Annotated[int, Meta(ge=0, le=LONGEST_HISTORY)] = option(0, trained_with=True)
    """Number of past steps, each an observation and an action, in the policy's input."""
    observe_vehicle: bool = option(False, trained_with=True)
    """Let the policy observe six parameters of its vehicle."""


@dataclasses.dataclass(frozen=True)
class Training(Record):
    """Defaults for the options of `landing-train` with the same names."""

    steps: Many | None = 1_000_000
    """Fixed number of environment steps; None: the run ends by success."""
    success: Share | None = None
    """Success rate that ends the run when two evaluations in a row reach it."""
    min_steps: Annotated[int, Meta(ge=0, le=10**9)] = 300_000
    """Minimum number of environment steps of a run that ends by success."""
    max_steps: Many = 3_000_000
    """Maximum number of environment steps of a run that ends by success."""
    start_from: str | None = None
    """Policy to start from: a file, a shipped name, or the feedback law `descent`."""
    integrator: str = "implicitfast"
    """Integrator of the engine in training, with steps of 4 ms."""
    keep_out: Zone = 0.04
    """Width of a contact-free zone around the platform that counts as an obstacle in training [m]."""
    curriculum: str = "none"
    """Name of the curriculum, one of the task's `curricula`."""
    environments: Annotated[int, Meta(ge=1, le=16_384)] = 64
    """Number of vehicles simulated in parallel."""
    rollout: Annotated[int, Meta(ge=1, le=65_536)] = 128
    """Steps of each vehicle between two updates of PPO."""
    batch_size: Annotated[int, Meta(ge=2, le=10**9)] = 512
    """Samples in a minibatch, at most a whole rollout."""
    epochs: Annotated[int, Meta(ge=1, le=1000)] = 5
    """Passes over each rollout."""
    learning_rate: Annotated[float, Meta(gt=0, lt=1)] = 1e-3
    """Initial learning rate; the curriculum determines its decay."""
    gamma: Annotated[float, Meta(gt=0, lt=1)] | str = 0.99
    """Discount factor, or "paper": rising from 0.97 to 0.99 over 800 000 steps."""
    gae_lambda: Share = 0.95
    """Lambda of the generalised advantage estimate."""
    log_std_init: Annotated[float, Meta(ge=-10, le=2)] = -0.4
    """Logarithm of the initial exploration noise."""
