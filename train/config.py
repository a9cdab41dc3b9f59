"""What a training run is made of: one line per field, written to the run folder as it was resolved."""

from __future__ import annotations

import dataclasses
import numbers
import types
import typing
from pathlib import Path
from typing import Annotated

import tyro

from inclined_landing.envs.tasks import TASKS, task_class
from inclined_landing.envs.tasks.base import Training
from inclined_landing.models.errors import UserError, shown
from inclined_landing.models.plants import PLANTS
from inclined_landing.models.scene import INTEGRATORS

# A field of `envs.tasks.base.Training` that is left at None becomes what the task says there.
_OF_THE_TASK = tuple(field.name for field in dataclasses.fields(Training))


@dataclasses.dataclass(frozen=True)
class Range:
    """Which numbers an option takes: from `low` to `high`, without the two where it is `open`."""

    low: float
    high: float
    open: bool = False

    def __contains__(self, value: float) -> bool:
        return self.low < value < self.high if self.open else self.low <= value <= self.high

    def __str__(self) -> str:
        return f"{'between' if self.open else 'from'} {self.low} {'and' if self.open else 'to'} {self.high}"


_MANY = Range(1, 10**9)
_INTERVAL = Range(0, 10**9)


@dataclasses.dataclass
class TrainConfig:
    """Train a policy with Stable-Baselines3 PPO; everything lands in one run folder."""

    task: tyro.conf.Positional[str] = "landing"
    """landing, setpoint or touchdown."""
    out: Path | None = None
    """Run folder (default: runs/TASK-seed)."""
    seed: Annotated[int, Range(0, 2**32 - 1)] = 0
    """Of the policy, the starts and the minibatches; periodic evaluation uses starts of its own."""
    steps: Annotated[int | None, _MANY] = None
    """Environment steps, fixed beforehand (default: 1 200 000 landing, 1 000 000 setpoint,
    1 500 000 touchdown)."""
    start_from: Annotated[str | None, tyro.conf.arg(name="from", metavar="POLICY")] = None
    """touchdown: the landing policy to go on from, a file or a shipped one (default: landing)."""
    vehicle: Annotated[Path | None, tyro.conf.arg(metavar="FILE")] = None
    """Vehicle file (TOML), where it differs from the shipped one; the run keeps a copy."""
    max_seconds: Annotated[float | None, Range(0, 10**9, open=True)] = None
    """Stop at this wall time; the checkpoint allows to resume."""
    resume: bool = False
    """Continue the run in --out from its last checkpoint; task and all else are those of the run."""
    report: bool = True
    """After training: success table, learning curves, figures and the landing video."""

    plant: str = "mujoco"
    """mujoco or analytic."""
    integrator: str | None = None
    """Of the MuJoCo plant while training, 4 ms steps (default: implicitfast, touchdown RK4, in which
    springy contact comes to rest); evaluation always uses RK4."""
    keep_out: Annotated[float | None, Range(0, 1)] = None
    """Sensor-only zone around the platform that counts as obstacle while training [m] (default: 0.04,
    touchdown 0)."""
    threads: Annotated[int, Range(0, 1024)] = 0
    """Physics threads (0: all cores)."""

    curriculum: str | None = None
    """landing: adaptive (default), paper or none; setpoint: effort (default) or none; touchdown:
    touchdown."""
    pwm_centre: str = "hover"
    """PWM at action 0: hover (of the equations) or paper (42 000)."""

    environments: Annotated[int, Range(1, 16_384)] = 64
    """Vehicles stepped together."""
    rollout: Annotated[int, Range(1, 65_536)] = 128
    """Steps of each vehicle between updates."""
    batch_size: Annotated[int, Range(2, 10**9)] = 512
    """Samples in a minibatch, at most a whole rollout of all vehicles."""
    epochs: Annotated[int | None, Range(1, 1000)] = None
    """Passes over each rollout (default: 5, setpoint 8)."""
    learning_rate: Annotated[float | None, Range(0, 1, open=True)] = None
    """Initial; the curriculum says when it falls (default: 1e-3, touchdown 4e-4)."""
    gamma: Annotated[float | None, Range(0, 1, open=True)] = None
    """Discount (default: 0.99, setpoint 0.97); the paper's curriculum sets its own."""
    gae_lambda: Annotated[float, Range(0, 1)] = 0.95
    """Of the advantage estimate."""
    log_std_init: Annotated[float | None, Range(-10, 2)] = None
    """Logarithm of the initial exploration noise (default: -0.4, touchdown -1.2)."""
    entropy: Annotated[float, Range(0, 1)] = 0.0
    """Entropy bonus."""
    reward_scale: Annotated[float, Range(0, 1000, open=True)] = 0.1
    """Rewards are multiplied by this before PPO sees them."""

    evaluate_every: Annotated[int, _INTERVAL] = 20
    """Iterations between evaluations in the plain plant (0: never)."""
    checkpoint_every: Annotated[int, _MANY] = 20
    """Iterations between checkpoints."""
    video_every: Annotated[int, _INTERVAL] = 50
    """Iterations between videos of one flight, as in the paper (0: never)."""

    def resolved(self) -> TrainConfig:
        """A copy with every default filled in and every value checked; raises UserError."""
        self._check_types()
        training = task_class(self.task).training
        if self.plant not in PLANTS:
            raise UserError(f"unknown plant {shown(self.plant, 40)!r}; known are {' and '.join(PLANTS)}")
        if self.integrator not in (None, *INTEGRATORS):
            known = ", ".join(INTEGRATORS)
            raise UserError(f"unknown integrator {shown(self.integrator, 40)!r}; known are {known}")
        if self.start_from is not None and training.start_from is None:
            known = " and ".join(task.name for task in TASKS.values() if task.training.start_from)
            raise UserError(f"--from is for the {known} task; {self.task} is learned from nothing")
        given = {name: getattr(self, name) for name in _OF_THE_TASK}
        filled = {k: getattr(training, k) if value is None else value for k, value in given.items()}
        out = Path(self.out or f"runs/{self.task}-{self.seed}")
        vehicle = None if self.vehicle is None else Path(self.vehicle)
        config = dataclasses.replace(self, out=out, vehicle=vehicle, **filled)
        config._check_ranges()
        samples = config.environments * config.rollout
        if samples == 1:
            raise UserError("--environments and --rollout must give more than one sample")
        config.batch_size = min(config.batch_size, samples)
        if samples % config.batch_size == 1:
            raise UserError("--batch-size leaves a last minibatch of one sample; choose another")
        return config

    def _check_types(self) -> None:
        for name, kind in typing.get_type_hints(TrainConfig).items():
            kinds = typing.get_args(kind) if isinstance(kind, types.UnionType) else (kind,)
            value = getattr(self, name)
            if (isinstance(value, bool) and bool not in kinds) or not isinstance(value, _kinds(kinds)):
                words = " or ".join(_KINDS[kind][1] for kind in kinds if kind in _KINDS)
                raise UserError(f"{_option(name)} must be {words}, not {shown(repr(value), 40)}")

    def _check_ranges(self) -> None:
        for name, kind in typing.get_type_hints(TrainConfig, include_extras=True).items():
            value = getattr(self, name)
            for limits in getattr(kind, "__metadata__", ()):
                if isinstance(limits, Range) and value is not None and value not in limits:
                    raise UserError(f"{_option(name)} must lie {limits}, not {shown(value, 40)}")

    def as_json(self) -> dict:
        """The configuration with JSON types only."""
        paths = {name: str(path) for name in ("out", "vehicle") if (path := getattr(self, name)) is not None}
        return dataclasses.asdict(self) | paths


# What an annotation takes, and what sentences call it.
_KINDS = {
    bool: (bool, "true or false"),
    int: (numbers.Integral, "a whole number"),
    float: (numbers.Real, "a number"),
    str: (str, "text"),
    Path: ((str, Path), "a path"),
}


def _kinds(kinds: tuple) -> tuple:
    return tuple(_KINDS[kind][0] if kind in _KINDS else kind for kind in kinds)


def _option(name: str) -> str:
    return "--from" if name == "start_from" else f"--{name.replace('_', '-')}"
