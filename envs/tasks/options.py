"""Options of tasks as records: the only source of each option's name, type, default and limits.

The record of a task is its class's `options_type`, a frozen dataclass derived from `TaskOptions`. The
constructor takes its fields as keyword arguments, and a policy file carries them as `task_options`.
"""

from __future__ import annotations

import dataclasses
from typing import Annotated, Any, Literal

from msgspec import Meta

from inclined_landing.models.base import schema
from inclined_landing.models.base.errors import UserError

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
class LandingOptions(TaskOptions):
    """Options of the landing task."""

    inclination: float | None = option(None, recorded=True)
    """Platform inclination [rad] (default: the vehicle file's); negative rises towards +x."""
    steepest: float | None = option(None, trained_with=True)
    """Draw a slope for every episode, up to this inclination [rad], in both directions or, in three
    dimensions, in any direction. The policy observes it."""
    dimensions: Literal[2, 3] = option(2, trained_with=True)
    """3: the vehicle flies in space, with roll; 2: in a plane."""
    azimuth: float = 0.0
    """Direction that the slope faces, from +x [rad]."""
    random_yaw: bool = False
    """In three dimensions, draw the initial heading of every episode."""
    fastest: Annotated[float, Meta(ge=0, le=10)] | None = option(None, trained_with=True)
    """In three dimensions, platforms travel in any direction at up to this constant speed [m/s]."""
    swell: Annotated[float, Meta(ge=0, le=2)] = option(0.0, trained_with=True)
    """With `fastest`, platforms also heave, roll and pitch; 1 is up to 0.24 m and 16 deg."""

    def check(self) -> None:
        """Raise UserError for a value beyond its limits, or for options that cannot be combined."""
        super().check()
        if self.dimensions == 2 and (self.azimuth or self.random_yaw):
            named = "azimuth" if self.azimuth else "random_yaw"
            raise UserError(f"{named} needs dimensions=3: in the plane a vehicle cannot follow it")
        if self.fastest is None and self.swell:
            raise UserError("swell applies to moving platforms: set fastest too (0 is allowed)")
        if self.fastest is not None and self.dimensions == 2:
            raise UserError("fastest needs dimensions=3: in the plane a vehicle cannot follow a platform")
