"""Options of tasks as records: the one source of each option's name, type, default, limits and help.

The record of a task is its class's `options_type`, a frozen dataclass derived from `TaskOptions`. The
constructor takes its fields as keyword arguments, a policy file carries them as `task_options`, and
`landing-train` has an option for every field with a help text. `Training`, the training defaults of a task,
is a record of the same kind.
"""

from __future__ import annotations

import dataclasses
from typing import Annotated, Any

from msgspec import Meta

from inclined_landing.models import schema
from inclined_landing.models.scene import Zone

LONGEST_HISTORY = 50  # steps
Many = Annotated[int, Meta(ge=1, le=10**9)]
Share = Annotated[float, Meta(ge=0, le=1)]


@dataclasses.dataclass(frozen=True)
class Option:
    """What is said of an option besides its name, type and default."""

    help: str = ""  # without one, `landing-train` has no such option
    degrees: bool = False  # on the command line; an angle in rad everywhere else
    kind: Any = None  # type on the command line, with its limits, where it is another one
    more: dict[str, Any] = dataclasses.field(default_factory=dict)  # further arguments of tyro.conf.arg
    recorded: bool = False  # policy files carry it even at its default
    trained_with: bool = False  # a policy is refused for a task with another value


def option(default: Any, help: str = "", **others: Any) -> Any:
    """Return a field of a record from its default, its help text and other fields of `Option`."""
    return dataclasses.field(default=default, metadata={"option": Option(help, **others)})


@dataclasses.dataclass(frozen=True)
class Record:
    """A record of options."""

    def check(self) -> None:
        """Raise UserError for a value that is not of its type, or beyond its limits."""
        schema.check(self)

    def recorded(self) -> dict[str, Any]:
        """Return what a policy file carries of them: what is not at its default, and some always."""
        values = {field.name: getattr(self, field.name) for field in dataclasses.fields(self)}
        return {
            field.name: values[field.name]
            for field, known, _ in fields_of(type(self))
            if known.recorded or values[field.name] != field.default
        }


def fields_of(*records: type) -> list[tuple[dataclasses.Field, Option, Any]]:
    """Return the fields of records, each name once, what is said of each, and its type."""
    found: dict[str, tuple[dataclasses.Field, Option, Any]] = {}
    for record in records:
        for field in dataclasses.fields(record):
            kind = schema.kinds_of(record)[field.name]
            found.setdefault(field.name, (field, field.metadata.get("option") or Option(), kind))
    return list(found.values())


@dataclasses.dataclass(frozen=True)
class TaskOptions(Record):
    """Options that every task has."""

    angle_limit: float | None = option(
        None,
        "Of roll and pitch commands in degrees, where it differs from the vehicle file's.",
        degrees=True,
        kind=Annotated[float, Meta(ge=1, le=80)],
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
    pwm_span: Annotated[float, Meta(ge=1, le=65_535)] | None = option(
        None,
        "PWM from action 0 to action 1: wider, for a vehicle whose motors have lost thrust.",
        more={
            "metavar": "NUMBER",
            "help_behavior_hint": "(default: the vehicle file's, 16500; landing on drawn vehicles up to the "
            "ends of all commands, 25000; with --from the policy's)",
        },
        recorded=True,
    )
    history: Annotated[int, Meta(ge=0, le=LONGEST_HISTORY)] = option(
        0,
        "Past steps, observation and action each, that the policy is given besides the observation (default: "
        "as many as the policy in --from; else landing on drawn vehicles 3, others 0).",
    )
    observe_vehicle: bool = option(
        False,
        "Tell the policy six numbers of each vehicle: thrust to weight, lags, gain, drag, reach. One that "
        "goes on from a policy that is told them is too.",
    )


@dataclasses.dataclass(frozen=True)
class Training(Record):
    """What `landing-train` takes where its option of the same name is not given."""

    steps: Many | None = option(1_000_000, "Environment steps, fixed beforehand")  # noqa: RUF009
    success: Share | None = option(None, "Share of successes, in two evaluations in a row, that ends the run")  # noqa: RUF009
    min_steps: Annotated[int, Meta(ge=0, le=10**9)] = option(
        300_000, "Environment steps that such a run has at least"
    )
    max_steps: Many = option(3_000_000, "Environment steps that such a run has at most")  # noqa: RUF009
    start_from: str | None = option(
        None,
        "The policy to go on from, a file or a shipped one; {start}",
        more={"name": "from", "metavar": "POLICY"},
    )
    integrator: str = option("implicitfast", "Of the engine in training, 4 ms steps; evaluation uses RK4")
    keep_out: Zone = option(0.04, "Sensor-only zone around the platform that is an obstacle in training, m")  # noqa: RUF009
    curriculum: str = option("none", "What eases the task at first; {curricula}")
    environments: Annotated[int, Meta(ge=1, le=16_384)] = option(64, "Vehicles stepped together")
    rollout: Annotated[int, Meta(ge=1, le=65_536)] = option(
        128, "Steps of each vehicle in an iteration; ppo updates after it"
    )
    batch_size: Annotated[int, Meta(ge=2, le=10**9)] = option(
        512, "Samples in a minibatch, of ppo at most a whole rollout; sac and td3 256"
    )
    epochs: Annotated[int, Meta(ge=1, le=1000)] = option(5, "Passes of ppo over each rollout")
    learning_rate: Annotated[float, Meta(gt=0, lt=1)] = option(
        1e-3, "Initial, the curriculum says when it falls; sac and td3 0.001"
    )
    gamma: Annotated[float, Meta(gt=0, lt=1)] | str = option(
        0.99,
        "Discount; paper: from 0.97 to 0.99 over 800 000 steps, as in the curriculum paper anyway",
        more={"metavar": "NUMBER|paper"},
    )
    log_std_init: Annotated[float, Meta(ge=-10, le=2)] = option(
        -0.4, "Logarithm of the initial exploration noise of ppo"
    )
